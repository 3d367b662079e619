"""Our router's result for a small design on the real chip: nextpnr accepts every route, has almost
nothing left to do, and reports the same clock. Two runs give the same bytes; and everything but the
routes, such as the kind of a pin, is as without our router."""

import json
import re
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc import build, ecp5, tools  # noqa: E402

# Carry chains, LUT RAM, a block RAM, a multiplier, enables, resets, a net of many pins.
DESIGN = """
module top(input clk, input rst, input enable, input [3:0] at, input [15:0] d, output reg q);
    reg [31:0] count, sum;
    reg [15:0] small [0:15];
    reg [15:0] large [0:1023];
    reg [15:0] a, b;
    always @(posedge clk) begin
        if (rst) count <= 0; else if (enable) count <= count + d;
        if (enable) small[at] <= d;
        if (at[0]) large[count[9:0]] <= d;
        a <= small[count[3:0]];
        b <= large[sum[9:0]];
        sum <= a * b + (sum ^ {32{enable}});
        q <= ^sum ^ count[31];
    end
endmodule
"""


def main():
    board = SimpleNamespace(sys_clk_hz=50_000_000, platform=SimpleNamespace(device="LFE5U-25F-6BG256C", package="CABGA256"))
    results = []
    with tempfile.TemporaryDirectory(dir=ROOT / "target") as folder:
        folder = Path(folder)
        (folder / "design.v").write_text(DESIGN)
        (folder / "top.lpf").write_text('FREQUENCY PORT "clk" 50 MHz;\nIOBUF PORT "q" IO_TYPE=LVCMOS33 DRIVE=16 PULLMODE=UP;\n')
        tools.run("yosys", ["-q", "-p", "read_verilog design.v; synth_ecp5 -top top -json top.json"], folder, "yosys.log")
        tools.run("nextpnr-ecp5", ["--json", "top.json", "--lpf", "top.lpf", "--lpf-allow-unconstrained", "--textcfg", "theirs.config",
                                   "--seed", "1", *ecp5.PLACER.split(), "--25k", "--package", "CABGA256", "--speed", "6"], folder, "theirs.log")
        for name in ("2", "1"):
            report = build.place(board, folder, 1, "--lpf-allow-unconstrained", name=name)
            results.append((json.dumps(report["fmax"], sort_keys=True), (folder / f"top{name}.config").read_text()))
        assert results[0] == results[1], "routed twice, not the same"
        theirs, ours = (sorted(re.findall(r"^enum: PIO.*", config, re.M)) for config in ((folder / "theirs.config").read_text(), results[0][1]))
        assert ours == theirs and any("LVCMOS33" in line for line in ours), "a pin is of another kind than without our router"
        (clock,) = report["fmax"].values()
        assert abs(clock["constraint"] - 50) < 0.1, clock
        said = (folder / "routing1.log").read_text()
        reached = float(re.findall(r"([\d.]+) MHz$", said, re.M)[-1])
        assert abs(reached / clock["achieved"] - 1) < 0.02, f"the router says {reached} MHz, nextpnr {clock['achieved']}"
        (left,) = re.findall(r"Routing (\d+) arcs", (folder / "nextpnr1.log").read_text())
        assert int(left) <= 2, f"nextpnr had {left} pins left to route"
    print(f"PASS router: routes and clock ({reached} MHz) as nextpnr sees them, twice the same")


if __name__ == "__main__":
    main()
