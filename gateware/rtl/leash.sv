// leash: an interrupt if the CPU does not come back in time from a program that may fail.
//
// The firmware sets it before it calls the program and takes it off behind the call. The interrupt
// stays until then.
//
//   clk    _/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_
//   set    ____/‾‾‾\________________      clocks = 3
//   left   0   |   | 3 | 2 | 1 | 0 |
//   irq    ________________________/‾‾    clocks + 1 after `set`, if it is not set again before
//
`default_nettype none
module leash (
    input  wire         clk,
    input  wire         rst,
    input  wire         set,
    input  wire  [23:0] clocks, // 0: taken off
`ifdef FORMAL
    output wire  [23:0] formal_left,
    output wire         formal_on,
`endif
    output logic        irq
);
    logic [23:0] left = 24'd0;
    logic        on   = 1'b0;
    initial irq = 1'b0;
`ifdef FORMAL
    assign {formal_left, formal_on} = {left, on};
`endif

    always_ff @(posedge clk) begin
        if (left != 24'd0) left <= left - 24'd1;
        irq <= on & left <= 24'd1;
        if (set) begin
            left <= clocks;
            on   <= clocks != 24'd0;
            irq  <= 1'b0;
        end
        if (rst) begin
            on  <= 1'b0;
            irq <= 1'b0;
        end
    end
endmodule
`default_nettype wire
