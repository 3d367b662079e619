// Any requests, and a reset in any clock. The guarantees are beside the logic in sdram.sv, and so
// are the two assumptions: a request stays until it is taken, and the chip gives the word that it
// holds.
`default_nettype none
module sdram_promises #(
    parameter int BANK_BITS = 2,  // 1: the two chips of 16 bits that some cards have
    parameter int T_REFI = 930,
    parameter bit READY = 1'b0
) (
    input wire        clk, reset, want, store,
    input wire [18+BANK_BITS:0] at,
    input wire [31:0] data, dq_in
);
    sdram #(.BANK_BITS(BANK_BITS), .T_REFI(T_REFI), .READY(READY)) core (
        .clk(clk), .reset(reset), .want(want), .store(store), .at(at), .data(data), .taken(), .valid(), .word(), .ready(),
        .ras_n(), .cas_n(), .we_n(), .ba(), .a(), .drives(), .dq_out(), .dq_in(dq_in));
endmodule
`default_nettype wire
