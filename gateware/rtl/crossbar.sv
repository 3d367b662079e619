// crossbar: each sink carries the one source that was written for it, inverted or not, or a
// constant.
//
// The routes are truth tables in LUT RAM (truth_table.sv), four sinks by four sources; a sink is
// the OR of its tables. A word has the routes of four sinks; the core itself makes their tables of
// it, so that no word can join two sources in a sink. That takes 16 clocks, each of which writes
// one line of all tables of these sinks. Lines are written only while `shut`.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_  ...  _/‾\_/‾\_/‾\_
//   shut     ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾ ... ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾
//   we       ____/‾‾‾\_________ ... ______________    refused while not `shut`, or not `idle`
//   line             | 0 | 1 |  ...   | 14| 15|
//   idle     ‾‾‾‾‾‾‾‾\_________ ... ___________/‾‾
//   ready    __________________ ... ___________/‾‾    a word was written, and all lines of the last
//   sinks    old     | some lines new         | new
//
//   a sink's byte of the word
//   6:0      source; 124 to 127: the constant 0
//   7        inverts it
//
// If `shut` falls between the lines, the rest waits for it, and `ready` stays low. A sink for which
// no word was written is 0. A source that does not exist gives 0, inverted or not.
`default_nettype none
module crossbar #(
    parameter integer SOURCES = 36,  // this and SINKS: multiples of 4
    parameter integer SINKS   = 56,
    // 1: the four `own` bits of each four sinks are sources of these sinks, too, behind all others
    parameter bit OWN = 1'b1
`ifdef FORMAL
    , parameter bit LINK = 1'b0  // 1: the tables are proven, too; so that induction needs one step
`endif
) (
    input  wire                clk,
    input  wire                shut,
    input  wire                we,
    input  wire          [4:0] to,      // four sinks
    input  wire         [31:0] word,    // the first sink's byte is the lowest
    input  wire  [SOURCES-1:0] sources,
    input  wire    [SINKS-1:0] own,
`ifdef FORMAL  // of four sinks: which; their routes; whether a word came; its lines so far
    input  wire          [4:0] f_to,
    input  wire         [31:0] f_routes,
    input  wire                f_known,
    input  wire          [4:0] f_lines,
`endif
    output wire                idle,
    output wire                ready,
    output wire    [SINKS-1:0] sinks
);
    localparam integer GROUPS = SOURCES / 4 + 32'(OWN), QUADS = SINKS / 4;

    logic        busy = 1'b0, written = 1'b0;
    logic  [3:0] line = 4'd0;
    logic  [4:0] place = 5'd0;
    logic [31:0] routes = 32'd0;

    assign idle  = ~busy;
    assign ready = written & ~busy;
    wire   take  = we & shut & ~busy;
    wire   next  = busy & shut;

    always_ff @(posedge clk) begin
        if (take) {place, routes} <= {to, word};
        if (next) line <= line + 4'd1;
        busy    <= take | (busy & ~(next & &line));
        written <= written | (next & &line);
    end

    // What the line is to hold of each sink, if the table has its source.
    wire [3:0] level;
    wire [3:0] constant;
    for (genvar n = 0; n < 4; n++) begin : sink
        assign constant[n] = &routes[8 * n + 2 +: 5];
        assign level[n]    = (line[routes[8 * n +: 2]] & ~constant[n]) ^ routes[8 * n + 7];
    end
    wire [4 * GROUPS-1:0] bits;
    for (genvar g = 0; g < GROUPS; g++) begin : group
        for (genvar n = 0; n < 4; n++) begin : sink
            assign bits[4 * g + n] = level[n] & (routes[8 * n + 2 +: 5] == 5'(g) | (g == 0 & constant[n]));
        end
    end

    wire unused = &{1'b0, own};
    for (genvar q = 0; q < QUADS; q++) begin : quad
        wire                  hit = next & (place == 5'(q));
        wire [4 * GROUPS-1:0] from;
        wire [4 * GROUPS-1:0] found;  // of each sink what every table says
        if (OWN) begin : with_own
            assign from = {own[4 * q +: 4], sources};
        end else begin : without
            assign from = sources;
        end
        for (genvar g = 0; g < GROUPS; g++) begin : group
            wire [3:0] says;
            assign {found[3 * GROUPS + g], found[2 * GROUPS + g], found[GROUPS + g], found[g]} = says;
            truth_table block (
                .clk(clk), .we(hit), .line(line), .bits(bits[4 * g +: 4]),
`ifdef FORMAL
                .f_wanted(f_wanted[64 * g +: 64]), .f_below(LINK & f_to == 5'(q) ? f_below : 5'd0),
`endif
                .sources(from[4 * g +: 4]), .sinks(says));
        end
        for (genvar n = 0; n < 4; n++) begin : sink
            assign sinks[4 * q + n] = |found[GROUPS * n +: GROUPS];
        end
    end

`ifdef FORMAL  // gateware/formal/crossbar.sv has the guarantees; this is their link to the tables
    localparam [63:0] F_LINES = 64'hff00_f0f0_cccc_aaaa;
    wire [64 * GROUPS-1:0] f_wanted;
    wire             [4:0] f_below = ~busy | place != f_to ? 5'd16 : f_lines;
    for (genvar g = 0; g < GROUPS; g++) begin : f_group
        for (genvar n = 0; n < 4; n++) begin : f_sink
            assign f_wanted[64 * g + 16 * n +: 16] = ~f_known ? 16'd0
                : f_routes[8 * n +: 7] >= 7'd124 ? {16{g == 0 & f_routes[8 * n + 7]}}
                : f_routes[8 * n + 2 +: 5] != 5'(g) ? 16'd0
                : {16{f_routes[8 * n + 7]}} ^ F_LINES[16 * f_routes[8 * n +: 2] +: 16];
        end
    end
`ifndef BROKEN
    always_ff @(posedge clk) begin
        if (busy) assert (line == f_lines[3:0]);
        else assert (line == 4'd0);
        if (busy & place == f_to) assert (f_known & routes == f_routes);
    end
`endif
`endif
endmodule
`default_nettype wire
