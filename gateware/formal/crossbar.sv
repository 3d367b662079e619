// The guarantees of the crossbar, of any four sinks: the routes that were written for them last are
// said by their bytes, without a table. The defaults are a board with 56 pins.
`default_nettype none
module crossbar_promises #(
    parameter integer SOURCES = 36,
    parameter integer SINKS   = 56,
    parameter bit LINK = 1'b0
) (
    input wire                clk, shut, we,
    input wire          [4:0] to,
    input wire         [31:0] word,
    input wire  [SOURCES-1:0] sources,
    input wire    [SINKS-1:0] own
);
    logic             idle, ready;
    logic [SINKS-1:0] sinks;
    (* anyconst *) logic [4:0] f_to;
    logic [31:0] f_routes = 32'd0;  // of these four; the lines below f_lines are theirs already
    logic        f_known  = 1'b0;   // a word has been written for them
    // A word is taken while shut and idle, and takes 16 clocks in which it is shut.
    logic       f_busy = 1'b0, f_any = 1'b0;
    logic [4:0] f_lines = 5'd16;
    crossbar #(.SOURCES(SOURCES), .SINKS(SINKS), .LINK(LINK)) core (.*);

    always_ff @(posedge clk) begin
        if (shut & f_busy) begin
            f_lines <= f_lines + 5'd1;
            if (f_lines == 5'd15) {f_busy, f_any} <= 2'b01;
        end
        if (shut & we & ~f_busy) begin
            {f_busy, f_lines} <= {1'b1, 5'd0};
            if (to == f_to) {f_known, f_routes} <= {1'b1, word};
        end
    end

    // What a byte says of its sink.
    logic [3:0] f_says;
    wire [SOURCES + 3:0] f_all = {own[4 * f_to +: 4], sources};
    always_comb
        for (int n = 0; n < 4; n++)
            f_says[n] = f_routes[8 * n +: 7] >= 7'd124 ? f_routes[8 * n + 7]
                : f_routes[8 * n +: 7] < 7'(SOURCES + 4) & (f_all[f_routes[8 * n +: 7]] ^ f_routes[8 * n + 7]);

    logic       past = 1'b0, past_open;
    logic [3:0] past_sinks;
    logic [SOURCES + 3:0] past_all;
    always_ff @(posedge clk) begin
        past       <= 1'b1;
        past_open  <= ~shut;
        past_sinks <= sinks[4 * f_to +: 4];
        past_all   <= f_all;
    end

    wire f_one = f_to < 5'(SINKS / 4);
    always_ff @(posedge clk) begin
`ifndef BROKEN
        assert (idle == ~f_busy & ready == (f_any & ~f_busy));
        assert (f_busy ? f_lines < 5'd16 : f_lines == 5'd16);
        assert (~f_known | f_any | f_busy);
`endif
`ifdef PROVE_the_same_at_full_width
`define PROVE_a_sink_carries_the_one_source_that_was_written_for_it
`define PROVE_a_sink_for_which_nothing_was_written_is_0
`define PROVE_no_table_changes_while_it_may_not_be_written
`define PROVE_it_is_ready_only_when_all_lines_of_the_last_word_are_written
`endif
`ifdef PROVE_a_sink_carries_the_one_source_that_was_written_for_it
        if (f_one & ready & f_known) assert (sinks[4 * f_to +: 4] == f_says);
`endif
`ifdef PROVE_a_sink_for_which_nothing_was_written_is_0
        if (f_one & ~f_known) assert (sinks[4 * f_to +: 4] == 4'd0);
`endif
`ifdef PROVE_no_table_changes_while_it_may_not_be_written
        if (f_one & past & past_open & f_all == past_all) assert (sinks[4 * f_to +: 4] == past_sinks);
`endif
`ifdef PROVE_it_is_ready_only_when_all_lines_of_the_last_word_are_written
        assert (ready == (f_any & ~f_busy) & idle == ~f_busy);
`endif
    end
endmodule
`default_nettype wire
