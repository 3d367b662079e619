// truth_table: four sinks as any functions of four sources, in LUT RAM. The crossbar is made of
// such tables.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_
//   we       ____/‾‾‾\________    `line` holds `bits` a clock later
//   sources  -X s X-----------
//   sinks    -X line s X------    without a clock
//
`default_nettype none
module truth_table (
    input  wire        clk,
    input  wire        we,
    input  wire  [3:0] line,
    input  wire  [3:0] bits,
`ifdef FORMAL  // line n is to hold bit n of each sink's 16; checked of the lines below f_below
    input  wire [63:0] f_wanted,
    input  wire  [4:0] f_below,
`endif
    input  wire  [3:0] sources,
    output wire  [3:0] sinks
);
    logic [3:0] lines[0:15];
    initial for (int n = 0; n < 16; n++) lines[n] = 4'd0;

    always_ff @(posedge clk) if (we) lines[line] <= bits;
    assign sinks = lines[sources];

`ifdef FORMAL
`ifndef BROKEN
    always_ff @(posedge clk)
        for (int n = 0; n < 16; n++)
            if (5'(n) < f_below) assert (lines[n] == {f_wanted[48 + n], f_wanted[32 + n], f_wanted[16 + n], f_wanted[n]});
`endif
`endif
endmodule
`default_nettype wire
