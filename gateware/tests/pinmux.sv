// Both halves of the pin multiplexer, for 8 step generators, 8 encoders and 8 PWM on 56 pins.
`default_nettype none
module pinmux (
    input  wire        clk,
    input  wire        gate,
    input  wire        we_in,
    input  wire        we_out,
    input  wire  [5:0] at,
    input  wire [31:0] word,
    input  wire [35:0] sources,
    input  wire [55:0] own,
    input  wire [55:0] pins,
    output wire        idle_in,
    output wire        idle_out,
    output wire        refused_in,
    output wire        refused_out,
    output wire        live,
    output wire [55:0] levels,
    output wire [55:0] drives,
    output wire [55:0] seen,
    output wire [47:0] sinks
);
    wire ready;
    pinmux_in i (
        .clk(clk), .gate(gate), .we(we_in), .at(at[4:0]), .word(word), .pins(pins),
        .idle(idle_in), .refused(refused_in), .ready(ready), .levels(seen), .sinks(sinks));
    pinmux_out o (
        .clk(clk), .gate(gate), .inputs_ready(ready), .we(we_out), .at(at), .word(word), .sources(sources), .own(own),
        .idle(idle_out), .refused(refused_out), .live(live), .levels(levels), .drives(drives));
endmodule
`default_nettype wire
