// The edge words of any one channel, for the proofs. The rotation is the tally's; the wall clock begins anywhere.
`default_nettype none
module edges_promises #(
    parameter integer CHANNELS = 16
) (
    input wire        clk, sample, sampling,
    input wire [CHANNELS-1:0] moved, illegal
);
    (* anyconst *) logic [3:0]  channel;
    (* anyconst *) logic [23:0] began;
    logic [23:0] clocks = 0;
    logic [15:0] turn = 1;
    wire  [31:0] sampled;
    always_ff @(posedge clk) begin
        clocks <= clocks + 24'd1;
        turn   <= {turn[14:0], turn[15]};
    end
    always_comb assume (channel < CHANNELS);
    edges #(.CHANNELS(CHANNELS)) core (.clk(clk), .turn(turn), .sampling(sampling), .sample(sample), .moved(moved), .illegal(illegal),
        .now(began + clocks), .addr(channel), .sampled(sampled), .f_channel(channel));
endmodule
`default_nettype wire
