// A board with e-stop inputs for the proofs: 0 and 11 trigger high, 31 low. The guarantees are
// beside the logic in gpio.sv.
`default_nettype none
module gpio_promises (
    input wire        clk, gate, commit, debounce_we, clear,
    input wire [31:0] value, safe, invert, job_mask, job_value, in_pins,
    input wire  [4:0] debounce_pin,
    input wire [15:0] debounce_limit
);
    logic [31:0] in, raw, estop_latched, out_pins;
    logic        estop;
    gpio #(.ESTOP_MASK(32'h80000801), .ESTOP_LEVEL(32'h00000801), .JOBS(1'b1)) core (.*);
endmodule
`default_nettype wire
