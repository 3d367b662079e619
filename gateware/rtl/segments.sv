// segments: plays motion segments into the stepgens, each on its clock; scales their time; stops them when the segments run out.
//
// A segment says how long it lasts, the velocity each axis has at its end and the acceleration that leads there, and the outputs.
// The core is a sequencer, not an integrator: it puts the next segment's words where the stepgens' staged commands are and pulls
// their commit when the clock has come. Whatever is promised of a stepgen stays true, and whoever knows the words knows every edge.
//
//   path clock    |  c  | c+1 | c+2 | c+3 |  ...  | c+N |        N: the segment's duration
//   commit        __/‾‾‾\_________________________/‾‾‾‾‾\_
//   left          -1    |N-2  |N-3  |             | -1
//   aux           ------X its own ------------------------X
//   velocity      ------------------X--X--X--X----------     the stepgen learns its direction in c and c+1: N-2 moves
//
// Path clocks are those with `advance`. A phase adds `pace` every clock, and its carry lets path time pass: 65536 is every clock, 0
// none. The pace slews to what it was told by `slew` per clock; the duration counts path clocks, so that all axes slow down on the path, to a
// stand if wanted, and go on from there. A pulse that has to wait for its pins' times (`waits`) holds path time for everybody.
//
// A segment counts only when it is complete: its words are written in any order, then pushed as one. A push that finds a word missing,
// no room, or a duration below 64 changes nothing and says so; what was written of it is forgotten.
//
//   IDLE --start--> SETTLE --all stand--> PLAY --the last segment's last clock, or asked to--> HALT --all stand--> IDLE
//
// In SETTLE and HALT the stepgens have their `stop`: a job begins at rest, and ends there. `reason` says why it ended: with all
// velocities 0 it is done; with any other it is an underrun, which is never a velocity held. Unless it is done the FIFO is empty from then
// on, takes nothing, and nothing starts, until `clear`. A closed gate empties the FIFO, too.
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
    input  wire         quit,       // come to rest and forget the rest
    input  wire         clear,

    // time; `pace_we` is high in the clock before `pace` is another
    input  wire         pace_we,
    input  wire  [16:0] pace,       // 65536 and more: every clock
    input  wire  [31:0] slew,       // 2^-32 per clock; 0 at once

    input  wire  [15:0] beam,       // outputs that are 0 unless the axes are on their way

    // the stepgens
    input  wire         waits,      // any of them
    input  wire         stopped,    // all of them
    output wire         advance,
    output wire         stop,       // staged velocities are 0 from then on
    output wire         busy,       // the stepgens are ours: `stage` and `commit` instead of the bus'
    output wire         stage,
    output wire  [3:0]  stage_at,   // 2n: velocity of axis n; 2n + 1: its acceleration
    output wire  [31:0] staged_word,
    output wire         commit,
    output wire  [15:0] aux,

    // what happens
    output logic [7:0]  level,      // segments that wait
    output logic [1:0]  state,
    output logic [2:0]  reason,
    output logic [4:0]  refused,    // sticky: full, incomplete, too short, not now, start
    output wire         stands,     // path time does not pass
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

    // ---- time ---------------------------------------------------------------------------------------------------
    // The slew is the stepgen's ramp: after a new pace it tries a move upwards, and only its comparison is used.
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

    // ---- FIFO ---------------------------------------------------------------------------------------------------
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

    // ---- the next segment: its words from the last down to the duration, which stays where it is read ------------------
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

    // ---- the present one ----------------------------------------------------------------------------------------------
    logic [32:0] left  = '1;            // negative in the last clock
    logic        first = 1'b1;          // none has begun
    logic        moves = 1'b0;          // some velocity at its end is not 0
    logic [15:0] outputs = 16'd0;

    wire starts = start & (state == IDLE) & ~dead & ~halt & (level != 8'd0);
    wire breaks = ~gate | halt | quit;
    wire over   = left[32] & advance;

    assign commit   = (state == PLAY) & staged & over & ~breaks;
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
endmodule
`default_nettype wire
