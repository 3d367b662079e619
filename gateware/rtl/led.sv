// led: tells the four states of a board apart from across the room.
//
//   0 off      ________________________
//   1 on       ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾
//   2 slow     ____________‾‾‾‾‾‾‾‾‾‾‾‾
//   3 fast     ___‾‾‾___‾‾‾___‾‾‾___‾‾‾
//   4 double   ‾‾‾___‾‾‾_______________
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
    wire [2:0] slot = count[BITS-1:BITS-3];
    initial lit = 1'b0;

    always_ff @(posedge clk) begin
        count <= count + {{(BITS-1){1'b0}}, 1'b1};
        case (pattern)
            3'd1:    lit <= 1'b1;
            3'd2:    lit <= slot[2];
            3'd3:    lit <= slot[0];
            3'd4:    lit <= (slot == 3'd0) | (slot == 3'd2);
            default: lit <= 1'b0;
        endcase
    end
endmodule
`default_nettype wire
