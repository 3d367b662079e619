// sdram: reads lines of 8 words from an SDRAM of 32 bits, writes single words, and refreshes it. It
// starts the chip by itself.
//
// One request is in work at a time. Each bank's row stays open behind a request until another row
// of that bank is wanted or a refresh closes all: the next request in an open row needs no
// activate. A refresh is due every T_REFI clocks and waits for the request in work at most. The
// chip always does single words: the cards tie its data masks to ground, so a store is a whole
// word.
//
//   clk      _/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_/‾\_ .. _/‾\_/‾\_/‾\_/‾\_/‾\_
//   want     _/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾ .. ‾‾‾‾\________________    a line; `at` and `store` do not change
//   command  -ACT-----RD0-RD1-RD2-RD3-RD4- .. -RD7-----------------    T_RCD between them; the row stays open
//   taken    ____________________________ .. _/‾‾\________________    with the last command of a request
//   valid    _____________________/‾‾‾‾‾‾ .. ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_______
//   word     ---------------------X 0 X 1 .. X 4 X 5 X 6 X 7 X-----    three clocks after its command
//
//   want     _/‾‾‾\_____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_____________       two stores, the second one in another row
//   command  -WR--------PRE-----ACT-----WR-----------------------       T_WR, T_RAS before PRE, T_RP behind it
//   drives   _/‾‾‾\_____________________/‾‾‾\____________________
//
// The outputs of this module end in the pads' registers, the chip's clock is a third of a period
// behind ours, and `dq_in` is the pads' input register: so a word is here CL + 1 = 3 clocks after
// its command. A store waits until the chip has let go of the lines.
//
// Every time is in clocks. All of them but T_REFI are at least what the data sheets ask for,
// rounded up; T_RC and T_RRD follow from the others, as one command is issued after the other (the
// proofs say so). The start: START intervals of rest, all banks closed, eight refreshes, the mode
// register, an interval apart each.
//
`default_nettype none
module sdram #(
    parameter int BANK_BITS = 2, ROW_BITS = 11, COL_BITS = 8,
    parameter int T_RCD = 2, T_RP = 2, T_RAS = 3, T_WR = 2, T_RFC = 5,
    parameter int T_REFI = 930, START = 14,
    parameter bit READY = 1'b0   // 1: the chip has been started already, for proofs
) (
    input  wire                                    clk,
    input  wire                                    reset,   // starts the chip once more

    input  wire                                    want,    // level, until `taken`
    // of a word; else a line, from its first word on
    input  wire                                    store,
    input  wire [ROW_BITS+BANK_BITS+COL_BITS-1:0]  at,      // a word: row, bank, column
    input  wire [31:0]                             data,
    output wire                                    taken,   // the next request may follow
    output wire                                    valid,   // a word of a line
    output wire [31:0]                             word,
    output logic                                   ready,   // the chip has been started

    output logic                                   ras_n, cas_n, we_n,
    output wire  [BANK_BITS-1:0]                   ba,
    output logic [ROW_BITS-1:0]                    a,
    output wire                                    drives,
    output wire  [31:0]                            dq_out,
    input  wire  [31:0]                            dq_in
);
    localparam int BANKS = 1 << BANK_BITS;
    localparam int STEPS = START + 9;         // and the mode register: the step of 0
    localparam logic [9:0] MODE = 10'h020;    // bursts of one word, CL 2
    localparam logic [4:0] CLOSES = 5'd9;     // the step that closes all banks

    logic [10:0]         interval = 11'(T_REFI - 1);  // clocks until the next refresh is due
    logic                due = 1'b0;          // a refresh, or a step of the start
    logic [4:0]          step = READY ? 5'd0 : 5'(STEPS);  // of the start, down to 0
    logic [2:0]          rest = 3'd0;         // clocks until the next command may follow
    logic [2:0]          hold = 3'd0;         // clocks until a row may be closed
    logic [BANKS-1:0]    open = '0;
    logic [ROW_BITS-1:0] rows [0:BANKS-1];
    logic [2:0]          column = 3'd0;       // the line's next word
    logic [2:0]          coming = 3'd0;       // reads on their way, the last one first
    initial ready = READY;

    wire [ROW_BITS-1:0]  row  = at[ROW_BITS+BANK_BITS+COL_BITS-1:BANK_BITS+COL_BITS];
    wire [BANK_BITS-1:0] bank = at[BANK_BITS+COL_BITS-1:COL_BITS];
    wire                 here = open[bank] & (rows[bank] == row);

    // A refresh does not come between the words of a line.
    wire free      = rest == 3'd0;
    wire closable  = free & (hold == 3'd0);
    wire serves    = due & (column == 3'd0);
    wire works     = free & ready & want & ~serves;
    wire keeps     = free & serves & ready;
    wire starts    = closable & due & ~ready;
    wire refreshes = (keeps & (open == '0)) | (starts & (step < CLOSES) & (step != 5'd0));
    wire sets_mode = starts & (step == 5'd0);
    wire closes_all = (keeps & closable & (open != '0)) | (starts & (step == CLOSES));
    wire activates = works & ~open[bank];
    wire closes    = works & closable & open[bank] & ~here;
    wire reads     = works & here & ~store;
    wire writes    = works & here & store & (coming[1:0] == 2'd0);

    assign ras_n  = ~(refreshes | sets_mode | closes_all | activates | closes);
    assign cas_n  = ~(refreshes | sets_mode | reads | writes);
    assign we_n   = ~(sets_mode | closes_all | closes | writes);
    assign ba     = ready ? bank : '0;
    assign drives = writes;
    assign dq_out = data;
    always_comb begin
        a = '0;
        if (~ready) a[9:0] = MODE;
        else if (~open[bank]) a = row;
        else a[COL_BITS-1:0] = store ? at[COL_BITS-1:0] : {at[COL_BITS-1:3], column};
        if (serves | ~ready) a[10] = step != 5'd0 | ready;  // all banks; not with the mode
    end

    assign taken = writes | (reads & (column == 3'd7));
    assign valid = coming[2];
    assign word  = dq_in;

    always_ff @(posedge clk) begin
        interval <= interval - 11'd1;
        due      <= due & ~(refreshes | starts);
        if (interval == 11'd0) begin
            interval <= 11'(T_REFI - 1);
            due      <= 1'b1;
            if (~ready) step <= step - 5'd1;
        end
        ready <= ready | sets_mode;

        rest <= rest - 3'(rest != 3'd0);
        if (activates) rest <= 3'(T_RCD - 1);
        if (closes | closes_all) rest <= 3'(T_RP - 1);
        if (refreshes | sets_mode) rest <= 3'(T_RFC - 1);
        hold <= hold - 3'(hold != 3'd0);
        if (activates) hold <= 3'(T_RAS - 1);
        if (writes) hold <= 3'(T_WR - 1);  // T_RAS is over by then

        if (activates) begin
            open[bank] <= 1'b1;
            rows[bank] <= row;
        end
        if (closes) open[bank] <= 1'b0;
        if (closes_all) open <= '0;
        column <= column + 3'(reads);
        coming <= {coming[1:0], reads};
        if (reset) begin
            ready  <= 1'b0;
            step   <= 5'(STEPS);
            column <= 3'd0;
        end
    end

// what gateware/formal proves, from the commands as the chip sees them, for any word `f_at`
`ifdef FORMAL
    localparam int T_RC = 4, T_MRD = 2;                  // at 60 MHz: 63 ns, 2 clocks
    localparam int PAUSE = (START - 1) * T_REFI;         // of the start
    localparam logic [6:0] BOUND = 7'd42;                // clocks from a request to its end
    localparam logic [10:0] LATE = 11'd14;               // a refresh behind its time
    (* anyconst *) logic [ROW_BITS+BANK_BITS+COL_BITS-1:0] f_at;
    wire [ROW_BITS-1:0]  f_its_row = f_at[ROW_BITS+BANK_BITS+COL_BITS-1:BANK_BITS+COL_BITS];
    wire [BANK_BITS-1:0] f_bank    = f_at[BANK_BITS+COL_BITS-1:COL_BITS];

    wire [2:0] f_command = {ras_n, cas_n, we_n};
    wire f_mrs = f_command == 3'b000;
    wire f_ref = f_command == 3'b001;
    wire f_pre = (f_command == 3'b010) & (a[10] | (ba == f_bank));
    wire f_act = (f_command == 3'b011) & (ba == f_bank);
    wire f_wr  = (f_command == 3'b100) & (ba == f_bank);
    wire f_rd  = (f_command == 3'b101) & (ba == f_bank);

    // The chip: its bank, and clocks since the last command of each kind, 15 at most.
    logic                f_open = 1'b0;
    logic [ROW_BITS-1:0] f_row = '0;
    logic [3:0]          f_since_act = 4'd15, f_since_pre = 4'd15, f_since_wr = 4'd15, f_since_ref = 4'd15, f_since_mrs = 4'd15;
    logic                f_acted = 1'b0;            // a bank was activated in the clock before
    // a read one and two clocks ago: its word may be on the lines
    logic [1:0]          f_reading = 2'd0;
    // since power-up or reset: mode set, all closed once
    logic                f_modes = READY, f_closed = READY;
    logic [3:0]          f_refreshes = READY ? 4'd8 : 4'd0;
    logic [14:0]         f_age = READY ? 15'd32767 : 15'd0;  // clocks since then, at most
    always_ff @(posedge clk) begin
        f_since_act <= f_act ? 4'd1 : f_since_act + 4'(f_since_act != 4'd15);
        f_since_pre <= f_pre & f_open ? 4'd1 : f_since_pre + 4'(f_since_pre != 4'd15);
        f_since_wr  <= f_wr ? 4'd1 : f_since_wr + 4'(f_since_wr != 4'd15);
        f_since_ref <= f_ref ? 4'd1 : f_since_ref + 4'(f_since_ref != 4'd15);
        f_since_mrs <= f_mrs ? 4'd1 : f_since_mrs + 4'(f_since_mrs != 4'd15);
        f_acted     <= f_command == 3'b011;
        f_reading   <= {f_reading[0], f_command == 3'b101};
        if (f_act) f_row <= a;
        f_open      <= f_act | (f_open & ~f_pre);
        f_modes     <= ~reset & (f_modes | f_mrs);
        f_closed    <= ~reset & (f_closed | ((f_command == 3'b010) & a[10]));
        f_refreshes <= reset ? 4'd0 : f_refreshes + 4'(f_ref & (f_refreshes != 4'd8));
        f_age       <= reset ? 15'd0 : f_age + 15'(f_age != 15'd32767);
    end

    // The word: in the chip, and as it was stored last; and on its way.
    logic [31:0] f_cell, f_stored, f_c1, f_c2, f_c3, f_s1, f_s2, f_s3;
    logic        f_known = 1'b0, f_k1 = 1'b0, f_k2 = 1'b0, f_k3 = 1'b0;
    logic [2:0]  f_chip = 3'd0, f_asked = 3'd0, f_came = 3'd0;
    wire f_reads_it  = f_rd & f_open & (f_row == f_its_row) & (a[COL_BITS-1:0] == f_at[COL_BITS-1:0]);
    wire f_writes_it = f_wr & f_open & (f_row == f_its_row) & (a[COL_BITS-1:0] == f_at[COL_BITS-1:0]);
    wire f_asks_it   = reads & ({at[ROW_BITS+BANK_BITS+COL_BITS-1:3], column} == f_at);
    always_ff @(posedge clk) begin
        if (f_writes_it & drives) f_cell <= dq_out;
        if (taken & store & (at == f_at)) begin
            f_stored <= data;
            f_known  <= 1'b1;
        end
        f_chip  <= {f_chip[1:0], f_reads_it};
        f_asked <= {f_asked[1:0], f_asks_it};
        {f_c3, f_c2, f_c1} <= {f_c2, f_c1, f_cell};
        {f_s3, f_s2, f_s1} <= {f_s2, f_s1, f_stored};
        {f_k3, f_k2, f_k1} <= {f_k2, f_k1, f_known};
        f_came <= reset ? 3'd0 : f_came + 3'(valid);
    end

    // Progress: the clocks a request may still need, and a refresh.
    logic [6:0] f_wait = 7'd0;      // clocks that this request has waited
    logic       f_again = 1'b0;     // a refresh has become due meanwhile
    logic       f_owed = 1'b0;      // this interval's refresh has not been done
    wire  [10:0] f_past = 11'(T_REFI - 1) - interval;   // clocks since the last one became due
    wire  [6:0] f_rest = {4'd0, rest}, f_hold = {4'd0, hold > rest ? hold : rest};
    wire  [6:0] f_column = {4'd0, column};
    wire  [6:0] f_last = 7'd7, f_open_it = 7'(T_RCD), f_close_it = 7'(T_RP), f_refresh_it = 7'(T_RFC);
    wire  [6:0] f_line = f_last - f_column;
    wire  [6:0] f_word = coming[0] ? 7'd2 : {6'd0, coming[1]};
    wire  [6:0] f_store = f_rest > f_word ? f_rest : f_word;
    wire  [6:0] f_left = serves ? ((open != '0) ? f_hold + f_close_it : f_rest) + f_refresh_it + f_open_it + f_last
                       : here ? (store ? f_store : f_rest + f_line)
                       : open[bank] ? f_hold + f_close_it + f_open_it + f_last : f_rest + f_open_it + f_last;
    wire  [6:0] f_until = ((column != 3'd0) ? 7'd8 - f_column : 7'd0) + ((open != '0) ? f_hold + f_close_it : f_rest);
    wire        f_waits = want & ready & ~reset;
    always_ff @(posedge clk) begin
        f_wait  <= f_waits & ~taken ? f_wait + 7'd1 : 7'd0;
        f_again <= f_waits & ~taken & (f_again | (interval == 11'd0));
        f_owed  <= ready & ~reset & ((interval == 11'd0) | (f_owed & ~f_ref));
    end

    // The chip's answer, and a client that keeps its request until it is taken.
    logic f_asking = 1'b0, f_store_before;
    logic [ROW_BITS+BANK_BITS+COL_BITS-1:0] f_at_before;
    logic [31:0] f_data_before;
    always_ff @(posedge clk) begin
        f_asking       <= want & ~taken & ~reset;
        f_store_before <= store;
        f_at_before    <= at;
        f_data_before  <= data;
    end
    always_comb begin
        if (f_chip[2]) assume (dq_in == f_c3);
        if (f_asking) assume (want & (store == f_store_before) & (at == f_at_before) & (data == f_data_before));
    end

`ifdef PROVE_all_of_it_at_full_size
`define PROVE_rows_are_opened_and_closed_in_time
`define PROVE_a_column_is_of_the_open_row
`define PROVE_the_chip_rests_behind_refresh_and_mode
`define PROVE_every_interval_has_its_refresh
`define PROVE_the_lines_have_one_driver
`define PROVE_what_is_read_is_what_was_written
`define PROVE_a_request_is_done_in_time
`define PROVE_the_chip_is_started_before_it_is_used
`endif
    always_comb begin
`ifdef PROVE_all_of_it_at_full_size  // 200 us; 4096 refreshes in 64 ms, and 2048 in 32
        assert (PAUSE >= 12_000);
        assert ((4096 * T_REFI + 14 < 3_840_000) & (2048 * T_REFI + 14 < 1_920_000));
`endif
`ifndef BROKEN
        assert (open[f_bank] == f_open);
        assert (~f_open | (rows[f_bank] == f_row));
        assert (rest <= 3'd4 & hold <= 3'd2);
        assert (interval <= 11'(T_REFI - 1));
        assert ({1'b0, f_since_act} + {2'd0, rest} >= 5'(T_RCD));
        assert ({1'b0, f_since_pre} + {2'd0, rest} >= 5'(T_RP));
        assert ({1'b0, f_since_ref} + {2'd0, rest} >= 5'(T_RFC));
        assert ({1'b0, f_since_mrs} + {2'd0, rest} >= 5'(T_MRD));
        assert ({1'b0, f_since_act} + {2'd0, hold} >= 5'(T_RAS));
        assert ({1'b0, f_since_wr} + {2'd0, hold} >= 5'(T_WR));
        assert (f_open | ({1'b0, f_since_act} + {2'd0, rest} >= 5'(T_RAS + T_RP)));
        assert (~f_acted | (rest != 3'd0));
        // The start.
        assert (step <= 5'(STEPS));
        assert (~ready | ((step == 5'd0) & f_modes));
        assert (ready | (step != 5'd0) | due);
        assert (ready | ~due | (f_past + {4'd0, f_hold} <= LATE));
        assert ((open != '0) | (hold == 3'd0));
        assert (ready | ~((step < CLOSES) | ((step == CLOSES) & ~due)) | ((open == '0) & ~f_open & f_closed));
        assert (f_refreshes <= 4'd8);
        assert (~ready | (f_age >= 15'(PAUSE)));
        assert (~ready | (f_closed & (f_refreshes == 4'd8)));
        assert (ready | (step >= CLOSES) | due | ({1'b0, f_refreshes} >= 5'd9 - ((step == 5'd0) ? 5'd1 : step)));
        assert (ready | (step >= CLOSES) | ~due | ({1'b0, f_refreshes} >= 5'd8 - step));
        assert (ready | (step == 5'(STEPS)) | (f_age == 15'd32767)
            | (f_age >= (15'(STEPS) - {10'd0, step} - 15'd1) * 15'(T_REFI) + {4'd0, f_past}));
        assert (ready | (column == 3'd0));
        // Data.
        assert (f_reading == coming[1:0]);
        assert (f_chip == f_asked);
        assert ((f_chip & ~coming) == 3'd0);
        assert (~f_known | (f_cell == f_stored));
        assert (~(f_chip[0] & f_k1) | (f_c1 == f_s1));
        assert (~(f_chip[1] & f_k2) | (f_c2 == f_s2));
        assert (~(f_chip[2] & f_k3) | (f_c3 == f_s3));
        // Progress.
        assert ((column == 3'd0) | (f_asking & ~f_store_before & (rest == 3'd0)));
        assert ((column == 3'd0) | (open[f_at_before[BANK_BITS+COL_BITS-1:COL_BITS]]
            & (rows[f_at_before[BANK_BITS+COL_BITS-1:COL_BITS]] == f_at_before[ROW_BITS+BANK_BITS+COL_BITS-1:BANK_BITS+COL_BITS])));
        assert (~f_owed | (ready & due));
        assert (~(ready & due) | (f_past + {4'd0, f_until} <= LATE));
        assert (f_wait < BOUND);
        assert ((f_wait == 7'd0) | f_asking);
        assert (~f_again | ((f_wait != 7'd0) & (f_past <= {4'd0, f_wait})));
        assert (~(f_waits & ~f_again) | (f_wait + f_left <= 7'd21));
        assert (~(f_waits & f_again) | (f_wait + f_left < BOUND));
`endif
`ifdef PROVE_rows_are_opened_and_closed_in_time
        if (f_act) assert (~f_open & (f_since_pre >= 4'(T_RP)) & (f_since_act >= 4'(T_RC)) & f_modes);
        if (f_act) assert (~f_acted);  // T_RRD: a clock between banks
        if (f_pre & f_open) assert ((f_since_act >= 4'(T_RAS)) & (f_since_wr >= 4'(T_WR)));
`endif
`ifdef PROVE_a_column_is_of_the_open_row
        if (f_rd | f_wr) assert (f_open & (f_row == row) & (f_since_act >= 4'(T_RCD)) & ~a[10]);
`endif
`ifdef PROVE_the_chip_rests_behind_refresh_and_mode
        if (f_command != 3'b111) assert ((f_since_ref >= 4'(T_RFC)) & (f_since_mrs >= 4'(T_MRD)));
        if (f_ref | f_mrs) assert (~f_open & (f_since_pre >= 4'(T_RP)) & (f_since_act >= 4'(T_RC)));
`endif
`ifdef PROVE_the_chip_is_started_before_it_is_used
        if (f_command != 3'b111) assert (f_age >= 15'(PAUSE));
        if (f_ref | f_mrs) assert (f_closed);
        if (f_mrs) assert ((f_refreshes == 4'd8) & (a == ROW_BITS'(MODE)) & (ba == '0));
        if ((f_command == 3'b011) | ~ras_n & ~cas_n & ready) assert (f_modes);
`endif
`ifdef PROVE_every_interval_has_its_refresh
        if (f_owed) assert (f_past <= LATE);
        if (interval == 11'd0) assert (~f_owed);
`endif
`ifdef PROVE_the_lines_have_one_driver
        if (drives) assert ((f_reading == 2'd0) & (f_command == 3'b100));
        if (f_command == 3'b100) assert (drives);
`endif
`ifdef PROVE_what_is_read_is_what_was_written
        if (f_asked[2]) assert (valid);
        if (f_asked[2] & f_k3) assert (word == f_s3);
`endif
`ifdef PROVE_a_request_is_done_in_time
        assert (f_wait < BOUND);
        if (taken) assert (want);
`endif
    end
`endif
endmodule
`default_nettype wire
