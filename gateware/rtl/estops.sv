// estops: four e-stop inputs of an image, which can be any header line (pinmux_in.sv).
//
// No debounce, no setting and no mask: a line whose route was written stops with its level 1, and
// no word can disable it while the gate is open. `estop` follows the lines by one clock, three
// behind the pin, as in gpio.sv. Each line's latch falls with `clear`, and only when the line is
// released.
//
//   lines    ____/‾‾‾‾‾‾‾\__________________    synchronous
//   estop    ______/‾‾‾‾‾‾‾\________________
//   clear    ________/‾\______/‾\___________    the first has no effect
//   latched  ______/‾‾‾‾‾‾‾‾‾‾‾‾\___________
//
`default_nettype none
module estops (
    input  wire        clk,
    input  wire  [3:0] lines,   // 1 stops
    // pulse: reset the latches of released lines; the watchdog's `cleared`
    input  wire        clear,
    output logic       estop,   // a line is active
    output logic [3:0] latched
);
    initial {estop, latched} = '0;

    always_ff @(posedge clk) begin
        estop   <= |lines;
        latched <= lines | (clear ? 4'd0 : latched);
    end

`ifdef FORMAL  // what gateware/formal proves: the guarantees, stated without the logic above
    logic       f_past = 1'b0, f_clear;
    logic [3:0] f_lines = 4'd0, f_latched = 4'd0;
    always_ff @(posedge clk) begin
        f_past    <= 1'b1;
        f_lines   <= lines;
        f_latched <= latched;
        f_clear   <= clear;
`ifdef PROVE_a_line_stops_in_one_clock
        assert (estop == |f_lines);
`endif
`ifdef PROVE_a_latch_falls_only_on_request_and_only_when_its_line_is_released
        assert ((f_lines & ~latched) == 4'd0);
        if (f_past) assert ((f_latched & ~latched & (f_clear ? f_lines : 4'hf)) == 4'd0);
        if (f_past & f_clear) assert (latched == f_lines);
`endif
    end
`endif
endmodule
`default_nettype wire
