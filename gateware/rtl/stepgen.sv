// stepgen: turns a velocity into pulses at two pins, and counts the emitted pulses.
//
// A velocity ramps towards its target by at most `accel` per clock. Its integer part is added to a
// position of 32.32 steps every clock; each change of the position's integer part is one pulse.
// When the pins' timing forbids the pulse, the position stays and tries again in the next clock: a
// pulse may be late, but is never merged, lost or sent in the wrong direction. The integer part of
// the position is, by construction, the signed number of pulses at the pins. Its low bits are in
// this module (`delta`), its wide part is in wide_counter.sv, which visits every 16 clocks:
// position = {wide count + delta, fraction}.
//
//   kind 0, step/dir: STEP carries the pulses, DIR their direction
//   step  ____/‾‾‾‾\________/‾‾‾‾\_______________/‾‾‾‾\__     1 steplen    2 stepspace
//             |-1--|---2----|    |--3--|----4----|            3 dirhold    4 dirsetup
//   dir   ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\________________
//
//   kind 1, up/down: STEP carries the pulses forwards, DIR those backwards; at a reversal 3 + 4
//   lie between them
//   step  ____/‾‾‾‾\________/‾‾‾‾\_______________________
//             |-1--|---2----|    |--3--|----4----|
//   dir   ______________________________________/‾‾‾‾\__
//
//   kind 2, quadrature: each pulse changes one line; forwards STEP (A) leads DIR (B); edges are
//   at least 1 + 2 apart
//   step  ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\___________________/‾‾‾‾‾‾
//             |---1+2--|---1+2--|     3 + 4 or more
//   dir   _____________/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾
//
// Units: velocity f_clk/2^32 steps/s; accel f_clk^2/2^56 steps/s^2 (the velocity carries 24
// fraction bits); times in clocks. Times of 0 are read as 1, accel 0 as "no limit". Fastest:
// steplen = stepspace = 1, f_clk/2.
//
//   commit       _/‾\__________________     the command is taken at the end of this clock,
//   target       ----X new ------------     the ramp pauses for this clock and one more, to learn its
//   velocity     -----------X--X--X--X      direction; the velocity moves from then on, every clock.
//
// `stop`, or enable = 0 at a commit, ramps to rest at `stop_accel`. `gate` = 0 makes the pulse
// inactive on the next clock, discards target and velocity and keeps the position; DIR and
// quadrature lines keep their level, so that no edge disturbs the last pulse. After either, nothing
// moves until the next commit: an old target has no effect.
//
// Velocity and position change in path time, which passes in the clocks in which `advance` is 1
// (TIMED; else in every clock). In the other clocks they stand, and so does a commit that has
// begun; pulses, their times, and a stop's ramp continue with the clock. A commit counts only while
// path time passes. The core that scales time stops it while `waits` (segments.sv): a late pulse
// then delays all axes and loses no step.
`default_nettype none
module stepgen #(
    // 1: path time is scaled; 0: `advance` is ignored, and costs no logic
    parameter bit TIMED = 1'b0
) (
    input  wire         clk,

    // the gate and the watchdog
    input  wire         gate,         // 1: outputs live
    input  wire         stop,         // 1: come to rest; commits are ignored
    output logic        stopped,      // 1: `stop` has been obeyed: velocity 0 and no pulse active

    input  wire         advance,      // 1: path time passes

    // the command, taken while `commit`
    input  wire         commit,       // with `advance`
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

    // results
    // 1: `delta` is taken, and starts again with the pulse of this clock
    input  wire         visit,
    // signed pulses since the visit before; at most 8 in 16 clocks
    output logic [4:0]  delta,
    output logic [31:0] fraction,     // of the next pulse; powers up at half a step
    output wire  [31:0] velocity_now, // signed, integer part
    // 1: a pulse is due in this clock and has to wait; independent of `advance`
    output wire         waits,

    // the pins, registered
    output logic        step,
    output logic        dir
);
    // ---- target ---------------------------------------------------------------------------------
    wire         halt    = stop | ~gate;
    logic        halted  = 1'b1;
    logic        fresh   = 1'b0;  // target changed: `up` and `jump` are not valid in this clock
    logic        braking = 1'b1;  // towards rest, at stop_accel
    logic [31:0] wanted  = 32'd0;
    logic [31:0] limit   = 32'd0;
    // A mask instead of a reset: each channel would have its own, and all flip-flops of a tile
    // share one (decision 10).
    wire  [31:0] target  = wanted & {32{~braking}};

    // `advance` comes late and decides last.
    wire command = commit & ~halt;
    wire take    = TIMED ? command & advance : command;
    wire begins  = halt & ~halted;  // a stop
    wire pause   = fresh | take | begins;
    // a stop works whether or not time passes
    wire holds   = fresh | begins | (TIMED & ~advance ? ~braking : command);

    wire fresh_next = begins | (TIMED & ~advance ? fresh & ~braking : command);

    always_ff @(posedge clk) begin
        halted <= halt;
        fresh  <= fresh_next;
        if (halt | (take & ~enable)) braking <= 1'b1;
        else if (take) braking <= 1'b0;
        if (take) begin
            wanted <= velocity;
            limit  <= accel;
        end
    end

    // ---- velocity: s32.24, moves towards target by at most limit per clock ----------------------
    // In the clock after a new target the adder tries a move upwards, and only its comparison is
    // used. A target above, but nearer than one move, thus counts as one below: the move downwards
    // then also reaches or passes it.
    logic [55:0] v = 56'd0;
    logic        up = 1'b1;   // v is below target, by more than a move
    logic        jump = 1'b1; // no limit
    // v moves down: ~up & ~fresh, in a flip-flop of its own, because the ramp's longest path begins
    // here.
    logic        down = 1'b0;

    wire [56:0] move    = {25'd0, braking ? stop_accel : limit} ^ {57{down}};
    wire [56:0] moved   = {v[55], v} + move + {56'd0, down};
    wire        below   = $signed(moved[56:24]) < $signed({target[31], target});
    wire        arrived = jump | (up ^ below);  // this move would reach or pass the target
    wire        up_next = ~gate | (fresh ? below : up);

    always_ff @(posedge clk) begin
        up   <= up_next;
        down <= ~up_next & ~fresh_next;
        if (fresh | (up & ~gate)) jump <= move[31:0] == 32'd0;
        if (~gate) v[55:24] <= 32'd0;
        else if (~holds) v[55:24] <= arrived ? target : moved[55:24];
        if (~gate | (~holds & arrived)) v[23:0] <= 24'd0;
        else if (~holds) v[23:0] <= moved[23:0];
    end

    assign velocity_now = v[55:24];
    wire negative = v[55];

    // ---- position: adds the velocity, requests a pulse when the integer part would change -------
    logic        reverse = 1'b0;  // direction of the pulses: DIR before inversion
    wire  [32:0] sum     = {1'b0, fraction} + {v[55], v[55:24]};
    wire         due     = sum[32];
    wire         ready;
    wire         ripe    = gate & due & ready;
    wire         emit    = TIMED ? ripe & advance : ripe;
    wire  [3:0]  carry   = delta[3:0] ^ {4{reverse}};

    assign waits = gate & due & ~ready;

    always_ff @(posedge clk) begin
        if (TIMED ? advance : 1'b1) if (gate & (~due | ready)) fraction <= sum[31:0];
        if (visit) delta <= {{4{emit & reverse}}, emit};
        // +-1 without a carry chain
        else if (emit) delta <= delta ^ {&carry, &carry[2:0], &carry[1:0], carry[0], 1'b1};
    end

    // ---- timing: when a pulse may start and end, and the direction may change -------------------
    // Two clocks count up from the last event; a time is over from the clock on in which they are
    // equal. A flip-flop says so, computed a clock ahead: the longest path begins there, and goes
    // through path time to the ramps of all axes. A time of 0 is one of 1.
    logic        pulse      = 1'b0;
    logic        setup      = 1'b0;   // dir_clock counts dirsetup (else dirhold)
    logic [12:0] step_clock = 13'd1;  // since the pulse rose or fell
    logic [15:0] dir_clock  = 16'd1;  // since the pulse fell or the direction changed
    logic        step_done  = 1'b1;
    logic        dir_done   = 1'b1;

    wire [12:0] step_time = pulse ? steplen : stepspace;
    wire [15:0] dir_time  = setup ? dirsetup : dirhold;
    wire [12:0] step_next = step_clock + 13'd1;
    wire [15:0] dir_next  = dir_clock + 16'd1;

    // A closed gate cuts a pulse; in quadrature there is no pulse to cut, and the next edge keeps
    // its distance.
    wire quadrature = kind == 2'd2;
    wire updown     = kind == 2'd1;
    wire fall       = pulse & (step_done | (~gate & ~quadrature));
    wire turn       = gate & ~pulse & (setup | dir_done) & (negative ? ~reverse : reverse & (v[54:24] != 31'd0));

    assign ready = ~pulse & step_done & (reverse == negative) & ~(setup & ~dir_done);

    always_ff @(posedge clk) begin
        step_clock <= (emit | fall) ? 13'd1 : step_next;
        step_done  <= emit ? steplen[12:1] == 12'd0 : fall ? stepspace[12:1] == 12'd0 : step_done | (step_next == step_time);
        dir_clock  <= (turn | fall) ? 16'd1 : dir_next;
        dir_done   <= turn ? dirsetup[15:1] == 15'd0 : fall ? dirhold[15:1] == 15'd0 : dir_done | (dir_next == dir_time);
        if (turn) setup <= 1'b1;
        else if (fall) setup <= 1'b0;
    end

    // ---- pins -----------------------------------------------------------------------------------
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

`ifdef FORMAL
    // ---- what must hold: gateware/formal/stepgen.proofs -----------------------------------------
    // First a model of a drive that sees the pins and has its own clocks; then its guarantees, one
    // `ifdef per proof; then the link between its clocks and ours, so that induction needs only one
    // step (not asserted for a broken core: the guarantee must catch that). Every guarantee reads 0
    // as 1.
    wire [17:0] high_least  = {5'd0, steplen} + {18'd0, steplen == 13'd0};
    wire [17:0] low_least   = {5'd0, stepspace} + {18'd0, stepspace == 13'd0};
    wire [17:0] setup_least = {2'd0, dirsetup} + {18'd0, dirsetup == 16'd0};
    wire [17:0] hold_least  = {2'd0, dirhold} + {18'd0, dirhold == 16'd0};

    function automatic [17:0] more(input [17:0] n);  // counts up, and saturates
        more = &n ? n : n + 18'd1;
    endfunction

    wire one       = known & (step ^ step_invert);  // the registers power up at 0, inverted or not
    wire two       = known & (dir ^ dir_invert);
    wire active    = quadrature ? pulse : updown ? one | two : one;
    wire backwards = quadrature ? (one != was_one) == (was_one != was_two) : two;
    wire edge_seen = known & (quadrature ? one != was_one || two != was_two : active & ~was_active);

    logic        known = 1'b0, was_one = 1'b0, was_two = 1'b0, was_active = 1'b0, was_open = 1'b0;
    logic        was_says = 1'b0, was_backwards = 1'b0;
    logic [17:0] high      = 18'd0;        // clocks up to the one before
    logic [17:0] low       = 18'h3ffff;
    logic [17:0] since_dir = 18'h3ffff;
    logic [17:0] since_edge = 18'h3ffff;
    logic [31:0] counted   = 32'd0, harvested = 32'd0;
    wire  [31:0] counted_now = counted + (edge_seen ? {{31{backwards}}, 1'b1} : 32'd0);

    wire         says           = known & (quadrature | updown ? reverse : two);
    wire  [17:0] since_dir_now  = says != was_says ? 18'd0 : since_dir;
    wire  [17:0] since_edge_now = edge_seen ? 18'd0 : since_edge;
    wire         last_backwards = edge_seen ? backwards : was_backwards;
    logic [4:0]  unvisited      = 5'd1;

    always_comb assume (visit | unvisited < 5'd16);  // the wide counter guarantees this

    always_ff @(posedge clk) begin
        unvisited  <= visit ? 5'd1 : unvisited + 5'd1;
        known      <= 1'b1;
        was_one    <= one;
        was_two    <= two;
        was_active <= active;
        was_open   <= gate;
        high       <= active ? more(high) : 18'd0;
        low        <= active ? 18'd0 : more(low);
        was_says   <= says;
        since_dir  <= more(since_dir_now);
        since_edge <= more(since_edge_now);
        was_backwards <= last_backwards;
        counted    <= counted_now;
        if (visit) harvested <= harvested + {{27{delta[4]}}, delta};
    end

    // The ramp's input and its response one clock later.
    wire         halting = stop | ~gate;
    logic        resting = 1'b1;
    logic [31:0] asked = 32'd0, given = 32'd0;
    wire  [31:0] allowed = resting ? stop_accel : given;
    logic        was_resting = 1'b1, was_paused = 1'b1, was_taken = 1'b0, was_waiting = 1'b0, was_advancing = 1'b0, was_halt = 1'b0, was_halted = 1'b0;
    logic        was_fresh = 1'b0;
    logic [64:0] was_kept = 65'd0;
    logic [31:0] was_allowed = 32'd0, was_asked = 32'd0;
    logic [55:0] was_v = 56'd0;
    logic [63:0] was_at = 64'd0;
    logic [1:0]  rests = 2'd0;  // clocks in which everything has been at rest under `stop`

    wire [56:0] dv    = {v[55], v} - {was_v[55], was_v};
    wire [56:0] size  = dv[56] ? -dv : dv;
    wire [56:0] most  = {25'd0, was_allowed};
    wire [55:0] goal  = {was_asked, 24'd0};
    wire [63:0] at    = {counted_now, fraction};

    always_ff @(posedge clk) begin
        if (halting) {resting, asked} <= {1'b1, 32'd0};
        else if (commit & advance) {resting, asked, given} <= {~enable, enable ? velocity : 32'd0, accel};
        was_resting <= resting;
        was_paused  <= pause;
        was_taken   <= commit & advance & ~halting;
        was_waiting <= waits;
        was_advancing <= advance;
        was_fresh   <= fresh;
        was_kept    <= {target, limit, braking};
        was_halt    <= halting;
        was_halted  <= was_halt;
        was_allowed <= allowed;
        was_asked   <= asked;
        was_v       <= v;
        was_at      <= at;
        rests       <= ~(halting & was_halt & was_halted & v == 56'd0 & ~pulse) ? 2'd0 : rests == 2'd2 ? 2'd2 : rests + 2'd1;
    end

    wire rises = known & ~was_active & active;
    wire falls = known & was_active & ~active;

    always_comb if (known) begin
`ifdef PROVE_pulse_lasts_steplen
        if (falls) assert (high >= high_least | ~was_open);
`endif
`ifdef PROVE_pulses_are_stepspace_apart
        if (rises) assert (low >= low_least);
`endif
`ifdef PROVE_dir_is_stable_for_dirhold_after_a_pulse
        if (two != was_two) assert (~active & ~was_active & low >= hold_least);
`endif
`ifdef PROVE_dir_is_stable_for_dirsetup_before_a_pulse
        if (rises) assert (since_dir >= setup_least);
`endif
`ifdef PROVE_up_and_down_never_together_and_apart_at_a_reversal
        assert (~(one & two));
        if (rises) assert (low >= low_least);
        if (rises & backwards != was_backwards) assert (low >= hold_least + setup_least);
`endif
`ifdef PROVE_edges_change_one_line_and_are_apart
        assert (one == was_one | two == was_two);
        if (edge_seen) assert (since_edge >= high_least & since_edge - high_least >= low_least);
        if (edge_seen & backwards != was_backwards) assert (since_edge - high_least >= hold_least + setup_least);
`endif
`ifdef PROVE_count_is_what_the_pins_did
        assert (counted_now == harvested + {{27{delta[4]}}, delta});
`endif
`ifdef PROVE_closed_gate_begins_nothing
        if (~was_open & quadrature) assert (one == was_one & two == was_two);
        if (~was_open & ~quadrature) assert (~active);
        if (~was_open & ~quadrature & ~updown) assert (two == was_two);
`endif
`ifdef PROVE_velocity_changes_by_at_most_the_limit
        if (was_open & most != 57'd0) assert (size <= most);
        if (~was_open) assert (v == 56'd0);
`endif
`ifdef PROVE_velocity_never_passes_its_target
        if (was_open & $signed(was_v) <= $signed(goal)) assert ($signed(was_v) <= $signed(v) & $signed(v) <= $signed(goal));
        if (was_open & $signed(was_v) >= $signed(goal)) assert ($signed(was_v) >= $signed(v) & $signed(v) >= $signed(goal));
`endif
`ifdef PROVE_stop_and_disable_come_to_rest
        // In every clock the velocity comes nearer by the whole limit, except in the two that find
        // the direction; nothing moves at rest; and `stopped` is right.
        if (was_open & was_resting & ~was_paused) assert (v == 56'd0 | (most != 57'd0 & size == most & v[55] == was_v[55]));
        if (was_open & was_resting & ~was_paused) assert (v == 56'd0 | v[55] != dv[56]);
        if (halting & was_halt & was_halted) assert (~pause);
        if (was_resting & was_v == 56'd0 & ~was_taken) assert (v == 56'd0 & resting);
        if (was_v == 56'd0) assert (at == was_at);
        if (stopped) assert (was_halt & v == 56'd0 & ~pulse & (quadrature | ~active));
        if (rests == 2'd2) assert (stopped);
`endif
`ifdef PROVE_position_is_the_sum_of_the_velocities
        assert (at == was_at + (was_open & was_advancing & ~was_waiting ? {{32{was_v[55]}}, was_v[55:24]} : 64'd0));
`endif
`ifdef PROVE_time_that_stands_moves_nothing
        // A command that has just come is kept, too: path time continues as if it had not stopped.
        if (~was_advancing) assert (at == was_at);
        if (was_open & ~was_advancing & ~was_taken & ~was_resting & ~was_halt) assert (v == was_v & fresh == was_fresh & {target, limit, braking} == was_kept);
`endif
`ifdef PROVE_a_late_pulse_that_holds_time_loses_nothing
        assert (at == was_at + (was_open & was_advancing ? {{32{was_v[55]}}, was_v[55:24]} : 64'd0));
`endif
    end

`ifndef BROKEN
    always_comb begin
        assert (high == 18'd0 | ~was_active | ~&high);
        if (known) assert (one == (quadrature ? a : pulse & ~(updown & reverse)));
        if (known) assert (two == (quadrature ? b : updown ? pulse & reverse : reverse));
        if (known) assert (was_active == (high != 18'd0) & was_active == (low == 18'd0));
        assert (~known | was_open | quadrature | ~pulse);
        assert (down == (~up & ~fresh));
        assert (step_done | step_clock != 13'd0 & {5'd0, step_clock} < (pulse ? high_least : low_least));
        assert (dir_done | dir_clock != 16'd0 & {2'd0, dir_clock} < (setup ? setup_least : hold_least));
        assert (~pulse | {5'd0, step_clock} == high + 18'd1 & step_done == ({5'd0, step_clock} == high_least) & (~setup | dir_done));
        if (~pulse & ~step_done) assert ({5'd0, step_clock} == low + 18'd1);
        if (~pulse & step_done) assert (more(low) >= low_least);
        if (~pulse & ~setup & ~dir_done) assert ({2'd0, dir_clock} == low + 18'd1);
        if (~pulse & ~setup & dir_done) assert (more(low) >= hold_least);
        if (~pulse & setup) assert (low >= hold_least);
        if (setup & ~dir_done) assert ({2'd0, dir_clock} == since_dir_now + 18'd1);
        if (setup & dir_done) assert (more(since_dir_now) >= setup_least);
        if (~setup) assert (since_dir_now >= setup_least);
        assert (edge_seen == (pulse & step_clock == 13'd1));
        if (pulse | ~setup) assert (last_backwards == reverse);
        if (~pulse & last_backwards != reverse & ~dir_done) assert (low >= hold_least + {2'd0, dir_clock} - 18'd1);
        if (~pulse & last_backwards != reverse & dir_done) assert (more(low) >= hold_least + setup_least);
        if (quadrature & pulse) assert (high == since_edge_now);
        if (quadrature & ~pulse) assert (since_edge_now >= high_least & (&since_edge_now | since_edge_now - high_least >= low));
        assert (unvisited != 5'd0 & unvisited <= 5'd16);
        assert ($signed({delta, 1'b0}) <= $signed({1'b0, unvisited}) + $signed({5'd0, pulse}));
        assert ($signed({delta, 1'b0}) >= -$signed({1'b0, unvisited}) - $signed({5'd0, pulse}));
        assert (counted_now == harvested + {{27{delta[4]}}, delta});
        assert (target == asked & braking == resting & (braking | limit == given));
        assert (~halted | braking);
        assert (~braking | target == 32'd0);
        assert (was_halt == halted | ~known);
        // power-up
        if (~fresh) assert (jump == (allowed == 32'd0) | jump & v == 56'd0 & target == 32'd0);
        if (~fresh & ~jump & up) assert ($signed(v) <= $signed({target, 24'd0}));
        if (~fresh & ~jump & ~up) assert ($signed({v[55], v}) + $signed({25'd0, allowed}) >= $signed({target[31], target, 24'd0}));
    end
`endif
`endif
endmodule
`default_nettype wire
