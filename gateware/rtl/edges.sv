// edges: when each encoder last moved, and how often its lines lied. Sits beside a tally and shares its rotation.
//
// A channel keeps the four low bits of time at its last edge; the visit makes 24 of them, by knowing how long ago it was
// at most. Like the counts, a sample is exact to its clock: an edge after the strobe is not in it, so that count and time
// of one sample belong together and a velocity can be made of them.
//
//   moved[n]    pulse: the count changes in this clock
//   illegal[n]  pulse: both lines changed at once
//   now         low bits of the wall clock
//   sampled     {errors 31:24, edge_time 23:0} at the strobe, right 18 clocks after it; read without a clock at `addr`
//
// edge_time is `now` of the clock in which the count last changed, 0 before the first. errors counts illegal transitions
// and wraps at 256; those of one channel within one rotation of 16 clocks count once.
//
`default_nettype none
module edges #(
    parameter integer CHANNELS = 16  // as the tally's
) (
    input  wire                clk,
    input  wire [15:0]         turn,      // tally.turn
    input  wire                sampling,  // tally.sampling
    input  wire                sample,    // the strobe
    input  wire [CHANNELS-1:0] moved,
    input  wire [CHANNELS-1:0] illegal,
    input  wire [23:0]         now,
    input  wire [3:0]          addr,
    output wire [31:0]         sampled
);
    logic [3:0] at   = 4'd0;
    logic [3:0] behind = 4'd15;

    logic [4*CHANNELS-1:0] stamp        = {4*CHANNELS{1'b0}};  // `at` in the clock of the edge
    logic [4*CHANNELS-1:0] stamp_caught = {4*CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   seen         = {CHANNELS{1'b0}};    // an edge since the last visit
    logic [CHANNELS-1:0]   seen_caught  = {CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   wrong        = {CHANNELS{1'b0}};    // an illegal transition since the last visit
    logic [CHANNELS-1:0]   wrong_caught = {CHANNELS{1'b0}};

    integer n;
    always_ff @(posedge clk) begin
        at   <= at + 4'd1;
        behind <= at;
        for (n = 0; n < CHANNELS; n = n + 1) begin
            if (moved[n]) stamp[4*n +: 4] <= at;
            seen[n]  <= moved[n] | (seen[n] & ~turn[n]);
            wrong[n] <= illegal[n] | (wrong[n] & ~turn[n]);
            if (sample) stamp_caught[4*n +: 4] <= stamp[4*n +: 4];
            if (turn[n]) seen_caught[n] <= 1'b0;
            else if (sample) seen_caught[n] <= seen[n];
            if (turn[n]) wrong_caught[n] <= 1'b0;
            else if (sample) wrong_caught[n] <= wrong[n];
        end
    end

    // Words that are 0 unless visited, put together by an OR: as in tally.sv.
    logic [15:0] away = 16'hFFFE;  // ~turn
    logic [4*CHANNELS-1:0] stamp_shown = {4*CHANNELS{1'b0}}, stamp_caught_shown = {4*CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   seen_shown = {CHANNELS{1'b0}}, seen_caught_shown = {CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   wrong_shown = {CHANNELS{1'b0}}, wrong_caught_shown = {CHANNELS{1'b0}};
    logic [3:0]            edge_at, edge_at_caught;

    always_ff @(posedge clk) begin
        away <= {away[14:0], away[15]};
        for (n = 0; n < CHANNELS; n = n + 1)
            if (away[n]) begin
                stamp_shown[4*n +: 4]        <= 4'd0;
                stamp_caught_shown[4*n +: 4] <= 4'd0;
                seen_shown[n]                <= 1'b0;
                seen_caught_shown[n]         <= 1'b0;
                wrong_shown[n]               <= 1'b0;
                wrong_caught_shown[n]        <= 1'b0;
            end else begin
                stamp_shown[4*n +: 4]        <= stamp[4*n +: 4];
                stamp_caught_shown[4*n +: 4] <= stamp_caught[4*n +: 4];
                seen_shown[n]                <= seen[n];
                seen_caught_shown[n]         <= seen_caught[n];
                wrong_shown[n]               <= wrong[n];
                wrong_caught_shown[n]        <= wrong_caught[n];
            end
    end

    always_comb begin
        edge_at        = 4'd0;
        edge_at_caught = 4'd0;
        for (int c = 0; c < CHANNELS; c++) begin
            edge_at        = edge_at | stamp_shown[4*c +: 4];
            edge_at_caught = edge_at_caught | stamp_caught_shown[4*c +: 4];
        end
    end

    logic [23:0] times         [0:15];
    logic [7:0]  errors        [0:15];
    logic [31:0] samples       [0:15];
    assign sampled = samples[addr];

    // The edge was 1 to 16 clocks before the visit, so its time is visit - 16 + (edge_at - at modulo 16).
    logic [23:0] visited = 24'd0, time_old = 24'd0;
    logic [7:0]  errors_old = 8'd0;
    logic        to_sample = 1'b0;
    wire  [3:0]  ago = edge_at - behind, ago_caught = edge_at_caught - behind;
    wire  [23:0] time_new    = visited + {20'hFFFFF, ago};
    wire  [23:0] time_caught = visited + {20'hFFFFF, ago_caught};

    always_ff @(posedge clk) begin
        visited    <= now;
        time_old   <= times[at];
        errors_old <= errors[at];
        to_sample  <= sampling;
        if (|seen_shown) times[behind] <= time_new;
        if (|wrong_shown) errors[behind] <= errors_old + 8'd1;
        if (to_sample) samples[behind] <= {errors_old + {7'd0, |wrong_caught_shown}, |seen_caught_shown ? time_caught : time_old};
    end

    initial begin
        for (int i = 0; i < 16; i++) begin
            times[i]   = 24'd0;
            errors[i]  = 8'd0;
            samples[i] = 32'd0;
        end
    end
endmodule
`default_nettype wire
