// rgmii_link: the PHY's in-band link status in the core clock; 0 when the PHY gives no clock.
//
// The word changes seldom and all at once, in another clock: it counts when two samples agree. A
// PHY that has stopped its clock says nothing more, so its last word is no longer believed after
// 256 clocks (4.3 us; at 10 Mbit/s `beat` changes every 1.6 us). Each change of `beat` is seen as
// long as it comes no faster than the core clock: at 1000 Mbit/s every 32 ns.
//
`default_nettype none
module rgmii_link (
    input  wire        clk,
    input  wire  [3:0] word,    // from another clock
    input  wire        beat,    // from another clock: changes while it runs
    output logic [3:0] status,
    output wire        changed  // a clock for each change of `beat`
);
    logic [3:0] word_meta = 4'd0, word_now = 4'd0, word_was = 4'd0;
    logic       beat_meta = 1'b0, beat_now = 1'b0, beat_was = 1'b0;
    logic [8:0] silence = 9'd0;
    initial status = 4'd0;
    assign changed = beat_now != beat_was;

    always_ff @(posedge clk) begin
        word_meta <= word;
        word_now  <= word_meta;
        word_was  <= word_now;
        beat_meta <= beat;
        beat_now  <= beat_meta;
        beat_was  <= beat_now;
        if (changed) silence <= 9'd0;
        else if (~silence[8]) silence <= silence + 9'd1;
        if (silence[8]) status <= 4'd0;
        else if (word_now == word_was) status <= word_was;
    end
endmodule
`default_nettype wire
