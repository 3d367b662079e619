// The shared counts and any one of their channels, with its latch, for the proofs. The other
// channels have arbitrary inputs.
`default_nettype none
module wide_counter_promises (
    input wire        clk, sample, arm_index, arm_probe, index, probe, wants_clear,
    input wire        moves, down,
    input wire [79:0] others,
    input wire [15:0] other_captures, other_clears
);
    (* anyconst *) logic [3:0] channel;
    wire  [15:0] mine = 16'd1 << channel;
    wire  [15:0] visit, pending, turn;
    wire  [31:0] sampled, latched, f_latched;
    wire         capture, index_latched, probe_latched, sampling;

    // The behaviour of a stepgen or an encoder: it counts by one, and restarts when visited.
    logic [4:0]  delta = 0;
    logic [31:0] position = 0;
    wire  [31:0] move = ~moves ? 0 : down ? -1 : 1;
    wire         clears = capture & wants_clear;
    always_ff @(posedge clk) begin
        delta    <= ((visit & mine) != 0 ? 5'd0 : delta) + move[4:0];
        position <= (clears ? 0 : position) + move;
    end
    always_comb assume (~moves | (visit & mine) != 0 | delta != (down ? 5'h10 : 5'h0F));

    wire [79:0] mask = 80'h1F << 5 * channel;
    wide_counter core (
        .clk(clk), .sample(sample), .addr(channel), .delta((others & ~mask) | ({75'd0, delta} << 5 * channel)),
        .capture((other_captures & ~mine) | (capture ? mine : 16'd0)), .clear((other_clears & ~mine) | (clears ? mine : 16'd0)),
        .visit(visit), .pending(pending), .turn(turn), .sampling(sampling), .sampled(sampled), .latched(latched),
        .f_channel(channel), .f_position(position), .f_latched(f_latched));
    latch gate (
        .clk(clk), .arm_index(arm_index), .arm_probe(arm_probe), .index(index), .probe(probe), .pending((pending & mine) != 0),
        .capture(capture), .index_latched(index_latched), .probe_latched(probe_latched));

    // The host's view: a flag, and with it the count at the clock of the capture.
    always_comb begin
        assert (~capture | (pending & mine) == 0);
`ifdef PROVE_a_latched_flag_shows_the_count_at_the_capture
        if (index_latched | probe_latched) assert (latched == f_latched);
`endif
    end
endmodule
`default_nettype wire
