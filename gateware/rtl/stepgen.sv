// stepgen: turns a velocity into pulses at two pins, and counts what it emitted.
//
// A velocity ramps towards its target by at most `accel` per clock; its integer part is added to a position of 32.32
// steps every clock; each change of the position's integer part is one pulse. When the pins' timing forbids the pulse,
// the position waits where it is and tries again in the next clock: a pulse is late, never merged, lost or misdirected.
// The integer part of the position is, by construction, the number of pulses at the pins, signed. Its low bits are here
// (`delta`), its wide part is in tally.sv, which comes by every 16 clocks: position = {tally + delta, fraction}.
//
//   kind 0, step/dir: STEP carries the pulses, DIR their direction
//   step  ____/‾‾‾‾\________/‾‾‾‾\_______________/‾‾‾‾\__     1 steplen    2 stepspace
//             |-1--|---2----|    |--3--|----4----|            3 dirhold    4 dirsetup
//   dir   ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\________________
//
//   kind 1, up/down: STEP carries the pulses forwards, DIR those backwards; at a reversal 3 + 4 lie between them
//   step  ____/‾‾‾‾\________/‾‾‾‾\_______________________
//             |-1--|---2----|    |--3--|----4----|
//   dir   ______________________________________/‾‾‾‾\__
//
//   kind 2, quadrature: each pulse changes one line; forwards STEP (A) leads DIR (B); edges are at least 1 + 2 apart
//   step  ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\___________________/‾‾‾‾‾‾
//             |---1+2--|---1+2--|     3 + 4 or more
//   dir   _____________/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾
//
// Units: velocity f_clk/2^32 steps/s; accel f_clk^2/2^56 steps/s^2 (the velocity carries 24 fraction bits); times in
// clocks. Times of 0 are read as 1, accel 0 as "no limit". Fastest: steplen = stepspace = 1, f_clk/2.
//
//   commit       _/‾\__________________     the command is taken at the end of this clock,
//   target       ----X new ------------     the ramp pauses for this clock and one more, to learn its
//   velocity     -----------X--X--X--X      direction; the velocity moves from then on, every clock.
//
// `stop`, or enable = 0 at a commit, ramps to rest at `stop_accel`. `gate` = 0 makes the pulse inactive on the next clock,
// forgets target and velocity and keeps the position; DIR and quadrature lines keep their level, so that no edge disturbs
// the last pulse. After either, nothing moves until the next commit: an old target cannot come back to life.
`default_nettype none
module stepgen (
    input  wire         clk,

    // the gate and the watchdog
    input  wire         gate,         // 1: outputs live
    input  wire         stop,         // 1: come to rest; commits are ignored
    output logic        stopped,      // 1: `stop` has been obeyed: velocity 0 and no pulse active

    // the command, taken while `commit`
    input  wire         commit,
    input  wire         enable,
    input  wire  [31:0] velocity,     // signed
    input  wire  [31:0] accel,

    // settings, quasi-static
    input  wire  [12:0] steplen,
    input  wire  [12:0] stepspace,
    input  wire  [15:0] dirsetup,
    input  wire  [15:0] dirhold,
    input  wire  [31:0] stop_accel,
    input  wire  [1:0]  kind,         // 0 step/dir, 1 up/down, 2 quadrature, 3 as 0
    input  wire         step_invert,
    input  wire         dir_invert,

    // what happened
    input  wire         visit,        // 1: `delta` is taken, and starts again with the pulse of this clock
    output logic [4:0]  delta,        // signed pulses since the visit before; 16 clocks hold 8 at most
    output logic [31:0] fraction,     // of the next pulse; powers up at half a step
    output wire  [31:0] velocity_now, // signed, integer part
    output wire         waits,        // 1: a pulse is due in this clock and has to wait

    // the pins, registered
    output logic        step,
    output logic        dir
);
    // ---- target -------------------------------------------------------------------------------------------------
    wire         halt    = stop | ~gate;
    logic        halted  = 1'b1;
    logic        fresh   = 1'b0;  // target changed: `up` and `jump` are not valid in this clock
    logic        braking = 1'b1;  // towards rest, at stop_accel
    logic [31:0] target  = 32'd0;
    logic [31:0] limit   = 32'd0;

    wire take  = commit & ~halt;
    wire pause = fresh | take | (halt & ~halted);

    always_ff @(posedge clk) begin
        halted <= halt;
        fresh  <= take | (halt & ~halted);
        if (halt | (take & ~enable)) target <= 32'd0;
        else if (take) target <= velocity;
        if (halt | (take & ~enable)) braking <= 1'b1;
        else if (take) braking <= 1'b0;
        if (take) limit <= accel;
    end

    // ---- velocity: s32.24, moves towards target by at most limit per clock ------------------------------------------
    // In the clock after a new target the adder tries a move upwards, and only its comparison is used. A target that lies
    // above, but nearer than one move, is thereby taken for one below: the move downwards then reaches or passes it just the same.
    logic [55:0] v = 56'd0;
    logic        up = 1'b1;   // v is below target, by more than a move
    logic        jump = 1'b1; // no limit

    wire        down    = ~up & ~fresh;
    wire [56:0] move    = {25'd0, braking ? stop_accel : limit} ^ {57{down}};
    wire [56:0] moved   = {v[55], v} + move + {56'd0, down};
    wire        below   = $signed(moved[56:24]) < $signed({target[31], target});
    wire        arrived = jump | (up ^ below);  // this move would reach or pass the target

    always_ff @(posedge clk) begin
        if (~gate) up <= 1'b1;
        else if (fresh) up <= below;
        if (~gate | fresh) jump <= move[31:0] == 32'd0;
        if (~gate) v[55:24] <= 32'd0;
        else if (~pause) v[55:24] <= arrived ? target : moved[55:24];
        if (~gate | (~pause & arrived)) v[23:0] <= 24'd0;
        else if (~pause) v[23:0] <= moved[23:0];
    end

    assign velocity_now = v[55:24];
    wire negative = v[55];

    // ---- position: adds the velocity, asks for a pulse when the integer part would change -----------------------------
    logic        reverse = 1'b0;  // direction of the pulses: what DIR says, before inversion
    wire  [32:0] sum     = {1'b0, fraction} + {v[55], v[55:24]};
    wire         due     = sum[32];
    wire         ready;
    wire         emit    = gate & due & ready;
    wire  [3:0]  carry   = delta[3:0] ^ {4{reverse}};

    assign waits = gate & due & ~ready;

    always_ff @(posedge clk) begin
        if (gate & (~due | ready)) fraction <= sum[31:0];
        if (visit) delta <= {{4{emit & reverse}}, emit};
        else if (emit) delta <= delta ^ {&carry, &carry[2:0], &carry[1:0], carry[0], 1'b1};  // +-1 without a carry chain
    end

    // ---- timing: when a pulse may start and end, and the direction may change -----------------------------------------
    // Two clocks count up from the last event; a time is over from the clock on in which they are equal. In the first
    // clock after the event times of 0 and 1 are equal.
    logic        pulse      = 1'b0;
    logic        setup      = 1'b0;   // dir_clock counts dirsetup (else dirhold)
    logic [12:0] step_clock = 13'd1;  // since the pulse rose or fell
    logic [15:0] dir_clock  = 16'd1;  // since the pulse fell or the direction changed
    logic        step_first = 1'b0;
    logic        dir_first  = 1'b0;
    logic        step_over  = 1'b1;
    logic        dir_over   = 1'b1;

    wire [12:0] step_time = pulse ? steplen : stepspace;
    wire [15:0] dir_time  = setup ? dirsetup : dirhold;
    wire step_done = step_over | ((step_clock[12:1] == step_time[12:1]) & ((step_clock[0] == step_time[0]) | step_first));
    wire dir_done  = dir_over | ((dir_clock[15:1] == dir_time[15:1]) & ((dir_clock[0] == dir_time[0]) | dir_first));

    // A closed gate cuts a pulse; in quadrature there is nothing to cut, and the next edge keeps its distance.
    wire quadrature = kind == 2'd2;
    wire updown     = kind == 2'd1;
    wire fall       = pulse & (step_done | (~gate & ~quadrature));
    wire turn       = gate & ~pulse & (setup | dir_done) & (negative ? ~reverse : reverse & (v[54:24] != 31'd0));

    assign ready = ~pulse & step_done & (reverse == negative) & ~(setup & ~dir_done);

    always_ff @(posedge clk) begin
        step_clock <= (emit | fall) ? 13'd1 : step_clock + 13'd1;
        step_first <= emit | fall;
        step_over  <= step_done & ~(emit | fall);
        dir_clock  <= (turn | fall) ? 16'd1 : dir_clock + 16'd1;
        dir_first  <= turn | fall;
        dir_over   <= dir_done & ~(turn | fall);
        if (turn) setup <= 1'b1;
        else if (fall) setup <= 1'b0;
    end

    // ---- pins -------------------------------------------------------------------------------------------------------
    logic a = 1'b0;  // the quadrature lines, before inversion
    logic b = 1'b0;

    wire pulse_next   = emit | (pulse & ~fall);
    wire reverse_next = reverse ^ turn;
    wire a_next       = a ^ (emit & (a ^ b ^ ~reverse));
    wire b_next       = b ^ (emit & (a ^ b ^ reverse));

    always_ff @(posedge clk) begin
        pulse   <= pulse_next;
        reverse <= reverse_next;
        a       <= a_next;
        b       <= b_next;
        step    <= step_invert ^ (quadrature ? a_next : pulse_next & ~(updown & reverse));
        dir     <= dir_invert ^ (quadrature ? b_next : updown ? pulse_next & reverse : reverse_next);
        stopped <= halt & halted & ~pause & arrived & ~pulse_next;
    end

    initial begin
        step     = 1'b0;
        dir      = 1'b0;
        stopped  = 1'b0;
        delta    = 5'd0;
        fraction = 32'h8000_0000;
    end
endmodule
`default_nettype wire
