// debounce: believes a group of lines together, once all of them have stood still for `filter` + 2 clocks.
//
// One timer serves the group: quadrature lines move one at a time, so a line that moves is a line the others wait for. What
// lasts `filter` + 1 clocks or less is never seen. A change of `filter` takes at most 256 quiet clocks to settle.
//
//   lines   ____/‾‾‾\__/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾     synchronous to clk
//   level   ___________________/‾‾‾‾‾‾‾‾
//                      |-------|             filter + 2 clocks
//
`default_nettype none
module debounce #(
    parameter integer LINES = 1,
    parameter integer WIDTH = 8  // of the timer
) (
    input  wire              clk,
    input  wire [LINES-1:0]  lines,
    input  wire [WIDTH-1:0]  filter,
    output logic [LINES-1:0] level,
    output logic             known  // since power-up, `level` is what the lines were
);
    logic [LINES-1:0] was = {LINES{1'b0}};
    logic [WIDTH-1:0] still = {WIDTH{1'b0}};
    initial level = {LINES{1'b0}};
    initial known = 1'b0;

    wire moved = lines != was;
    wire long_enough = still == filter;

    always_ff @(posedge clk) begin
        was <= lines;
        if (moved) still <= {WIDTH{1'b0}};
        else if (~long_enough) still <= still + {{(WIDTH-1){1'b0}}, 1'b1};
        if (~moved & long_enough) begin
            level <= was;
            known <= 1'b1;
        end
    end
endmodule
`default_nettype wire
