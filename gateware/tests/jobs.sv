// Segments and three stepgens, wired as in the SoC: staged commands, stop, and the counts.
`default_nettype none
module jobs #(
    parameter integer AXES = 3
) (
    input  wire         clk,
    input  wire         gate,
    input  wire         halt,
    input  wire         word_we,
    input  wire   [3:0] word_at,
    input  wire  [31:0] word,
    input  wire         push,
    input  wire         start,
    input  wire         quit,
    input  wire         clear,
    input  wire         pace_we,
    input  wire  [16:0] pace,
    input  wire  [31:0] slew,
    input  wire  [15:0] beam,
    input  wire         bus_commit,  // the host's own commands
    input  wire  [31:0] bus_velocity,
    input  wire  [12:0] steplen,
    input  wire  [15:0] dirsetup,
    input  wire  [31:0] stop_accel,
    output wire         advance,
    output wire         stop,
    output wire         busy,
    output wire         commit,
    output wire  [15:0] aux,
    output wire   [7:0] level,
    output wire   [1:0] state,
    output wire   [2:0] reason,
    output wire   [4:0] refused,
    output wire         stands,
    output wire         held,
    output wire  [31:0] begun,
    output wire  [31:0] left,
    output wire  [15:0] tag,
    output wire  [16:0] pace_now,
    output wire         waits,
    output wire   [2:0] step,
    output wire   [2:0] dir,
    output wire  [95:0] velocities,
    output wire  [63:0] position0,
    output wire  [63:0] position1,
    output wire  [63:0] position2
);
    wire        stage;
    wire  [3:0] stage_at;
    wire [31:0] staged_word;
    wire  [2:0] waiting, stopped;
    wire [191:0] positions;
    assign waits = |waiting;
    assign {position2, position1, position0} = positions;

    wire commit_due;
    segments #(.AXES(AXES)) core (
        .clk(clk), .gate(gate), .halt(halt), .word_we(word_we), .word_at(word_at), .word(word), .push(push), .start(start), .quit(quit),
        .clear(clear), .pace_we(pace_we), .pace(pace), .slew(slew), .beam(beam), .waits(waits), .stopped(&stopped), .advance(advance),
        .stop(stop), .busy(busy), .stage(stage), .stage_at(stage_at), .staged_word(staged_word), .commit_due(commit_due), .commit(commit), .aux(aux),
        .level(level), .state(state), .reason(reason), .refused(refused), .stands(stands), .held(held), .begun(begun), .left_now(left),
        .tag(tag), .pace_now(pace_now));

    for (genvar n = 0; n < 3; n++) begin : axis
        logic [31:0] velocity = 32'd0, accel = 32'd0, total = 32'd0;
        wire   [4:0] delta;
        wire  [31:0] recent = {{27{delta[4]}}, delta};
        assign positions[64 * n + 32 +: 32] = total + recent;
        always_ff @(posedge clk) begin
            total <= total + recent;
            if (stop) velocity <= 32'd0;
            else if (busy ? stage & stage_at == 4'(2 * n) : bus_commit) velocity <= busy ? staged_word : bus_velocity;
            if (stage & stage_at == 4'(2 * n + 1)) accel <= staged_word;
        end
        stepgen #(.TIMED(1'b1)) s (
            .clk(clk), .gate(gate), .stop(halt | stop), .stopped(stopped[n]), .advance(advance), .commit(busy ? commit_due : bus_commit),
            .enable(1'b1), .velocity(velocity), .accel(accel), .steplen(steplen), .stepspace(steplen), .dirsetup(dirsetup),
            .dirhold(16'd1), .stop_accel(stop_accel), .kind(2'd0), .step_invert(1'b0), .dir_invert(1'b0), .visit(1'b1),
            .delta(delta), .fraction(positions[64 * n +: 32]), .velocity_now(velocities[32 * n +: 32]), .waits(waiting[n]),
            .step(step[n]), .dir(dir[n]));
    end
endmodule
`default_nettype wire
