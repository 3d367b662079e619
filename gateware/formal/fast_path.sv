// The fast path behind the watchdog, wired as in gateware/ferrocnc/banks.py. Firmware keeps to what
// firmware/src/pass.rs does: a pass that commits is for a live gate, and its condition stays while
// the pass is out. All else is what host and firmware like.
`default_nettype none
module fast_path_behind_the_gate (
    input wire        clk, rst, ext_reset, estop, token_we, arm, soft_stop, shut, clear, all_stopped,
    input wire [31:0] token, timeout, grace,
    input wire        run_we, executes, timed, pass, revoke, valid, last, whole, bad, like_high, like_low, waiting, free,
    input wire [3:0]  run_at,
    input wire [18:0] run,
    input wire [15:0] ip_sum, udp_sum,
    input wire [7:0]  gate_as,
    input wire [31:0] data,
    input wire [4:0]  at, select
);
    localparam logic [7:0] LIVE = 8'b0010_0001;  // open and armed, and nothing else
    wire gate, stop, bitten, reset_latched, estop_latched, armed, taken, take, commit, commit_timed, out, hold;
    watchdog dog (.clk(clk), .rst(rst), .ext_reset(ext_reset), .estop(estop), .token_we(token_we), .token(token), .feed(taken), .arm(arm), .soft_stop(soft_stop),
        .shut(shut), .clear(clear), .timeout(timeout), .grace(grace), .all_stopped(all_stopped), .gate(gate), .stop(stop), .bitten(bitten),
        .reset_latched(reset_latched), .estop_latched(estop_latched), .armed(armed), .cleared(), .last_close(), .remaining(), .last_token(), .bites());
    wire [7:0] now = {estop, estop_latched, armed, ext_reset, reset_latched, bitten, stop, gate};
    fast_path core (.clk(clk), .rst(rst), .run_we(run_we), .run_at(run_at), .run(run), .ip_sum(ip_sum), .udp_sum(udp_sum), .gate_as(gate_as), .executes(executes),
        .timed(timed), .pass(pass), .revoke(revoke), .valid(valid), .last(last), .whole(whole), .bad(bad), .data(data), .at(at), .like_high(like_high),
        .like_low(like_low), .gate_now(now), .waiting(waiting), .select(select), .free(free), .stages(), .to(), .take(take), .taken(taken), .commit(commit),
        .commit_timed(commit_timed), .gathers_next(), .from_next(), .puts(), .put_at(), .hold(hold), .out(out), .executed());

    // The gate has not been live in every clock since firmware armed last. Why does not matter: a
    // bite, a pin, a stop, a reset.
    logic       dead = 1'b1, was_dead = 1'b1, kept = 1'b0, was_executes = 1'b0;
    logic [7:0] was_as = 8'd0;
    logic [1:0] closed = 2'd0;  // it has been live, was not, and is again
    always_ff @(posedge clk) begin
        dead     <= ~arm & (dead | now != LIVE);
        was_dead <= dead;
        kept     <= out | hold;
        {was_executes, was_as} <= {executes, gate_as};
        closed   <= {closed[1] | (closed[0] & bitten), closed[0] | (now == LIVE)};
    end
    always_comb begin
        assume (~executes | gate_as == LIVE);
        assume (~kept | (executes == was_executes & gate_as == was_as));
`ifdef PROVE_a_gate_that_was_not_live_lets_nothing_be_committed_until_firmware_arms
        if (dead) assert (~(take & executes));
        if (commit | commit_timed) assert (~was_dead);
`endif
`ifdef PROVE_a_command_is_committed_once_firmware_has_armed_behind_a_bite
        cover (closed[1] & commit);
`endif
`ifndef BROKEN
        assert (~dead | now != LIVE);
        assert (~kept | ~taken | ~executes | ~was_dead);
        assert (~taken | kept);
`endif
    end
endmodule
`default_nettype wire
