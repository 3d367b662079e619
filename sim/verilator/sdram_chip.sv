// A model of an SDRAM that is used as its data sheet says: burst length 1, no data masks.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_
//   command  --ACT-----RD------     tRCD between them
//   q        ------------------Q    so that the pad's register catches it `cl` + 1 edges after the command left its own
//
// After wrong use (a mode register that is not set, a row that is not open, a time that is too
// short, a row that waited too long for its refresh) it returns rubbish and loses writes. The test
// bench sets `data_low`, `data_high` and `row_low`: lines of the board that are shorted to ground
// or to the supply, and it turns bits over in `mem`. On the card the chip's clock is a fraction of
// a period late; here all share one edge, and the outputs' way back is that fraction shorter.
module sdram_chip #(
    parameter int BANK_BITS = 2, ROW_BITS = 11, COL_BITS = 8,
    parameter int T_RCD = 2, T_RP = 2, T_RAS = 3, T_RFC = 5, T_WR = 2,   // clocks at 60 MHz, rounded up from 21, 21, 42 and 80 ns; the last one is 2 clocks
    parameter int T_REF = 3_840_000                                      // 64 ms
) (
    input  logic                 clk,
    input  logic                 ras_n, cas_n, we_n,
    input  logic [BANK_BITS-1:0] ba,
    input  logic [ROW_BITS-1:0]  a,
    input  logic                 drives,
    input  logic [31:0]          d,
    output logic [31:0]          q
);
    localparam int BANKS = 1 << BANK_BITS;
    localparam logic [31:0] RUBBISH = 32'hdead_5d5d;

    logic [31:0]         mem [0:(1 << (BANK_BITS + ROW_BITS + COL_BITS)) - 1];
    logic                open [0:BANKS-1];
    logic [ROW_BITS-1:0] row [0:BANKS-1];
    logic [7:0]          since [0:BANKS-1];       // clocks since the bank's last activate or precharge, at most 255
    logic [7:0]          idle, wrote;             // since the last refresh or mode, since the last write
    logic [31:0]         refreshed;               // clocks since 4096 refreshes were seen
    logic [12:0]         refreshes;
    logic                ready = 0, was_precharged = 0;
    logic [2:0]          cl = 0;
    logic [31:0]         later;
    logic                kept;                    // it has been refreshed in time
    logic [31:0]         data_low = 0;            // lines that are always low
    logic [31:0]         data_high = 0;           // and always high
    logic [15:0]         row_low = 0;             // likewise those of a row's number; the highest: a chip of half the size

    initial begin
        for (int n = 0; n < BANKS; n++) begin open[n] = 0; row[n] = 0; since[n] = 255; end
        idle = 255; wrote = 255; refreshed = 0; refreshes = 0; kept = 1; later = RUBBISH; q = RUBBISH;
    end

    wire all = a[10];
    wire [BANK_BITS+ROW_BITS+COL_BITS-1:0] place = {row[ba], ba, a[COL_BITS-1:0]};
    wire usable = ready & kept & open[ba] & (since[ba] + 1 >= T_RCD) & (idle + 1 >= T_RFC);

    always_ff @(posedge clk) begin
        logic [31:0] out;
        out = RUBBISH;
        for (int n = 0; n < BANKS; n++) if (since[n] != 255) since[n] <= since[n] + 1;
        if (idle != 255) idle <= idle + 1;
        if (wrote != 255) wrote <= wrote + 1;
        // 4096 refreshes in 64 ms, once it is in use.
        if (ready) begin
            refreshed <= refreshed + 1;
            if (refreshed > T_REF) kept <= 0;
        end
        case ({ras_n, cas_n, we_n})
            3'b000: begin // mode register
                ready <= was_precharged & (a[2:0] == 0);
                cl <= a[6:4];
                idle <= 0;
                kept <= 1; refreshed <= 0; refreshes <= 0;
            end
            3'b001: begin // refresh
                for (int n = 0; n < BANKS; n++) if (open[n] | (since[n] + 1 < T_RP)) ready <= 0;
                idle <= 0;
                if (refreshes[11:0] == '1) refreshed <= 0;
                refreshes <= refreshes + 1;
            end
            3'b010: // precharge
                for (int n = 0; n < BANKS; n++) if (all | (n == int'(ba))) begin
                    if (open[n] & ((since[n] + 1 < T_RAS) | (wrote + 1 < T_WR))) ready <= 0;
                    if (open[n]) since[n] <= 0;
                    open[n] <= 0;
                    if (all) was_precharged <= 1;
                end
            3'b011: begin // activate
                if (open[ba] | (since[ba] + 1 < T_RP) | (idle + 1 < T_RFC)) ready <= 0;
                open[ba] <= 1;
                row[ba] <= a & ~row_low[ROW_BITS-1:0];
                since[ba] <= 0;
            end
            3'b100: begin // write, the row closed behind it if a[10]
                if (usable & drives) mem[place] <= d;
                wrote <= 0;
                if (all) begin open[ba] <= 0; since[ba] <= 0; end
            end
            3'b101: begin // read
                if (usable & ~drives) out = mem[place];
                if (all) begin open[ba] <= 0; since[ba] <= 0; end
            end
            default: ;
        endcase
        out = (out & ~data_low) | data_high;
        later <= out;
        q <= cl == 2 ? out : cl == 3 ? later : RUBBISH;
    end
endmodule
