// An encoder with any constant mode and filter for the proofs; the guarantees are beside the logic
// in encoder.sv.
`default_nettype none
module encoder_promises (
    input wire clk, a, b, index, mask, visit
);
    (* anyconst *) logic [7:0] mode, filter;
    wire [4:0] delta;
    wire       index_level, moved, illegal;
    encoder core (.*);
endmodule
`default_nettype wire
