// debounce: accepts the levels of a group of lines once all of them have been stable for `filter` +
// 2 clocks.
//
// One timer serves the group: quadrature lines move one at a time, so the other lines wait for one
// that moves. A level that lasts `filter` + 1 clocks or less is never seen. A change of `filter`
// takes at most 256 quiet clocks to settle.
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
    output logic             known  // `level` has been a level of the lines, since power-up
`ifdef FORMAL
    , output wire [LINES-1:0] f_was, output wire [WIDTH-1:0] f_still
`endif
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

`ifdef FORMAL
    assign f_was = was;  // encoder.sv's proofs use these
    assign f_still = still;
    logic [WIDTH+1:0] f_run = 1;  // clocks since `was` changed; its power-up value counts as one
    logic [WIDTH+1:0] f_age = 0;  // the same for the lines alone
    logic [LINES-1:0] f_level = 0;
    always_ff @(posedge clk) begin
        f_run   <= moved ? 1 : &f_run ? f_run : f_run + 1'b1;
        f_age   <= moved | f_age == 0 ? 1 : &f_age ? f_age : f_age + 1'b1;
        f_level <= level;
    end
    always_comb begin
        assert (still == (f_run > filter ? filter : f_run - 1));
        assert (f_run != 0 & (f_age == f_run | (was == 0 & level == 0 & (f_run == f_age + 1 | &f_run))));
`ifdef PROVE_a_pulse_of_filter_plus_one_clocks_is_never_seen
        if (level != f_level) assert (level == was & f_age >= filter + 2);
`endif
`ifdef PROVE_filter_plus_two_clocks_at_rest_are_always_seen
        if (f_age >= filter + 2) assert (level == was & known);
`endif
    end
`endif
endmodule
`default_nettype wire
