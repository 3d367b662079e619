// The environments of a stepgen for gateware/formal/run.sh: any command in any clock, any constant
// settings, and a wide counter that visits at least every 16 clocks. The properties are in
// rtl/stepgen.sv itself.
`default_nettype none
module stepgen_environment (
    input wire       clk,
    input wire [1:0] kind,
    input wire       gate, stop, advance, commit, enable, visit,
    input wire [31:0] velocity, accel,
    output wire      waits
);
    (* anyconst *) logic [12:0] steplen, stepspace;
    (* anyconst *) logic [15:0] dirsetup, dirhold;
    (* anyconst *) logic [31:0] stop_accel;
    (* anyconst *) logic        step_invert, dir_invert;

    stepgen #(.TIMED(1'b1)) core (.stopped(), .delta(), .fraction(), .velocity_now(), .step(), .dir(), .*);
endmodule

module stepgen_any (input wire clk, gate, stop, advance, commit, enable, visit, input wire [31:0] velocity, accel);
    (* anyconst *) logic [1:0] kind;
    wire waits;
    stepgen_environment environment (.*);
endmodule

// Path time as segments.sv controls it: it never passes in a clock in which a pulse waits.
module stepgen_in_time (input wire clk, gate, stop, tick, commit, enable, visit, input wire [31:0] velocity, accel);
    (* anyconst *) logic [1:0] kind;
    wire waits;
    stepgen_environment environment (.advance(tick & ~waits), .*);
endmodule

module stepgen_step_dir (input wire clk, gate, stop, advance, commit, enable, visit, input wire [31:0] velocity, accel);
    (* anyconst *) logic three;  // kind 3 is kind 0
    wire waits;
    stepgen_environment environment (.kind({2{three}}), .*);
endmodule

module stepgen_up_down (input wire clk, gate, stop, advance, commit, enable, visit, input wire [31:0] velocity, accel);
    wire waits;
    stepgen_environment environment (.kind(2'd1), .*);
endmodule

module stepgen_quadrature (input wire clk, gate, stop, advance, commit, enable, visit, input wire [31:0] velocity, accel);
    wire waits;
    stepgen_environment environment (.kind(2'd2), .*);
endmodule
