// spi: clocks 1 to 32 bits out of and into the flash, most significant first, mode 0, a quarter of the core clock.
//
// It knows no flash: firmware selects, writes words and polls `busy`. What it promises is the order of the wires: SCK never
// moves while CS is high, and a transfer has as many clocks as its length says.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_
//   start    _/‾‾\________________________________________    one clock; `data` and `length` with it
//   busy     ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_________
//   mosi     ----X bit 1         X bit 0         X--------
//   sck      ____________/‾‾‾‾‾‾‾\_______/‾‾‾‾‾‾‾\________
//   miso     ----X bit 1         X bit 0         X--------    the flash changes it after a fall
//   sampled  ________________|_______________|____________    a clock after the rise
//
// MISO is taken three clocks after the fall that made it (50 ns at 60 MHz, the flash needs 8 and the way there and back some
// 12) and a clock before the next one. CS is high for at least four clocks (67 ns, the flash asks for 50); a start before it
// has fallen waits for it, and CS stays low until a transfer is over, so firmware need not count. A start while busy, or
// while not selected, is ignored.
//
`default_nettype none
module spi (
    input  wire         clk,
    input  wire         select,    // level: 1 pulls CS low
    input  wire         start,
    input  wire  [31:0] data,      // bit 31 leaves first
    input  wire  [4:0]  length,    // bits; 0 is 32
    output logic        busy,
    output wire  [31:0] received,  // the last bit in is bit 0; above them what was not sent
    output logic        cs_n,
    output wire         sck,
    output wire         mosi,
    input  wire         miso
);
    logic [31:0] shift = 32'd0;
    logic [4:0]  left = 5'd0;    // bits after this one
    logic [1:0]  phase = 2'd0;   // of the bit; while CS is high, how long it has been
    logic        bit_in = 1'b0;
    logic        high = 1'b0;    // SCK, a flip-flop: no glitch leaves
    initial busy = 1'b0;
    initial cs_n = 1'b1;

    wire moves   = busy & ~cs_n;
    wire rested  = cs_n & (phase == 2'd3);
    wire ends    = moves & (phase == 2'd3);
    wire accepts = start & select & ~busy;

    assign received = shift;
    assign sck  = high;
    assign mosi = shift[31];

    always_ff @(posedge clk) begin
        busy <= accepts | (busy & ~(ends & (left == 5'd0)));
        if (cs_n) cs_n <= ~(rested & (select | busy));
        else cs_n <= ~(select | busy);

        if (rested) phase <= {2{~(select | busy)}};
        else if (cs_n | moves) phase <= phase + 2'd1;

        high <= moves & ((phase == 2'd1) | (phase == 2'd2));
        if (moves & (phase == 2'd2)) bit_in <= miso;
        if (accepts) begin
            shift <= data;
            left  <= length - 5'd1;
        end else if (ends) begin
            shift <= {shift[30:0], bit_in};
            left  <= left - 5'd1;
        end
    end
endmodule
`default_nettype wire
