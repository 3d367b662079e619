// Any words, any commands, stepgens that wait and stand at any time. The guarantees are beside the
// logic in segments.sv.
`default_nettype none
module segments_promises #(
    parameter integer AXES  = 3,
    parameter integer DEPTH = 64
) (
    input wire        clk, gate, halt, word_we, push, start, quit, clear, pace_we, waits, stopped,
    input wire  [3:0] word_at,
    input wire [31:0] word, slew,
    input wire [16:0] pace,
    input wire [15:0] beam
);
    segments #(.AXES(AXES), .DEPTH(DEPTH)) core (
        .advance(), .stop(), .busy(), .stage(), .stage_at(), .staged_word(), .commit_due(), .commit(), .aux(), .level(), .state(), .reason(), .refused(),
        .stands(), .held(), .begun(), .left_now(), .tag(), .pace_now(), .*);
endmodule
`default_nettype wire
