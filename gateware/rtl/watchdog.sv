// watchdog: controls the gate that every output passes. It closes the gate when the tokens stop,
// independently of the CPU.
//
// A token feeds it if it differs from the one before; a repeated token does not count. So does
// `feed`, a pulse for each command that the fast path executes. A bite is latched: only `clear`
// resets it, a token or `feed` never does. The external reset and the e-stop inputs close the gate
// in the clock in which they are seen. None of this needs the CPU, and the reason of the last close
// survives a reset of the CPU.
//
//   token     1    2    3    3    3
//   remaining \|\  |\   |\__|\_______           timeout, then the rest of `grace`
//   stop      ______________/‾‾‾‾‾‾‾\___        bite: every stepgen ramps to rest,
//   gate      ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\___        then (or after `grace`) the gate closes
//
`default_nettype none
module watchdog (
    input  wire         clk,
    // closes the gate, resets the bite and the external reset, but not an e-stop
    input  wire         rst,
    input  wire         ext_reset,  // synchronised pin
    input  wire         estop,      // an e-stop input is active, synchronised

    input  wire         token_we,
    input  wire  [31:0] token,
    input  wire         feed,       // pulse: the fast path has executed a command
    input  wire         arm,        // pulses
    input  wire         soft_stop,
    input  wire         shut,
    input  wire         clear,
    input  wire  [31:0] timeout,    // clocks
    input  wire  [31:0] grace,      // clocks

    input  wire         all_stopped,
    output wire         gate,
    output logic        stop,          // a soft stop is running
    output logic        bitten,
    output logic        reset_latched,
    output logic        estop_latched,
    output logic        armed,         // awake, counting
    output wire         cleared,       // `clear` was accepted: all latches fall
    output logic  [3:0] last_close,    // why the gate closed last
    // clocks until it bites; during a soft stop, until the gate closes
    output logic [31:0] remaining,
    output logic [31:0] last_token,
    output logic [31:0] bites
);
    localparam logic [3:0] NEVER_OPENED = 4'd0, BITE = 4'd1, EXT_RESET = 4'd2, STOP_KEY = 4'd3, SOFT_STOP = 4'd4, E_STOP = 4'd5,
                           SYSTEM_RESET = 4'd6;

    logic open = 1'b0;
    wire  pins = ext_reset | estop;

    assign gate    = open & ~pins;
    assign cleared = clear & ~open & ~pins;

    wire        fed   = (token_we & (token != last_token)) | feed;
    wire [32:0] less  = {1'b0, remaining} - 33'd1;
    wire        done  = less[32];
    wire        bite  = armed & done & ~fed;
    wire        opens = ~open & arm & ~bitten & ~reset_latched & ~estop_latched & ~pins & ~shut & ~rst;
    wire        shuts = open & (pins | rst | shut | (stop & (all_stopped | done)));
    wire        stops = armed & (bite | soft_stop);

    always_ff @(posedge clk) begin
        if (token_we) last_token <= token;

        open  <= opens | (open & ~shuts);
        armed <= opens | (armed & ~shuts & ~stops);
        stop  <= ~shuts & (stop | stops) & open;

        if ((~open | shuts) & ~opens) remaining <= 32'd0;
        else if (opens | fed & armed & ~stops) remaining <= timeout;
        else if (stops) remaining <= grace;
        else remaining <= less[31:0];

        bitten        <= ((bitten & ~cleared) | bite) & ~rst;
        reset_latched <= (reset_latched & ~cleared & ~rst) | ext_reset;
        estop_latched <= (estop_latched & ~cleared) | estop;
        if (bite) bites <= bites + 32'd1;

        // A bite stays the reason, whatever cuts its soft stop short; a pin is always the reason.
        if (shuts)
            last_close <= estop ? E_STOP : ext_reset ? EXT_RESET : (bitten | bite) ? BITE : rst ? SYSTEM_RESET : shut ? STOP_KEY : SOFT_STOP;
    end

    initial begin
        stop          = 1'b0;
        bitten        = 1'b0;
        reset_latched = 1'b0;
        estop_latched = 1'b0;
        armed         = 1'b0;
        last_close    = NEVER_OPENED;
        remaining     = 32'd0;
        last_token    = 32'd0;
        bites         = 32'd0;
    end
endmodule
`default_nettype wire
