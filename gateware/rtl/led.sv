// led: blink patterns for the states of a board, visible from a distance.
//
//   0 off      ________________________
//   1 on       ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾
//   2 slow     ____________‾‾‾‾‾‾‾‾‾‾‾‾
//   3 fast     ___‾‾‾___‾‾‾___‾‾‾___‾‾‾
//   4 double   ‾‾‾___‾‾‾_______________
//   5 triple   ‾‾‾___‾‾‾___‾‾‾_________
//   6 beat     ‾‾__‾‾__________________
//   7 flicker  ‾_‾_‾_‾_‾_‾_‾_‾_‾_‾_‾_‾_    16 blinks
//              |------ 2^BITS clocks -----|    about a second
//
`default_nettype none
module led #(
    parameter integer BITS = 26
) (
    input  wire       clk,
    input  wire [2:0] pattern,
    output logic      lit
);
    logic [BITS-1:0] count = {BITS{1'b0}};
    wire [4:0] slot = count[BITS-1:BITS-5];  // 32 in a round
    initial lit = 1'b0;

    always_ff @(posedge clk) begin
        count <= count + {{(BITS-1){1'b0}}, 1'b1};
        case (pattern)
            3'd0: lit <= 1'b0;
            3'd1: lit <= 1'b1;
            3'd2: lit <= slot[4];
            3'd3: lit <= slot[2];
            3'd4: lit <= ~slot[4] & ~slot[2];
            3'd5: lit <= ~(slot[4] & slot[3]) & ~slot[2];
            3'd6: lit <= (slot[4:1] == 4'd0) | (slot[4:1] == 4'd2);
            3'd7: lit <= ~slot[0];
        endcase
    end
endmodule
`default_nettype wire
