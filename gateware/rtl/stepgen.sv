// stepgen: turns a velocity into STEP and DIR, and counts what it emitted.
//
// A velocity ramps towards its target by at most `accel` per clock; its integer part is added to a position of 32.32
// steps every clock; each change of the position's integer part is one pulse. When the pins' timing forbids the pulse,
// the position waits where it is and tries again in the next clock: a pulse is late, never merged, lost or misdirected.
// The integer part of the position is, by construction, the number of rising edges of STEP, signed.
//
//   step  ____/‾‾‾‾\________/‾‾‾‾\_______________/‾‾‾‾\__     1 steplen    2 stepspace
//             |-1--|---2----|    |--3--|----4----|            3 dirhold    4 dirsetup
//   dir   ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\________________
//
// Units: velocity f_clk/2^32 steps/s; accel f_clk^2/2^56 steps/s^2 (the velocity carries 24 fraction bits); times in
// clocks. steplen and stepspace 0 are read as 1, accel 0 as "no limit". Fastest: steplen = stepspace = 1, f_clk/2.
//
//   commit       _/‾\__________________     the command is taken at the end of this clock,
//   target       ----X new ------------     the ramp pauses for this clock and one more, to learn its
//   velocity     -----------X--X--X--X      direction; the velocity moves from then on, every clock.
//
// `stop`, or enable = 0 at a commit, ramps to rest at `stop_accel`. `gate` = 0 makes STEP inactive on the next clock,
// forgets target and velocity and keeps the position; DIR keeps its level, so that no edge disturbs the last pulse. After
// either, nothing moves until the next commit: an old target cannot come back to life.
`default_nettype none
module stepgen (
    input  wire         clk,

    // the gate and the watchdog
    input  wire         gate,         // 1: outputs live
    input  wire         stop,         // 1: come to rest; commits are ignored
    output logic        stopped,      // 1: `stop` has been obeyed: velocity 0 and STEP inactive

    // the command, taken while `commit`
    input  wire         commit,
    input  wire         enable,
    input  wire  [31:0] velocity,     // signed
    input  wire  [31:0] accel,

    // settings, quasi-static
    input  wire  [15:0] steplen,
    input  wire  [15:0] stepspace,
    input  wire  [23:0] dirsetup,
    input  wire  [23:0] dirhold,
    input  wire  [31:0] stop_accel,
    input  wire         step_invert,
    input  wire         dir_invert,

    // what happened
    output logic [63:0] position,     // s32.32, pulses in the high word; powers up at half a step
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
    logic [31:0] target  = 32'd0;
    logic [31:0] limit   = 32'd0;

    wire take  = commit & ~halt;
    wire pause = fresh | take | (halt & ~halted);

    always_ff @(posedge clk) begin
        halted <= halt;
        fresh  <= take | (halt & ~halted);
        if (halt | (take & ~enable)) target <= 32'd0;
        else if (take) target <= velocity;
        if (halt | take) limit <= (take & enable) ? accel : stop_accel;
    end

    // ---- velocity: s32.24, moves towards target by at most limit per clock ------------------------------------------
    // In the clock after a new target the adder adds nothing, so that its comparison tells where the target lies.
    logic [55:0] v = 56'd0;
    logic        up = 1'b0;   // v is below target
    logic        jump = 1'b1; // no limit

    wire        down    = ~up & ~fresh;
    wire [56:0] moved   = {v[55], v} + ({25'd0, limit & {32{~fresh}}} ^ {57{down}}) + {56'd0, down};
    wire        below   = $signed(moved[56:24]) < $signed({target[31], target});
    wire        arrived = jump | (up ^ below);  // this move would reach or pass the target

    always_ff @(posedge clk) begin
        if (fresh) up <= below;
        jump <= limit == 32'd0;
        if (~gate) v <= 56'd0;
        else if (~pause) begin
            v[55:24] <= arrived ? target : moved[55:24];
            v[23:0]  <= arrived ? 24'd0 : moved[23:0];
        end
    end

    assign velocity_now = v[55:24];
    wire negative = v[55];

    // ---- position: adds the velocity, asks for a pulse when the integer part would change -----------------------------
    logic [31:0] fraction = 32'h8000_0000;
    logic [31:0] pulses   = 32'd0;

    wire [32:0] sum  = {1'b0, fraction} + {v[55], v[55:24]};
    wire        due  = sum[32];
    wire        ready;
    wire        emit = gate & due & ready;

    assign waits    = gate & due & ~ready;
    assign position = {pulses, fraction};

    always_ff @(posedge clk) begin
        if (gate & (~due | ready)) fraction <= sum[31:0];
        if (emit) pulses <= pulses + {{31{negative}}, 1'b1};
    end

    // ---- pins: when a pulse may start and DIR may move ----------------------------------------------------------------
    logic        pulse    = 1'b0;   // STEP, before inversion
    logic        reverse  = 1'b0;   // DIR, before inversion
    logic        setup    = 1'b0;   // `dir_left` counts dirsetup (else dirhold)
    logic [15:0] step_left = 16'd0; // clocks left of steplen or stepspace; done at 1 or 0
    logic [23:0] dir_left  = 24'd0; // clocks left of dirhold or dirsetup; done at 1 or 0

    wire step_done = step_left[15:1] == 15'd0;
    wire dir_done  = dir_left[23:1] == 23'd0;
    wire fall      = pulse & (step_done | ~gate);
    wire turn      = gate & ~pulse & (setup | dir_done) & (negative ? ~reverse : reverse & (v[54:24] != 31'd0));

    assign ready = ~pulse & step_done & (reverse == negative) & ~(setup & ~dir_done);

    wire pulse_next   = emit | (pulse & ~fall);
    wire reverse_next = reverse ^ turn;

    always_ff @(posedge clk) begin
        pulse   <= pulse_next;
        reverse <= reverse_next;
        step    <= pulse_next ^ step_invert;
        dir     <= reverse_next ^ dir_invert;

        if (emit) step_left <= steplen;
        else if (fall) step_left <= stepspace;
        else if (~step_done) step_left <= step_left - 16'd1;

        if (turn) dir_left <= dirsetup;
        else if (fall) dir_left <= dirhold;
        else if (~dir_done) dir_left <= dir_left - 24'd1;

        if (turn) setup <= 1'b1;
        else if (fall) setup <= 1'b0;

        stopped <= halt & halted & ~pause & arrived & ~pulse_next;
    end

    initial begin
        step    = 1'b0;
        dir     = 1'b0;
        stopped = 1'b0;
    end
endmodule
`default_nettype wire
