// rgmii_rx: turns a PHY's signals at 1000, 100 or 10 Mbit/s into a stream of bytes, and finds the
// speed.
//
// At 1000 a byte comes in one clock, low nibble on its rising edge and high nibble on its falling
// one. At the lower speeds a nibble comes in each clock, low one first. The speed comes from the
// PHY: between frames RXD carries link, speed and duplex (in-band status). It is accepted when it
// was stable for 8 clocks, and used only while it says that the link is up: with a PHY that never
// reports it, the speed stays 1000.
//
//   1000         clk   _/‾\_/‾\_/‾\_/‾\_         100, 10      clk   _/‾\_/‾\_/‾\_/‾\_
//                rise  --X 5 | a | 1 X-status                 rise  --X 5 | d | 1 | a X-status
//                fall  --X d | b | 2 X-status                 byte          d5      a1
//                byte    d5  ba  21
//
// At the lower speeds the SFD (5, d) shows where a byte begins, however many nibbles of the
// preamble the PHY has lost. An extra nibble at the end is dropped, as 802.3 requires. Each byte is
// held back until the next is complete or the frame has ended, so that `last` comes with the last
// one. From an error (RX_ER) to the end of its frame all bytes are inverted: the MAC finds a wrong
// FCS, counts it and drops the frame.
//
`default_nettype none
module rgmii_rx (
    input  wire        clk,        // RXC: 125, 25 or 2.5 MHz
    // RXD at the clock's rising edge, and at the falling one after it
    input  wire  [3:0] rise,
    input  wire  [3:0] fall,
    input  wire        ctl_rise,   // RX_DV
    input  wire        ctl_fall,   // RX_DV xor RX_ER
    output wire        valid,
    output wire  [7:0] data,
    output wire        last,
    output logic [3:0] status,     // the PHY's link status: bit 0 up, 2:1 speed, 3 full duplex
    output logic       slow,       // a nibble per clock
    // changes every 4 clocks, so that another clock domain can see that this clock runs
    output wire        beat
);
    logic [3:0] lo = 4'd0, hi = 4'd0, lo_was = 4'd0;
    logic       dv = 1'b0, er = 1'b0;
    initial status = 4'd0;
    initial slow   = 1'b0;

    logic [2:0] pulse = 3'd0;
    assign beat = pulse[2];

    // The link.
    logic [2:0] same = 3'd0;
    wire quiet   = ~dv & ~er;
    wire settled = quiet & (&same);

    // Bytes: `whole` when both nibbles of one have come.
    logic odd = 1'b0, aligned = 1'b0;
    wire sfd   = slow & dv & ~aligned & (lo == 4'hd) & (lo_was == 4'h5);
    wire whole = dv & (~slow | odd | sfd);
    logic       done = 1'b0, gone = 1'b1, bad = 1'b0;  // a clock later; `gone`: no frame
    logic [7:0] next = 8'd0, held = 8'd0;
    logic       full = 1'b0;

    assign valid = full & (done | gone);
    assign last  = gone;
    assign data  = held;

    always_ff @(posedge clk) begin
        pulse <= pulse + 3'd1;
        lo <= rise;
        hi <= fall;
        dv <= ctl_rise;
        er <= ctl_rise ^ ctl_fall;
        lo_was <= lo;

        if (~quiet | (lo != lo_was)) same <= 3'd0;
        else if (~settled) same <= same + 3'd1;
        if (settled) begin
            status <= lo_was;
            if (lo_was[0] & ~&lo_was[2:1]) slow <= ~lo_was[2];
        end

        odd     <= dv & slow & ~odd & ~sfd;
        aligned <= dv & (aligned | sfd);
        done    <= whole;
        gone    <= ~dv;
        next    <= slow ? {lo, lo_was} : {hi, lo};
        bad     <= (dv & er) | (bad & ~gone);

        if (done) held <= next ^ {8{bad}};
        full <= done | (full & ~gone);
    end
endmodule
`default_nettype wire
