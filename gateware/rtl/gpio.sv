// gpio: inputs through two flip-flops and a debouncer, outputs through the gate, e-stop inputs
// directly to the gate.
//
// While the gate is closed every output has its safe level; after the gate opens it keeps it until
// the next commit. `invert` inverts a pin, its safe level included. On a board with jobs, outputs
// in `job_mask` carry `job_value` from that commit on, whatever was committed.
//
//   gate    ___/‾‾‾‾‾‾‾‾‾‾‾\____
//   commit  ________/‾\_________
//   pins    safe      | value | safe
//
// One debouncer visits every input in turn, each once in 32 clocks. A new level is accepted when it
// was seen in limit + 1 visits in a row: a level shorter than 32 * limit clocks never passes, one
// of 32 * (limit + 1) always does.
//
//   visit   |    |    |    |    |    |    |      limit 2
//   raw     ___/‾‾\____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾
//   in      _______________________/‾‾‾‾‾‾
//
// An e-stop input is not debounced: no setting may delay it. The e-stop inputs and their levels are
// wired in, so that no program can disable them. `estop` follows the pin in three clocks; each
// input's latch falls with `clear`, and only when the input is released.
//
`default_nettype none
module gpio #(
    parameter integer INPUTS  = 32,
    parameter integer OUTPUTS = 32,
    parameter logic [31:0] ESTOP_MASK  = 32'd0,  // 1: this input is an e-stop
    parameter logic [31:0] ESTOP_LEVEL = 32'd0,  // the level at which it triggers
    parameter bit JOBS = 1'b0  // 1: outputs in `job_mask` carry `job_value`, without a commit
) (
    input  wire               clk,
    input  wire               gate,
    input  wire               commit,
    input  wire [OUTPUTS-1:0] value,
    input  wire [OUTPUTS-1:0] safe,
    input  wire [OUTPUTS-1:0] invert,
    input  wire [OUTPUTS-1:0] job_mask,
    input  wire [OUTPUTS-1:0] job_value,
    input  wire  [INPUTS-1:0] in_pins,         // asynchronous
    input  wire               debounce_we,
    input  wire         [4:0] debounce_pin,
    input  wire        [15:0] debounce_limit,  // 32 clocks
    // pulse: reset the latches of released inputs; the watchdog's `cleared`
    input  wire               clear,
    output logic [INPUTS-1:0] in,              // debounced
    output logic [INPUTS-1:0] raw,             // synchronised only
    output logic              estop,           // an e-stop input is active now
    output logic       [31:0] estop_latched,
    output logic [OUTPUTS-1:0] out_pins        // registered
);
    // Until the pins have been seen, e-stop inputs count as released and all others as 0.
    localparam logic [31:0] RELEASED = ESTOP_MASK & ~ESTOP_LEVEL;

    // Inputs --------------------------------------------------------------------------------------

    (* keep *) logic [INPUTS-1:0] meta = RELEASED[INPUTS-1:0];
    logic  [4:0] pin = 5'd0;  // the input being visited
    logic [15:0] limits[0:31];
    logic [15:0] lefts[0:31];  // visits left until it is accepted
    initial for (int n = 0; n < 32; n++) begin
        limits[n] = 16'd0;
        lefts[n]  = 16'd0;
    end

    wire [31:0] differs  = 32'(raw ^ in);
    wire        differing = differs[pin];
    wire [15:0] limit    = limits[pin];
    wire [16:0] left     = {1'b0, lefts[pin]} - 17'd1;
    wire        believed = differing & left[16];
    logic [31:0] turn;
    always_comb for (int n = 0; n < 32; n++) turn[n] = believed & (pin == 5'(n));

    wire [31:0] active = (32'(raw) ^ ~ESTOP_LEVEL) & ESTOP_MASK;

    always_ff @(posedge clk) begin
        meta <= in_pins;
        raw  <= meta;
        pin  <= pin + 5'd1;
        in   <= in ^ turn[INPUTS-1:0];
        lefts[pin] <= (differing & ~left[16]) ? left[15:0] : limit;
        if (debounce_we) limits[debounce_pin] <= debounce_limit;

        estop         <= |active;
        estop_latched <= active | (clear ? 32'd0 : estop_latched);
    end

    initial begin
        raw           = RELEASED[INPUTS-1:0];
        in            = {INPUTS{1'b0}};
        estop         = 1'b0;
        estop_latched = 32'd0;
    end

    // Outputs -------------------------------------------------------------------------------------

    logic [OUTPUTS-1:0] held = {OUTPUTS{1'b0}};
    logic               live = 1'b0;  // a commit has come since the gate opened
    initial out_pins = {OUTPUTS{1'b0}};

    wire  [OUTPUTS-1:0] driven = JOBS ? (held & ~job_mask) | (job_value & job_mask) : held;

    always_ff @(posedge clk) begin
        if (commit) held <= value;
        live     <= gate & (live | commit);
        out_pins <= ((gate & live) ? driven : safe) ^ invert;
    end

`ifdef FORMAL  // what gateware/formal proves: the guarantees, stated without the logic above
    logic [1:0] f_age = 2'd0;
    always_ff @(posedge clk) f_age <= &f_age ? f_age : f_age + 2'd1;

    // An output is safe unless the gate is open and a commit has come since it opened.
    logic               f_live = 1'b0, f_driven = 1'b0;
    logic [OUTPUTS-1:0] f_value, f_safe, f_wanted;
    always_ff @(posedge clk) begin
        f_live   <= gate & (f_live | commit);
        f_driven <= gate & f_live;
        f_safe   <= safe ^ invert;
        f_wanted <= (JOBS ? (f_value & ~job_mask) | (job_value & job_mask) : f_value) ^ invert;
        if (commit) f_value <= value;
`ifdef PROVE_outputs_are_safe_unless_committed_since_the_gate_opened
        if (f_age != 2'd0) assert (out_pins == (f_driven ? f_wanted : f_safe));
`ifndef BROKEN
        assert (live == f_live);
        assert (~live | held == f_value);
`endif
`endif
    end

    // An e-stop needs three clocks and no program; its latch falls only on request, and only when
    // the input is released.
    logic [INPUTS-1:0] f_pins1, f_pins2;
    logic       [31:0] f_active, f_latched;
    logic              f_clear;
    always_ff @(posedge clk) begin
        f_pins1   <= in_pins;
        f_pins2   <= f_pins1;
        f_active  <= (32'(f_pins2) ^ ~ESTOP_LEVEL) & ESTOP_MASK;
        f_latched <= estop_latched;
        f_clear   <= clear;
`ifdef PROVE_an_estop_is_seen_in_three_clocks_and_latched
        if (&f_age) assert (estop == |f_active);
        if (&f_age) assert ((f_active & ~estop_latched) == 32'd0);
        if (&f_age) assert ((f_latched & ~estop_latched & (f_clear ? f_active : 32'hFFFFFFFF)) == 32'd0);
        assert ((estop_latched & ~ESTOP_MASK) == 32'd0);
`endif
    end

    // Any one input: it changes at the visit at which it has differed limit + 1 times in a row, and
    // at no other.
    (* anyconst *) logic [4:0] f_pin;
    logic  [4:0] f_turn = 5'd0;
    // now; when the run began; number of visits that differed
    logic [15:0] f_limit = 16'd0, f_loaded = 16'd0, f_seen = 16'd0;
    logic        f_in = 1'b0;
    wire         f_differs = raw[f_pin] != in[f_pin];
    always_ff @(posedge clk) begin
        f_turn <= f_turn + 5'd1;
        if (debounce_we & debounce_pin == f_pin) f_limit <= debounce_limit;
        if (f_turn == f_pin) begin
            if (f_differs & f_seen == f_loaded) f_in <= ~f_in;
            f_seen <= (f_differs & f_seen != f_loaded) ? f_seen + 16'd1 : 16'd0;
            if (~f_differs | f_seen == f_loaded) f_loaded <= f_limit;
        end
`ifdef PROVE_an_input_changes_after_limit_plus_one_visits_in_a_row
        assert (in[f_pin] == f_in);
`ifndef BROKEN
        assert (pin == f_turn & limits[f_pin] == f_limit);
        assert (f_seen <= f_loaded & lefts[f_pin] == f_loaded - f_seen);
`endif
`endif
    end
`endif
endmodule
`default_nettype wire
