// spi: shifts 1 to 32 bits out to the flash and in from it, most significant first, mode 0, a
// quarter of the core clock.
//
// It does not know flash commands: the firmware selects, writes words and polls `busy`. It
// guarantees the order of the wires: SCK never moves while CS is high, and a transfer has exactly
// as many clocks as its length.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_
//   start    _/‾‾\________________________________________    one clock; `data` and `length` with it
//   busy     ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_________
//   mosi     ----X bit 1         X bit 0         X--------
//   sck      ____________/‾‾‾‾‾‾‾\_______/‾‾‾‾‾‾‾\________
//   miso     ----X bit 1         X bit 0         X--------    the flash changes it after a fall
//   sampled  ________________|_______________|____________    a clock after the rise
//
// MISO is sampled three clocks after the fall that changed it (50 ns at 60 MHz; the flash needs 8,
// the wires both ways about 12) and a clock before the next fall. CS stays high for at least four
// clocks (67 ns; the flash needs 50). A start before CS has fallen waits for it, and CS stays low
// until a transfer is over, so the firmware need not count. A start while busy, or while not
// selected, is ignored.
//
`default_nettype none
module spi (
    input  wire         clk,
    input  wire         select,    // level: 1 pulls CS low
    input  wire         start,
    input  wire  [31:0] data,      // bit 31 leaves first
    input  wire  [4:0]  length,    // bits; 0 is 32
    output logic        busy,
    // the last bit received is bit 0; above the received bits are the unsent ones
    output wire  [31:0] received,
    output logic        cs_n,
    output wire         sck,
    output wire         mosi,
    input  wire         miso
);
    logic [31:0] shift = 32'd0;
    logic [4:0]  left = 5'd0;    // bits after this one
    logic [1:0]  phase = 2'd0;   // of the bit; while CS is high, the time since it rose
    logic        bit_in = 1'b0;
    logic        high = 1'b0;    // SCK, a flip-flop: without glitches
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

`ifdef FORMAL  // what gateware/formal proves; `done` bits of this transfer are over
    logic [5:0]  f_length = 6'd0, f_rises = 6'd0;
    logic [31:0] f_data = 32'd0, f_in = 32'd0;
    logic [1:0]  f_rested = 2'd0;  // clocks CS was high before this one, 3 at most
    logic        f_high = 1'b0, f_cs_n = 1'b1, f_mosi = 1'b0, f_miso = 1'b0, f_busy = 1'b0;
    wire  [5:0]  f_done = f_length - 6'd1 - {1'b0, left};
    wire         f_rise = high & ~f_high;
    always_ff @(posedge clk) begin
        f_high <= high;
        f_cs_n <= cs_n;
        f_mosi <= mosi;
        f_busy <= busy;
        if (moves & (phase == 2'd2)) f_miso <= miso;
        f_rested <= cs_n ? f_rested + 2'(f_rested != 2'd3) : 2'd0;
        if (accepts) begin
            f_length <= {length == 5'd0, length};
            f_rises  <= 6'd0;
            f_data   <= data;
            f_in     <= 32'd0;
        end else begin
            f_rises <= f_rises + 6'(high & ~f_high);
            if (ends) f_in <= {f_in[30:0], f_miso};
        end
    end
    always_comb begin
`ifndef BROKEN
        assert (high == (moves & phase[1]));
        assert (busy | cs_n | (phase == 2'd0));
        assert (~cs_n | (f_rested == phase));
        assert (~f_high | (high & (phase == 2'd3)) | (phase == 2'd0));
        assert (~(high & (phase == 2'd3)) | f_high);
        assert (~(high & (phase == 2'd2)) | ~f_high);
        assert (~busy | (f_length != 6'd0 & f_length <= 6'd32 & {1'b0, left} < f_length));
        assert (~(busy & cs_n) | ({1'b0, left} == f_length - 6'd1));
        assert (~(busy & f_high & ~high) | ~cs_n);
        assert (~busy | (f_rises + 6'(f_rise) == f_done + 6'(moves & phase[1])));
        assert (busy | (f_rises == f_length));
        assert (~busy | (shift == ((f_data << f_done) | f_in)));
        assert (~busy | ((f_in >> f_done) == 32'd0));
        assert (busy | ((f_in ^ shift) << (6'd32 - f_length) == 32'd0));
        assert (~(moves & (phase == 2'd3)) | (bit_in == f_miso));
        assert (~(f_cs_n & ~cs_n) | (phase == 2'd0));
`endif
`ifdef PROVE_sck_never_moves_while_cs_is_high
        assert ((high == f_high) | ~(cs_n | f_cs_n));
`endif
`ifdef PROVE_a_transfer_has_as_many_clocks_as_its_length
        assert (~(f_busy & ~busy) | (f_rises == f_length));
        assert (~f_rise | (busy & f_rises < f_length));
`endif
`ifdef PROVE_cs_stays_low_through_a_transfer_and_high_for_four_clocks
        assert (~(cs_n & ~f_cs_n) | (~busy & ~f_busy));
        assert (~(f_cs_n & ~cs_n) | (f_rested == 2'd3));
`endif
`ifdef PROVE_the_bits_are_the_words_and_the_ones_that_came
        assert (~high | (mosi == f_data[5'd31 - f_done[4:0]] & mosi == f_mosi));
        assert (~(f_busy & ~busy) | ((f_in ^ shift) << (6'd32 - f_length) == 32'd0));
`endif
    end
`endif
endmodule
`default_nettype wire
