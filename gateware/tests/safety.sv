// The cores between a motor and an accident, wired as in the SoC: pins, watchdog, gate, and one
// core of each kind.
`default_nettype none
module safety (
    input  wire         clk,
    input  wire         rst,
    input  wire         pin,
    input  wire   [1:0] estop_pins,  // 0 triggers high, 1 low
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
    input  wire   [1:0] kind,
    input  wire  [12:0] steplen,
    input  wire   [7:0] out_value,
    input  wire   [7:0] out_safe,
    output wire         gate,
    output wire         stopping,
    output wire         bitten,
    output wire         reset_latched,
    output wire         estop_latched,
    output wire  [31:0] estop_inputs,
    output wire         armed,
    output wire   [3:0] last_close,
    output wire  [31:0] remaining,
    output wire  [31:0] bites,
    output wire         step,
    output wire         dir,
    output wire         pwm_out,
    output wire   [7:0] out_pins,
    output wire  [31:0] velocity_now,
    output wire  [63:0] position
);
    wire        ext_reset, stopped, estop, cleared;
    wire  [4:0] delta;
    wire [31:0] fraction;
    logic [31:0] total = 32'd0;  // a wide counter that visits every clock
    wire  [31:0] recent = {{27{delta[4]}}, delta};
    assign position = {total + recent, fraction};
    always_ff @(posedge clk) total <= total + recent;

    /* verilator lint_off PINCONNECTEMPTY */
    extreset #(.ACTIVE_LOW(1'b0)) r (.clk(clk), .pin(pin), .active(ext_reset));
    watchdog w (
        .clk(clk), .rst(rst), .ext_reset(ext_reset), .estop(estop), .token_we(token_we), .token(token), .feed(1'b0), .arm(arm), .soft_stop(soft_stop),
        .shut(shut), .clear(clear), .timeout(timeout), .grace(grace), .all_stopped(stopped), .gate(gate), .stop(stopping),
        .bitten(bitten), .reset_latched(reset_latched), .estop_latched(estop_latched), .armed(armed), .cleared(cleared),
        .last_close(last_close), .remaining(remaining), .last_token(), .bites(bites));
    stepgen s (
        .clk(clk), .gate(gate), .stop(stopping), .stopped(stopped), .advance(1'b1), .commit(commit), .enable(1'b1), .velocity(velocity),
        .accel(accel), .steplen(steplen), .stepspace(13'd1), .dirsetup(16'd3), .dirhold(16'd3), .stop_accel(stop_accel),
        .kind(kind), .step_invert(1'b0), .dir_invert(1'b0), .visit(1'b1), .delta(delta), .fraction(fraction), .velocity_now(velocity_now),
        .waits(), .step(step), .dir(dir));
    pwm p (
        .clk(clk), .gate(gate), .commit(commit), .enable(1'b1), .direction(1'b0), .width(29'd40 << 8), .period(21'd41), .kind(2'd0),
        .dither(1'b0), .swap(1'b0), .invert(1'b0), .out(pwm_out), .dir());
    gpio #(.INPUTS(2), .OUTPUTS(8), .ESTOP_MASK(32'h3), .ESTOP_LEVEL(32'h1)) g (
        .clk(clk), .gate(gate), .commit(commit), .value(out_value), .safe(out_safe), .invert(8'h0f), .job_mask(8'd0), .job_value(8'd0), .in_pins(estop_pins),
        .debounce_we(1'b0), .debounce_pin(5'd0), .debounce_limit(16'd0), .clear(cleared), .in(), .raw(),
        .estop(estop), .estop_latched(estop_inputs), .out_pins(out_pins));
    /* verilator lint_on PINCONNECTEMPTY */
endmodule
`default_nettype wire
