// timebase: the wall clock, and the two strobes that make every channel act on one clock.
//
// A timed commit is never lost and never happens twice. If its apply time has already passed, it
// commits at once; if it is replaced before it is due, or in that same clock, only the new one
// commits. Times compare as plain numbers, so 2^64 - 1 means never (at 60 MHz the clock needs 9 700
// years to wrap). This module knows no bus and no channel.
//
//   clk          _/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_
//   now          99 |100|101|102|103|104|
//   commit_now   ________/‾‾‾\____________      seen in the clock it is asked for
//   commit       ________/‾‾‾\___/‾‾‾\____
//   commit_at    103 (timed)      here: now == commit_at
//
`default_nettype none
module timebase (
    input  wire         clk,
    input  wire         rst,          // discards a pending commit; the clock itself runs on
    input  wire         commit_now,   // pulse: commit in this clock
    input  wire         sample_now,   // pulse: sample in this clock
    input  wire         commit_timed, // pulse: commit when now reaches commit_at
    input  wire  [63:0] commit_at,    // stable from the clock before commit_timed
    output logic [63:0] now,
    output wire         commit,
    output wire         sample,
    output logic        pending
);
    // `next` is the counter and `now` its registered copy, so that "due in the next clock" is a
    // plain registered comparison.
    logic [63:0] next = 64'd1;
    logic        due  = 1'b0;
    initial now     = 64'd0;
    initial pending = 1'b0;

    assign commit = commit_now | (pending & due & ~commit_timed);
    assign sample = sample_now;

    always_ff @(posedge clk) begin
        next <= next + 64'd1;
        now  <= next;
        due  <= next >= commit_at;
        if (rst) pending <= 1'b0;
        else if (commit_timed) pending <= 1'b1;
        else if (due) pending <= 1'b0;
    end
endmodule
`default_nettype wire
