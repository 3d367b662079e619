// The guarantees of the output pins, for any crossbar: this one, in place of the real one, says
// whatever it likes at any time. What the real one says is proven in crossbar.sv.
`default_nettype none
module crossbar #(
    parameter integer SOURCES = 4,
    parameter integer SINKS   = 4
) (
    input  wire                clk, shut, we,
    input  wire          [4:0] to,
    input  wire         [31:0] word,
    input  wire  [SOURCES-1:0] sources,
    input  wire    [SINKS-1:0] own,
    output wire                idle, ready,
    output wire    [SINKS-1:0] sinks
);
    (* anyseq *) logic             any_idle, any_ready;
    (* anyseq *) logic [SINKS-1:0] any_sinks;
    assign {idle, ready, sinks} = {any_idle, any_ready & any_idle, any_sinks};
endmodule

module pinmux_out_promises (
    input wire        clk, gate, inputs_ready, we,
    input wire  [5:0] at,
    input wire [31:0] word,
    input wire [35:0] sources,
    input wire [55:0] own
);
    logic        idle, refused, live, formal_shut, formal_we, formal_ready, formal_opened;
    logic [55:0] levels, drives, formal_sinks, formal_safe, formal_keeps;
    pinmux_out core (.*);

    // Any one pin, and what the words say that came while the gate was closed.
    (* anyconst *) logic [5:0] f_pin;
    logic f_safe = 1'b0, f_keeps = 1'b0, f_drives = 1'b0, f_shown = 1'b0;
    wire  f_taken = we & ~gate & ~live & idle;
    wire  f_bit = word[f_pin[4:0]];
    wire  f_word = {1'b0, at[1:0]} == {2'b00, f_pin[5]};
    always_ff @(posedge clk) begin
        f_shown <= live | (f_shown & ~f_taken);
        if (f_taken & f_word & at[5:2] == 4'd8) f_safe <= f_bit;
        if (f_taken & f_word & at[5:2] == 4'd9) f_keeps <= f_bit;
        if (f_taken & f_word & at[5:2] == 4'd10) f_drives <= f_bit;
    end

    // One and two clocks ago.
    logic        f_1 = 1'b0, f_gate1 = 1'b0, f_gate2 = 1'b0, f_may1 = 1'b0, f_may2 = 1'b0, f_live1 = 1'b0;
    logic        f_level1, f_sink1, f_rest1;
    logic [55:0] f_drives1;
    always_ff @(posedge clk) begin
        f_1 <= 1'b1;
        {f_gate1, f_gate2} <= {gate, f_gate1};
        {f_may1, f_may2} <= {formal_ready & inputs_ready, f_may1};
        {f_live1, f_level1, f_sink1, f_drives1} <= {live, levels[f_pin], formal_sinks[f_pin], drives};
        f_rest1 <= f_keeps & f_shown ? levels[f_pin] : f_safe;
    end

    always_ff @(posedge clk) if (f_pin < 6'd56) begin
`ifndef BROKEN
        assert (live == (f_gate1 & f_may1) & drives[f_pin] == f_drives);
        assert (formal_safe[f_pin] == f_safe & formal_keeps[f_pin] == f_keeps & formal_opened == f_shown);
        if (f_1) assert (f_live1 == (f_gate2 & f_may2));
        else assert (~live & ~f_gate1 & ~f_gate2 & ~f_live1 & levels == 56'd0 & drives == 56'd0);
`endif
`ifdef PROVE_nothing_is_written_unless_the_gate_is_closed
        if (formal_shut | formal_we) assert (~gate);
        if (f_gate1) assert (drives == f_drives1);
`endif
`ifdef PROVE_a_pin_that_was_not_configured_never_drives
        assert (drives[f_pin] == f_drives);
`endif
`ifdef PROVE_with_the_gate_closed_a_pin_rests_whatever_the_crossbar_says
        if (f_1 & ~f_gate2) assert (levels[f_pin] == f_rest1);
        if (~f_1) assert (~levels[f_pin]);
`endif
`ifdef PROVE_a_pin_rests_before_routes_are_written_and_while_they_are
        if (f_1 & ~f_may2) assert (levels[f_pin] == f_rest1);
`endif
`ifdef PROVE_every_live_pin_is_its_sink_of_one_clock_ago
        if (f_1 & f_live1) assert (levels[f_pin] == f_sink1);
        if (f_1 & f_gate2 & f_may2) assert (f_live1);
`endif
    end
endmodule
`default_nettype wire
