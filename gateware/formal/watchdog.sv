// The guarantees of the watchdog, seen from outside: arbitrary pins, tokens and keys in every
// clock, arbitrary but constant times.
`default_nettype none
module watchdog_promises (
    input wire        clk,
    input wire        rst, ext_reset, estop, token_we, feed, arm, soft_stop, shut, clear, all_stopped,
    input wire [31:0] token
);
    (* anyconst *) logic [31:0] timeout;
    (* anyconst *) logic [31:0] grace;
    logic        gate, stop, bitten, reset_latched, estop_latched, armed, cleared;
    logic  [3:0] last_close;
    logic [31:0] remaining, last_token, bites;
    watchdog core (.*);

    // One clock ago.
    logic        started = 1'b0, was_gate, was_stop, was_armed, was_bitten, was_reset_latched, was_estop_latched;
    logic        was_rst, was_ext_reset, was_estop, was_arm, was_soft_stop, was_shut, was_clear, was_all_stopped;
    logic  [3:0] was_close;
    logic [31:0] was_remaining, was_bites;
    always_ff @(posedge clk) begin
        started <= 1'b1;
        {was_gate, was_stop, was_armed, was_bitten, was_reset_latched, was_estop_latched} <= {gate, stop, armed, bitten, reset_latched, estop_latched};
        {was_rst, was_ext_reset, was_estop, was_arm, was_soft_stop, was_shut, was_clear, was_all_stopped} <= {rst, ext_reset, estop, arm, soft_stop, shut, clear, all_stopped};
        {was_close, was_remaining, was_bites} <= {last_close, remaining, bites};
    end
    wire pins     = ext_reset | estop;
    wire was_pins = was_ext_reset | was_estop;

    // A heartbeat is a token that differs from the last one written, a command of the fast path,
    // and an arming. `silence` counts the clocks without one.
    logic [31:0] heard = 32'd0;
    logic [32:0] silence = 33'd0, stopping = 33'd0;
    wire         heartbeat = (token_we & (token != heard)) | feed;
    always_ff @(posedge clk) begin
        if (token_we) heard <= token;
        silence  <= (heartbeat | ~armed) ? 33'd0 : silence + 33'd1;
        stopping <= stop ? stopping + 33'd1 : 33'd0;
    end

    always_ff @(posedge clk) begin
`ifndef BROKEN
        // Links the proofs: open is either awake or stopping, never both, and the counter is the
        // remaining time.
        assert (gate == ((armed | stop) & ~pins));
        assert (~(armed & stop));
        assert (heard == last_token);
        assert (~armed | ~(bitten | reset_latched | estop_latched));
        assert (~stop | ~(reset_latched | estop_latched));
        assert (~armed | {1'b0, remaining} + silence == {1'b0, timeout});
        assert (~stop | {1'b0, remaining} + stopping == {1'b0, grace});
`endif

`ifdef PROVE_bitten_stays_bitten_until_cleared_behind_a_closed_gate
        if (started & was_bitten & ~bitten) assert (was_rst | (was_clear & ~was_gate & ~was_armed & ~was_stop & ~was_pins));
`endif
`ifdef PROVE_a_repeated_token_is_no_heartbeat
        assert (~armed | silence <= {1'b0, timeout});
`endif
`ifdef PROVE_silence_bites
        if (started & was_armed & was_remaining == 32'd0 & silence != 33'd0 & ~was_rst) assert (bitten);
        if (started & was_armed & ~armed) assert (bitten | was_soft_stop | was_shut | was_rst | was_pins);
        if (started & ~was_bitten & bitten) assert (was_armed & bites == was_bites + 32'd1);
`endif
`ifdef PROVE_the_grace_ends
        assert (~stop | stopping <= {1'b0, grace});
        if (started & was_stop & was_all_stopped) assert (~gate);
`endif
`ifdef PROVE_the_gate_closes_in_the_clock_of_a_pin_and_stays_closed
        if (pins) assert (~gate);
        if (started & was_pins) assert (~gate);
`endif
`ifdef PROVE_nothing_opens_the_gate_but_arm_with_nothing_latched
        if (started & gate & ~was_gate)
            assert (was_arm & ~was_bitten & ~was_reset_latched & ~was_estop_latched & ~was_pins & ~was_rst & ~was_shut);
        if (started & (was_shut | was_rst)) assert (~gate);
`endif
`ifdef PROVE_an_estop_stays_latched_until_released_and_cleared
        if (started & was_estop) assert (estop_latched);
        if (started & was_estop_latched & ~estop_latched) assert (was_clear & ~was_pins & ~was_gate);
`endif
`ifdef PROVE_last_close_says_why
        if (started & (was_armed | was_stop) & ~(armed | stop)) begin
            // The order of reasons: a pin, then a bite that began the stop, then a command;
            // otherwise a soft stop is over.
            if (was_estop) assert (last_close == 4'd5);
            else if (was_ext_reset) assert (last_close == 4'd2);
            else if (was_bitten | was_bites != bites) assert (last_close == 4'd1);
            else if (was_rst) assert (last_close == 4'd6);
            else if (was_shut) assert (last_close == 4'd3);
            else assert (last_close == 4'd4 & was_stop & (was_all_stopped | was_remaining == 32'd0));
        end else if (started) assert (last_close == was_close);
        else assert (last_close == 4'd0);
`endif
    end
endmodule
`default_nettype wire
