// fast_path: executes the owner's next command without the CPU, and answers it. Firmware judges in
// advance: it writes what the frame of the next command must look like up to its 18th word
// (rx_admission.sv compares), where the words behind go, and of what the answer consists. Then it
// hands out a pass for one command.
//
// A frame that is like that to the last bit, whole, with right checksums, while the gate reads as
// firmware said, is executed: its words have been staged as they passed, all channels commit and
// are sampled on one clock, the watchdog is fed, and the answer leaves. Such a frame takes no
// receive slot, uses up the pass and sets `executed`. Every other frame lies in its slot for
// firmware, and has changed nothing but staged words, which do nothing without a commit.
//
//   valid    _/‾\_ .. _/‾\___/‾\______________________     a word passes; `last` with the frame's last
//   stages   __________/‾\___/‾\______________________     word 18 and up: written to register `to`
//   take     ___________________/‾\___________________     the slot's writer forgets the frame
//   taken    ______________________/‾\________________     commit, sample, feed, send
//   gathers  _______________________________/‾‾\_/‾‾‾‾     a word of the answer is read
//   puts     __________________________________/‾\_/‾‾     a clock later: written to word `put_at` of the slot
//   hold     __________/‾\___/‾‾‾‾‾‾‾\______/‾‾\_/‾‾‾‾     the CPU's access to registers waits
//
// A run is {end, select, skip, count - 1, address}. Runs 0 to 3 say to which registers the received
// words go, in order, runs 4 to 15 from which registers the answer comes. With `skip` nothing is
// read for `count` clocks, and the answer goes on at word `address` of its slot. `end` marks the
// last run of either kind. Run 15 is the last whatever it says, so the bus is always given back.
//
// Two conditions are firmware's, both on the first run of the answer, `skip`: it takes at least 5
// clocks, so that the sampled words are complete when they are read, and at most 15, so that they
// are written before the slot's reader needs them.
//
// The banks keep the address of a read in flip-flops: `gathers_next` and `from_next` say what
// the next clock gathers.
//
`default_nettype none
module fast_path #(
    parameter COUNT_BITS = 6  // of a run's count; fewer only in proofs
) (
    input  wire         clk,
    input  wire         rst,           // takes the pass back and ends an answer
    input  wire         run_we,        // firmware, with no pass out
    input  wire  [3:0]  run_at,
    input  wire  [COUNT_BITS + 12:0] run,
    input  wire  [15:0] ip_sum,        // of the words of the IP header that do not change
    input  wire  [15:0] udp_sum,       // of pseudo header and ports
    input  wire  [7:0]  gate_as,       // how the gate must read
    input  wire         executes,      // 1: commit; 0: only sample and answer
    input  wire         timed,         // commit at its time
    input  wire         pass,          // pulses
    input  wire         revoke,

    input  wire         valid,         // a word on its way into the slots
    input  wire         last,
    input  wire         whole,         // with the last: all four bytes are the frame's
    input  wire         bad,           // with the last: the FCS is wrong
    input  wire  [31:0] data,
    input  wire  [4:0]  at,            // rx_admission.sv: number of this word, 24 stays
    input  wire         like_high,     // and how its halves compare
    input  wire         like_low,

    input  wire  [7:0]  gate_now,
    input  wire         waiting,       // a timed commit is pending
    input  wire  [4:0]  select,        // whose latch was asked for, as staged
    input  wire         free,          // the answer's slot can be sent

    output wire         stages,
    output wire  [9:0]  to,
    output wire         take,
    output logic        taken,
    output wire         commit,
    output wire         commit_timed,
    output wire         gathers_next,
    output wire  [9:0]  from_next,
    output logic        puts,
    output logic [6:0]  put_at,
    output wire         hold,
    output logic        out,           // a pass is
    output logic        executed
);
    logic [COUNT_BITS + 12:0] runs [0:15];
    logic [3:0]  next    = 4'd0;    // number of the run to come
    logic [9:0]  address = 10'd0;   // where the present one is
    logic [COUNT_BITS - 1:0] left = '0;  // words or clocks of it behind this one
    logic        ends    = 1'b0;    // no run follows it
    logic        skips   = 1'b0;
    logic        mine    = 1'b0;    // a pass has been out since the frame's first word
    logic        alike   = 1'b0;    // no word so far differs
    logic        complete = 1'b0;   // the frame ended with the last word of the last run
    logic        gathering = 1'b0;
    logic [6:0]  index   = 7'd0;    // word of the answer
    initial {taken, puts, out, executed} = 4'd0;
    initial put_at = 7'd0;

    wire [COUNT_BITS + 12:0] coming = runs[next];
    wire        turns  = left == '0;

    // ---- is it like the pass? -------------------------------------------------------------------
    // Words 5, 6 and 10 have a half that changes from frame to frame (number, checksums); word 12
    // is padding.
    wire free_word = (at == 5'd5) | (at == 5'd12);
    wire free_low  = (at == 5'd6) | (at == 5'd10);
    wire head      = at < 5'd18;
    wire fragment  = (at == 5'd5) & ((data[13:0] != 14'd0) | data[15]);
    wire unknown   = (at == 5'd23) & (data[31:21] != 11'd0);  // above the selection of a latch
    wire differs   = (head & ((~free_word & (~like_high | (~free_low & ~like_low))) | fragment)) | unknown;

    // ---- the checksums: ones' complement, 32 bits at a time, a carry is added a word later ------
    logic [31:0] sum = 32'd0;
    logic        carry = 1'b0, unsummed = 1'b0;  // the sender has made no checksum
    wire         begins = (at == 5'd4) | (at == 5'd9);
    wire         adds   = (at == 5'd5) | (at == 5'd6) | at[4] | (at[3] & (at[2] | at[1]));  // 10 and up
    wire  [32:0] more   = {1'b0, sum} + {1'b0, data} + {32'd0, carry};
    wire  [16:0] folded = {1'b0, sum[31:16]} + {1'b0, sum[15:0]} + {16'd0, carry};
    wire         right  = (folded[15:1] == 15'h7fff) & (folded[0] != folded[16]);
    wire         ip_wrong = (at == 5'd8) & ~right;

    // ---- the frame's end ------------------------------------------------------------------------
    assign take = complete & (right | unsummed) & out & (gate_now == gate_as) & free;
    assign commit       = taken & executes & ~timed;
    assign commit_timed = taken & executes & timed;

    // A word 23 that differs is staged, too, like those before it.
    assign stages  = valid & mine & out & alike & ~head;
    assign to      = address;
    wire   gathers = gathering & ~skips;
    assign hold    = stages | complete | taken | gathers;
    wire   [9:0] begins_at = coming[9:0] | {5'd0, select & {5{coming[COUNT_BITS + 11]}}};
    assign gathers_next = ~rst & gathering & ~(turns ? ends | coming[COUNT_BITS + 10] : skips);
    assign from_next    = turns ? begins_at : address + {9'd0, ~skips};

    always_ff @(posedge clk) begin
        if (run_we) runs[run_at] <= run;

        out      <= ~rst & (pass | (out & ~revoke & ~take));
        executed <= ~rst & (take | (executed & ~pass));
        taken    <= ~rst & take;
        complete <= ~rst & valid & last & whole & ~bad & mine & out & alike & ~head & ~unknown & turns & ends;

        mine <= mine & out;
        if (valid) begin
            if (at == 5'd0) mine <= out & ~waiting & ~gathering & ~complete;
            alike <= (alike | (at == 5'd0)) & ~differs & ~ip_wrong & ~(~head & turns & ends);
            if (begins) begin
                sum   <= {16'd0, at[0] ? udp_sum : ip_sum};
                carry <= 1'b0;
            end else if (adds) {carry, sum} <= more;
            if (at == 5'd10) unsummed <= data[15:0] == 16'd0;
        end

        // ---- the runs: a word as it comes, then a word or a clock of the answer every clock -----
        if (gathering ? turns : valid & (at == 5'd17 | (~head & turns))) begin
            ends    <= coming[COUNT_BITS + 12] | (&next);
            skips   <= coming[COUNT_BITS + 10];
            left    <= coming[COUNT_BITS + 9:10];
            address <= begins_at;
            next    <= next + 4'd1;
        end else if (gathering | stages) begin
            left    <= left - 1'd1;
            address <= address + {9'd0, ~skips};
        end
        if (valid & ~gathering & at == 5'd0) next <= 4'd0;
        if (take) begin
            {gathering, skips, ends} <= 3'b110;  // behind a run of no words: runs from 4 on
            left <= '0;
            next <= 4'd4;
        end else if (gathering & turns & ends) gathering <= 1'b0;
        if (rst) gathering <= 1'b0;

        index  <= skips ? address[6:0] : index + {6'd0, gathers};
        puts   <= gathers;
        put_at <= index;
    end

`ifdef FORMAL  // what gateware/formal proves, for a host and a firmware that do what they like
// What takes seconds is asked only where a promise is about it.
`ifdef PROVE_a_frame_as_written_is_executed
`define F_LENGTH
`define F_SUMS
`endif
`ifdef PROVE_a_frame_of_another_length_is_not_executed
`define F_LENGTH
`endif
`ifdef PROVE_a_frame_is_committed_for_every_word_that_is_compared
`define F_LENGTH
`endif
`ifdef PROVE_any_bit_of_a_compared_word_may_be_the_only_one_that_differs
`define F_LENGTH
`endif
`ifdef PROVE_each_condition_may_be_the_only_one_that_fails
`define F_LENGTH
`endif
`ifdef PROVE_all_that_is_promised_of_an_executed_command_happens
`define F_LENGTH
`endif
`ifdef PROVE_a_frame_with_a_wrong_ip_sum_is_not_executed
`define F_SUMS
`endif
`ifdef PROVE_a_frame_with_a_wrong_udp_sum_is_not_executed
`define F_SUMS
`endif
`ifdef PROVE_only_the_owners_words_are_staged
`define F_SUMS
`endif
    // ---- the frame, from what is on the wire alone ----------------------------------------------
    logic [10:0] f_at = 11'd0;       // number of this word; 2047 stays, no frame as written is so long
    logic        f_alike = 1'b1;     // all words so far were as they should be
    logic        f_out = 1'b0;       // a pass is out
    logic        f_had = 1'b0;       // and has been since the frame's first word, when nothing waited
    logic [31:0] f_ones = 32'd0;     // the ones' complement sum, carries added at once (RFC 1071)
    logic        f_none = 1'b0;      // no checksum
    logic        f_ip_ok = 1'b0;
    logic        f_staged = 1'b0;    // a word in the clock before

    wire f_must_high = f_at < 11'd18 & f_at != 11'd5 & f_at != 11'd12;
    wire f_must_low  = f_must_high & f_at != 11'd6 & f_at != 11'd10;
    wire f_this = (~f_must_high | like_high) & (~f_must_low | like_low)
        & (f_at != 11'd5 | {data[15], data[13:0]} == 15'd0) & (f_at != 11'd23 | data[31:21] == 11'd0);
    always_comb assume (at == (f_at > 11'd24 ? 5'd24 : f_at[4:0]));  // rx_admission.sv proves it
    wire [32:0] f_added = {1'b0, f_ones} + {1'b0, data};
    wire [31:0] f_sum   = f_added[31:0] + {31'd0, f_added[32]};  // with this word
    // The halves of a right one add up to 65535, once their carry is added.
    logic [31:0] f_last_ones = 32'd0;  // of the frame that has just ended
    wire  [16:0] f_half = {1'b0, f_ones[31:16]} + {1'b0, f_ones[15:0]}, f_halves = {1'b0, f_last_ones[31:16]} + {1'b0, f_last_ones[15:0]};
    wire         f_was_right = f_half[15:0] + {15'd0, f_half[16]} == 16'hffff, f_is_right = f_halves[15:0] + {15'd0, f_halves[16]} == 16'hffff;
    // The same from the core's registers.
    wire [31:0] f_done = sum + {31'd0, carry} + {31'd0, carry & (&sum)};
    always_ff @(posedge clk) begin
        f_staged <= stages;
        f_had    <= f_had & f_out;
        if (valid) begin
            f_at    <= last ? 11'd0 : f_at + 11'(f_at != 11'd2047);
            f_alike <= last | (f_alike & f_this);
            if (f_at == 11'd0) f_had <= f_out & ~waiting & ~gathering & ~complete;
            if (f_at == 11'd4) f_ones <= {16'd0, ip_sum};
            if (f_at == 11'd8) f_ip_ok <= f_was_right;
            if (f_at == 11'd9) f_ones <= {16'd0, udp_sum};
            if (f_at == 11'd5 | f_at == 11'd6 | f_at >= 11'd10) f_ones <= f_sum;
            if (f_at == 11'd10) f_none <= data[15:0] == 16'd0;
        end
        f_out <= ~rst & (pass | (f_out & ~revoke & ~take));
    end

    // ---- its length: the words of the head, and of the runs up to the one that ends them --------
    // Of each run and those behind it: the one solution of what is assumed, so it always exists,
    // and is the same while no run is written.
    (* anyseq *) logic [16 * 11 - 1:0] f_words;
    logic [16 * 11 - 1:0] f_words_were;
    logic                 f_written = 1'b1;
    always_ff @(posedge clk) {f_written, f_words_were} <= {run_we, f_words};
`ifdef F_LENGTH
    always_comb assume (~(run_we & out));  // as the register map asks of firmware
    always_comb if (~f_written) assume (f_words == f_words_were);
    genvar f_n;
    generate
        for (f_n = 0; f_n < 16; f_n = f_n + 1) begin : f_run
            wire [COUNT_BITS + 12:0] one = runs[f_n];
            wire [10:0] behind;
            if (f_n == 15) assign behind = 11'd0;
            else assign behind = one[COUNT_BITS + 12] ? 11'd0 : f_words[11 * f_n + 11 +: 11];
            always_comb assume (f_words[11 * f_n +: 11] == 11'(one[COUNT_BITS + 9:10]) + 11'd1 + behind);
        end
    endgenerate
`endif
    wire [10:0] f_length = 11'd18 + f_words[10:0];
    logic [10:0] f_more;  // of the run to come and those behind it
    always_comb begin
        f_more = 11'd0;
        for (int n = 0; n < 16; n++) if (next == 4'(n)) f_more = f_words[11 * n +: 11];
    end

    // ---- the verdict on the frame that has just ended, condition by condition -------------------
    logic f_ended = 1'b0;
    logic f_is_like = 1'b0, f_is_long = 1'b0, f_is_whole = 1'b0, f_is_ip = 1'b0, f_is_had = 1'b0, f_is_none = 1'b0;
    always_ff @(posedge clk) begin
        f_ended <= valid & last;
        if (valid & last) begin
            f_is_like  <= f_alike & f_this;
            f_is_long  <= f_at + 11'd1 == f_length & whole;
            f_is_whole <= ~bad;
            f_is_ip    <= f_ip_ok;
            f_is_none  <= f_none;
            f_is_had   <= f_had & f_out;
            f_last_ones <= f_sum;
        end
    end
    wire f_is_udp = f_is_none | f_is_right;
    wire f_gate = gate_now == gate_as;
    // Like, of this length, whole, right sums, in time, a pass, the gate, and room for the answer.
    wire [8:0] f_verdict = {f_is_like, f_is_long, f_is_whole, f_is_ip, f_is_udp, f_is_had, f_out, f_gate, free};

    // Any word of the head, and what firmware wrote for it, which stays while a pass is out.
    // rx_admission.sv proves that `like_high` and `like_low` say this.
    (* anyconst *) logic [10:0] f_word;
    (* anyseq *)   logic [31:0] f_new;
    logic [31:0] f_wrote;
    always_ff @(posedge clk) if (~out) f_wrote <= f_new;
    wire  [31:0] f_compared = {16'hffff, {16{f_word != 11'd6 & f_word != 11'd10}}};
    always_comb assume (f_word < 11'd18 & f_word != 11'd5 & f_word != 11'd12);
    wire         f_is_it = valid & f_at == f_word;
    always_comb assume (~f_is_it | (like_high == (data[31:16] == f_wrote[31:16]) & (~like_high | like_low == (data[15:0] == f_wrote[15:0]))));
    logic        f_differs = 1'b0, f_differed = 1'b1, f_differed_then = 1'b1;
    logic        f_others = 1'b1, f_others_like = 1'b0;   // all other words were alike
    logic [31:0] f_turned = 32'd0;                        // which of its bits were not
    always_ff @(posedge clk) begin
        if (f_is_it) f_turned <= (data ^ f_wrote) & f_compared;
        if (valid) begin
            f_differs <= ~last & (f_differs | (f_is_it & ((data ^ f_wrote) & f_compared) != 32'd0));
            f_others  <= last | (f_others & (f_is_it | f_this));
            if (last) f_differed <= f_differs | f_at <= f_word;
            if (last) f_others_like <= f_others & (f_is_it | f_this);
        end
        f_differed_then <= f_differed;
    end

    // ---- passes ---------------------------------------------------------------------------------
    logic f_took = 1'b0;            // a command was executed in the clock before
    logic f_unused = 1'b0;          // a pass was handed out, and no command executed since
    logic f_handed = 1'b0;          // in the clock before
    logic f_was_out = 1'b0;
    logic f_gate_was = 1'b0;
    logic f_revoked = 1'b1;         // none was handed out since the last one was taken back or used
    logic f_broke = 1'b0, f_is_broken = 1'b0;  // taken back during the frame
    logic f_reset_was = 1'b0;
    wire  f_back = rst | (revoke & ~pass);
    always_ff @(posedge clk) begin
        f_took      <= take;
        f_unused    <= (pass & ~rst) | (f_unused & ~take);
        f_handed    <= pass & ~rst;
        f_was_out   <= out;
        f_gate_was  <= f_gate & free;
        f_reset_was <= rst;
        f_revoked   <= rst | (~pass & (revoke | take | f_revoked));
        f_broke     <= ~(valid & last) & (f_broke | f_back) & (f_at != 11'd0 | valid);
        if (valid & last) f_is_broken <= f_broke | f_back;
    end
    // At most so many clocks of an answer are to come: less in every clock, whatever else happens.
    localparam F_RUNS = 12;
    localparam logic [11:0] F_ANSWER = 12'(F_RUNS << COUNT_BITS);
    wire  [11:0] f_to_come = ends ? 12'(left) : ((12'd16 - 12'(next)) << COUNT_BITS) + 12'(left);
    logic [11:0] f_came = 12'd0, f_gathered = 12'd0;
    logic [11:0] f_since = 12'd4095;  // clocks since the last command was executed
    logic [11:0] f_held = 12'd0;      // clocks without a word since the last frame, with the bus held
    logic        f_was_gathering = 1'b0;
    // What was said a clock ago.
    logic        f_gathers_next = 1'b0;
    logic [9:0]  f_from_next = 10'd0;
    always_ff @(posedge clk) begin
        f_was_gathering <= gathering & ~rst;
        {f_gathers_next, f_from_next} <= {gathers_next, from_next};
        f_came     <= f_to_come;
        f_gathered <= gathering ? f_gathered + 12'd1 : 12'd0;
        f_since    <= take ? 12'd0 : f_since + 12'(f_since != 12'd4095);
        f_held     <= valid & last ? 12'd0 : f_held + 12'(hold & ~valid);
    end
    always_comb begin
`ifdef PROVE_only_a_frame_like_the_pass_is_executed
        if (take) assert (f_ended & f_is_like);
`endif
`ifdef PROVE_a_frame_of_another_length_is_not_executed
        if (take) assert (f_ended & f_is_long);
        if (stages) assert (f_at < f_length);
`endif
`ifdef PROVE_a_frame_with_a_wrong_fcs_is_not_executed
        if (take) assert (f_ended & f_is_whole);
`endif
`ifdef PROVE_a_frame_with_a_wrong_ip_sum_is_not_executed
        if (take) assert (f_ended & f_is_ip);
`endif
`ifdef PROVE_a_frame_with_a_wrong_udp_sum_is_not_executed
        if (take) assert (f_ended & f_is_udp);
`endif
`ifdef PROVE_a_frame_that_began_before_its_pass_is_not_executed
        if (take) assert (f_ended & f_is_had & f_out);
`endif
`ifdef PROVE_behind_another_gate_nothing_is_executed
        if (take) assert (f_gate & free);
        if (taken | commit | commit_timed) assert (f_gate_was);
`endif
`ifdef PROVE_a_frame_as_written_is_executed
        assert (take == (f_ended & (&f_verdict)));
        assert (taken == (f_took & ~f_reset_was) & commit == (taken & executes & ~timed) & commit_timed == (taken & executes & timed));
`endif
`ifdef PROVE_a_pass_is_for_one_command
        if (take) assert (f_unused);
        if (taken | commit | commit_timed) assert (f_took);
        assert (~(commit & commit_timed));
`endif
`ifdef PROVE_nothing_is_committed_that_differs_from_what_firmware_wrote
        if (take) assert (~f_differed);
        if (taken | commit | commit_timed) assert (~f_differed_then);
`endif
`ifdef PROVE_a_pass_is_never_handed_out_by_itself
        if (out & ~f_was_out) assert (f_handed);
`endif
`ifdef PROVE_a_revocation_is_final
        if (f_revoked) assert (~take & ~out & ~stages);
        if (f_revoked & ~f_took) assert (~taken & ~commit & ~commit_timed);
        if (f_reset_was) assert (~taken & ~commit & ~commit_timed & ~gathering);
        if (take) assert (~f_is_broken);
`endif
`ifdef PROVE_what_is_gathered_has_been_said_a_clock_before
        assert (gathers == f_gathers_next);
        if (gathers) assert (address == f_from_next);
`endif
`ifdef PROVE_only_an_executed_command_writes_its_answer
        if (puts) assert (f_since <= F_ANSWER + 12'd1);
`endif
`ifdef PROVE_only_the_owners_words_are_staged
        if (stages) assert (f_out & f_had & f_alike & f_ip_ok & f_at >= 11'd18);
`endif
`ifdef PROVE_the_commit_comes_behind_the_last_staged_word
        if (commit | commit_timed) assert (~f_staged & ~stages);
`endif
`ifdef PROVE_what_the_answer_gathers_comes_to_an_end
        if (gathering & f_was_gathering) assert (f_to_come < f_came);
        assert (f_gathered <= F_ANSWER + 12'd1);
`endif
`ifdef PROVE_the_bus_is_never_held_for_the_wire
        if (hold & ~valid) assert (complete | taken | (gathering & (~f_was_gathering | f_to_come < f_came)));
        if (complete) assert (f_ended);
        if (taken) assert (f_took);
        assert (f_held <= F_ANSWER + 12'd2);
`endif
        // ---- what can be reached ----------------------------------------------------------------
`ifdef PROVE_a_frame_is_committed_for_every_word_that_is_compared
        for (int n = 0; n < 18; n++) if (n != 5 & n != 12) cover (commit & f_word == 11'(n));
`endif
`ifdef PROVE_any_bit_of_a_compared_word_may_be_the_only_one_that_differs
        for (int n = 0; n < 32; n++) cover (f_ended & f_others_like & f_turned == 32'd1 << n & (&f_verdict[7:0]) & f_is_none & ~take);
`endif
`ifdef PROVE_each_condition_may_be_the_only_one_that_fails
        for (int n = 0; n < 9; n++) cover (f_ended & ~take & f_verdict == ~(9'd1 << n));
`endif
`ifdef PROVE_all_that_is_promised_of_an_executed_command_happens
        cover (take & ~f_is_none);
        cover (commit_timed & f_is_none);
        cover (taken & ~executes & f_is_none);
        cover (take & f_length > 11'd20 & f_is_none);              // more than a run
        cover (puts & f_is_none);
        cover (f_revoked & f_ended & f_is_none & (&{f_verdict[8:3], f_verdict[1:0]}));  // taken back in time
        cover (f_reset_was & f_took & ~taken & f_is_none);          // a reset in the clock of `take`
`endif
`ifndef BROKEN
        assert (f_out == out);
        assert (~out | f_unused);
        assert (f_revoked == ~out);
        assert (f_was_out | f_handed | ~out);
        if (gathering) assert (f_since == f_gathered);
        if (puts) assert (f_since <= F_ANSWER + 12'd1);
        assert (mine == f_had);
        assert (f_at == 11'd0 | ~alike | f_alike);
        if (f_at == 11'd0) assert (f_alike & ~f_differs & ~f_broke & f_others);
        assert (f_at == 11'd0 | ~alike | ~f_differs);
        assert (~(f_broke & f_had) | ~out);
        if (complete) assert (~f_differed & (~f_is_broken | ~out));
        if (taken) assert (~f_differed_then & f_gate_was);
        if (taken) assert (f_took);
        if (f_at > 11'd10) assert (f_none == unsummed);
        if (complete) assert (f_ended & f_is_like & f_is_whole & f_is_had & f_is_none == unsummed);
`ifdef F_SUMS
        if (f_at > 11'd8) assert (~alike | f_ip_ok);
        if (f_at >= 11'd5 & f_at <= 11'd8 | f_at >= 11'd10) assert (f_done == f_ones);
        if (complete) assert (f_is_ip & f_done == f_last_ones);
`endif
`ifdef F_LENGTH
        if (f_had & f_at != 11'd0 & f_at <= 11'd17) assert (next == 4'd0);
        if (f_had & alike & f_at != 11'd0) assert (f_at < f_length);
        if (f_had & alike & f_at >= 11'd18) assert (f_at - 11'd17 + 11'(left) + (ends ? 11'd0 : f_more) == f_words[10:0]);
        if (complete) assert (f_is_long);
`endif
`ifdef PROVE_a_frame_as_written_is_executed
        if (f_had & f_at != 11'd0) assert (alike == (f_alike & (f_at <= 11'd8 | f_ip_ok) & f_at < f_length));
        if (f_ended & (&f_verdict[8:2])) assert (complete);
`endif
        assert (~gathering | ~complete);
        if (taken) assert (gathering);
        if (taken) assert (~f_staged);
        if (gathering) assert (f_at == 11'd0 | ~mine);
        if (complete) assert (f_at == 11'd0 & f_held == 12'd0);
        assert (f_gathered <= F_ANSWER + 12'd1);
        if (gathering) assert (next >= 4'd4 | ends);
        if (gathering) assert (f_gathered + f_to_come <= F_ANSWER);
        if (gathering) assert (f_held + 12'd1 + f_to_come <= F_ANSWER + 12'd2);
        assert (f_held <= F_ANSWER + 12'd2);
`endif
    end
`endif
endmodule
`default_nettype wire
