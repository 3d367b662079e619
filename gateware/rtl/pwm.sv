// pwm: one pulse per period on one of two pins; all changes take effect at the edge of a period.
//
// A new width, direction, period or kind waits for the running period to end: no pulse is cut
// short, and no period is lost. Width 0 is constantly inactive, width >= period constantly active,
// both without a glitch. Period 0 is off. A closed gate makes both pins inactive on the next clock
// and discards the command, so that the output stays off until the next commit. The pins follow the
// count by two clocks, and whole periods later right after the gate opened.
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
// `swap` exchanges the two pins. `invert` inverts pulses, but not a level of DIR. With `dither` the
// fraction of the width is accumulated, and a period is one clock longer active whenever the sum
// reaches a whole clock: 256 periods are exact to 1/256 clock. PDM is the same sum 16 bits higher:
// a bit is active whenever it overflows.
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
    logic [23:0] sum         = 24'd0;  // accumulated width that was not output yet
    logic        longer      = 1'b0;   // dither: this period is one clock longer active
    logic        on          = 1'b0;   // the pulse has not ended; PDM: this bit

    wire        off   = this_period == 21'd0;
    wire [20:0] after = count + 21'd1;
    wire        last  = (after == this_period) | off;
    wire        ends  = (count == this_width) & ~pdm;
    wire        pulse = on & ~(ends & ~longer) & (pdm | ~off);

    wire  [8:0] low   = {1'b0, sum[7:0]} + {1'b0, next_width[7:0]};
    wire        whole = low[8] & dither;
    wire [16:0] high  = {1'b0, sum[23:8]} + {1'b0, next_width[23:8]} + {16'd0, whole};
    wire        full  = |next_width[28:24];

    // The levels of the pins before polarity and swap.
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

`ifdef FORMAL  // what gateware/formal proves: the guarantees, stated without the logic above
    // The last commit, and its value when this period began: nothing else may decide about this
    // period.
    logic [28:0] f_next = 29'd0;
    logic        f_next_dir = 1'b0;
    logic [20:0] f_at = 21'd0, f_period = 21'd0;
    logic [21:0] f_width = 22'd0;  // in clocks, with what dither added
    logic        f_dir = 1'b0, f_silent = 1'b1;
    logic  [1:0] f_kind = 2'd0;
    logic [28:0] f_asked = 29'd0;
    logic  [8:0] f_part = 9'd0;  // fractions collected, and the carry of the last
    logic [23:0] f_before = 24'd0;  // the accumulated width when this period began
    wire         f_edge  = ~gate | {1'b0, f_at} + 22'd1 >= {1'b0, f_period};
    wire   [8:0] f_parts = {1'b0, f_part[7:0]} + {1'b0, f_next[7:0]};
    always_ff @(posedge clk) begin
        f_next     <= ~gate ? 29'd0 : ~commit ? f_next : enable ? width : 29'd0;
        f_next_dir <= gate & (commit ? direction : f_next_dir);
        f_at       <= f_edge ? 21'd0 : f_at + 21'd1;
        if (f_edge) begin
            f_period <= period;
            f_kind   <= kind;
            f_width  <= {1'b0, f_next[28:8]} + {21'd0, dither & f_parts[8]};
            f_asked  <= f_next;
            f_part   <= gate ? f_parts : 9'd0;
            f_before <= gate ? sum : 24'd0;
            f_dir    <= gate & f_next_dir;
            f_silent <= ~gate;
        end
`ifndef BROKEN
        assert (count == f_at & this_period == f_period & next_width == f_next & next_dir == f_next_dir);
        assert (f_at == 21'd0 | f_at < f_period);
        assert (sum[7:0] == f_part[7:0]);
        if (f_silent) assert (sum == 24'd0);
        assert (f_width == {1'b0, f_asked[28:8]} + {21'd0, longer});
`ifdef PROVE_dither_is_never_a_clock_in_debt
        assert (f_next[28:8] < period & f_asked[28:8] < period);
        if (~f_silent) assert (f_period == period & f_kind != PDM & longer == f_part[8]);
        if (~f_silent) assert ({8'd0, sum[7:0]} == {8'd0, f_before[7:0]} + {8'd0, f_asked[7:0]} - {7'd0, longer, 8'd0});
`endif
`ifdef PROVE_density_is_never_a_bit_in_debt
        assert (f_next <= 29'h1000000 & f_asked <= 29'h1000000 & (f_silent | pdm));
`endif
        if (~f_silent & pdm & f_asked <= 29'h1000000) assert ({6'd0, sum[23:8]} == {6'd0, f_before[23:8]} + f_width - {5'd0, on, 16'd0});
        assert (f_width == {1'b0, this_width} + {21'd0, longer});
        assert (pdm == (f_kind == PDM) & up_down == (f_kind == UP_DOWN) & this_dir == f_dir);
        if (f_silent) assert (~on);
        else if (~pdm) assert (on == (f_at <= this_width));
`endif
    end

    // The pins show all of it two clocks later, if the gate has been open since.
    logic        f_live1 = 1'b0, f_live2 = 1'b0, f_dir1 = 1'b0, f_dir2 = 1'b0, f_end1 = 1'b0, f_end2 = 1'b0, f_bit1 = 1'b0, f_bit2 = 1'b0;
    logic  [1:0] f_kind1 = 2'd0, f_kind2 = 2'd0;
    logic [20:0] f_at1 = 21'd0, f_at2 = 21'd0, f_period1 = 21'd0, f_period2 = 21'd0;
    logic [21:0] f_width1 = 22'd0, f_width2 = 22'd0;
    logic        f_swap = 1'b0, f_invert = 1'b0;
    logic [28:0] f_asked1 = 29'd0, f_asked2 = 29'd0;
    logic [23:0] f_before1 = 24'd0, f_before2 = 24'd0;
    // commanded less output, since the gate opened: clocks / 256, or bits / 65536
    logic [32:0] f_debt = 33'd0;
    logic [21:0] f_high = 22'd0;  // clocks the pins were active in this period, until now
    wire         f_plus  = (f_swap ? dir : out) ^ f_invert;
    wire         f_minus = (f_swap ? out : dir) ^ (f_invert & f_kind2 == UP_DOWN);
    wire         f_active = f_plus | (f_kind2 == UP_DOWN & f_minus);
    wire  [21:0] f_total  = f_high + {21'd0, f_active};
    wire  [21:0] f_wanted = f_width2 < {1'b0, f_period2} ? f_width2 : {1'b0, f_period2};
    always_ff @(posedge clk) begin
        {f_live1, f_live2}     <= {gate & ~f_silent, gate & f_live1};
        {f_dir1, f_dir2}       <= {f_dir, f_dir1};
        {f_end1, f_end2}       <= {f_edge, f_end1};
        {f_bit1, f_bit2}       <= {on, f_bit1};
        {f_kind1, f_kind2}     <= {f_kind, f_kind1};
        {f_at1, f_at2}         <= {f_at, f_at1};
        {f_period1, f_period2} <= {f_period, f_period1};
        {f_width1, f_width2}   <= {f_width, f_width1};
        {f_asked1, f_asked2}   <= {f_asked, f_asked1};
        {f_before1, f_before2} <= {f_before, f_before1};
        {f_swap, f_invert}     <= {swap, invert};
        f_high                 <= (f_end2 | ~f_live2) ? 22'd0 : f_total;
        if (~f_live2) f_debt <= 33'd0;
        else if (f_end2) f_debt <= f_debt + (f_kind2 == PDM ? {11'd0, f_width2} - {16'd0, f_plus, 16'd0} : {4'd0, f_asked2} - {3'd0, f_total, 8'd0});
`ifndef BROKEN
        assert (minus_pulses == (f_kind1 == UP_DOWN));
        if (~f_live1) assert (~plus & (f_kind1 != UP_DOWN | ~minus));
        else if (f_kind1 == PDM) assert (plus == f_bit1 & minus == f_dir1);
        else if (f_kind1 == UP_DOWN) assert (plus == (f_period1 != 0 & f_at1 < f_width1 & ~f_dir1) & minus == (f_period1 != 0 & f_at1 < f_width1 & f_dir1));
        else assert (plus == (f_period1 != 0 & f_at1 < f_width1) & minus == f_dir1);
        if (f_live2 & f_kind2 != PDM) assert (f_active == (f_period2 != 0 & f_at2 < f_width2));
        if (f_live2 & f_kind2 != PDM) assert (f_high == (f_at2 < f_width2 ? {1'b0, f_at2} : f_width2) | f_period2 == 0);
`endif
`ifdef PROVE_dither_is_never_a_clock_in_debt
`ifndef BROKEN
        if (f_live2) assert (f_debt == {25'd0, f_before2[7:0]});
`endif
        assert (f_debt < 33'd256);
`endif
`ifdef PROVE_density_is_never_a_bit_in_debt
`ifndef BROKEN
        if (f_live2) assert (f_debt == {17'd0, f_before2[23:8]});
`endif
        assert (f_debt < 33'd65536);
        if (f_live2) assert (f_plus == f_bit2);  // and a bit is one level for `period` clocks
`endif
`ifdef PROVE_high_time_per_period_is_the_width
        if (f_live2 & f_end2 & f_kind2 != PDM) assert (f_total == f_wanted);
`endif
`ifdef PROVE_up_and_down_are_never_both_active_and_never_the_wrong_one
        if (f_kind2 == UP_DOWN) assert (~(f_plus & f_minus));
        if (f_kind2 == UP_DOWN) assert (~(f_dir2 ? f_plus : f_minus));
`endif
`ifdef PROVE_nothing_is_active_behind_a_closed_gate_nor_until_committed
        if (~f_live2) assert (~f_active);
        if (~f_live2 & f_kind2 != UP_DOWN) assert (~f_minus);
`endif
    end
`endif
endmodule
`default_nettype wire
