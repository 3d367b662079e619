// pwm: one pulse per period, changed only at the edge of a period.
//
// A new width or period waits for the running period to end: no runt pulse, no lost period. Width 0 is constantly
// inactive, width >= period constantly active: both without a glitch. Period 0 is off. A closed gate makes the output
// inactive on the next clock and forgets the command, so that nothing restarts before the next commit.
//
//   count   0 1 2 3 4 5 6 7 0 1 2 3 4 5 6 7 0
//   out     ‾‾‾‾‾\__________‾‾‾‾‾‾‾‾‾‾\______      period 8; width 3, then 5
//   commit  ______/‾\________________________
//
`default_nettype none
module pwm #(
    parameter integer WIDTH = 24
) (
    input  wire             clk,
    input  wire             gate,
    input  wire             commit,
    input  wire             enable,
    input  wire             direction,
    input  wire [WIDTH-1:0] width,   // clocks
    input  wire [WIDTH-1:0] period,  // clocks
    input  wire             invert,
    output logic            out,     // the pins, registered
    output logic            dir
);
    logic [WIDTH-1:0] next_width = {WIDTH{1'b0}};    // committed, waits for the period edge
    logic [WIDTH-1:0] this_width = {WIDTH{1'b0}};
    logic [WIDTH-1:0] this_period = {WIDTH{1'b0}};
    logic [WIDTH-1:0] count = {WIDTH{1'b0}};

    wire [WIDTH:0] after = {1'b0, count} + {{WIDTH{1'b0}}, 1'b1};
    wire           last  = after >= {1'b0, this_period};  // also when the period is 0

    always_ff @(posedge clk) begin
        if (~gate | (commit & ~enable)) next_width <= {WIDTH{1'b0}};
        else if (commit) next_width <= width;

        if (~gate | last) begin
            count       <= {WIDTH{1'b0}};
            this_width  <= gate ? next_width : {WIDTH{1'b0}};
            this_period <= period;
        end else count <= after[WIDTH-1:0];

        out <= (gate & (this_period != {WIDTH{1'b0}}) & (count < this_width)) ^ invert;
        if (gate & commit) dir <= direction;
    end

    initial begin
        out = 1'b0;
        dir = 1'b0;
    end
endmodule
`default_nettype wire
