// Wrappers around the stepgen for gateware/formal/run.sh: arbitrary commands, arbitrary but constant settings.
`default_nettype none
module stepgen_gate (
    input wire        clk,
    input wire        gate, stop, commit, enable,
    input wire [31:0] velocity, accel
);
    (* anyconst *) logic [12:0] steplen, stepspace;
    (* anyconst *) logic [15:0] dirsetup, dirhold;
    (* anyconst *) logic [31:0] stop_accel;
    logic step;
    stepgen core (.step_invert(1'b0), .dir_invert(1'b0), .kind(2'd0), .visit(1'b0), .delta(), .fraction(), .velocity_now(), .waits(), .stopped(), .dir(), .*);

    logic was_open = 1'b0, was_high = 1'b0;
    always_ff @(posedge clk) begin
        was_open <= gate;
        was_high <= step;
        assert (was_open | ~step);
    end
endmodule
