// rgmii_link: the PHY's word about its link, brought into the core clock; 0 when there is no clock from the PHY.
//
// The word changes seldom and all at once, in another clock: it counts when two samples agree. A PHY that has stopped its
// clock says nothing more, so its last word is no longer believed after 256 clocks (4.3 us; at 10 Mbit/s `beat` changes every
// 1.6 us).
//
`default_nettype none
module rgmii_link (
    input  wire        clk,
    input  wire  [3:0] word,    // from another clock
    input  wire        beat,    // from another clock: changes while it runs
    output logic [3:0] status
);
    logic [3:0] word_meta = 4'd0, word_now = 4'd0, word_was = 4'd0;
    logic       beat_meta = 1'b0, beat_now = 1'b0, beat_was = 1'b0;
    logic [8:0] silence = 9'd0;
    initial status = 4'd0;

    always_ff @(posedge clk) begin
        word_meta <= word;
        word_now  <= word_meta;
        word_was  <= word_now;
        beat_meta <= beat;
        beat_now  <= beat_meta;
        beat_was  <= beat_now;
        if (beat_now != beat_was) silence <= 9'd0;
        else if (~silence[8]) silence <= silence + 9'd1;
        if (silence[8]) status <= 4'd0;
        else if (word_now == word_was) status <= word_was;
    end
endmodule
`default_nettype wire
