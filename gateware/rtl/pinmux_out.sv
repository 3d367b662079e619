// pinmux_out: what each pin of the headers carries, if it is an output; decided by words that
// firmware writes, and never while the gate is open.
//
//   gate     ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_____________
//   live     ________/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_________    a clock behind the gate
//   source   | a | b | c | d | e | f | g | h | i     registered in its core
//   level    rest    | rest  | c | d | e | f | rest  registered
//   we       ___/‾\______/‾\________________/‾\__    only the first has an effect
//
// `level` follows its source by one clock, the same for all sources and pins: STEP and DIR keep
// their distance. `live` is a clock behind the gate, too, so that a pulse that its core emitted,
// and counted, in the gate's last clock reaches the pin.
//
// At rest a pin has its safe level. A pin that `keeps` has its safe level until it has been live
// since the last word was written; then it stays as it is when the gate closes. That is for DIR
// and for quadrature lines: an edge there would disturb the last pulse, or be one.
//
// Nothing is live before routes have been written, nor while a word is being written, of the
// inputs (`inputs_ready`) or of the outputs, even if the gate opens. `drives` is 0 from power-up:
// the pin is an input until its bit is written.
//
//   at       word
//   0 to 31  routes of four pins each (crossbar.sv)
//   32 to 35 safe levels, a bit for each pin
//   36 to 39 keeps
//   40 to 43 drives
`default_nettype none
module pinmux_out #(
    parameter integer PINS    = 56,  // this and SOURCES: multiples of 4
    parameter integer SOURCES = 36
) (
    input  wire                clk,
    input  wire                gate,
    input  wire                inputs_ready,
    input  wire                we,
    input  wire          [5:0] at,
    input  wire         [31:0] word,
    input  wire  [SOURCES-1:0] sources,
    input  wire     [PINS-1:0] own,      // GPIO bits; a pin can carry those of its four pins
`ifdef FORMAL
    output wire                formal_shut, formal_we, formal_ready, formal_opened,
    output wire     [PINS-1:0] formal_sinks, formal_safe, formal_keeps,
`endif
    output wire                idle,
    output logic               refused,  // the last word had no effect
    output logic               live,
    output logic    [PINS-1:0] levels,
    output logic    [PINS-1:0] drives
);
    logic [PINS-1:0] safe = '0, keeps = '0;
    logic            opened = 1'b0;  // live since the last word
    initial {refused, live, levels, drives} = '0;

    wire            ready;
    wire [PINS-1:0] sinks;
    wire            shut  = ~gate & ~live;
    wire            taken = we & shut & idle;

    crossbar #(.SOURCES(SOURCES), .SINKS(PINS)) joins (
        .clk(clk), .shut(shut), .we(taken & ~at[5]), .to(at[4:0]), .word(word), .sources(sources), .own(own),
        .idle(idle), .ready(ready), .sinks(sinks));

`ifdef FORMAL
    assign {formal_shut, formal_we, formal_ready, formal_opened} = {shut, taken & ~at[5], ready, opened};
    assign {formal_sinks, formal_safe, formal_keeps} = {sinks, safe, keeps};
`endif

    always_ff @(posedge clk) begin
        live   <= gate & ready & inputs_ready;
        opened <= live | (opened & ~taken);
        levels <= live ? sinks : (keeps & {PINS{opened}} & levels) | (safe & ~(keeps & {PINS{opened}}));
        if (we) refused <= ~taken;
        for (int p = 0; p < PINS; p++)
            if (taken & at[5] & at[1:0] == 2'(p / 32)) begin
                if (at[4:2] == 3'd0) safe[p] <= word[p % 32];
                if (at[4:2] == 3'd1) keeps[p] <= word[p % 32];
                if (at[4:2] == 3'd2) drives[p] <= word[p % 32];
            end
    end
endmodule
`default_nettype wire
