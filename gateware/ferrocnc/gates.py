"""nextpnr's netlist of a board, as Verilog that Verilator simulates in the place of the RTL
(docs/netlist.md).

In: the routed design as nextpnr writes it (`routedSEED.json`), and the elaboration beside it. Out:
`gates.v`, a module `sim` with the ports of `sim.py`'s, and a manifest, so that
`sim/verilator/build.sh` makes a library of it that the simulator loads as it loads any board. A
cell that is not known here, or a setting of one, is an error.

    cell           modelled as
    TRELLIS_COMB   its function of A to D, its half of a carry chain, its wide multiplexer, or 16 bits of LUT RAM
    TRELLIS_FF     a flip-flop with its power-up level, enable, and reset with or without a clock
    DP16KD         a memory with two ports, see `_Memory`
    MULT18X18D     a product without registers
    IOLOGIC        a DDR pin: both levels of a clock at once, as the RTL's simulation has its bytes
    TRELLIS_IO     a pad; DCCA, EHXPLLL and USRMCLK: wires; the PLL has locked when `sys_rst` falls

What the RTL does not define is random here, from a seed that the encoders' pins carry while
`sys_rst` is high:

* the contents of LUT RAM and block RAM at power-up, except those of ROMs;
* the word a port of a block RAM reads while the other port writes there. Each such clock is
  counted, in `collided`;
* the word that is stored where both ports write; counted as well;
* the output of LUT RAM that the Ethernet clock writes, until that clock's next edge.

To make a test fail on purpose, `step_index` selects the memory, counted from 1, that inverts a bit
it reads.
"""

import json
import re
from pathlib import Path

from . import image, regmap as rm, sim, soc as ferro
from .tools import ToolError

_WIDTHS = (1, 2, 4, 9, 18, 36)
_FLOATING = "1'b1"  # an input that is not connected is high


class GatesError(ToolError):
    """A netlist that is not understood; the text is the message."""


def write(board, work, routed, out):
    """Writes gates.v and manifest.json into `out`, from `work / routed`. Returns a summary for the
    user."""
    out = Path(out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    gates = Gates(board, json.loads((work / routed).read_text()), _undefined(work / "top.json"), (work / "board.bin").read_bytes())
    (out / "gates.v").write_text(gates.verilog())
    manifest = {
        "top": "sim", "board": board.name, "verilog": [str(out / "gates.v"), str(sim.COPPER)], "rom_signals": ["rom"], "ram_signals": ["collided"],
        "rom_words": rm.ROM[1] // 4, "sys_clk_hz": board.sys_clk_hz, "eth_clk_hz": 125_000_000, "ports": dict(sim.PORTS),
        "memories": [memory.name for memory in gates.memories],
    }
    (out / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    return gates.found


def _undefined(path):
    """Names of the LUT RAMs with contents that the RTL does not define. yosys knows them, nextpnr
    fills them with 0."""
    (module,) = (m for m in json.loads(path.read_text())["modules"].values() if int(m["attributes"].get("top", "0"), 2))
    return {name for name, cell in module["cells"].items() if cell["type"] == "TRELLIS_DPR16X4" and "x" in cell["parameters"]["INITVAL"]}


def lut(init, pins):
    """A function of up to four pins as an expression: constants and inputs that do not matter are
    left out."""
    table, names = [init >> n & 1 for n in range(1 << len(pins))], list(pins)
    for n in range(len(names) - 1, -1, -1):  # constant pins
        if names[n] in ("1'b0", "1'b1"):
            level = int(names[n][-1])
            table = [table[_with(k, n, level)] for k in range(len(table) // 2)]
            del names[n]
    return _function(tuple(table), tuple(names))


def _with(k, n, level):
    return (k >> n << n + 1) | level << n | k & (1 << n) - 1


def _function(table, names):
    if not any(table):
        return "1'b0"
    if all(table):
        return "1'b1"
    low, high, name = table[:len(table) // 2], table[len(table) // 2:], names[-1]
    if low == high:
        return _function(low, names[:-1])
    if all(a != b for a, b in zip(low, high)):
        other = _function(low, names[:-1])
        return name if other == "1'b0" else f"~{name}" if other == "1'b1" else f"({name} ^ {other})"
    zero, one = _function(low, names[:-1]), _function(high, names[:-1])
    if zero == "1'b0":
        return name if one == "1'b1" else f"({name} & {one})"
    if one == "1'b0":
        return f"(~{name} & {zero})"
    if zero == "1'b1":
        return f"(~{name} | {one})"
    if one == "1'b1":
        return f"({name} | {zero})"
    return f"({name} ? {one} : {zero})"


def _bits(text):
    """A parameter as nextpnr writes numbers."""
    return int(text.strip().replace("x", "0") or "0", 2)


class Gates:
    """The conversion of a routed design to Verilog."""

    def __init__(self, board, design, undefined, blob):
        self.board, self.undefined, self.blob = board, undefined, blob
        (module,) = design["modules"].values()
        self.cells = {name: cell for name, cell in module["cells"].items() if cell["type"] != "$scopeinfo"}
        # nextpnr keeps no ports of a netlist that it did not pack itself: a pad is the net at its
        # cell.
        names = {bit: name for name, found in module["netnames"].items() for bit in found["bits"]}
        pads = (cell["connections"]["B"][0] for cell in self.cells.values() if cell["type"] == "TRELLIS_IO")
        self.ports = {f"n{bit}": names[bit] for bit in pads}
        self.declared, self.assigned, self.clocked = [], [], {}
        self.memories, self.found = [], {}
        self.alias, self.rom_columns, self.rom_bits = {}, None, 0
        self.pads = {}  # port bit: what drives it from inside
        for name, cell in self.cells.items():
            self.found[cell["type"]] = self.found.get(cell["type"], 0) + 1
            self._clock_wire(name, cell)
        for name, cell in self.cells.items():
            kind = getattr(self, "_" + cell["type"].lower(), None)
            if kind is None:
                raise GatesError(f"{name}: a {cell['type']}, which has no model")
            kind(name, cell)

    # Nets

    def _clock_wire(self, name, cell):
        """A clock is one net from pad to pin, otherwise Verilator finds clocks derived from
        clocks."""
        pin = {"DCCA": ("CLKO", "CLKI"), "EHXPLLL": ("CLKOP", None)}.get(cell["type"])
        if pin:
            self.alias[f"n{cell['connections'][pin[0]][0]}"] = "sys_clk" if pin[1] is None else f"n{cell['connections'][pin[1]][0]}"
        if cell["type"] == "TRELLIS_IO" and self.ports[f"n{cell['connections']['B'][0]}"] == "eth_clocks0_rx":
            self.alias[f"n{cell['connections']['O'][0]}"] = "eth_clk"

    def net(self, cell, pin):
        """The signal at an input pin, its multiplexer included."""
        mux = cell["parameters"].get(f"{pin}MUX", pin).strip()
        bits = cell["connections"].get(pin, [])
        if mux in ("0", "1"):
            return f"1'b{mux}"
        level = self._named(f"n{bits[0]}") if bits else _FLOATING
        if mux == "INV":
            return {"1'b1": "1'b0", "1'b0": "1'b1"}.get(level, f"~{level}")
        if mux != pin:
            raise GatesError(f"a {cell['type']} with {pin}MUX {mux}")
        return level

    def _named(self, net):
        while net in self.alias:
            net = self.alias[net]
        return net

    def _drives(self, cell, pin, value=None):
        """The wire at an output pin, or None if it leads nowhere."""
        bits = cell["connections"].get(pin, [])
        if not bits:
            return None
        wire = f"n{bits[0]}"
        if value is not None:
            self.declared.append(f"wire {wire};")
            self.assigned.append(f"assign {wire} = {value};")
        return wire

    def _at(self, clock, text):
        self.clocked.setdefault(clock, []).append(text)

    # Cells

    def _trellis_comb(self, name, cell):
        at, mode, init = cell["parameters"], cell["parameters"].get("MODE", "LOGIC"), _bits(cell["parameters"].get("INITVAL", "0"))
        a, b, c, d = (self.net(cell, pin) for pin in "ABCD")
        if mode == "RAMW_BLOCK":
            return
        function = lut(init, (a, b, c, d))
        if mode == "DPRAM":
            function = self._lut_ram(name, cell, init, f"{{{a}, {c}, {b}, {d}}}")
        elif mode == "CCU2":
            inject = at["CCU2_INJECT1"].strip() == "YES"
            carry = self.net(cell, "FCI") if cell["connections"].get("FCI") else "1'b0"
            other = "1'b0" if inject else lut(init & 15, (a, b))
            self._drives(cell, "FCO", f"{function} ? {carry} : {other}")
            function = function if inject else f"{function} ^ {carry}"
        elif mode != "LOGIC":
            raise GatesError(f"{name}: a TRELLIS_COMB in mode {mode}")
        own = self._drives(cell, "F", function)
        if cell["connections"].get("OFX"):
            upper = re.search(r"\.K([01])$", cell["attributes"]["NEXTPNR_BEL"])[1] == "1"
            one, zero = ("FXB", "FXA") if upper else ("F1", None)
            low = self.net(cell, zero) if zero else own or f"({function})"
            self._drives(cell, "OFX", f"{self.net(cell, 'M')} ? {self.net(cell, one)} : {low}")

    def _lut_ram(self, name, cell, init, address):
        if init:
            raise GatesError(f"{name}: LUT RAM with contents: their order is not modelled")
        ram = f"lutram{len(self.declared)}"
        self.declared.append(f"reg [15:0] {ram};  // {name}")
        where = ", ".join(self.net(cell, f"WAD{n}") for n in (3, 2, 1, 0))
        first = f"noise({len(self.declared)}) >> 16" if name.partition("$")[0] in self.undefined else "16'd0"
        clock, writes, bit = self.net(cell, "WCK"), self.net(cell, "WRE"), self.net(cell, "WD")
        if clock == "sys_clk":
            self._at(clock, f"if (loading) {ram} <= {first}; else if ({writes}) {ram}[{{{where}}}] <= {bit};")
        else:  # read in the core's clock: noise until the writer's next edge
            self.declared.append(f"reg [31:0] {ram}_noise; reg [3:0] {ram}_at; reg {ram}_new = 1'b0, {ram}_bit = 1'b0;")
            self._at(clock, f"{ram}_noise <= loading ? noise({len(self.declared)}) : draw({ram}_noise); "
                            f"{ram}_new <= {writes}; {ram}_at <= {{{where}}}; {ram}_bit <= {bit}; if (loading) {ram} <= {first}; "
                            f"else begin if ({ram}_new) {ram}[{ram}_at] <= {ram}_bit; if ({writes}) {ram}[{{{where}}}] <= {ram}_noise[9]; end")
        return f"{ram}[{address}]"

    def _trellis_ramw(self, _, cell):
        for n, pin in enumerate(("D0", "B0", "C0", "A0")):
            self._drives(cell, f"WADO{n}", self.net(cell, pin))
        for n, pin in enumerate(("C1", "A1", "D1", "B1")):
            self._drives(cell, f"WDO{n}", self.net(cell, pin))

    def _trellis_ff(self, name, cell):
        at = {key: value.strip() for key, value in cell["parameters"].items()}
        q = self._drives(cell, "Q")
        if q is None:
            return
        if at.get("LSRMODE", "LSR") != "LSR" or at.get("SRMODE", "LSR_OVER_CE") not in ("LSR_OVER_CE", "ASYNC"):
            raise GatesError(f"{name}: a flip-flop with reset {at}")
        level = "1'b1" if at["REGSET"] == "SET" else "1'b0"
        d = self.net(cell, "M" if at["SD"] == "0" else "DI")
        enable = self.net(cell, "CE")
        reset = self.net(cell, "LSR") if cell["connections"].get("LSR") else "1'b0"
        clock = self.net(cell, "CLK")
        self.declared.append(f"reg {q} = {level};")
        take = f"{q} <= {d};" if enable == "1'b1" else f"if ({enable}) {q} <= {d};"
        if reset == "1'b0":
            self._at(clock, take)
        elif at.get("SRMODE") == "ASYNC":
            self._at(f"{clock} or posedge {reset}", f"if ({reset}) {q} <= {level}; else {take}")
        else:
            self._at(clock, f"if ({reset}) {q} <= {level}; else {take}")

    def _dp16kd(self, name, cell):
        memory = _Memory(self, name, cell, len(self.memories))
        self.memories.append(memory)

    def _mult18x18d(self, name, cell):
        registers = {key: value for key, value in cell["parameters"].items()
                     if re.fullmatch(r"REG_(INPUT|PIPELINE|OUTPUT)\w*_CLK", key) and value.strip() != "NONE"}
        if registers:
            raise GatesError(f"{name}: a multiplier with registers, {registers}")
        factors = []
        for port in "AB":
            bits = [self.net(cell, f"{port}{n}") for n in range(17, -1, -1)]
            sign = f"({self.net(cell, 'SIGNED' + port)} & {bits[0]})"
            factors.append(f"$signed({{{{19{{{sign}}}}}, {', '.join(bits)}}})")
        if self.net(cell, "SOURCEA") + self.net(cell, "SOURCEB") not in ("1'b01'b0", self._ground() * 2):
            raise GatesError(f"{name}: a multiplier with factors from its neighbour")
        product = f"product{len(self.declared)}"
        self.declared.append(f"wire [36:0] {product};")
        self.assigned.append(f"assign {product} = {factors[0]} * {factors[1]};")
        for n in range(36):
            self._drives(cell, f"P{n}", f"{product}[{n}]")

    def _ground(self):
        return f"n{self.cells['$PACKER_GND']['connections']['F'][0]}"

    def _dcca(self, name, cell):
        if cell["connections"].get("CE"):
            raise GatesError(f"{name}: a clock that is switched")

    def _ehxplll(self, _, cell):
        self._drives(cell, "LOCK", "~sys_rst")

    def _usrmclk(self, name, cell):
        if self.net(cell, "PADDT") not in ("1'b0", self._ground()):
            raise GatesError(f"{name}: the flash's clock is not always driven")
        self.pads["spi_clk"] = self.net(cell, "PADDO")

    def _iologic(self, name, cell):
        at = {key: value.strip() for key, value in cell["parameters"].items()}
        if at["MODE"] != "IDDRX1_ODDRX1":
            raise GatesError(f"{name}: an IOLOGIC in mode {at['MODE']}")
        clock = self.net(cell, "CLK")
        if out := self._drives(cell, "IOLDO"):
            pair = [f"{out}_{edge}" for edge in ("rise", "fall")]
            self.declared.append(f"reg {pair[0]} = 1'b0, {pair[1]} = 1'b0;")
            for n, level in enumerate(pair):
                self._at(clock, f"{level} <= {self.net(cell, f'TXDATA{n}')};")
            return
        pad = self.net(cell, "PADDI")
        for n, edge in enumerate(("rise", "fall")):
            if q := self._drives(cell, f"RXDATA{n}"):
                self.declared.append(f"reg {q} = 1'b0;")
                self._at(clock, f"{q} <= {pad}_{edge};")

    def _trellis_io(self, _, cell):
        at = {key: value.strip() for key, value in cell["parameters"].items()}
        outside = self.ports[f"n{cell['connections']['B'][0]}"]
        if at["DIR"] != "INPUT":
            mux = at.get("DATAMUX_ODDR", "PADDO")
            self.pads[outside] = f"n{cell['connections']['IOLDO'][0]}" if mux == "IOLDO" else self.net(cell, "I")
        inside = self._drives(cell, "O")
        if inside and self._named(inside) == inside:
            data = re.fullmatch(r"eth0_rx_data\[(\d)\]", outside)
            if data or outside == "eth0_rx_ctl":
                for edge in ("rise", "fall"):
                    self.declared.append(f"wire {inside}_{edge} = rx_{edge}[{data[1] if data else 4}];")
            else:
                self.declared.append(f"wire {inside} = {self._from_pad(outside)};")

    def _from_pad(self, pad):
        """The simulated board's signal at this pad."""
        if found := re.fullmatch(r"gpio_in_pin(\d+)", pad):
            return f"gpio_in[{found[1]}]"
        for pattern, first, count in _COPPER:
            for n in range(count):
                if pad == pattern.format(n):
                    return f"copper_level[{first + n}]"
        known = {
            "flash_miso": "spi_miso", "clk": "1'b0", "eth0_mdio": "1'b0", "phy_reset": "1'b1",
            "ext_reset": f"ext_reset ^ 1'b{int(self.board.ext_reset_active_low)}",
            "factory": f"factory ^ 1'b{int(getattr(self.board, 'factory_active_low', False))}",
        }
        if pad not in known:
            raise GatesError(f"an input {pad}, which the simulated board does not have")
        return known[pad]

    # ROMs

    def columns(self, memory):
        """{(width of the port, column of 512 bits): (block of 512 words, bit)} of a memory that is
        part of a ROM. The random words in a routed design identify the ROM."""
        if self.rom_columns is None:
            pattern = [word for words in ferro.place_words() for word in words]
            self.rom_columns = {
                sum((word >> bit & 1) << row for row, word in enumerate(pattern[512 * block:512 * block + 512])): (block, bit)
                for block in range(len(pattern) // 512) for bit in range(32)}
        found = {place: self.rom_columns[column] for place, column in image.columns(memory.init) if column in self.rom_columns}
        self.rom_bits += len(found)
        return found

    def word(self, block):
        """Word `i` of a block of 512 of them."""
        blocks = rm.ROM[1] // 4 // 512
        return f"rom[{512 * block} + i]" if block < blocks else f"board_rom[{512 * (block - blocks)} + i]"

    def _board_rom(self):
        words = ferro.board_words(self.blob)
        return [f"reg [31:0] board_rom[0:{len(words) - 1}];", "initial begin",
                *(f"    board_rom[{n}] = 32'h{word:08x};" for n, word in enumerate(words)), "end"]

    # The whole

    def verilog(self):
        """Writes the module `sim`."""
        widths = {name: f"[{width - 1}:0] " if width > 1 else "" for name, width in sim.PORTS}
        outputs = {"gmii_tx_data", "gmii_tx_en", "step", "dir", "step_n", "dir_n", "pwm_out", "pwm_dir", "gpio_out", "led", "gate", "spi_cs_n", "spi_clk", "spi_mosi",
                   "header_out", "header_drives"}
        ports = ",\n    ".join(f"{'output' if name in outputs else 'input'} wire {widths[name]}{name}" for name, _ in sim.PORTS)
        lines = ["// Written by gateware/ferrocnc/gates.py from a routed design; do not edit.", f"module sim (\n    {ports}\n);"]
        lines += [f"reg [31:0] rom[0:{rm.ROM[1] // 4 - 1}] /*verilator public_flat_rw*/;",
                  f"reg [31:0] collided[0:{max(len(self.memories), 1) - 1}] /*verilator public_flat_rw*/;",
                  "wire [127:0] copper_level;", _NOISE]
        lines += ["wire [4:0] rx_rise = {gmii_rx_dv, gmii_rx_dv ? gmii_rx_data[3:0] : 4'b1101};",
                  "wire [4:0] rx_fall = {gmii_rx_dv, gmii_rx_dv ? gmii_rx_data[7:4] : 4'b1101};"]
        lines += [line for memory in self.memories for line in memory.declared()] + self.declared
        lines += self._board_rom() + self.assigned
        for clock, texts in self.clocked.items():
            for at in range(0, len(texts), 200):
                lines += [f"always @(posedge {clock}) begin", *(f"    {text}" for text in texts[at:at + 200]), "end"]
        for memory in self.memories:
            lines += memory.process()
        missing = (rm.ROM[1] + rm.BOARD_ROM[1]) // 4 // 512 * 32 - self.rom_bits
        if missing:
            raise GatesError(f"{missing} columns of the ROMs are nowhere in the netlist")
        lines += self._outside()
        return "\n".join([*lines, "endmodule", ""])

    def _outside(self):
        """The ports of the simulated board, from the pads."""
        def gathered(pattern, count):
            return "{" + ", ".join(self.pads.get(pattern.format(n), "1'b0") for n in range(count - 1, -1, -1)) + "}"

        tx = [self.pads[f"eth0_tx_data[{n}]"] for n in range(4)]
        yield f"assign gmii_tx_en = {self.pads['eth0_tx_ctl']}_rise;"
        yield f"assign gmii_tx_data = {{{', '.join(f'{tx[n]}_{edge}' for edge in ('fall', 'rise') for n in (3, 2, 1, 0))}}};"
        driven = ", ".join(gathered(pattern, count)[1:-1] for pattern, _, count in reversed(_COPPER))
        yield f"copper copper(.driven({{{driven}}}), .fault(pad_fault), .at(pad_at), .to(pad_to), .level(copper_level));"
        for (port, _), (_, first, count) in zip(sim.DRIVEN, _COPPER):
            yield f"assign {port} = copper_level[{first + count - 1}:{first}];"
        yield f"assign led = {self.pads['led']} ^ 1'b{int(self.board.platform.led_active_low)};"
        yield f"assign spi_cs_n = {self.pads['flash_cs']};"
        yield f"assign spi_mosi = {self.pads['flash_mosi']};"
        yield f"assign spi_clk = {self.pads['spi_clk']};"
        yield "assign gate = 1'b0;  // no pad"
        yield "assign {header_out, header_drives} = 128'b0;  // only an image has them"


# Names of the driven pads, in the order of `sim.DRIVEN`: the first's number in `copper.sv`, and how
# many there can be.
_COPPER = tuple((pattern, 16 * n, 32 if n == 6 else 16) for n, pattern in enumerate((
    "stepgen_step{}", "stepgen_dir{}", "stepgen_step_n{}", "stepgen_dir_n{}", "pwm_pin{}", "pwm_dir{}", "gpio_out_pin{}")))

# Xorshift; four clocks of the core, so that whatever has another clock has one in them.
_NOISE = """function [31:0] draw(input [31:0] last);
    reg [31:0] x;
    begin
        x = last ^ last << 13; x = x ^ x >> 17; draw = x ^ x << 5;
    end
endfunction
function [31:0] noise(input integer stream);
    noise = draw(draw(draw({enc_b, enc_a} * 32'd2654435761 + stream * 32'd40503 + 32'd1)));
endfunction
reg [2:0] clocks = 3'd0;
reg [15:0] wrong = 16'd0;
wire loading = ~clocks[2];
always @(posedge sys_clk) if (loading) begin clocks <= clocks + 3'd1; wrong <= step_index; end"""


class _Memory:
    """A block RAM: 2048 bytes of nine bits, two ports, each with a width of its own.

    A port of up to 9 bits addresses a byte, or 1, 2 or 4 of its lower eight bits; one of 18 bits
    addresses two bytes and has an enable for each in its two lowest address bits; one of 36 bits
    addresses four. The mode says what a port reads when it writes: NORMAL keeps the last word read,
    WRITETHROUGH gives the new bytes, READBEFOREWRITE the old ones. Lattice does not define for all
    modes what a port reads of a byte that the other port writes in the same clock: it is random
    here, and so is a byte that both ports write.
    """

    def __init__(self, gates, name, cell, number):
        self.gates, self.name, self.cell, self.number, self.own = gates, name, cell, number, f"noise{number}"
        at = {key: value.strip() for key, value in cell["parameters"].items()}
        self.width = {port: _bits(at[f"DATA_WIDTH_{port}"]) for port in "AB"}
        for port in "AB":
            if at.get(f"REGMODE_{port}", "NOREG") != "NOREG" or at[f"CSDECODE_{port}"] != "0b000" or self.width[port] not in _WIDTHS:
                raise GatesError(f"{name}: a block RAM with port {port} like this: {at}")
            if any(gates.net(cell, f"CS{port}{n}") != "1'b0" for n in range(3)):
                raise GatesError(f"{name}: a block RAM that is selected")
        self.mode = {port: at.get(f"WRITEMODE_{port}", "NORMAL") for port in "AB"}
        self.sync = at.get("RESETMODE", "SYNC") == "SYNC"
        clocks = {gates.net(cell, f"CLK{port}") for port in "AB"} - {"1'b1", "1'b0"}
        if len(clocks) != 1:
            raise GatesError(f"{name}: a block RAM with clocks {sorted(clocks)}; its ports' collisions would need a model of time")
        (self.clock,) = clocks
        self.init = [self._byte(at, n) for n in range(2048)]

    @staticmethod
    def _byte(at, n):
        """Byte `n` of the contents: rows of 18 bits, 16 of them in a parameter, 20 bits apart."""
        row = n >> 1
        return _bits(at[f"INITVAL_{row >> 4:02X}"]) >> 20 * (row & 15) + 9 * (n & 1) & 511

    def _writes(self, port):
        gates, cell = self.gates, self.cell
        enabled, write = gates.net(cell, f"CE{port}"), gates.net(cell, f"WE{port}")
        return "1'b0" if "1'b0" in (enabled, write) else f"{enabled} & {write}"

    def _address(self, port, low):
        return "{" + ", ".join(self.gates.net(self.cell, f"AD{port}{n}") for n in range(13, low - 1, -1)) + "}"

    def _lanes(self, port):
        """Bytes of a port: (address of the byte, whether it is written, the byte, its bits in the
        port)."""
        width, net = self.width[port], lambda pin: self.gates.net(self.cell, pin)
        data = [net(f"DI{port}{n}") for n in range(18)]
        if width == 36:
            data = [net(f"DIA{n}") for n in range(18)] + [net(f"DIB{n}") for n in range(18)]
        if width < 9:
            return [(self._address(port, 3), None, data)]
        lanes, low = [], {9: 3, 18: 4, 36: 5}[width]
        for n in range(width // 9):
            base = self._address(port, low)
            address = base if width == 9 else f"{{{base[1:-1]}, {low - 3}'d{n}}}"
            enable = "1'b1" if width == 9 else net(f"AD{port}{n}")
            lanes.append((address, enable, f"{{{', '.join(reversed(data[9 * n:9 * n + 9]))}}}"))
        return lanes

    def _outputs(self, port):
        """The wires of a port's read data, lowest bit first. A read of 36 bits uses the wires of
        both ports."""
        width, pins = self.width[port], [f"DO{port}{n}" for n in range(18)]
        if self.width["B"] == 36:
            pins = [f"DO{half}{n}" for half in "AB" for n in range(18)] if port == "B" else []
        return [(n, pin) for n, pin in enumerate(pins[:width]) if self.cell["connections"].get(pin)]

    def declared(self):
        """Its registers, and the wires at its outputs."""
        m = f"m{self.number}"
        yield f"reg [8:0] {m}[0:2047];  // {self.name}, ports of {self.width['A']} and {self.width['B']}, {self.mode['A']} and {self.mode['B']}"
        yield f"reg [31:0] {self.own};"
        for port in "AB":
            yield f"reg [{max(self.width[port], 9) - 1}:0] {m}_{port};"
            for n, pin in self._outputs(port):
                yield f"wire n{self.cell['connections'][pin][0]} = {m}_{port}[{n}];"

    def process(self):
        """The actions at a clock. One process: in it, reads come before writes."""
        m = f"m{self.number}"
        yield f"always @(posedge {self.clock}) begin : p{self.number}"
        yield f"    reg [10:0] at_A, at_B; reg [8:0] was, now; reg collides; reg [{max(self.width.values()) + 8}:0] read_A, read_B;"
        yield "    collides = 1'b0;"
        for port in "AB":
            yield from self._read(m, port)
        for port in "AB":
            yield from self._write(m, port)
        for port in "AB":
            yield from self._show(m, port)
        yield f"    if (collides) collided[{self.number}] <= collided[{self.number}] + 32'd1;"
        yield "    if (sys_rst) begin"
        yield from self._load(m)
        yield "    end"
        yield "end"

    def _read(self, m, port):
        if not self._outputs(port):
            return
        for n, (address, _, _) in enumerate(self._lanes(port)):
            yield f"    read_{port}[{9 * n} +: 9] = {m}[{address}];"

    def _touched(self, port, address):
        """Whether this port writes the byte at that address."""
        other = []
        if self._writes(port) == "1'b0":
            return "1'b0"
        for at, enable, _ in self._lanes(port):
            other.append(f"({enable or chr(49) + chr(39) + 'b1'} & {at} == {address})")
        return f"({self._writes(port)}) & ({' | '.join(other)})"

    def _write(self, m, port):
        if self._writes(port) == "1'b0":
            return
        width = self.width[port]
        yield f"    if ({self._writes(port)}) begin"
        for address, enable, data in self._lanes(port):
            if width < 9:
                sub = self._address(port, {1: 0, 2: 1, 4: 2}[width])
                select = "{" + sub[1:-1].split(", ", 11)[11] + "}"
                yield f"        {m}[{address}][{select} * {width} +: {width}] = {{{', '.join(reversed(data[:width]))}}};"
            else:
                yield f"        if ({enable}) {m}[{address}] = {data};"
        yield "    end"
        if port == "B" and self._writes("A") != "1'b0":
            for address, enable, _ in self._lanes("B"):
                yield f"    if (({self._writes('B')}) & {enable or _FLOATING} & {self._touched('A', address)}) begin collides = 1'b1; {self.own} = draw({self.own}); {m}[{address}] = {self.own}[8:0]; end"

    def _show(self, m, port):
        """The port's output after this clock."""
        if not self._outputs(port):
            return
        other, width = "BA"["AB".index(port)], self.width[port]
        enable, writes = self.gates.net(self.cell, f"CE{port}"), self._writes(port)
        yield f"    if ({enable}) begin"
        for n, (address, _, _) in enumerate(self._lanes(port)):
            touched = self._touched(other, address)
            if self.mode[port] == "WRITETHROUGH" and writes != "1'b0":
                yield f"        if ({writes}) read_{port}[{9 * n} +: 9] = {m}[{address}];"
            if touched != "1'b0":
                shown = f"~({writes})" if self.mode[port] == "NORMAL" and writes != "1'b0" else "1'b1"
                yield f"        if ({touched} & {shown}) begin collides = 1'b1; {self.own} = draw({self.own}); read_{port}[{9 * n} +: 9] = {self.own}[20:12]; end"
        if width < 9:
            sub = self._address(port, {1: 0, 2: 1, 4: 2}[width])
            select = "{" + sub[1:-1].split(", ", 11)[11] + "}"
            shown = f"{{{9 - width}'d0, read_{port}[{select} * {width} +: {width}]}}"
        else:
            shown = f"read_{port}[{width - 1}:0]"
        keep = f"if (~({writes})) " if self.mode[port] == "NORMAL" and writes != "1'b0" else ""
        yield f"        {keep}{m}_{port} <= {shown} ^ {max(width, 9)}'(wrong == 16'd{self.number + 1});"
        yield "    end"
        reset = self.gates.net(self.cell, f"RST{port}")
        if reset != "1'b0":
            if not self.sync:
                raise GatesError(f"{self.name}: a block RAM with an output that is cleared without a clock")
            yield f"    if ({reset}) {m}_{port} <= 0;"

    def _load(self, m):
        """Contents while reset lasts: the simulator's image, the board's description, otherwise
        noise."""
        yield f"        if (loading) {self.own} = noise({1_000_000 + self.number});"
        columns = self.gates.columns(self)
        if columns:
            yield "        for (integer i = 0; i < 512; i = i + 1) begin"
            for (width, column), (block, bit) in columns.items():
                bits = 8 if width < 9 else 9
                at = f"(i * {width} + {column % width + column // width * 512 * width})"
                yield f"            {m}[{at} / {bits}][{at} % {bits}] = {self.gates.word(block)}[{bit}];"
            yield "        end"
        elif any(self.init):
            for n, byte in enumerate(self.init):
                yield f"        {m}[{n}] = 9'd{byte};"
        else:
            yield f"        if (loading) for (integer i = 0; i < 2048; i = i + 1) begin {self.own} = draw({self.own}); {m}[i] = {self.own}[8:0]; end"
        yield f"        if (loading) begin collided[{self.number}] <= 32'd0; {self.own} = draw({self.own}); {m}_A <= {{{self.own}[4:0], {self.own}}}; {m}_B <= {{{self.own}, {self.own}[8:4]}}; end"
