// What stands between a motor and a mishap, wired as in the SoC: pin, watchdog, gate, and one core of each kind.
`default_nettype none
module safety (
    input  wire         clk,
    input  wire         rst,
    input  wire         pin,
    input  wire         token_we,
    input  wire  [31:0] token,
    input  wire         arm,
    input  wire         soft_stop,
    input  wire         shut,
    input  wire         clear,
    input  wire  [31:0] timeout,
    input  wire  [31:0] grace,
    input  wire         commit,
    input  wire  [31:0] velocity,
    input  wire  [31:0] accel,
    input  wire  [31:0] stop_accel,
    input  wire  [15:0] steplen,
    input  wire   [7:0] out_value,
    input  wire   [7:0] out_safe,
    output wire         gate,
    output wire         stopping,
    output wire         bitten,
    output wire         reset_latched,
    output wire         armed,
    output wire  [31:0] remaining,
    output wire  [31:0] bites,
    output wire         step,
    output wire         dir,
    output wire         pwm_out,
    output wire   [7:0] out_pins,
    output wire  [31:0] velocity_now,
    output wire  [63:0] position
);
    wire ext_reset, stopped;
    extreset #(.ACTIVE_LOW(1'b0)) r (.clk(clk), .pin(pin), .active(ext_reset));
    watchdog w (
        .clk(clk), .rst(rst), .ext_reset(ext_reset), .token_we(token_we), .token(token), .arm(arm), .soft_stop(soft_stop),
        .shut(shut), .clear(clear), .timeout(timeout), .grace(grace), .all_stopped(stopped), .gate(gate), .stop(stopping),
        .bitten(bitten), .reset_latched(reset_latched), .armed(armed), .remaining(remaining),
        /* verilator lint_off PINCONNECTEMPTY */ .last_token() /* verilator lint_on PINCONNECTEMPTY */, .bites(bites));
    stepgen s (
        .clk(clk), .gate(gate), .stop(stopping), .stopped(stopped), .commit(commit), .enable(1'b1), .velocity(velocity),
        .accel(accel), .steplen(steplen), .stepspace(16'd1), .dirsetup(24'd3), .dirhold(24'd3), .stop_accel(stop_accel),
        .step_invert(1'b0), .dir_invert(1'b0), .position(position), .velocity_now(velocity_now),
        /* verilator lint_off PINCONNECTEMPTY */ .waits() /* verilator lint_on PINCONNECTEMPTY */, .step(step), .dir(dir));
    pwm p (
        .clk(clk), .gate(gate), .commit(commit), .enable(1'b1), .direction(1'b0), .width(24'd40), .period(24'd41), .invert(1'b0),
        .out(pwm_out), /* verilator lint_off PINCONNECTEMPTY */ .dir() /* verilator lint_on PINCONNECTEMPTY */);
    gpio #(.INPUTS(1), .OUTPUTS(8)) g (
        .clk(clk), .gate(gate), .commit(commit), .value(out_value), .safe(out_safe), .invert(8'h0f), .in_pins(1'b0),
        /* verilator lint_off PINCONNECTEMPTY */ .in() /* verilator lint_on PINCONNECTEMPTY */, .out_pins(out_pins));
endmodule
`default_nettype wire
