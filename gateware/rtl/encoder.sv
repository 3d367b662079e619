// encoder: turns the lines of a shaft encoder into counts. The wide count is in wide_counter.sv,
// the index latch in latch.sv, the time of the last edge in edges.sv. This module finds the edges,
// per channel and at every clock.
//
// A and B count after both have been stable for `filter` + 2 clocks. So every legal sequence with
// transitions at least `filter` + 3 clocks apart at the asynchronous pins is counted exactly:
// f_clk/3 transitions per second at filter 0. Counting does not stop for a closed gate, so the
// position of a machine pushed by hand stays known. A change of both lines at once is reported as
// an error, and not counted.
//
//   a        ___/‾‾‾‾‾‾‾\_______/‾‾‾‾‾‾‾\___        filtered
//   b        _______/‾‾‾‾‾‾‾\_______/‾‾‾‾‾‾‾
//   x4       0  1   2   3   4   5   6   7   8       A before B counts up
//   x2       0  1       2       3       4           edges of A
//   x1       0  1               2                   A while B is low; its way back takes the count back, so that a line
//                                                   that jitters across one edge does not run away
//
//   mode 2:0  0 x4, 1 x2, 2 x1, 3 counter (a rise of A counts up, B is ignored), 4 step/dir (a rise of A counts, B = 1
//             down), 5 up/down (a rise of A up, of B down; both at once cancel), 6 as 4, 7 as 5
//   mode 4    index_invert      mode 5  mask_enable: the index is seen only while the mask pin is active
//   mode 6    mask_invert       mode 7  clear_on_index, for the wide counter
//
`default_nettype none
module encoder #(
    parameter integer FILTER = 8  // width of the filter timers
) (
    input  wire              clk,
    input  wire              a,            // the pins, asynchronous
    input  wire              b,
    input  wire              index,
    input  wire              mask,
    input  wire [7:0]        mode,
    input  wire [FILTER-1:0] filter,       // in clocks
    input  wire              visit,        // wide_counter.visit of this channel
    // signed counts since the visit, without the one of this clock
    output logic [4:0]       delta,
    // filtered as A and B are, masked, polarity applied: rises with the count it belongs to
    output logic             index_level,
    output wire              moved,        // pulse: the count changes in this clock
    // pulse: both lines changed at once; only where A and B are quadrature
    output wire              illegal
);
    // Two flip-flops against metastability. Those of A start unlike each other, so that no level is
    // accepted before the pin was seen.
    (* keep *) logic a_meta = 1'b0, b_meta = 1'b0, i_meta = 1'b0, m_meta = 1'b0;
    (* keep *) logic a_sync = 1'b1, b_sync = 1'b0, i_sync = 1'b0, m_sync = 1'b0;

    wire [1:0] level;
    wire       known, index_seen, index_known;
    wire       index_in = (i_sync ^ mode[4]) & ((m_sync ^ mode[6]) | ~mode[5]);
    debounce #(.LINES(2), .WIDTH(FILTER)) shaft (
`ifdef FORMAL
        .f_was(f_was), .f_still(f_still),
`endif
        .clk(clk), .lines({a_sync, b_sync}), .filter(filter), .level(level), .known(known));
    debounce #(.LINES(1), .WIDTH(FILTER)) mark (
`ifdef FORMAL
        .f_was(f_mark_was), .f_still(f_mark_still),
`endif
        .clk(clk), .lines(index_in), .filter(filter), .level(index_seen), .known(index_known));

    logic a_was = 1'b0, b_was = 1'b0, live = 1'b0;
    wire  a_now = level[1], b_now = level[0];
    wire  a_edge = a_now ^ a_was, b_edge = b_now ^ b_was;
    wire  a_rise = a_now & ~a_was, b_rise = b_now & ~b_was;
    logic counts, up;

    always_comb begin
        up = a_now ^ b_was;  // after one edge, A and the old B differ: A leads
        case (mode[2:0])
            3'd0: counts = a_edge ^ b_edge;
            3'd1: counts = a_edge & ~b_edge;
            3'd2: counts = a_edge & ~b_edge & ~b_now;
            3'd3: counts = a_rise;
            3'd4, 3'd6: counts = a_rise;
            default: counts = a_rise ^ b_rise;
        endcase
        if (mode[2:0] == 3'd3) up = 1'b1;
        else if (mode[2]) up = mode[0] ? a_rise : ~b_now;
    end
    assign moved = live & counts;
    assign illegal = live & a_edge & b_edge & ~mode[2] & (mode[1:0] != 2'd3);

    always_ff @(posedge clk) begin
        a_meta <= a;
        b_meta <= b;
        i_meta <= index;
        m_meta <= mask;
        a_sync <= a_meta;
        // a counter's B may be open; noise there must not hold A up
        b_sync <= b_meta & (mode[2:0] != 3'd3);
        i_sync <= i_meta;
        m_sync <= m_meta;
        a_was  <= a_now;
        b_was  <= b_now;
        live   <= known;
        index_level <= index_seen;
        delta <= (visit ? 5'd0 : delta) + (moved ? {{4{~up}}, 1'b1} : 5'd0);
    end

    initial delta = 5'd0;
    initial index_level = 1'b0;
    wire unused = &{1'b0, mode[7], mode[3], index_known};

// what gateware/formal proves: a shaft, as seen at the pins, and the count that is due for it
`ifdef FORMAL
    wire [1:0]        f_was;
    wire [FILTER-1:0] f_still, f_mark_still;
    wire              f_mark_was;
    wire [1:0]        f_pins = {a, b & (mode[2:0] != 3'd3)};
    logic [1:0]       f_last = 0;
    // after the pins, the flip-flops, those of the filter: not the power-up value any more
    logic [2:0]       f_any = 0;
    // The ghosts count modulo 256: they are never more than three apart, so equal modulo 256 means
    // equal.
`ifdef PROVE_total_and_delta_are_the_count
    localparam integer F = 32;
`else
    localparam integer F = 8;
`endif
    logic [F-1:0]     f_told = 0, f_lies = 0;
    always_ff @(posedge clk) begin
        f_any  <= {f_any[1:0], 1'b1};
        f_last <= f_pins;
        if (moved) f_told <= up ? f_told + 1 : f_told - 1;
        if (illegal) f_lies <= f_lies + 1;
    end

`ifdef PROVE_total_and_delta_are_the_count
    // Any levels at the pins; visits at most 16 clocks apart, as the wide counter's are.
    logic [31:0] f_total = 0;
    logic [4:0]  f_gap = 0;
    logic        f_moved = 0;
    wire  [4:0]  f_size = delta[4] ? -delta : delta;
    always_ff @(posedge clk) begin
        if (visit) f_total <= f_total + {{27{delta[4]}}, delta};
        f_gap   <= visit ? 1 : f_gap + 1;
        f_moved <= moved;
    end
    always_comb begin
        assume (visit | f_gap < 16);
        assert (f_gap <= 16 & f_size <= (f_gap + f_moved) >> 1);
        assert (f_total + {{27{delta[4]}}, delta} == f_told);
    end
`else
    // A pair of levels lasts filter + 2 clocks or more. The count it is due, without the logic
    // above:
    function automatic f_up(input [2:0] kind, input [1:0] from, input [1:0] to);
        f_up = kind == 0 ? {from, to} == 4'b00_10 | {from, to} == 4'b10_11 | {from, to} == 4'b11_01 | {from, to} == 4'b01_00
             : kind == 1 ? {from, to} == 4'b00_10 | {from, to} == 4'b11_01
             : kind == 2 ? {from, to} == 4'b00_10
             : kind == 3 ? to[1] > from[1]
             : kind == 4 | kind == 6 ? to[1] > from[1] & ~to[0]
             : to[1] > from[1] & ~(to[0] > from[0]);
    endfunction
    function automatic f_down(input [2:0] kind, input [1:0] from, input [1:0] to);
        f_down = kind < 3 ? f_up(kind, to, from)
               : kind == 3 ? 1'b0
               : kind == 4 | kind == 6 ? to[1] > from[1] & to[0]
               : to[0] > from[0] & ~(to[1] > from[1]);
    endfunction
    function automatic [F-1:0] f_step(input [2:0] kind, input [1:0] from, input [1:0] to);
        f_step = f_up(kind, from, to) ? 1 : f_down(kind, from, to) ? -1 : 0;
    endfunction
    function automatic f_lie(input [2:0] kind, input [1:0] from, input [1:0] to);
        f_lie = kind < 3 & (from ^ to) == 2'b11;
    endfunction

    wire        f_moves = f_any[0] & f_pins != f_last;
    wire [F-1:0] f_step_pins = f_step(mode[2:0], f_last, f_pins), f_step_level = f_step(mode[2:0], level, f_was);
    wire [F-1:0] f_step_last = f_step(mode[2:0], {a_was, b_was}, level);
    wire        f_lie_pins = f_lie(mode[2:0], f_last, f_pins), f_lie_to_level = f_lie(mode[2:0], level, f_was);
    wire        f_lie_to_last = f_lie(mode[2:0], {a_was, b_was}, level);
    // clocks since the pair at this stage came
    logic [FILTER+1:0] f_age = 0, f_age_sync = 0, f_age_was = 0;
    logic [2:0]  f_turned = 0;  // for each stage: this pair is not the one of power-up
    logic        f_rested = 0;  // the pair before was completely counted when this one came
    logic [F-1:0] f_due = 0, f_due_sync = 0, f_due_was = 0, f_due_level = 0, f_due_last = 0, f_before = 0;
    logic [F-1:0] f_lie_due = 0, f_lie_sync = 0, f_lie_was = 0, f_lie_level = 0, f_lie_last = 0;
    always_ff @(posedge clk) begin
        f_age      <= ~f_any[0] | f_moves ? 1 : &f_age ? f_age : f_age + 1;
        f_age_sync <= f_age;
        f_age_was  <= f_age_sync;
        f_turned   <= {f_turned[1:0], f_turned[0] | f_moves};
        if (f_moves) f_rested <= f_age >= filter + 5;
        if (f_moves) f_before <= f_due;
        if (f_moves) f_due <= f_due + f_step_pins;
        if (f_moves) f_lie_due <= f_lie_due + f_lie_pins;
        {f_due_sync, f_lie_sync} <= {f_due, f_lie_due};
        {f_due_was, f_lie_was}   <= {f_due_sync, f_lie_sync};
        if ({a_sync, b_sync} == f_was & f_still == filter) {f_due_level, f_lie_level} <= {f_due_was, f_lie_was};
        {f_due_last, f_lie_last} <= {f_due_level, f_lie_level};
    end

    always_comb begin
        if (f_moves) assume (f_age >= filter + 2);
`ifdef PROVE_count_is_exact_for_every_legal_sequence
        assume (~mode[2] & mode[1:0] != 3);
        if (f_moves) assume (^(f_pins ^ f_last));
`endif
        // From stage to stage, the due counts differ by the same amount as the pairs.
        if (f_any[0]) assert (f_age != 0);
        if (f_any[2]) assert (f_age_was > filter ? f_still == filter : f_still >= f_age_was - 1 & f_still <= filter);
        if (f_turned[2]) assert (f_age_was > filter | f_still == f_age_was - 1);
        if (f_any[2] & f_age_was >= filter + 2) assert (known & level == f_was);
        if (known) assert (f_any[2] & f_due_was - f_due_level == f_step_level);
        if (known) assert (f_lie_was - f_lie_level == f_lie_to_level);
        if (~known) assert (f_due_was == 0 & f_due_level == 0 & f_lie_was == 0 & f_lie_level == 0);
        if (live) assert (known & f_due_level - f_due_last == f_step_last);
        if (live) assert (f_lie_level - f_lie_last == f_lie_to_last);
        if (~live) assert (f_due_last == 0 & f_due_level == 0 & f_lie_last == 0 & f_lie_level == 0);
        assert (f_told == f_due_last & f_lies == f_lie_last);
        if (f_rested) assert (f_turned[0] & (f_age >= filter + 4 | f_due_level == f_before) & (f_age >= filter + 5 | f_due_last == f_before));
        // The guarantee: filter + 5 clocks after an edge it has been counted, and not a clock
        // earlier.
        if (f_age >= filter + 5) assert (f_told == f_due & f_lies == f_lie_due);
        else if (f_rested) assert (f_told == f_before);
    end

`ifdef PROVE_count_is_exact_for_every_legal_sequence
    // The shaft's position in quarters of a line, and x4, x2 and x1 by arithmetic: none of them can
    // accumulate errors.
    logic [F+1:0] f_position = 0, f_start = 0;
    wire  [F+1:0] f_at_rest = {{F{1'b0}}, f_pins[0], ^f_pins};
    wire         f_forward = f_pins[1] ^ f_last[0];
    always_ff @(posedge clk) begin
        if (~f_any[0]) {f_position, f_start} <= {f_at_rest, f_at_rest};
        else if (f_moves) f_position <= f_forward ? f_position + 1 : f_position - 1;
    end
    wire [F+1:0] f_half = (f_position + 1 >> 1) - (f_start + 1 >> 1), f_whole = (f_position + 3 >> 2) - (f_start + 3 >> 2);
    always_comb if (f_any[0]) begin
        assert (f_last == {^f_position[1:0], f_position[1]});
        assert (f_due == (mode[1:0] == 0 ? f_position[F-1:0] - f_start[F-1:0] : mode[1:0] == 1 ? f_half[F-1:0] : f_whole[F-1:0]));
        assert ({f_lie_due, f_lie_sync, f_lie_was, f_lie_level, f_lie_last, f_lies} == 0);
    end
`endif
`ifdef PROVE_the_index_is_as_late_as_the_count
    wire  f_index = (index ^ mode[4]) & (~mode[5] | (mask ^ mode[6]));
    logic f_index_last = 0, f_index_before = 0, f_index_rested = 0;
    logic [2:0] f_index_turned = 0;
    logic [FILTER+1:0] f_index_age = 0, f_index_sync = 0, f_index_was = 0;
    wire  f_index_moves = f_any[0] & f_index != f_index_last;
    always_ff @(posedge clk) begin
        f_index_last  <= f_index;
        f_index_age   <= ~f_any[0] | f_index_moves ? 1 : &f_index_age ? f_index_age : f_index_age + 1;
        f_index_sync  <= f_index_age;
        f_index_was   <= f_index_sync;
        f_index_turned <= {f_index_turned[1:0], f_index_turned[0] | f_index_moves};
        if (f_index_moves) f_index_before <= f_index_last;
        if (f_index_moves) f_index_rested <= f_index_age >= filter + 5;
    end
    always_comb begin
        if (f_index_moves) assume (f_index_age >= filter + 2);
        if (f_any[0]) assert (f_index_age != 0);
        if (f_any[2]) assert (f_index_was > filter ? f_mark_still == filter : f_mark_still >= f_index_was - 1 & f_mark_still <= filter);
        if (f_any[2] & f_index_was >= filter + 2) assert (index_seen == f_mark_was);
        if (f_index_turned[2]) assert (f_index_was > filter | f_mark_still == f_index_was - 1);
        if (f_index_rested) assert (f_index_turned[0] & (f_index_age >= filter + 4 | index_seen == f_index_before));
        if (f_index_age >= filter + 5) assert (index_level == f_index_last);
        else if (f_index_rested) assert (index_level == f_index_before & f_index_before != f_index_last);
    end
`endif
`endif
`endif
endmodule
`default_nettype wire
