// edges: the time of each encoder's last edge, and its number of illegal transitions. It works
// beside a wide counter and shares its rotation.
//
// A channel stores the four low bits of time at its last edge; its visit extends them to 24,
// because the edge is at most one rotation old. Like the counts, a sample is exact to its clock: an
// edge after the strobe is not in it. So count and time of one sample belong together, and a
// velocity can be computed from them.
//
//   moved[n]    pulse: the count changes in this clock
//   illegal[n]  pulse: both lines changed at once
//   now         low bits of the wall clock
//   sampled     {errors 31:24, edge_time 23:0} at the strobe, valid 18 clocks after it; read without a clock at `addr`
//
// edge_time is `now` of the clock in which the count last changed, 0 before the first. errors
// counts illegal transitions and wraps at 256; those of one channel within one rotation of 16
// clocks count once.
//
`default_nettype none
module edges #(
    parameter integer CHANNELS = 16  // the same as the wide counter's
) (
    input  wire                clk,
    input  wire [15:0]         turn,      // wide_counter.turn
    input  wire                sampling,  // wide_counter.sampling
    input  wire                sample,    // the strobe
    input  wire [CHANNELS-1:0] moved,
    input  wire [CHANNELS-1:0] illegal,
    input  wire [23:0]         now,
    input  wire [3:0]          addr,
    output wire [31:0]         sampled
`ifdef FORMAL
    , input wire [3:0] f_channel
`endif
);
    logic [3:0] at   = 4'd0;
    logic [3:0] behind = 4'd15;

    logic [4*CHANNELS-1:0] stamp        = {4*CHANNELS{1'b0}};  // `at` in the clock of the edge
    logic [4*CHANNELS-1:0] stamp_caught = {4*CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   seen         = {CHANNELS{1'b0}};    // an edge since the last visit
    logic [CHANNELS-1:0]   seen_caught  = {CHANNELS{1'b0}};
    // an illegal transition since the last visit
    logic [CHANNELS-1:0]   wrong        = {CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   wrong_caught = {CHANNELS{1'b0}};

    integer n;
    always_ff @(posedge clk) begin
        at   <= at + 4'd1;
        behind <= at;
        for (n = 0; n < CHANNELS; n = n + 1) begin
            if (moved[n]) stamp[4*n +: 4] <= at;
            seen[n]  <= moved[n] | (seen[n] & ~turn[n]);
            wrong[n] <= illegal[n] | (wrong[n] & ~turn[n]);
            if (sample) stamp_caught[4*n +: 4] <= stamp[4*n +: 4];
            // Written like this they become LUTs and not flip-flops with a reset of their own for
            // each channel (decision 10).
            seen_caught[n]  <= ~turn[n] & (sample ? seen[n] : seen_caught[n]);
            wrong_caught[n] <= ~turn[n] & (sample ? wrong[n] : wrong_caught[n]);
        end
    end

    // Eight channels' words are merged in front of one register: as in wide_counter.sv.
    localparam GROUPS = (CHANNELS + 7) / 8;
    logic [4*GROUPS-1:0] stamp_shown = {4*GROUPS{1'b0}}, stamp_caught_shown = {4*GROUPS{1'b0}};
    logic [GROUPS-1:0]   seen_shown = {GROUPS{1'b0}}, seen_caught_shown = {GROUPS{1'b0}};
    logic [GROUPS-1:0]   wrong_shown = {GROUPS{1'b0}}, wrong_caught_shown = {GROUPS{1'b0}};
    logic [4*GROUPS-1:0] stamp_met, stamp_caught_met;
    logic [GROUPS-1:0]   seen_met, seen_caught_met, wrong_met, wrong_caught_met;
    logic [3:0]          edge_at, edge_at_caught;

    always_comb begin
        stamp_met        = {4*GROUPS{1'b0}};
        stamp_caught_met = {4*GROUPS{1'b0}};
        seen_met         = {GROUPS{1'b0}};
        seen_caught_met  = {GROUPS{1'b0}};
        wrong_met        = {GROUPS{1'b0}};
        wrong_caught_met = {GROUPS{1'b0}};
        for (int c = 0; c < CHANNELS; c++) begin
            stamp_met[4*(c/8) +: 4]        = stamp_met[4*(c/8) +: 4] | ({4{turn[c]}} & stamp[4*c +: 4]);
            stamp_caught_met[4*(c/8) +: 4] = stamp_caught_met[4*(c/8) +: 4] | ({4{turn[c]}} & stamp_caught[4*c +: 4]);
            seen_met[c/8]                  = seen_met[c/8] | (turn[c] & seen[c]);
            seen_caught_met[c/8]           = seen_caught_met[c/8] | (turn[c] & seen_caught[c]);
            wrong_met[c/8]                 = wrong_met[c/8] | (turn[c] & wrong[c]);
            wrong_caught_met[c/8]          = wrong_caught_met[c/8] | (turn[c] & wrong_caught[c]);
        end
    end

    always_ff @(posedge clk) begin
        stamp_shown        <= stamp_met;
        stamp_caught_shown <= stamp_caught_met;
        seen_shown         <= seen_met;
        seen_caught_shown  <= seen_caught_met;
        wrong_shown        <= wrong_met;
        wrong_caught_shown <= wrong_caught_met;
    end

    always_comb begin
        edge_at        = 4'd0;
        edge_at_caught = 4'd0;
        for (int g = 0; g < GROUPS; g++) begin
            edge_at        = edge_at | stamp_shown[4*g +: 4];
            edge_at_caught = edge_at_caught | stamp_caught_shown[4*g +: 4];
        end
    end

    logic [23:0] times         [0:15];
    logic [7:0]  errors        [0:15];
    logic [31:0] samples       [0:15];
    assign sampled = samples[addr];

    // The edge was 1 to 16 clocks before the visit, so its time is visit - 16 + (edge_at - at
    // modulo 16).
    logic [23:0] visited = 24'd0, time_old = 24'd0;
    logic [7:0]  errors_old = 8'd0;
    logic        to_sample = 1'b0;
    wire  [3:0]  ago = edge_at - behind, ago_caught = edge_at_caught - behind;
    wire  [23:0] time_new    = visited + {20'hFFFFF, ago};
    wire  [23:0] time_caught = visited + {20'hFFFFF, ago_caught};

    always_ff @(posedge clk) begin
        visited    <= now;
        time_old   <= times[at];
        errors_old <= errors[at];
        to_sample  <= sampling;
        if (|seen_shown) times[behind] <= time_new;
        if (|wrong_shown) errors[behind] <= errors_old + 8'd1;
        if (to_sample) samples[behind] <= {errors_old + {7'd0, |wrong_caught_shown}, |seen_caught_shown ? time_caught : time_old};
    end

    initial begin
        for (int i = 0; i < 16; i++) begin
            times[i]   = 24'd0;
            errors[i]  = 8'd0;
            samples[i] = 32'd0;
        end
    end

`ifdef FORMAL  // what gateware/formal proves for any one channel
    logic [23:0] f_time = 0, f_time_sampled = 0;
    logic [7:0]  f_errors = 0, f_errors_sampled = 0;
    logic        f_wrong = 0, f_waits = 0, f_started = 0;
    logic [4:0]  f_since = 31;  // clocks since the strobe
    wire         f_here = at == f_channel;
    always_ff @(posedge clk) begin
        f_started <= 1;
        f_since   <= sample ? 1 : &f_since ? f_since : f_since + 1;
        f_waits   <= sample | (f_waits & ~f_here);
        f_wrong   <= illegal[f_channel] | (f_wrong & ~f_here);
        if (moved[f_channel]) f_time <= now;
        if (illegal[f_channel] & (f_here | ~f_wrong)) f_errors <= f_errors + 1;
        if (sample) {f_time_sampled, f_errors_sampled} <= {f_time, f_errors};
    end

    wire        f_behind = behind == f_channel;
    wire [23:0] f_old    = f_behind ? |seen_shown ? time_new : time_old : times[f_channel];
    wire [7:0]  f_count  = f_behind ? errors_old + {7'd0, |wrong_shown} : errors[f_channel];
    wire [3:0]  f_gone   = at - f_channel - 4'd1, f_coming = f_channel - at;
    wire [23:0] f_ago = now - f_time - 24'd1, f_ago_sampled = now - f_time_sampled - 24'd1;
    wire [3:0]  f_stamp = stamp[4*f_channel +: 4], f_stamp_caught = stamp_caught[4*f_channel +: 4];
    integer j;
    always_comb begin
        assume (sampling == (f_since <= 16));  // proven for the wide counter
        assert (f_since != 0 & behind == at - 4'd1 & turn == 16'd1 << at);
        assert (f_waits == (sampling & {1'b0, f_coming} <= 5'd16 - f_since));
        assert (f_started ? visited == now - 24'd1 : {seen_shown, seen_caught_shown} == 0);
        for (j = 0; j < GROUPS; j = j + 1)
            assert (behind >> 3 == j | {stamp_shown[4*j +: 4], stamp_caught_shown[4*j +: 4], seen_shown[j], seen_caught_shown[j], wrong_shown[j], wrong_caught_shown[j]} == 0);
        // Either the last edge came after the visit, and the stamp has its time; or before it, and
        // the RAM has it.
        if (seen[f_channel]) assert (f_ago <= {20'd0, f_gone} & f_stamp == at - 4'd1 - f_ago[3:0]);
        else assert (f_time == f_old);
        assert (f_wrong == wrong[f_channel] & f_errors == f_count + {7'd0, f_wrong});
        if (f_waits) begin
            if (seen_caught[f_channel]) assert (f_ago_sampled <= {20'd0, f_gone} & f_stamp_caught == at - 4'd1 - f_ago_sampled[3:0]);
            else assert (f_time_sampled == f_old);
            assert (f_errors_sampled == f_count + {7'd0, wrong_caught[f_channel]});
        end else if (f_behind & to_sample)
            assert ({f_errors_sampled, f_time_sampled} == {errors_old + {7'd0, |wrong_caught_shown}, |seen_caught_shown ? time_caught : time_old});
        else assert ({f_errors_sampled, f_time_sampled} == samples[f_channel]);
        assert (addr != f_channel | f_since < 18 | sampled == {f_errors_sampled, f_time_sampled});
    end
`endif
endmodule
`default_nettype wire
