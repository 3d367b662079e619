// pwm: one pulse per period, changed only at the edge of a period, on one of two pins.
//
// A new width, direction, period or kind waits for the running period to end: no runt pulse, no lost period. Width 0 is
// constantly inactive, width >= period constantly active: both without a glitch. Period 0 is off. A closed gate makes both
// pins inactive on the next clock and forgets the command, so that nothing restarts before the next commit. The pins follow
// the count by two clocks, whole periods later when the gate has just opened.
//
//   count   0 1 2 3 4 5 6 7 0 1 2 3 4 5 6 7 0
//   pulse   ‾‾‾‾‾\__________‾‾‾‾‾‾‾‾‾‾\______      period 8; width 3, then 5
//   commit  ______/‾\________________________
//
//   kind             out                dir
//   0 PWM + DIR      pulse              direction
//   1 up/down        pulse, forwards    pulse, backwards       never both
//   2 PDM + DIR      density            direction              one bit per `period` clocks (0 as 1)
//
// `swap` lets the two pins change places; `invert` turns pulses over, and leaves a level of DIR alone. With `dither` the
// fraction of the width is collected, and a period is one clock longer active whenever a whole clock has come together: 256
// periods are exact to 1/256 clock. PDM is the same sum 16 bits further up: a bit is active whenever it overflows.
//
`default_nettype none
module pwm (
    input  wire        clk,
    input  wire        gate,
    input  wire        commit,
    input  wire        enable,
    input  wire        direction,
    input  wire [28:0] width,   // clocks / 256; PDM: bits 24:8 / 65536 are the density
    input  wire [20:0] period,  // clocks
    input  wire  [1:0] kind,
    input  wire        dither,
    input  wire        swap,
    input  wire        invert,
    output logic       out,     // the pins, registered
    output logic       dir
);
    localparam logic [1:0] UP_DOWN = 2'd1, PDM = 2'd2;

    logic [28:0] next_width  = 29'd0;  // committed, waits for the period edge
    logic        next_dir    = 1'b0;
    logic [20:0] this_width  = 21'd0;
    logic [20:0] this_period = 21'd0;
    logic        this_dir    = 1'b0;
    logic        pdm         = 1'b0;
    logic        up_down     = 1'b0;
    logic [20:0] count       = 21'd0;
    logic [23:0] sum         = 24'd0;  // what no pulse has paid for yet
    logic        longer      = 1'b0;   // dither: this period is one clock longer active
    logic        on          = 1'b0;   // the end of the pulse has not been seen; PDM: this bit

    wire        off   = this_period == 21'd0;
    wire [20:0] after = count + 21'd1;
    wire        last  = (after == this_period) | off;
    wire        ends  = (count == this_width) & ~pdm;
    wire        pulse = on & ~(ends & ~longer) & (pdm | ~off);

    wire  [8:0] low   = {1'b0, sum[7:0]} + {1'b0, next_width[7:0]};
    wire        whole = low[8] & dither;
    wire [16:0] high  = {1'b0, sum[23:8]} + {1'b0, next_width[23:8]} + {16'd0, whole};
    wire        full  = |next_width[28:24];

    // What the pins are about to carry, before polarity and place.
    logic plus = 1'b0, minus = 1'b0, minus_pulses = 1'b0;

    always_ff @(posedge clk) begin
        if (~gate | (commit & ~enable)) next_width <= 29'd0;
        else if (commit) next_width <= width;
        if (~gate) next_dir <= 1'b0;
        else if (commit) next_dir <= direction;

        if (~gate | last) begin
            count       <= 21'd0;
            this_width  <= next_width[28:8];
            this_period <= period;
            pdm         <= kind == PDM;
            up_down     <= kind == UP_DOWN;
            longer      <= whole;
        end else count <= after;

        if (~gate) begin  // and the first period is silent
            on       <= 1'b0;
            this_dir <= 1'b0;
            sum      <= 24'd0;
        end else if (last) begin
            on       <= (kind == PDM) ? high[16] | full : 1'b1;
            this_dir <= next_dir;
            sum      <= {high[15:0], low[7:0]};
        end else if (ends) on <= 1'b0;

        if (~gate) begin
            plus  <= 1'b0;
            minus <= 1'b0;
        end else begin
            plus  <= pulse & ~(up_down & this_dir);
            minus <= this_dir & (pulse | ~up_down);
        end
        minus_pulses <= up_down;

        out <= (gate & (swap ? minus : plus)) ^ (invert & (~swap | minus_pulses));
        dir <= (gate & (swap ? plus : minus)) ^ (invert & (swap | minus_pulses));
    end

    initial begin
        out = 1'b0;
        dir = 1'b0;
    end
endmodule
`default_nettype wire
