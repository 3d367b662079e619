// The guarantees of the timebase: a timed commit comes at its time, or at once when that is past,
// and never twice.
`default_nettype none
module timebase_promises (
    input wire        clk,
    input wire        rst, commit_now, sample_now, commit_timed,
    input wire [63:0] commit_at
);
    logic [63:0] now;
    logic        commit, sample, pending;
    timebase core (.*);

    // The register before the core: stable from the clock before the strobe until the commit has
    // come or is replaced. Writing it earlier is allowed as what it is, a new time for what waits;
    // the `live` proof holds that, with no assumption at all.
    logic        started = 1'b0, wanted = 1'b0, was_rst;
    // the request's time, and the clock after its strobe
    logic [63:0] was_at, was_now, asked_at, asked_now;
    always_ff @(posedge clk) begin
        started  <= 1'b1;
        was_at   <= commit_at;
        was_now  <= now;
        was_rst  <= rst;
        if (rst) wanted <= 1'b0;
        else if (commit_timed) wanted <= 1'b1;
        // by itself or with a commit in this clock
        else if (commit & now >= was_at) wanted <= 1'b0;
        if (commit_timed) asked_at <= commit_at;
        if (commit_timed) asked_now <= now + 64'd1;
    end
    wire by_time = commit & ~commit_now;  // a commit without a request in this clock

`ifdef PROVE_exactly_at_its_time_or_at_once_when_past
    always_comb begin
        if (commit_timed) assume (commit_at == was_at & started);
        if (wanted & ~commit_timed) assume (was_at == asked_at);
        assume (now != 64'hFFFFFFFFFFFFFFFF);  // the clock does not wrap
    end
`endif
    always_ff @(posedge clk) begin
`ifndef BROKEN
        assert (pending == wanted);
`endif
        if (started) assert (now == was_now + 64'd1);
        assert (sample == sample_now);
        if (commit_now) assert (commit);
`ifdef PROVE_exactly_at_its_time_or_at_once_when_past
        if (by_time) assert (now == asked_at | (now == asked_now & asked_at < now));
        if (wanted & ~commit_timed & ~commit_now) assert (commit == (now >= asked_at));
`endif
`ifdef PROVE_one_request_commits_once
        if (by_time) assert (wanted & ~commit_timed);
        if (started & was_rst & by_time) assert (1'b0);
`endif
`ifdef PROVE_live_register
        if (started) assert (commit == (commit_now | (wanted & ~commit_timed & now >= was_at)));
`endif
    end
endmodule
`default_nettype wire
