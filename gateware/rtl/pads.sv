// pads: the levels at the pads that the board drives, brought into the core clock for a CPU to look
// at.
//
// A pad has an input buffer beside its driver; what it sees is the pad's own level, whatever the
// driver wants: a pad held by a short reads as it is held. Nothing of this leads back to a driver.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_
//   levels   ____/‾‾‾‾‾‾‾‾‾‾‾‾    changes at any time
//   seen     __________/‾‾‾‾‾‾    two edges later
//
`default_nettype none
module pads #(
    parameter integer PINS = 32
) (
    input  wire             clk,
    input  wire  [PINS-1:0] levels,
    output logic [PINS-1:0] seen
);
    (* keep *) logic [PINS-1:0] meta = '0;
    initial seen = '0;

    always_ff @(posedge clk) begin
        meta <= levels;
        seen <= meta;
    end
endmodule
`default_nettype wire
