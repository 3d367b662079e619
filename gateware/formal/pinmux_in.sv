// The guarantees of the input pins, for any crossbar: what the real one says is proven in
// crossbar.sv.
`default_nettype none
module crossbar #(
    parameter integer SOURCES = 4,
    parameter integer SINKS   = 4,
    parameter bit OWN = 1'b0
) (
    input  wire                clk, shut, we,
    input  wire          [4:0] to,
    input  wire         [31:0] word,
    input  wire  [SOURCES-1:0] sources,
    input  wire    [SINKS-1:0] own,
    output wire                idle, ready,
    output wire    [SINKS-1:0] sinks
);
    (* anyseq *) logic any_idle, any_ready;
    assign {idle, ready} = {any_idle, any_ready & any_idle};
    assign sinks = {shut, we, sources[SINKS-3:0]};  // what it sees, for the promises
endmodule

module pinmux_in_promises (
    input wire        clk, gate, we,
    input wire  [4:0] at,
    input wire [31:0] word,
    input wire [55:0] pins
);
    logic        idle, refused, ready;
    logic [55:0] levels, formal_meta;
    logic [47:0] sinks;
    pinmux_in core (.*);

    logic [55:0] f_pins1 = 56'd0, f_pins2 = 56'd0;
    always_ff @(posedge clk) {f_pins1, f_pins2} <= {pins, f_pins1};

    always_ff @(posedge clk) begin
`ifndef BROKEN
        assert (formal_meta == f_pins1 & levels == f_pins2);
`endif
`ifdef PROVE_no_route_is_written_unless_the_gate_is_closed
        assert (sinks[47] == ~gate);
`endif
`ifdef PROVE_all_pins_are_seen_two_clocks_late
        assert (levels == f_pins2 & sinks[45:0] == f_pins2[45:0]);
`endif
    end
endmodule
`default_nettype wire
