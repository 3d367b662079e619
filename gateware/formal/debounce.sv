// A group of two lines and any constant filter for the proofs; the guarantees are beside the logic
// in debounce.sv.
`default_nettype none
module debounce_promises (
    input wire       clk,
    input wire [1:0] lines
);
    (* anyconst *) logic [7:0] filter;
    wire [1:0] level;
    wire       known;
    debounce #(.LINES(2)) core (.clk(clk), .lines(lines), .filter(filter), .level(level), .known(known), .f_was(), .f_still());
endmodule
`default_nettype wire
