// wide_counter: the wide part of every count, stored in LUT RAM; it visits one channel a clock.
//
// A channel counts its events since its last visit in five bits of its own, `delta`. The visit,
// every 16 clocks, adds them to the channel's 32-bit total. A sample or a capture is still exact to
// its clock: that clock stores `delta`, and the next visit writes total + stored delta into a RAM
// of its own. This module knows no pulses and no edges; a channel must not count 16 in 16 clocks in
// one direction, which neither core can do.
//
//   clk       0   1   2   3   4       16  17  18
//   sample    _/‾‾‾\________________________________     at any time; in this example channel 2 is visited in clock 3
//   visit[2]  _____________/‾‾‾\____________________     total += delta, delta restarts at this clock's event
//   sampled       old        |   | new                   addr = 2: right two clocks after the visit
//
// So all channels are right 18 clocks after the strobe.
//
// The position of a channel in a clock is total + delta, without the event of that clock. A strobe
// or a capture stores this value. If another strobe comes within 18 clocks, the words are those of
// the later one, 18 clocks after it; the totals are not affected. A capture must not come while the
// channel is `pending`; latch.sv ensures that.
//
// A capture with `clear` stores the count and restarts it at 0 in the same clock: in the next clock
// total + delta is 0, or the event of the capture's own clock.
//
//   delta     {channel n: bits 5n+4..5n}, signed, events since visit[n] and including the event of that clock
//   visit[n]  one clock in 16, and at a clearing capture: delta[n] restarts, at this clock's event
//   pending   capture[n] is being written; a flag that says "latched" must wait until it falls and one clock more
//   turn      the same rotation, one-hot, always 16 long and without the clears; sampling: a visit now writes its sample.
//             Both are for edges.sv: its words then belong to the same clock.
//   sampled, latched   read without a clock at `addr`
//
`default_nettype none
module wide_counter #(
    parameter integer CHANNELS = 16  // 1 to 16
) (
    input  wire                    clk,
    input  wire [5*CHANNELS-1:0]   delta,
    input  wire                    sample,
    input  wire [CHANNELS-1:0]     capture,
    input  wire [CHANNELS-1:0]     clear,
    input  wire [3:0]              addr,
    output wire [CHANNELS-1:0]     visit,
    output logic [CHANNELS-1:0]    pending,
    output logic [15:0]            turn,
    output logic                   sampling,
    output wire [31:0]             sampled,
    output wire [31:0]             latched
`ifdef FORMAL
    // any one channel, its count
    , input wire [3:0] f_channel, input wire [31:0] f_position, output logic [31:0] f_latched
`endif
);
    logic [3:0] at    = 4'd0;   // the channel visited in this clock: turn, in binary
    logic [3:0] behind = 4'd15;  // the one of the clock before: its words are written now
    logic [3:0] last = 4'd0;  // where the rotation of the sample ends

    logic [CHANNELS-1:0]   clearing = {CHANNELS{1'b0}};    // the total restarts at the next visit
    logic [CHANNELS-1:0]   afresh   = {CHANNELS{1'b0}};    // the strobe came after such a capture
    // delta at the strobe; valid until the visit
    logic [5*CHANNELS-1:0] caught   = {5*CHANNELS{1'b0}};
    logic [5*CHANNELS-1:0] held     = {5*CHANNELS{1'b0}};  // delta at the capture; likewise
    // the visit was in the strobe's own clock and has added it: the next adds nothing
    logic [CHANNELS-1:0]   passed   = {CHANNELS{1'b0}};
    logic [CHANNELS-1:0]   added    = {CHANNELS{1'b0}};    // the capture's own clock likewise

    assign visit = turn[CHANNELS-1:0] | (capture & clear);

    integer n;
    always_ff @(posedge clk) begin
        turn <= {turn[14:0], turn[15]};
        at   <= at + 4'd1;
        behind <= at;
        if (sample) last <= at;
        sampling <= sample | (sampling & (at != last));
        for (n = 0; n < CHANNELS; n = n + 1) begin
            pending[n]  <= capture[n] | (pending[n] & ~turn[n]);
            if (capture[n] & clear[n]) clearing[n] <= 1'b1;
            else if (turn[n]) clearing[n] <= 1'b0;
            afresh[n] <= ~turn[n] & (sample ? clearing[n] : afresh[n]);
            if (sample) begin  // without a reset: every channel would have its own (decision 10)
                caught[5*n +: 5] <= delta[5*n +: 5];
                passed[n]        <= turn[n];
            end
            if (capture[n]) begin
                held[5*n +: 5] <= delta[5*n +: 5];
                added[n]       <= turn[n];
            end
        end
    end

    // Only the visited channel's words are needed. Eight channels' words are merged in front of one
    // register, two to a LUT. A register for each channel, 0 unless visited, is a third of a LUT
    // cheaper but takes a reset per channel, for which the ECP5's tiles have no room.
    localparam GROUPS = (CHANNELS + 7) / 8;
    logic [5*GROUPS-1:0] delta_shown = {5*GROUPS{1'b0}}, caught_shown = {5*GROUPS{1'b0}}, held_shown = {5*GROUPS{1'b0}};
    logic [GROUPS-1:0]   pending_shown = {GROUPS{1'b0}};
    logic [5*GROUPS-1:0] delta_met, caught_met, held_met;
    logic [GROUPS-1:0]   pending_met;
    logic [4:0]          add_total, add_sample, add_latch;
    logic                to_latch;

    always_comb begin
        delta_met   = {5*GROUPS{1'b0}};
        caught_met  = {5*GROUPS{1'b0}};
        held_met    = {5*GROUPS{1'b0}};
        pending_met = {GROUPS{1'b0}};
        for (int c = 0; c < CHANNELS; c++) begin
            delta_met[5*(c/8) +: 5]  = delta_met[5*(c/8) +: 5] | ({5{turn[c]}} & delta[5*c +: 5]);
            caught_met[5*(c/8) +: 5] = caught_met[5*(c/8) +: 5] | ({5{turn[c] & ~passed[c]}} & caught[5*c +: 5]);
            held_met[5*(c/8) +: 5]   = held_met[5*(c/8) +: 5] | ({5{turn[c] & ~added[c]}} & held[5*c +: 5]);
            pending_met[c/8]         = pending_met[c/8] | (turn[c] & pending[c]);
        end
    end

    always_ff @(posedge clk) begin
        delta_shown   <= delta_met;
        caught_shown  <= caught_met;
        held_shown    <= held_met;
        pending_shown <= pending_met;
    end

    always_comb begin
        add_total  = 5'd0;
        add_sample = 5'd0;
        add_latch  = 5'd0;
        for (int g = 0; g < GROUPS; g++) begin
            add_total  = add_total | delta_shown[5*g +: 5];
            add_sample = add_sample | caught_shown[5*g +: 5];
            add_latch  = add_latch | held_shown[5*g +: 5];
        end
        to_latch = |pending_shown;
    end

    logic [31:0] totals  [0:15];
    logic [31:0] samples [0:15];
    logic [31:0] latches [0:15];
    wire  [31:0] total = totals[at];
    assign sampled = samples[addr];
    assign latched = latches[addr];

    // The visit reads; the clock after it adds and writes. Here `total` includes nothing of this
    // rotation.
    logic [31:0] base_total = 32'd0, base_sample = 32'd0, base_latch = 32'd0;
    logic        to_sample = 1'b0;

    function automatic [31:0] sum(input [31:0] base, input [4:0] few);
        sum = base + {{27{few[4]}}, few};
    endfunction

    always_ff @(posedge clk) begin
        base_total  <= |(clearing & turn[CHANNELS-1:0]) ? 32'd0 : total;
        base_sample <= |(afresh & turn[CHANNELS-1:0]) ? 32'd0 : total;
        base_latch  <= total;
        to_sample   <= sampling;
        totals[behind] <= sum(base_total, add_total);
        if (to_sample) samples[behind] <= sum(base_sample, add_sample);
        if (to_latch) latches[behind] <= sum(base_latch, add_latch);
    end

    initial begin
        turn     = 16'd1;
        sampling = 1'b0;
        pending  = {CHANNELS{1'b0}};
        for (int i = 0; i < 16; i++) begin
            totals[i]  = 32'd0;
            samples[i] = 32'd0;
            latches[i] = 32'd0;
        end
    end

`ifdef FORMAL  // what gateware/formal proves for any one channel
    // The content of the RAM, after the write of this clock.
    wire         f_behind = behind == f_channel;
    wire  [31:0] f_total  = f_behind ? sum(base_total, add_total) : totals[f_channel];
    wire  [4:0]  f_delta = delta[5*f_channel +: 5];
    wire  [4:0]  f_caught = {5{~passed[f_channel]}} & caught[5*f_channel +: 5], f_held = {5{~added[f_channel]}} & held[5*f_channel +: 5];
    wire         f_clearing = clearing[f_channel], f_pending = pending[f_channel], f_afresh = afresh[f_channel];
    wire  [3:0]  f_coming = f_channel - at, f_ends = last - at, f_begun = at - last;

    logic [31:0] f_sampled = 0;
    initial f_latched = 0;
    logic        f_waits = 0, f_was_pending = 0;  // the sample is not written yet
    logic [4:0]  f_since = 31;                    // clocks since the strobe
    always_ff @(posedge clk) begin
        f_was_pending <= f_pending;
        f_since <= sample ? 1 : &f_since ? f_since : f_since + 1;
        f_waits <= sample | (f_waits & at != f_channel);
        if (sample) f_sampled <= f_position;
        if (capture[f_channel]) f_latched <= f_position;
    end

    integer i;
    always_comb begin
        assert (behind == at - 4'd1 & turn == 16'd1 << at);
        for (i = 0; i < GROUPS; i = i + 1)
            assert (behind >> 3 == i | {delta_shown[5*i +: 5], caught_shown[5*i +: 5], held_shown[5*i +: 5], pending_shown[i]} == 0);
        assert (f_pending | ~f_clearing);
        assert (f_clearing | ~f_afresh);
        assert (f_position == (f_clearing ? 0 : f_total) + {{27{f_delta[4]}}, f_delta});
        // A sample waits, is being written, or can be read; 18 clocks after the strobe it can be
        // read.
        assert (f_since != 0 & sampling == (f_since <= 16) & (~sampling | f_begun == f_since[3:0]));
        assert (f_waits == (sampling & f_coming <= f_ends));
        if (f_waits) assert (f_sampled == (f_afresh ? 0 : f_total) + {{27{f_caught[4]}}, f_caught});
        else if (f_behind & to_sample) assert (f_sampled == sum(base_sample, add_sample));
        else assert (f_sampled == samples[f_channel]);
`ifdef PROVE_a_sample_is_the_count_at_the_strobe
        assert (addr != f_channel | f_since < 18 | sampled == f_sampled);
`endif
        // The same for a capture.
        if (f_pending) assert (f_latched == f_total + {{27{f_held[4]}}, f_held});
        else if (f_behind & to_latch) assert (f_latched == sum(base_latch, add_latch));
        else assert (f_latched == latches[f_channel]);
        assert (f_was_pending | ~(f_behind & to_latch) | f_pending);
`ifdef PROVE_a_latched_flag_shows_the_count_at_the_capture
        assert (addr != f_channel | f_pending | f_was_pending | latched == f_latched);
`endif
    end
`endif
endmodule
`default_nettype wire
