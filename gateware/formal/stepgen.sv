// The worlds around a stepgen for gateware/formal/run.sh: any command in any clock, any settings that stay, and a tally that
// comes by at least every 16 clocks. What must hold stands in rtl/stepgen.sv itself.
`default_nettype none
module stepgen_world (
    input wire       clk,
    input wire [1:0] kind,
    input wire       gate, stop, commit, enable, visit,
    input wire [31:0] velocity, accel
);
    (* anyconst *) logic [12:0] steplen, stepspace;
    (* anyconst *) logic [15:0] dirsetup, dirhold;
    (* anyconst *) logic [31:0] stop_accel;
    (* anyconst *) logic        step_invert, dir_invert;

    stepgen core (.stopped(), .delta(), .fraction(), .velocity_now(), .waits(), .step(), .dir(), .*);
endmodule

module stepgen_any (input wire clk, gate, stop, commit, enable, visit, input wire [31:0] velocity, accel);
    (* anyconst *) logic [1:0] kind;
    stepgen_world world (.*);
endmodule

module stepgen_step_dir (input wire clk, gate, stop, commit, enable, visit, input wire [31:0] velocity, accel);
    (* anyconst *) logic three;  // kind 3 is kind 0
    stepgen_world world (.kind({2{three}}), .*);
endmodule

module stepgen_up_down (input wire clk, gate, stop, commit, enable, visit, input wire [31:0] velocity, accel);
    stepgen_world world (.kind(2'd1), .*);
endmodule

module stepgen_quadrature (input wire clk, gate, stop, commit, enable, visit, input wire [31:0] velocity, accel);
    stepgen_world world (.kind(2'd2), .*);
endmodule
