// The ECP5 primitives that the benches need. They have no delays: the bench centres its clocks
// itself.
`default_nettype none
module DELAYG #(parameter DEL_MODE = "", DEL_VALUE = 0) (input wire A, output wire Z);
    assign Z = A;
endmodule
module ODDRX1F (input wire D0, D1, SCLK, output wire Q);
    reg a = 0, b = 0;
    always @(posedge SCLK) begin a <= D0; b <= D1; end
    assign Q = SCLK ? a : b;
endmodule
module IDDRX1F (input wire D, SCLK, output reg Q0, Q1);
    reg rise = 0, fall = 0;
    always @(posedge SCLK) begin rise <= D; Q0 <= rise; Q1 <= fall; end
    always @(negedge SCLK) fall <= D;
endmodule
module FD1S3BX (input wire CK, D, PD, output reg Q);
    initial Q = 1;
    always @(posedge CK or posedge PD) if (PD) Q <= 1; else Q <= D;
endmodule
`default_nettype wire
