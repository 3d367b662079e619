// segments: plays motion segments into the stepgens, each on its clock; scales their time; stops
// them when the segments run out.
//
// A segment has a duration, each axis' velocity at its end with the acceleration to it, and the
// outputs. The core is a sequencer, not an integrator: it puts the next segment's words in place of
// the stepgens' staged commands and pulses their commit on the right clock. Every guarantee of a
// stepgen stays valid, and the words determine every edge.
//
//   path clock    |  c  | c+1 | c+2 | c+3 |  ...  | c+N |        N: the segment's duration
//   commit        __/‾‾‾\_________________________/‾‾‾‾‾\_
//   left          -1    |N-2  |N-3  |             | -1
//   aux           ------X its own ------------------------X
//   velocity      ------------------X--X--X--X----------     the stepgen learns its direction in c and c+1: N-2 moves
//
// Path clocks are those with `advance`. A phase adds `pace` every clock, and its carry lets path
// time pass: 65536 is every clock, 0 is none. The pace moves to its new value by `slew` per clock.
// The duration counts path clocks, so all axes slow down on the path, to a stand if commanded, and
// resume there. A pulse that has to wait for its pins' times (`waits`) stops path time for all
// axes.
//
// A segment counts only when it is complete: its words are written in any order, then pushed as
// one. A push with a missing word, without room, or with a duration below 64 changes nothing and
// sets a bit of `refused`; the words written for it are discarded.
//
//   IDLE --start--> SETTLE --all stand--> PLAY --the last segment's last clock, or a command--> HALT --all stand--> IDLE
//
// In SETTLE and HALT the stepgens have their `stop`: a job begins and ends at rest. `reason` is the
// reason of the end: with all velocities 0 the job is done; otherwise it is an underrun, and no
// velocity is held. Unless it is done, the FIFO is empty from then on, takes no segment, and
// nothing starts, until `clear`. A closed gate empties the FIFO, too.
`default_nettype none
module segments #(
    parameter integer AXES  = 3,   // 1 to 7
    parameter integer DEPTH = 64,  // a power of two
    parameter integer WORDS = 2 + 2 * AXES
) (
    input  wire         clk,

    // the gate and the watchdog
    input  wire         gate,
    input  wire         halt,       // the watchdog's soft stop

    // the FIFO's end: 0 duration, 1 {tag, aux}, then velocity and acceleration of each axis
    input  wire         word_we,
    input  wire  [3:0]  word_at,
    input  wire  [31:0] word,
    input  wire         push,

    // pulses, one at a time
    input  wire         start,
    input  wire         quit,       // come to rest and discard the other segments
    input  wire         clear,

    // time; `pace_we` is high in the clock before `pace` changes
    input  wire         pace_we,
    input  wire  [16:0] pace,       // 65536 and more: every clock
    input  wire  [31:0] slew,       // 2^-32 per clock; 0 at once

    input  wire  [15:0] beam,       // outputs that are 0 unless the axes move

    // the stepgens
    input  wire         waits,      // any of them
    input  wire         stopped,    // all of them
    output wire         advance,
    output wire         stop,       // staged velocities are 0 from then on
    // this core controls the stepgens: `stage` and `commit` replace those of the bus
    output wire         busy,
    output wire         stage,
    output wire  [3:0]  stage_at,   // 2n: velocity of axis n; 2n + 1: its acceleration
    output wire  [31:0] staged_word,
    output wire         commit_due, // a commit if path time passes in this clock
    output wire         commit,
    output wire  [15:0] aux,

    // what happens
    output logic [7:0]  level,      // segments waiting
    output logic [1:0]  state,
    output logic [2:0]  reason,
    output logic [4:0]  refused,    // sticky: full, incomplete, too short, not now, start
    output wire         stands,     // path time is stopped
    output logic        held,       // sticky: a pulse had to wait and held path time
    output logic [31:0] begun,      // segments, since power-up
    output wire  [31:0] left_now,
    output logic [15:0] tag,
    output wire  [16:0] pace_now
);
    localparam integer SLOT = $clog2(DEPTH);
    localparam integer BITS = $clog2(WORDS);
    localparam logic [BITS-1:0] LAST = BITS'(WORDS - 1);

    localparam logic [1:0] IDLE = 2'd0, SETTLE = 2'd1, PLAY = 2'd2, HALT = 2'd3;
    localparam logic [2:0] NONE = 3'd0, DONE = 3'd1, UNDERRUN = 3'd2, QUIT = 3'd3, HALTED = 3'd4, CLOSED = 3'd5;

    wire failed = reason > DONE;
    wire dead   = failed | ~gate;

    // ---- time -----------------------------------------------------------------------------------
    // The slew is computed as in the stepgen's ramp: after a new pace it tries a move upwards, and
    // only the comparison is used.
    logic [32:0] scale = {17'h10000, 16'd0};
    logic        turned = 1'b0, up = 1'b0;
    logic [15:0] phase = 16'd0;
    logic        tick  = 1'b1;

    wire [16:0] wanted  = {pace[16], pace[15:0] & {16{~pace[16]}}};
    wire        down    = ~up & ~turned;
    wire [33:0] moved   = {1'b0, scale} + ({2'd0, slew} ^ {34{down}}) + {33'd0, down};
    wire        below   = $signed(moved) < $signed({1'b0, wanted, 16'd0});
    wire        there   = (slew == 32'd0) | (up ^ below);

    assign pace_now = scale[32:16];
    assign stands   = pace_now == 17'd0;

    initial begin
        state    = IDLE;
        reason   = NONE;
        level    = 8'd0;
        refused  = 5'd0;
        held     = 1'b0;
        begun    = 32'd0;
        tag      = 16'd0;
    end

    always_ff @(posedge clk) begin
        turned <= pace_we;
        if (turned) up <= below;
        if (~state[1]) scale <= {wanted, 16'd0};
        else if (state == PLAY & ~turned) scale <= there ? {wanted, 16'd0} : moved[32:0];
        {tick, phase} <= {1'b0, phase} + pace_now;
    end

    assign advance = ~state[1] | (tick & ~waits);

    // ---- FIFO -----------------------------------------------------------------------------------
    (* no_rw_check *)  // a slot is read only while it is not the one being written
    logic [31:0]      words[0:(DEPTH << BITS) - 1];
    logic [31:0]      out;
    logic [SLOT-1:0]  head = '0, tail = '0;
    logic [WORDS-1:0] seen = '0;
    logic             short = 1'b0;
    logic [BITS-1:0]  at = LAST;

    wire full  = level[SLOT];
    wire write = word_we & ({28'd0, word_at} < WORDS) & ~full;
    wire whole = &seen;
    wire taken = push & ~full & ~dead & whole & ~short;

    always_ff @(posedge clk) begin
        if (write) words[{head, word_at[BITS-1:0]}] <= word;
        out <= words[{tail, at}];

        if (push | dead) seen <= '0;
        else if (write) seen[word_at[BITS-1:0]] <= 1'b1;
        if (write & word_at == 4'd0) short <= word[31:6] == 26'd0;

        head  <= head + {{SLOT - 1{1'b0}}, taken};
        if (dead | clear & ~busy) tail <= head;
        else tail <= tail + {{SLOT - 1{1'b0}}, commit};
        if (dead | clear & ~busy) level <= 8'd0;
        else level <= level + {{7{commit & ~taken}}, commit ^ taken};

        if (push) refused[3:0] <= refused[3:0] | (full ? 4'd1 : dead ? 4'd8 : ~whole ? 4'd2 : short ? 4'd4 : 4'd0);
        if (start & ~starts) refused[4] <= 1'b1;
        if (clear) refused <= 5'd0;
    end

    // ---- the next segment: its words from the last down to the duration, which is used in place -
    logic        staged = 1'b0;
    logic        fetched = 1'b0;
    logic [BITS-1:0] fetched_at = '0;
    logic [31:0] next = 32'd0;          // {tag, aux}
    logic        next_moves = 1'b0;

    wire fetch = (state == PLAY) & ~staged & (level != 8'd0);
    wire axis  = fetched_at > {{BITS - 1{1'b0}}, 1'b1};

    assign staged_word = out;
    assign stage = fetched & axis;
    assign stage_at = {{4 - BITS{1'b0}}, fetched_at} - 4'd2;

    // ---- the current one ------------------------------------------------------------------------
    logic [32:0] left  = '1;            // negative in the last clock
    logic        first = 1'b1;          // none has begun
    logic        moves = 1'b0;          // some velocity at its end is not 0
    logic [15:0] outputs = 16'd0;

    wire starts = start & (state == IDLE) & ~dead & ~halt & (level != 8'd0);
    wire breaks = ~gate | halt | quit;
    wire over   = left[32] & advance;

    assign commit_due = (state == PLAY) & staged & left[32] & ~breaks;
    assign commit   = commit_due & advance;
    assign stop     = state[0];
    assign busy     = |state;
    assign left_now = left[31:0];
    assign aux      = outputs & ~({16{(state != PLAY) | stands}} & beam);

    always_ff @(posedge clk) begin
        fetched    <= fetch;
        fetched_at <= at;
        if (state != PLAY | commit) at <= LAST;
        else if (fetch & at != '0) at <= at - 1'b1;
        staged <= (state == PLAY) & ~commit & (staged | (fetch & at == '0));
        if (fetched & fetched_at == {{BITS - 1{1'b0}}, 1'b1}) next <= out;
        next_moves <= (state == PLAY) & ~commit & (next_moves | (stage & ~stage_at[0] & out != 32'd0));

        if (state == SETTLE) {left, first} <= '1;
        else if (commit | (~left[32] & advance)) {left, first} <= {(commit ? {1'b0, out} : left) - {31'd0, commit, ~commit}, first & ~commit};

        if (commit) begin
            begun          <= begun + 32'd1;
            moves          <= next_moves;
            {tag, outputs} <= next;
        end else if (state == IDLE & dead) outputs <= 16'd0;

        if (state == SETTLE) held <= 1'b0;
        else if (state == PLAY & tick & waits) held <= 1'b1;

        case (state)
            IDLE: begin
                if (starts) {state, reason} <= {SETTLE, NONE};
                else if (clear) reason <= NONE;
            end
            SETTLE:
                if (breaks) {state, reason} <= {HALT, ~gate ? CLOSED : halt ? HALTED : QUIT};
                else if (stopped) state <= PLAY;
            PLAY:
                if (breaks) {state, reason} <= {HALT, ~gate ? CLOSED : halt ? HALTED : QUIT};
                else if (over & ~staged & ~first) {state, reason} <= {HALT, moves ? UNDERRUN : DONE};
            HALT: begin
                if (stopped | ~gate) state <= IDLE;
                if (~gate & ~failed) reason <= CLOSED;
            end
        endcase
    end

`ifdef FORMAL
`ifdef PROVE_all_of_it_with_three_axes_and_64_segments
`define PROVE_a_segment_counts_only_when_complete
`define PROVE_what_is_played_is_what_was_pushed
`define PROVE_a_segment_lasts_its_clocks_then_the_next_begins_or_everything_stops
`define PROVE_an_underrun_is_never_a_held_velocity
`define PROVE_outputs_switch_on_the_first_clock_of_their_segment
`define PROVE_a_pause_holds_the_path
`define PROVE_a_job_begins_and_ends_at_rest
`endif
    // ---- what must hold: gateware/formal/segments.proofs ----------------------------------------
    // Any one slot of the FIFO and any one word of it, stored apart from the memory; any one axis'
    // staged word; and a path clock of our own. Every guarantee is stated in terms of those.
    (* anyconst *) logic [SLOT-1:0] f_slot;
    (* anyconst *) logic [BITS-1:0] f_at;     // 2 and more: a word of an axis
    always_comb assume (f_at >= BITS'(2) & {27'd0, 1'b0, f_at} < WORDS);
    always_comb assume (word_we + push + start + quit + clear <= 1);

    logic        f_has0 = 1'b0, f_has1 = 1'b0, f_hasw = 1'b0;
    logic [31:0] f_clocks = '0, f_aux = '0, f_word = '0;      // the slot's
    logic [31:0] f_staged = '0;                              // the staged word, from either side
    // the current segment came from the slot
    logic        f_mine = 1'b0;
    // its words; path clocks since its commit
    logic [31:0] f_duration = '0, f_velocity = '0, f_since = '0;
    logic [15:0] f_outputs = '0;
    logic        f_known = 1'b1;                             // what the outputs should be
    // the words written since the last push
    logic [WORDS-1:0] f_seen = '0;
    logic        f_short = 1'b0;
    logic [31:0] f_level = '0;
    logic        f_owes = 1'b0;                              // a stop that has not ended
    logic        f_failed = 1'b0;                            // an underrun not cleared yet
    logic        f_past = 1'b0, f_stood = 1'b0, f_waited = 1'b0, f_full = 1'b0, f_held = 1'b0, f_rest = 1'b0, f_gate = 1'b0;
    logic        f_advanced = 1'b0, f_committed = 1'b0, f_last = 1'b0, f_cleared = 1'b0;
    logic [1:0]  f_state = IDLE;
    logic [32:0] f_left = '1;
    logic [7:0]  f_levelled = '0;

    wire f_head  = head == f_slot;
    wire f_tail  = tail == f_slot;
    wire [SLOT-1:0] f_index = f_slot - tail;
    wire f_waits = {1'b0, f_index} < level[SLOT:0];          // the slot holds a waiting segment
    wire f_fits  = f_level < DEPTH;
    wire f_moves = ~f_at[0] & f_word != 32'd0;               // the word is a velocity, and not 0
    wire f_ended = state == PLAY & left[32] & ~first & advance & ~commit;

    always_ff @(posedge clk) begin
        if (word_we & f_fits & f_head & word_at == 4'd0) {f_has0, f_clocks} <= {1'b1, word};
        if (word_we & f_fits & f_head & word_at == 4'd1) {f_has1, f_aux} <= {1'b1, word};
        if (word_we & f_fits & f_head & word_at == {{4 - BITS{1'b0}}, f_at}) {f_hasw, f_word} <= {1'b1, word};
        if (stage & stage_at == {{4 - BITS{1'b0}}, f_at} - 4'd2) f_staged <= staged_word;

        if (push | ~gate | reason > DONE) f_seen <= '0;
        else if (word_we & f_fits & {28'd0, word_at} < WORDS) f_seen[word_at] <= 1'b1;
        if (word_we & f_fits & word_at == 4'd0) f_short <= word < 32'd64;
        if (~gate | reason > DONE | (clear & state == IDLE)) f_level <= '0;
        else f_level <= f_level + (push & f_fits & &f_seen & ~f_short) - commit;

        if (commit) {f_mine, f_duration, f_velocity, f_since} <= {f_tail, f_clocks, f_at[0] ? 32'd0 : f_word, 32'd0};
        else if (advance & state == PLAY) f_since <= f_since + 32'd1;
        if (commit) {f_known, f_outputs} <= {f_tail, f_aux[15:0]};
        else if (state == IDLE & (~gate | reason > DONE)) {f_known, f_outputs} <= {1'b1, 16'd0};

        f_owes   <= state == PLAY ? f_ended | breaks : state == SETTLE ? breaks : f_owes & ~stopped & gate;
        f_failed <= (f_failed & ~(clear & state == IDLE)) | (f_ended & f_mine & f_velocity != 32'd0);

        f_past      <= 1'b1;
        f_stood     <= stands & (state == PLAY | state == HALT);
        f_full      <= pace_now == 17'h10000;
        f_advanced  <= advance;
        f_committed <= commit;
        f_state     <= state;
        f_rest      <= stopped;
        f_gate      <= gate;
        f_left      <= left;
        f_levelled  <= level;
        f_last      <= f_ended;
        f_cleared   <= clear;
    end

    always_comb begin
`ifdef PROVE_a_segment_counts_only_when_complete
        assert ({24'd0, level} == f_level);
        if (taken) assert (&f_seen & ~f_short & f_fits & gate & reason <= DONE);
        assert (level <= 8'(DEPTH));
`endif
`ifdef PROVE_what_is_played_is_what_was_pushed
        // At the commit, the staged word, the duration and the outputs are those written into the
        // slot before its push.
        if (commit & f_tail) assert (f_has0 & f_has1 & f_hasw & f_staged == f_word & out == f_clocks & next == f_aux & f_clocks >= 32'd64);
        if (commit) assert (level != 8'd0);
`endif
`ifdef PROVE_a_segment_lasts_its_clocks_then_the_next_begins_or_everything_stops
        if (f_mine & commit & ~first) assert (f_since + 32'd1 == f_duration);
        if (f_mine & state == PLAY & ~first) assert (f_since < f_duration);
        if (f_last) assert (state == HALT & stop);
        if (f_owes) assert (state == HALT & stop & ~commit);
`endif
`ifdef PROVE_an_underrun_is_never_a_held_velocity
        // However slowly time passes: from the clock after the last one on, the stepgens have their
        // stop until they stand.
        if (f_last & f_mine & f_velocity != 32'd0) assert (stop & reason > DONE);
        if (f_failed) assert (stop & f_owes | state == IDLE | ~f_gate | f_rest);
        if (f_failed) assert (state != PLAY & state != SETTLE & ~commit & (state != IDLE | reason > DONE | level == 8'd0));
`endif
`ifdef PROVE_outputs_switch_on_the_first_clock_of_their_segment
        if (f_known) assert (aux == (f_outputs & ~(state != PLAY | pace_now == 17'd0 ? beam : 16'd0)));
`endif
`ifdef PROVE_a_pause_holds_the_path
        if (f_past & f_stood & (state == PLAY | state == HALT)) assert (~advance & ~commit);
        if (waits & (state == PLAY | state == HALT)) assert (~advance & ~commit);
        if (f_past & f_state == PLAY & state == PLAY & ~f_advanced) assert (left == f_left & ~f_committed & f_levelled <= level);
        if (f_past & f_full & state == PLAY & ~waits) assert (advance);
`endif
`ifdef PROVE_a_job_begins_and_ends_at_rest
        if (f_past & state == PLAY & f_state != PLAY) assert (f_rest & f_state == SETTLE);
        if (f_past & f_state != IDLE & state == IDLE) assert (f_state == HALT & (f_rest | ~f_gate));
        if (state == IDLE) assert (~stop & ~commit & ~busy & ~stage & advance);
        if (commit) assert (gate & ~halt & state == PLAY);
        if (reason > DONE & state == IDLE & f_past & f_state == IDLE & ~f_cleared) assert (level == 8'd0);
`endif
    end

`ifndef BROKEN
    always_comb begin
        assert (level <= 8'(DEPTH) & SLOT'(head - tail) == level[SLOT-1:0]);
        assert ({24'd0, level} == f_level & seen == f_seen);
        assert (~full | seen == '0);
        if (seen[0]) assert (short == f_short);
        if (f_has0) assert (words[{f_slot, BITS'(0)}] == f_clocks);
        if (f_has1) assert (words[{f_slot, BITS'(1)}] == f_aux);
        if (f_hasw) assert (words[{f_slot, f_at}] == f_word);
        if (f_waits) assert (f_has0 & f_has1 & f_hasw & f_clocks >= 32'd64);
        if (f_head & seen[0]) assert (f_has0 & f_short == (f_clocks < 32'd64));
        if (f_head & seen[1]) assert (f_has1);
        if (f_head & seen[f_at]) assert (f_hasw);
        if (state == IDLE | state == SETTLE) assert (at == LAST & ~staged & ~fetched & ~next_moves);
        if (state == PLAY & staged) assert (at == '0 & (~fetched | fetched_at == '0) & level != 8'd0);
        if (state == PLAY & ~staged & fetched) assert (fetched_at == at + 1'b1 & at < LAST & level != 8'd0);
        if (state == PLAY & ~staged & ~fetched) assert (at == LAST & ~next_moves);
        if (state == PLAY & f_tail & fetched) assert (out == words[{f_slot, fetched_at}]);
        if (state == PLAY & f_tail & staged) assert (out == words[{f_slot, BITS'(0)}] & next == f_aux);
        if (state == PLAY & f_tail & (staged | fetched) & at + 2 <= f_at) assert (f_staged == f_word & (~f_moves | next_moves));
        if (state == PLAY) assert (~first | left == '1);
        if (state == PLAY & f_mine & ~first) assert (left == {1'b0, f_duration} - 33'd2 - {1'b0, f_since} & f_duration >= 32'd64 & f_since < f_duration);
        if (state == PLAY & f_mine & ~first) assert (f_velocity == 32'd0 | moves);
        if (f_known) assert (outputs == f_outputs);
        assert (~f_owes | state == HALT);
        if (f_past) assert (f_owes == (state == HALT) | state == HALT & (f_state == HALT));
        if (state == HALT) assert (f_owes & reason != NONE);
        if (f_failed) assert (state == HALT & reason > DONE | state == IDLE & (reason > DONE));
        if (state == SETTLE | state == PLAY) assert (reason == NONE);
        if (reason > DONE & state == IDLE & f_past & f_state == IDLE) assert (level == 8'd0);
        if (f_past & f_stood) assert (~tick);
        if (f_past & f_full) assert (tick);
        assert (f_past | state == IDLE & reason == NONE);
        if (f_last) assert (state == HALT);
        if (f_last & f_mine & f_velocity != 32'd0) assert (reason > DONE);
    end
`endif
`endif
endmodule
`default_nettype wire
