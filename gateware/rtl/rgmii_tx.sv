// rgmii_tx: sends bytes at 1000, 100 or 10 Mbit/s, and keeps the gap between two frames.
//
// At 1000 it sends a byte per clock, low nibble first. At the lower speeds it sends a nibble per
// clock on both edges, so a byte every second clock. The speed changes only between frames. After a
// frame it takes no byte for 12 byte times, 96 bits.
//
//   1000    clk    _/‾\_/‾\_/‾\_         100, 10    clk    _/‾\_/‾\_/‾\_/‾\_
//           data   -X a1X b2X--                     data   -X a1    X b2    X--
//           ready  ‾‾‾‾‾‾‾‾‾‾‾\_                    ready  _____/‾‾‾\___/‾‾‾\_
//           rise   -----X 1 X 2 X                   rise   -----X 1 X a X 2 X b X
//           fall   -----X a X b X                   fall   -----X 1 X a X 2 X b X
//
`default_nettype none
module rgmii_tx (
    input  wire        clk,
    input  wire        slow,
    input  wire        valid,
    input  wire        last,
    input  wire  [7:0] data,
    output wire        ready,
    output logic [3:0] rise,
    output logic [3:0] fall,
    output logic       ctl      // the same on both edges: no TX_ER
);
    logic       halves = 1'b0;  // `slow`, as it was when the frame began
    logic       second = 1'b0;  // the high nibble is next
    logic [5:0] rest = 6'd0;    // counts up to 64 while bit 5 is set
    initial begin
        rise = 4'd0;
        fall = 4'd0;
        ctl  = 1'b0;
    end

    wire sending = valid & ~rest[5];
    assign ready = ~rest[5] & (~halves | second);

    always_ff @(posedge clk) begin
        if (~sending) halves <= slow;
        second <= sending & halves & ~second;
        ctl    <= sending;
        rise   <= (halves & second) ? data[7:4] : data[3:0];
        fall   <= (halves & ~second) ? data[3:0] : data[7:4];
        if (rest[5]) rest <= rest + 6'd1;
        else if (sending & ready & last) rest <= halves ? 6'd40 : 6'd52;
    end
endmodule
`default_nettype wire
