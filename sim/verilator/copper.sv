// copper: the pads that the simulated board drives, and one thing that is wrong with them.
//
// Pads by number: STEP n is n, DIR 16 + n, inverted STEP 32 + n, inverted DIR 48 + n, PWM 64 + n,
// its second pin 80 + n, output n 96 + n; on an image line n 96 + n. Where two drivers fight, the
// one that pulls low wins: the n-channel is the stronger one.
//
`default_nettype none
module copper (
    input  wire  [159:0] driven,
    input  wire    [1:0] fault,  // 0 none, 1 `at` is held low, 2 high, 3 `at` and `to` are joined
    input  wire    [7:0] at,
    input  wire    [7:0] to,
    output logic [159:0] level
);
    always_comb begin
        level = driven;
        if (fault == 2'd3) begin
            level[at] = driven[at] & driven[to];
            level[to] = driven[at] & driven[to];
        end else if (fault != 2'd0) level[at] = fault[1];
    end
endmodule
`default_nettype wire
