// pace: how fast another clock runs, against the core clock.
//
// That clock divides itself and sends a beat, which changes every so many of its clocks
// (`rgmii_rx`: 4). The module that brings it into the core clock (`rgmii_link`) says when it has
// changed, and here the changes are counted. The count is caught together with the wall clock, so
// two looks give the ratio of both clocks, and how long they are apart is how exact it is: a beat
// of 4 clocks at 125 MHz is 32 ns, or 0.03 ppm of a second.
//
//   beat      ___/‾‾‾\_______/‾‾‾‾‾‾‾‾     in the other clock
//   changed   ____/‾\_/‾\_____/‾\_____     a clock each
//   count     n    | n+1| n+2  | n+3
//
`default_nettype none
module pace (
    input  wire         clk,
    input  wire         changed,  // a clock per change of the beat
    input  wire         catch_it, // with the wall clock
    output logic [31:0] caught
);
    logic [31:0] count = 32'd0;
    initial caught = 32'd0;

    always_ff @(posedge clk) begin
        if (changed) count <= count + 32'd1;
        if (catch_it) caught <= count;
    end
endmodule
`default_nettype wire
