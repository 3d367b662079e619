// extreset: synchronises the external reset pin. Two flip-flops and a polarity, without settings.
//
//   clk     _/‾\_/‾\_/‾\_/‾\_
//   pin     __/‾‾‾‾‾‾‾‾‾‾‾‾‾‾       asynchronous
//   active  _________/‾‾‾‾‾‾‾       two edges later; the gate is closed in the same clock, STEP is inactive at the next
//
`default_nettype none
module extreset #(
    parameter ACTIVE_LOW = 1'b0
) (
    input  wire clk,
    input  wire pin,
    output wire active
);
    // Powers up active: until the pin has been seen, it counts as a reset.
    (* keep *) logic meta = 1'b1;
    (* keep *) logic sync = 1'b1;
    assign active = sync;
    always_ff @(posedge clk) begin
        meta <= pin ^ ACTIVE_LOW;
        sync <= meta;
    end
endmodule
`default_nettype wire
