// pinmux_in: which pin of the headers each input of a core listens to; decided by words that
// firmware writes, and never while the gate is open.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_
//   pins     ____/‾‾‾‾‾‾‾‾‾‾‾‾    at any time
//   levels   __________/‾‾‾‾‾‾    two edges later: all pins, for GPIO
//   sinks    __________/‾‾‾‾‾‾    of the pin whose route was written, with its polarity
//
// The pins are synchronised in front of the multiplexer, so that a change of one pin cannot disturb
// the input of another. All inputs of a core have the same delay. Until a route has been written
// an input is 0: a polarity belongs into the route, so that 0 is `released` and `inactive`.
`default_nettype none
module pinmux_in #(
    parameter integer PINS  = 56,  // this and SINKS: multiples of 4
    parameter integer SINKS = 48
) (
    input  wire              clk,
    input  wire              gate,
    input  wire              we,
    input  wire        [4:0] at,
    input  wire       [31:0] word,     // routes of four inputs (crossbar.sv); a source is a pin
    input  wire   [PINS-1:0] pins,     // asynchronous
`ifdef FORMAL
    output wire   [PINS-1:0] formal_meta,
`endif
    output wire              idle,
    output logic             refused,  // the last word had no effect
    output wire              ready,
    output logic  [PINS-1:0] levels,
    output wire  [SINKS-1:0] sinks
);
    (* keep *) logic [PINS-1:0] meta = '0;
    initial {refused, levels} = '0;
`ifdef FORMAL
    assign formal_meta = meta;
`endif

    always_ff @(posedge clk) begin
        {levels, meta} <= {meta, pins};
        if (we) refused <= ~(~gate & idle);
    end

    crossbar #(.SOURCES(PINS), .SINKS(SINKS), .OWN(1'b0)) joins (
        .clk(clk), .shut(~gate), .we(we), .to(at), .word(word), .sources(levels), .own('0),
        .idle(idle), .ready(ready), .sinks(sinks));
endmodule
`default_nettype wire
