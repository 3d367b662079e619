// The guarantees of the guard, said with the bounds of the windows in bytes. `set` comes from the
// bus through registers, so a word that sets it is an access of some clocks ago.
`default_nettype none
module guard_promises (
    input wire        clk,
    input wire        rst, set,
    input wire [31:0] word,
    input wire        stb, we,
    input wire [29:0] adr,
    input wire        ack,
    input wire        vacant
);
    localparam [31:0] KEY = 32'h4f50_4e21;
    logic        we_out, answer, closed, refused, irq;
    logic [29:0] at;
    guard #(
        .KEY(KEY), .WAYS(6),
        .PLACES({30'h1000_0000, 30'h3c00_8400, 30'h3c00_1202, 30'h3c00_120b, 30'h0400_0000, 30'h0400_0100}),
        .ROOMS ({30'h001f_ffff, 30'h0000_01ff, 30'h0000_0000, 30'h0000_0000, 30'h0000_00ff, 30'h0000_007f})
    ) core (.*);

    wire [31:0] byte_at = {adr, 2'b00};
    wire theirs = byte_at >= 32'h4000_0000 & byte_at < 32'h4080_0000  // SDRAM
        | byte_at >= 32'hf002_1000 & byte_at < 32'hf002_1800          // segments
        | byte_at == 32'hf000_4808                                    // timebase.snapshot
        | byte_at == 32'hf000_482c                                    // timebase.guard
        | byte_at >= 32'h1000_0000 & byte_at < 32'h1000_0600;         // the window in RAM

    // Is it closed? Its own memory is not asked.
    logic shut = 1'b0;
    // The first access it has refused since then.
    logic        was_refused = 1'b0;
    logic [29:0] first = 30'd0;
    logic        past_answer = 1'b0, past_vacant = 1'b0;
    wire store = stb & we & ~theirs, answered = answer & ack;
    always_ff @(posedge clk) begin
        {past_answer, past_vacant} <= {answer, vacant};
        if (shut & ~was_refused & (store | answered)) begin
            was_refused <= 1'b1;
            first <= adr;
        end
        if (set) begin
            shut <= word != KEY;
            if (~shut) was_refused <= 1'b0;
        end
        if (rst) {shut, was_refused} <= 2'b00;
    end

    logic valid = 1'b0, past_closed = 1'b0, past_opens = 1'b0;
    always_ff @(posedge clk) begin
        valid <= 1'b1;
        past_closed <= closed;
        past_opens <= rst | set & word == KEY;
    end

    always_ff @(posedge clk) begin
`ifndef BROKEN
        assert (closed == shut);
        assert (refused == was_refused);
        if (refused) assert (at == first);
        assert (past_answer ? ~answer : answer == past_vacant);
`endif
`ifdef PROVE_closed_no_write_leaves_but_to_what_is_allowed
        if (shut & ~theirs) assert (~we_out);
`endif
`ifdef PROVE_what_is_allowed_passes_closed_as_well
        if (theirs) assert (we_out == we);
`endif
`ifdef PROVE_only_the_key_or_a_reset_opens_it
        if (valid & past_closed & ~past_opens) assert (closed);
`endif
`ifdef PROVE_open_it_is_a_wire
        if (~shut) assert (we_out == we);
        assert (we | ~we_out);
`endif
`ifdef PROVE_the_first_refused_access_is_told_and_interrupts_until_it_is_opened
        assert (irq == (shut & was_refused));
        if (was_refused) assert (at == first);
`endif
`ifdef PROVE_where_there_is_nothing_each_access_is_answered_once_and_at_once
        assert (answer == (past_vacant & ~past_answer));
`endif
    end
endmodule
`default_nettype wire
