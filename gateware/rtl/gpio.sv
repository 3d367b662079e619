// gpio: inputs through two flip-flops, outputs through the gate.
//
// While the gate is closed every output carries its safe level; after the gate opens it stays there until the next
// commit. `invert` turns a pin over, safe level included.
//
//   gate    ___/‾‾‾‾‾‾‾‾‾‾‾\____
//   commit  ________/‾\_________
//   pins    safe      | value | safe
//
`default_nettype none
module gpio #(
    parameter integer INPUTS  = 32,
    parameter integer OUTPUTS = 32
) (
    input  wire               clk,
    input  wire               gate,
    input  wire               commit,
    input  wire [OUTPUTS-1:0] value,
    input  wire [OUTPUTS-1:0] safe,
    input  wire [OUTPUTS-1:0] invert,
    input  wire  [INPUTS-1:0] in_pins,   // asynchronous
    output logic [INPUTS-1:0] in,
    output logic [OUTPUTS-1:0] out_pins  // registered
);
    (* keep *) logic [INPUTS-1:0] meta = {INPUTS{1'b0}};
    logic [OUTPUTS-1:0] held = {OUTPUTS{1'b0}};
    logic               live = 1'b0;  // a commit has come since the gate opened

    initial in       = {INPUTS{1'b0}};
    initial out_pins = {OUTPUTS{1'b0}};

    always_ff @(posedge clk) begin
        meta <= in_pins;
        in   <= meta;
        if (commit) held <= value;
        live     <= gate & (live | commit);
        out_pins <= ((gate & live) ? held : safe) ^ invert;
    end
endmodule
`default_nettype wire
