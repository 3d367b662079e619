// guard: between the CPU's data bus and the interconnect. While it is closed a program may read
// everything, and write only where it is allowed to.
//
//   clk       _/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_
//   closed    ________/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾   a clock after `set` without the key
//   we        _/‾‾‾\_____/‾‾‾\_________
//   we_out    _/‾‾‾\___________________   the second store becomes a read, which is answered
//   refused   ________________/‾‾‾‾‾‾‾‾   and `at` is its address
//
// It also answers where nothing else does, on the clock behind the question: a fetch or a read
// there gives 0, which is no instruction.
`default_nettype none
module guard #(
    parameter KEY  = 32'h4f50_4e21,
    parameter WAYS = 1,                                // places that may be written to
    parameter [30 * WAYS - 1:0] PLACES = {30 * WAYS{1'b0}},   // of each: the first word's address
    parameter [30 * WAYS - 1:0] ROOMS  = {30 * WAYS{1'b0}}    // and its words less 1: 2^n - 1
) (
    input  wire         clk,
    input  wire         rst,
    input  wire         set,
    input  wire  [31:0] word,       // the key opens; any other word closes
    input  wire         stb,
    input  wire         we,
    input  wire  [29:0] adr,
    input  wire         ack,
    output wire         we_out,
    input  wire         vacant,     // of every master: an access where there is nothing
    output logic        answer,
    output logic        closed,
    output logic        refused,    // since it was closed last
    output logic [29:0] at,         // the word's address
    output wire         irq
);
    initial {answer, closed, refused, at} = '0;

    logic [WAYS - 1:0] allowed;
    always_comb
        for (int n = 0; n < WAYS; n++)
            allowed[n] = ((adr ^ PLACES[30 * n +: 30]) & ~ROOMS[30 * n +: 30]) == 30'd0;

    wire kept = closed & ~|allowed;
    assign we_out = we & ~kept;
    assign irq = closed & refused;

    always_ff @(posedge clk) begin
        answer <= vacant & ~answer;
        if (~refused) at <= adr;
        if (closed & (stb & we & kept | answer & ack)) refused <= 1'b1;
        if (set) begin
            closed <= word != KEY;
            if (~closed) refused <= 1'b0;
        end
        if (rst) {closed, refused} <= 2'b00;
    end
endmodule
`default_nettype wire
