// Any constant words to compare with, and any frames. The guarantees are beside the logic in
// rx_admission.sv.
`default_nettype none
module rx_admission_promises (
    input wire        clk, admit, valid, last, bad, room,
    input wire [1:0]  mode,
    input wire [31:0] data
);
    wire        refuse, like_high, like_low;
    wire [31:0] refused;
    wire [4:0]  at;
    rx_admission core (.clk(clk), .header_we(1'b0), .header_at(4'd0), .header(32'd0), .mode(mode), .admit(admit),
        .valid(valid), .last(last), .bad(bad), .room(room), .data(data), .refuse(refuse), .refused(refused),
        .at(at), .like_high(like_high), .like_low(like_low));
endmodule
`default_nettype wire
