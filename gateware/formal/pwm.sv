// The commands for dither and PDM: the guarantees are beside the logic in pwm.sv.
`default_nettype none
module pwm_dither (  // no width longer than the period, and no change of kind
    input wire        clk, gate, commit, enable, direction, swap, invert,
    input wire [28:0] width
);
    (* anyconst *) logic [20:0] period;
    (* anyconst *) logic  [1:0] kind;
    logic out, dir;
    pwm core (.dither(1'b1), .*);
    always_comb assume (width[28:8] < period & kind != 2'd2);
endmodule
module pwm_density (  // a density above 1 has no error to bound: it is constantly active
    input wire        clk, gate, commit, enable, direction, swap, invert,
    input wire [28:0] width,
    input wire [20:0] period
);
    (* anyconst *) logic dither;
    logic out, dir;
    pwm core (.kind(2'd2), .*);
    always_comb assume (width <= 29'h1000000);
endmodule
`default_nettype wire
