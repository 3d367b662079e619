// latch: decides in which clock a count is latched: at the first index or probe edge after it was
// armed.
//
// One count can be latched per channel; wide_counter.sv keeps it. While a flag is up nothing
// latches again, and a flag stays until its own arm bit falls. Levels are not edges: an index that
// is high when it is armed has to fall first.
//
//   arm_index      __/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\____
//   index          ______/‾‾‾‾‾\______/‾‾‾‾\_________
//   capture        ______/‾\_________________________    first edge only
//   pending        ________/‾‾‾‾\____________________    wide_counter.sv: the value is on its way, 16 clocks at most
//   index_latched  _______________/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\__    never before the value can be read
//
// An edge in the same clock as the rise of its arm bit does not count; one in the clock after does.
// An edge while `pending` is not captured: that concerns only an arm bit that rises again within 16
// clocks of a capture.
//
`default_nettype none
module latch (
    input  wire  clk,
    input  wire  arm_index,     // levels, already committed
    input  wire  arm_probe,
    input  wire  index,         // levels, synchronous, 1 is active
    input  wire  probe,
    input  wire  pending,       // wide_counter.pending of this channel
    output wire  capture,       // this clock's count is latched
    output logic index_latched,
    output logic probe_latched
);
    // 1 while not armed: a rise before arming is not an edge
    logic index_was = 1'b1, probe_was = 1'b1;
    // set at once; visible outside once the value is there
    logic index_flag = 1'b0, probe_flag = 1'b0;
    initial index_latched = 1'b0;
    initial probe_latched = 1'b0;

    wire index_edge = arm_index & index & ~index_was;
    wire probe_edge = arm_probe & probe & ~probe_was;
    wire free = ~(index_flag | probe_flag | pending);
    assign capture = free & (index_edge | probe_edge);

    always_ff @(posedge clk) begin
        index_was <= index | ~arm_index;
        probe_was <= probe | ~arm_probe;
        index_flag <= arm_index & (index_flag | (free & index_edge));
        probe_flag <= arm_probe & (probe_flag | (free & probe_edge));
        index_latched <= arm_index & index_flag & ~pending;
        probe_latched <= arm_probe & probe_flag & ~pending;
    end

// what gateware/formal proves: a source is ready once it was low while armed; its next high level
// is an edge
`ifdef FORMAL
    logic f_index_ready = 0, f_probe_ready = 0, f_pending = 0;
    logic f_index_done = 0, f_probe_done = 0;  // has captured, and its arm bit has not fallen since
    wire  f_index_edge = arm_index & f_index_ready & index, f_probe_edge = arm_probe & f_probe_ready & probe;
    always_ff @(posedge clk) begin
        f_index_ready <= arm_index & ~index;
        f_probe_ready <= arm_probe & ~probe;
        f_index_done  <= arm_index & (f_index_done | (capture & f_index_edge));
        f_probe_done  <= arm_probe & (f_probe_done | (capture & f_probe_edge));
        f_pending     <= pending;
    end
    always_comb begin
        assert (f_index_ready == ~index_was & f_probe_ready == ~probe_was);
        assert (f_index_done == index_flag & f_probe_done == probe_flag);
`ifdef PROVE_once_per_arming_and_the_first_edge_wins
        assert (capture == ((f_index_edge | f_probe_edge) & ~f_index_done & ~f_probe_done & ~pending));
`endif
`ifdef PROVE_never_without_arming
        assert (~capture | (arm_index & f_index_ready & index) | (arm_probe & f_probe_ready & probe));
        assert (~(index_latched & ~f_index_done & arm_index) & ~(probe_latched & ~f_probe_done & arm_probe));
`endif
`ifdef PROVE_a_flag_waits_for_its_value
        assert (~(index_latched | probe_latched) | ~f_pending);
`endif
    end
`endif
endmodule
`default_nettype wire
