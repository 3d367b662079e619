// rx_admission: decides which frames may occupy a receive slot. While the words of a frame stream
// into the slot, it compares the headers with one set of words. If they differ and there is no
// ticket, the frame is discarded at its end, like one with a wrong FCS.
//
// A frame with the expected words is the owner's and is never refused. Every other frame is a guest
// and needs a ticket. There is one ticket at a time: the firmware issues it when it has time for a
// guest, and the guest that is taken uses it up. So a storm of guests occupies one slot at most,
// costs one frame's work per ticket, and leaves the other slots to the owner.
//
//   mode       the words compared                                                  a guest is a frame that is not
//   0          none                                                                (no guests)
//   1          0, 1          to this MAC address                                   for this board alone
//   2, 3       0 to 3, 7, 9  MAC addresses, IPv4 over Ethernet, source, UDP ports  the owner's (or ARP, by MAC address)
//
//   word   0         1         2         3          4           7          8          9
//          |00 00 dst| dst     | src     |src 08 00 |45 ...     |source IP |our IP    |ports    ...
//
// The 16 expected words have places 0 to 15: words 0 to 4, 6 to 11 and 13 to 17 of a frame. Words 5
// and 12 are never compared. fast_path.sv compares all of them: `at` is the number of the word that
// passes, and `like_high` and `like_low` say whether its halves are the expected ones.
//
//   valid   _/‾\_/‾\_/‾\_ .. _/‾\__________/‾\_ ..           a word passes, at most one a clock
//   last    _________________/‾\______________ ..
//   refuse  ___ anything ____/‾\______________               with the last word: one of a guest's without a ticket
//   admit   _/‾\_____________________________
//   ticket  ___/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\______________               used up by a guest with a right FCS that found a slot free
//
// A frame of less than 59 bytes without its FCS always counts as a guest. A frame that passes while
// the words or the mode change may become a guest, too: a set of words written between two frames
// is never mixed.
//
`default_nettype none
module rx_admission (
    input  wire         clk,
    input  wire         header_we,
    input  wire  [3:0]  header_at,
    input  wire  [31:0] header,     // as a slot's word reads, first byte on the wire in bits 31:24
    input  wire  [1:0]  mode,
    input  wire         admit,      // pulse: a ticket, if there is none

    input  wire         valid,      // a word passes
    input  wire         last,       // and is the frame's last
    input  wire         bad,        // with the last: the FCS is wrong
    input  wire         room,       // the frame found a slot free
    input  wire  [31:0] data,
    output wire         refuse,     // with the last: discard it
    output logic [31:0] refused,    // discarded for that alone, a count
    output logic [4:0]  at,         // number of this word; 24 stays
    output wire         like_high,  // bits 31:16 of it are as expected; false at 5, 12, 18 and up
    output wire         like_low    // bits 15:0
);
    logic [31:0] expected [0:15];
    logic [3:0]  place = 4'd0;   // of the expected word
    logic        same = 1'b1;    // no word so far differs
    logic        arp = 1'b0;     // the rest of the frame is not IP
    logic        ticket = 1'b0;
    initial at = 5'd0;
    initial refused = 32'd0;

    wire [31:0] differ  = data ^ expected[place];
    wire        to_us   = at[4:1] == 4'd0;
    wire        by_whom = (at[4:1] == 4'd1) | (at == 5'd7) | (at == 5'd9);
    wire        counts  = to_us ? mode != 2'd0 : by_whom & mode[1] & ~arp;
    wire        is_arp  = (at == 5'd3) & (differ[2:1] == 2'b11);  // 0x0800 ^ 0x0806
    wire        others  = (differ[15:3] != 13'd0) | differ[0];    // of the lower half
    assign like_high = differ[31:16] == 16'd0;
    assign like_low  = ~others & (differ[2:1] == 2'd0);

    wire guests = (mode != 2'd0) & ~(same & (at[4] | (&at[3:0])));  // from word 15 on
    wire ends   = valid & last & ~bad & room;
    assign refuse = guests & ~ticket;

    always_ff @(posedge clk) begin
        if (header_we) expected[header_at] <= header;
        if (valid) begin
            at    <= last ? 5'd0 : at + 5'(~&at[4:3]);
            place <= last ? 4'd0 : place + 4'((at != 5'd5) & (at != 5'd12));
            same  <= last | (same & ~(counts & (~like_high | others | ((differ[2:1] != 2'd0) & ~is_arp))));
            arp   <= ~last & (arp | is_arp);
        end
        ticket <= admit | (ticket & ~(ends & guests));
        if (ends & refuse) refused <= refused + 32'd1;
    end

`ifdef FORMAL  // what gateware/formal proves, for any words that do not change
    (* anyconst *) logic [4:0] f_word;
    logic [5:0] f_at = 6'd0;       // number of this word, 32 stays
    logic       f_differs = 1'b0;  // word `f_word` was not the expected one
    logic       f_like = 1'b1;     // all compared words were
    logic       f_arp = 1'b0;
    logic       f_steady = 1'b1;   // the mode has not changed since the first word
    logic [1:0] f_mode = 2'd0;
    logic       f_let_in = 1'b0;   // with an unused ticket
    logic [31:0] f_ended = 32'd0, f_taken = 32'd0;

    // Which place a word has, as the register map says it.
    wire [5:0] f_place = f_at - {5'd0, f_at > 6'd5} - {5'd0, f_at > 6'd12};
    wire [31:0] f_wanted = expected[f_place[3:0]];
    wire f_compared = (f_at < 6'd2) | (mode[1] & ((f_at == 6'd2) | (f_at == 6'd3) | (~f_arp & ((f_at == 6'd7) | (f_at == 6'd9)))));
    wire f_is_arp   = (f_at == 6'd3) & (data == (expected[3] ^ 32'd6));
    wire f_equal    = (data == f_wanted) | f_is_arp;
    wire f_takes    = ends & ~refuse;
    wire f_held     = (f_at == 6'd0) | (f_steady & (mode == f_mode));
    wire f_whole    = f_held & (f_at >= 6'd15);
    always_ff @(posedge clk) begin
        if (valid) begin
            f_at      <= last ? 6'd0 : f_at + 6'(f_at != 6'd32);
            f_differs <= ~last & (f_differs | (f_compared & (f_at == {1'b0, f_word}) & ~f_equal));
            f_like    <= last | (f_like & (~f_compared | f_equal));
            f_arp     <= ~last & (f_arp | ((f_at == 6'd3) & (data[2:1] == ~expected[3][2:1])));
        end
        f_mode   <= mode;
        f_steady <= f_held | (valid & last);
        f_let_in <= admit | (f_let_in & ~(f_takes & guests));
        if (ends) f_ended <= f_ended + 32'd1;
        if (f_takes) f_taken <= f_taken + 32'd1;
    end
    always_comb begin
`ifndef BROKEN
        assert (f_at <= 6'd32);
        assert (at == (f_at > 6'd24 ? 5'd24 : f_at[4:0]));
        assert (f_at > 6'd17 | place == f_place[3:0]);
        assert (arp == f_arp);
        assert (~f_arp | (f_at > 6'd3));
        assert (ticket == f_let_in);
        assert (~(f_held & (mode != 2'd0)) | (same == f_like));
        assert (~f_differs | ~f_like);
        assert (~(f_at == 6'd0) | (same & f_like & ~f_arp & ~f_differs));
`endif
`ifdef PROVE_a_frame_unlike_the_owners_is_taken_only_with_a_ticket
        if (f_takes & f_held & (mode != 2'd0) & (f_differs | (f_at < 6'd15))) assert (f_let_in);
`endif
`ifdef PROVE_a_ticket_lets_in_one_guest
        if (f_takes & guests) assert (f_let_in);
`endif
`ifdef PROVE_the_owners_frame_is_never_refused
        if (valid & last & f_whole & f_like) assert (~refuse);
`endif
`ifdef PROVE_a_frame_that_is_not_taken_is_counted
        assert (refused == f_ended - f_taken);
`endif
`ifdef PROVE_without_a_mode_there_are_no_guests
        if (mode == 2'd0) assert (~refuse);
`endif
`ifdef PROVE_every_word_is_compared_with_the_one_in_its_place
        assert (at == (f_at > 6'd24 ? 5'd24 : f_at[4:0]));
        if (f_at < 6'd18 & f_at != 6'd5 & f_at != 6'd12) assert ((like_high & like_low) == (data == f_wanted) & like_high == (data[31:16] == f_wanted[31:16]));
`endif
    end
`endif
endmodule
`default_nettype wire
