// The guarantees of the leash: the interrupt comes exactly `clocks + 1` clocks after it was set,
// stays until it is set again, and never comes without having been set.
`default_nettype none
module leash_promises (
    input wire        clk,
    input wire        rst, set,
    input wire [23:0] clocks
);
    logic        irq, formal_on;
    logic [23:0] formal_left;
    leash core (.*);

    // Clocks since it was set, to the number it was set to; and whether it is on.
    logic        on = 1'b0;
    logic [24:0] since = 25'd0;
    logic [23:0] limit = 24'd0;
    always_ff @(posedge clk) begin
        if (since <= {1'b0, limit}) since <= since + 25'd1;
        if (set) begin
            since <= 25'd0;
            limit <= clocks;
            on    <= clocks != 24'd0;
        end
        if (rst) on <= 1'b0;
    end
    wire over = on & since >= {1'b0, limit};

    always_ff @(posedge clk) begin
`ifndef BROKEN
        assert (formal_on == on);
        assert (since <= {1'b0, limit} + 25'd1);
        if (on) assert (limit != 24'd0);
        if (since <= {1'b0, limit}) assert ({1'b0, formal_left} == {1'b0, limit} - since);
        if (since > {1'b0, limit}) assert (formal_left == 24'd0);
`endif
`ifdef PROVE_an_interrupt_comes_at_its_clock_and_stays
        if (over) assert (irq);
`endif
`ifdef PROVE_no_interrupt_comes_early_or_without_having_been_asked_for
        if (~over) assert (~irq);
`endif
    end
endmodule
`default_nettype wire
