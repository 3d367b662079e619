// The edge words of one channel, for the proofs. The rotation is the wide counter's; the wall clock
// begins anywhere.
//
// The channel is any one at reduced width. A solver does not finish with any of 16, so at full
// width it is the last one, and the other 15 have arbitrary inputs. The channels are iterations of
// one loop in edges.sv, which uses their number only for the group of eight: the last one is in the
// second group, those at reduced width are in the first. A broken core shows when the rotation has
// reached the channel, 16 clocks from power-up. CHANNEL=0 holds at full width, too (WIDTH
// CHANNEL=0).
`default_nettype none
module edges_promises #(
    parameter integer CHANNELS = 16,
    parameter integer CHANNEL = CHANNELS == 16 ? 15 : -1  // -1: any
) (
    input wire        clk, sample, sampling,
    input wire [CHANNELS-1:0] moved, illegal
);
    (* anyconst *) logic [3:0]  any;
    wire [3:0] channel = CHANNEL < 0 ? any : 4'(CHANNEL);
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
