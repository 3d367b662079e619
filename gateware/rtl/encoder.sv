// encoder: turns the lines of a shaft into counts. The wide count is tally.sv's, the index latch latch.sv's, the time of
// the last edge edges.sv's; what makes an edge is here, per channel and at every clock.
//
// A and B count after both have stood still for `filter` + 2 clocks, so every legal sequence whose transitions are at
// least `filter` + 3 clocks apart at the asynchronous pins is counted exactly: f_clk/3 transitions per second at filter 0.
// Counting never stops for a closed gate, so the position of a machine pushed by hand is known. Both lines changing at
// once is an error, told and not guessed.
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
//   mode 6    mask_invert       mode 7  clear_on_index, for the tally
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
    input  wire              visit,        // tally.visit of this channel
    output logic [4:0]       delta,        // signed counts since the visit, without the one of this clock
    output logic             index_level,  // filtered as A and B are, masked, polarity applied: rises with the count it belongs to
    output wire              moved,        // pulse: the count changes in this clock
    output wire              illegal       // pulse: both lines changed at once; only where A and B are quadrature
);
    // Two flip-flops against metastability. A's start unlike each other, so that nothing is believed before the pin is seen.
    (* keep *) logic a_meta = 1'b0, b_meta = 1'b0, i_meta = 1'b0, m_meta = 1'b0;
    (* keep *) logic a_sync = 1'b1, b_sync = 1'b0, i_sync = 1'b0, m_sync = 1'b0;

    wire [1:0] level;
    wire       known, index_seen, index_known;
    wire       index_in = (i_sync ^ mode[4]) & ((m_sync ^ mode[6]) | ~mode[5]);
    debounce #(.LINES(2), .WIDTH(FILTER)) shaft (.clk(clk), .lines({a_sync, b_sync}), .filter(filter), .level(level), .known(known));
    debounce #(.LINES(1), .WIDTH(FILTER)) mark (.clk(clk), .lines(index_in), .filter(filter), .level(index_seen), .known(index_known));

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
        b_sync <= b_meta & (mode[2:0] != 3'd3);  // a counter's B may be open; noise there must not hold A up
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
endmodule
`default_nettype wire
