// watchdog: owns the gate that every output passes. Closes it when the tokens stop, whoever is alive.
//
// Fed by a token that differs from the one before; a repeat is silence. A bite is latched and only `clear` forgets it,
// and a token never does. The external reset closes the gate in the clock it is seen. None of this needs the CPU.
//
//   token     1    2    3    3    3
//   remaining \|\  |\   |\___________           timeout
//   stop      ____________________/‾‾‾‾‾\_      bite: every stepgen ramps to rest,
//   gate      ‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\_      then (or after `grace`) the gate closes
//
`default_nettype none
module watchdog (
    input  wire         clk,
    input  wire         rst,        // closes the gate, forgets everything
    input  wire         ext_reset,  // synchronised pin

    input  wire         token_we,
    input  wire  [31:0] token,
    input  wire         arm,        // pulses
    input  wire         soft_stop,
    input  wire         shut,
    input  wire         clear,
    input  wire  [31:0] timeout,    // clocks
    input  wire  [31:0] grace,      // clocks

    input  wire         all_stopped,
    output wire         gate,
    output logic        stop,       // a soft stop is running
    output logic        bitten,
    output logic        reset_latched,
    output logic        armed,      // awake, counting
    output logic [31:0] remaining,
    output logic [31:0] last_token,
    output logic [31:0] bites
);
    logic        open = 1'b0;
    logic [31:0] patience = 32'd0;  // clocks left of the soft stop

    assign gate = open & ~ext_reset;

    wire fed  = token_we & (token != last_token);
    wire bite = armed & (remaining == 32'd0) & ~fed;

    always_ff @(posedge clk) begin
        if (token_we) last_token <= token;

        if (~open) begin
            stop      <= 1'b0;
            armed     <= 1'b0;
            remaining <= 32'd0;
            if (clear & ~ext_reset) begin
                bitten        <= 1'b0;
                reset_latched <= 1'b0;
            end
            if (arm & ~bitten & ~reset_latched & ~ext_reset) begin
                open      <= 1'b1;
                armed     <= 1'b1;
                remaining <= timeout;
            end
        end else if (stop) begin
            patience <= patience - 32'd1;
            if (all_stopped | (patience == 32'd0)) open <= 1'b0;
        end else if (bite | soft_stop) begin
            armed    <= 1'b0;
            stop     <= 1'b1;
            patience <= grace;
            if (bite) begin
                bitten <= 1'b1;
                bites  <= bites + 32'd1;
            end
        end else if (fed) remaining <= timeout;
        else remaining <= remaining - 32'd1;

        if (shut) open <= 1'b0;
        if (ext_reset) begin
            open          <= 1'b0;
            reset_latched <= 1'b1;
        end
        if (rst) begin
            open          <= 1'b0;
            bitten        <= 1'b0;
            reset_latched <= ext_reset;
        end
    end

    initial begin
        stop          = 1'b0;
        bitten        = 1'b0;
        reset_latched = 1'b0;
        armed         = 1'b0;
        remaining     = 32'd0;
        last_token    = 32'd0;
        bites         = 32'd0;
    end
endmodule
`default_nettype wire
