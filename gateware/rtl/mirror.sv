// Reads back written words: one block RAM for all settings and staged commands, of which the cores
// keep their own copies.
//
//   write_at/data --we--> 512 words --read_at--> value, one clock later
//
// A word is never read on the clock in which it is written: the bus takes two clocks for each
// access.
`default_nettype none
module mirror (
    input  wire         clk,
    input  wire         we,
    input  wire  [8:0]  write_at,
    input  wire  [31:0] data,
    input  wire  [8:0]  read_at,
    output logic [31:0] value
);
    (* ram_style = "block", no_rw_check *)
    logic [31:0] memory [0:511];

    always_ff @(posedge clk) begin
        if (we) memory[write_at] <= data;
        value <= memory[read_at];
    end

    initial for (int i = 0; i < 512; i++) memory[i] = 32'd0;
endmodule
`default_nettype wire
