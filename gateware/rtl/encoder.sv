// encoder: counts quadrature edges, remembers where the index was and when the last edge came.
//
// A level counts after it has stayed for `filter` clocks more than one. Counting never stops for a closed gate, so the
// position of a machine pushed by hand is known. Both lines changing on one clock is an error, counted and not guessed.
//
//   a      ___/‾‾‾‾‾‾‾\_______/‾‾‾‾‾‾‾\___        filtered
//   b      _______/‾‾‾‾‾‾‾\_______/‾‾‾‾‾‾‾
//   count  0  1   2   3   4   5   6   7   8       A before B counts up
//
//   arm     __/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\____
//   index   _____/‾‾\______/‾‾\_________          the first rise after arming latches the count,
//   latched _____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\____          later ones do not; arm = 0 clears the flag
//
`default_nettype none
module encoder #(
    parameter integer FILTER = 8  // width of the filter counters
) (
    input  wire              clk,
    input  wire              a,          // the pins, asynchronous
    input  wire              b,
    input  wire              index,
    input  wire              arm,
    input  wire [FILTER-1:0] filter,
    input  wire       [31:0] now,
    output logic      [31:0] count,
    output logic      [31:0] latch,
    output logic             latched,
    output logic      [31:0] edge_time,  // `now` of the clock in which the count last changed
    output logic      [15:0] errors
);
    wire a_level, b_level, i_level;
    debounce #(.WIDTH(FILTER)) a_filter (.clk(clk), .pin(a), .filter(filter), .level(a_level));
    debounce #(.WIDTH(FILTER)) b_filter (.clk(clk), .pin(b), .filter(filter), .level(b_level));
    debounce #(.WIDTH(FILTER)) i_filter (.clk(clk), .pin(index), .filter(filter), .level(i_level));

    logic a_was = 1'b0, b_was = 1'b0, i_was = 1'b0;
    logic [1:0] settle = 2'd0;  // the first clocks after power-up show the pins' levels, not edges

    wire a_edge  = a_level ^ a_was;
    wire b_edge  = b_level ^ b_was;
    wire live    = &settle;
    wire counts  = live & (a_edge ^ b_edge);
    wire down    = a_level ^ b_was;  // after one edge, A and the old B differ: B leads
    wire [31:0] next = count + (counts ? {{31{~down}}, 1'b1} : 32'd0);

    always_ff @(posedge clk) begin
        a_was <= a_level;
        b_was <= b_level;
        i_was <= i_level;
        if (~live) settle <= settle + 2'd1;
        count <= next;
        if (counts) edge_time <= now;
        if (live & a_edge & b_edge) errors <= errors + 16'd1;
        if (~arm) latched <= 1'b0;
        else if (live & i_level & ~i_was & ~latched) begin
            latched <= 1'b1;
            latch   <= next;
        end
    end

    initial begin
        count     = 32'd0;
        latch     = 32'd0;
        latched   = 1'b0;
        edge_time = 32'd0;
        errors    = 16'd0;
    end
endmodule

// debounce: two flip-flops against metastability, then a level must stay `filter` + 1 clocks to be believed.
module debounce #(
    parameter integer WIDTH = 8
) (
    input  wire             clk,
    input  wire             pin,
    input  wire [WIDTH-1:0] filter,
    output logic            level
);
    (* keep *) logic meta = 1'b0;
    (* keep *) logic sync = 1'b0;
    logic [WIDTH-1:0] held = {WIDTH{1'b0}};
    initial level = 1'b0;

    always_ff @(posedge clk) begin
        meta <= pin;
        sync <= meta;
        if (sync == level) held <= {WIDTH{1'b0}};
        else if (held >= filter) begin
            level <= sync;
            held  <= {WIDTH{1'b0}};
        end else held <= held + {{(WIDTH-1){1'b0}}, 1'b1};
    end
endmodule
`default_nettype wire
