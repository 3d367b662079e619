"""Removes parts of a netlist that yosys leaves in it and that cost cells in nextpnr: around a carry
chain, three things.

    one half of a CCU2C                         with the LUT4 F and, of A and B alone, the LUT2 G in it:
                                                S = F ^ CIN, COUT = F ? CIN : G

* A carry that is not read. nextpnr treats it like any net, and adds a cell to lead it out of the
  chain.
* A first carry that is constant. nextpnr adds a cell to lead it in. But the first half can make its
  own: with F = 0 its COUT is G, which is all that bit 0 passes on, whatever CIN is. Its sum becomes
  a LUT, if it is read.
* A LUT in front of a chain, if all its readers have room for its inputs: it goes into F, and into G
  if its pins are A and B; and into the LUTs.

That is 4 % of the LUT places of the largest board (decision 10). Every half and every LUT is
compared with what it was, for every level of its inputs; a netlist that cannot be understood is an
error.
"""

import collections
import itertools
import json

_PINS = "ABCD"
_CONSTANT = ("0", "1")
COUNTED = {"lut4": "LUT4", "ff": "TRELLIS_FF", "ebr": "DP16KD", "dsp": "MULT18X18D", "ccu2c": "CCU2C", "lutram": "TRELLIS_DPR16X4"}


def trim(path):
    """Rewrites the netlist in `path`. Returns its cell counts."""
    design = json.loads(path.read_text())
    (module,) = (m for m in design["modules"].values() if int(m["attributes"].get("top", "0"), 2))
    _trim(module)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(design))
    part.replace(path)
    return _count(module)


def _count(module):
    types = collections.Counter(cell["type"] for cell in module["cells"].values())
    return {key: types[cell] for key, cell in COUNTED.items()}


def _trim(module):
    cells = module["cells"]
    outside = {bit for port in module["ports"].values() if port["direction"] != "input" for bit in port["bits"]}
    readers, drivers = collections.defaultdict(set), {}  # bit: {(cell, pin)}; bit: cell
    for name, cell in cells.items():
        if cell["type"] == "$scopeinfo":
            continue
        for pin, bits in cell["connections"].items():
            for bit in bits:
                if cell["port_directions"][pin] == "output":
                    drivers[bit] = name
                else:
                    readers[bit].add((name, pin))
    chains = [name for name, cell in cells.items() if cell["type"] == "CCU2C"]
    for name in chains:
        wires = cells[name]["connections"]
        if not readers[wires["COUT"][0]] and wires["COUT"][0] not in outside:
            wires["COUT"] = ["x"]
        if wires["CIN"][0] in _CONSTANT:
            _begin(cells, name, readers, outside)
    for name in chains:
        for pin in ("A0", "B0", "C0", "D0", "A1", "B1", "C1", "D1"):
            bit = cells[name]["connections"][pin][0]
            while bit not in outside and _swallow(cells, bit, readers, drivers):
                bit = cells[name]["connections"][pin][0]


class _Half:
    """The functions F and G of one half of a CCU2C, of those of its pins that are not constant."""

    def __init__(self, cell, half):
        bits = [cell["connections"][pin + half][0] for pin in _PINS]
        # a pin of a chain that is not connected is high
        self.bits = ["1" if bit == "x" else bit for bit in bits]
        self.init = int(cell["parameters"][f"INIT{half}"], 2)
        if cell["parameters"][f"INJECT1_{half}"] != "NO":
            raise ValueError("a carry cell that is not one of an adder")

    def inputs(self):
        return [bit for bit in dict.fromkeys(self.bits) if bit not in _CONSTANT]

    def f(self, level):
        return self.init >> sum(level(bit) << n for n, bit in enumerate(self.bits)) & 1

    def g(self, level):
        return self.init >> sum(level(bit) << n for n, bit in enumerate(self.bits[:2])) & 1


def _levels(bits):
    """Every set of levels these bits can have, each as a function of a bit."""
    for values in itertools.product((0, 1), repeat=len(bits)):
        known = dict(zip(bits, values), **{"0": 0, "1": 1})
        yield known.__getitem__


def _carry(f, g, carry):
    return carry if f else g


def _lut(init, pins, level):
    return init >> sum(level(bit) << n for n, bit in enumerate(pins)) & 1


def _begin(cells, name, readers, outside):
    """The first half generates its carry itself, if that takes no more than two inputs."""
    cell = cells[name]
    old, wires = _Half(cell, "0"), cell["connections"]
    first, inputs = int(wires["CIN"][0]), old.inputs()
    if len(inputs) > 2:
        return
    pins = (inputs + ["1", "1"])[:2] + ["1", "1"]
    init = 0
    for level in _levels(inputs):
        made = _carry(old.f(level), old.g(level), first)
        for n, other in enumerate(itertools.product((0, 1), repeat=2)):
            if all(bit == "1" or level(bit) == value for bit, value in zip(pins, other[::-1])):
                init |= made << n
    sum_, wires["CIN"] = wires["S0"][0], ["x"]
    cell["parameters"]["INIT0"] = f"{init:016b}"
    _connect(cells, name, "0", pins, readers)
    new = _Half(cell, "0")
    for level in _levels(inputs):
        assert new.f(level) == 0 and new.g(level) == _carry(old.f(level), old.g(level), first)
    if not readers[sum_] and sum_ not in outside:
        return
    wires["S0"] = ["x"]
    pins = (inputs + ["0"] * 4)[:4]
    init = sum((old.f(level) ^ first) << n for n, level in enumerate(_levels(pins[::-1])) if not any(n >> k & 1 for k in range(len(inputs), 4)))
    for level in _levels(inputs):
        assert _lut(init, pins, level) == old.f(level) ^ first
    lut = f"{name}_S0"
    for pin, bit in zip(_PINS, pins):
        readers[bit].add((lut, pin))
    cells[lut] = {
        "hide_name": 0, "type": "LUT4", "parameters": {"INIT": f"{init:016b}"}, "attributes": {},
        "port_directions": dict.fromkeys(_PINS, "input") | {"Z": "output"},
        "connections": {pin: [bit] for pin, bit in zip(_PINS, pins)} | {"Z": [sum_]}}


def _swallow(cells, bit, readers, drivers):
    """Moves the LUT that drives `bit` into all its readers, if they all have room. Returns whether
    it did."""
    name = drivers.get(bit)
    lut = cells.get(name)
    if lut is None or lut["type"] != "LUT4" or not readers[bit]:
        return False
    behind = [lut["connections"][pin][0] for pin in _PINS]
    function = int(lut["parameters"]["INIT"], 2)
    if "x" in behind:
        return False

    def through(level):
        made = _lut(function, behind, level)
        return lambda other: made if other == bit else level(other)

    taken = {}  # (cell, half or "" for a LUT): pins, INIT
    for reader, pin in sorted(readers[bit]):
        kind = cells[reader]["type"]
        half = pin[1:] if kind == "CCU2C" else ""
        if kind not in ("CCU2C", "LUT4") or pin == "CIN":
            return False
        if (reader, half) not in taken:
            pins, init = (_into_half if half else _into_lut)(cells[reader], half, bit, behind, through)
            if init is None:
                return False
            taken[reader, half] = pins, init
    for (reader, half), (pins, init) in taken.items():
        _connect(cells, reader, half, pins, readers)
        cells[reader]["parameters"][f"INIT{half}"] = f"{init:016b}"
    for pin, other in zip(_PINS, behind):
        readers[other].discard((name, pin))
    assert not readers[bit]
    del cells[drivers.pop(bit)]
    return True


def _merged(bits, bit, behind):
    return list(dict.fromkeys(b for b in (*behind, *bits) if b not in _CONSTANT and b != bit))


def _into_half(cell, half, bit, behind, through):
    old = _Half(cell, half)
    inputs = _merged(old.bits, bit, behind)
    if len(inputs) > 3:
        return None, None
    for order in itertools.permutations(inputs):
        # D stays high: where C and D are low, F and G are the same bits
        pins = (list(order) + ["1"] * 3)[:3] + ["1"]
        init = _combined(old, inputs, pins, through)
        if init is None:
            continue
        wires = {f"{pin}{half}": [b] for pin, b in zip(_PINS, pins)}
        new = _Half({"connections": wires, "parameters": {f"INIT{half}": f"{init:016b}", f"INJECT1_{half}": "NO"}}, half)
        for level in _levels(inputs):
            before = through(level)
            for carry in (0, 1):
                assert new.f(level) == old.f(before)
                assert _carry(new.f(level), new.g(level), carry) == _carry(old.f(before), old.g(before), carry)
        return pins, init
    return None, None


def _into_lut(cell, _, bit, behind, through):
    old = [cell["connections"][pin][0] for pin in _PINS]
    inputs = _merged(old, bit, behind)
    if len(inputs) > 4 or "x" in old:
        return None, None
    pins, function = (inputs + ["0"] * 4)[:4], int(cell["parameters"]["INIT"], 2)
    init = 0
    for level in _levels(inputs):
        init |= _lut(function, old, through(level)) << sum(level(b) << n for n, b in enumerate(pins))
    for level in _levels(inputs):
        assert _lut(init, pins, level) == _lut(function, old, through(level))
    return pins, init


def _combined(old, inputs, pins, through):
    """The INIT of a half with these pins that does what `old` does after the LUT, or None: G has
    only pins A and B, and matters only where F is 0."""
    init, known = 0, {}
    for level in _levels(inputs):
        before, place = through(level), sum(level(bit) << n for n, bit in enumerate(pins))
        f, g = old.f(before), old.g(before)
        init |= f << place
        if not f and known.setdefault(place & 3, g) != g:
            return None
    return init | sum(g << n for n, g in known.items())


def _connect(cells, name, half, pins, readers):
    wires = cells[name]["connections"]
    for pin in _PINS[: len(pins)]:
        readers[wires[pin + half][0]].discard((name, pin + half))
    for pin, bit in zip(_PINS, pins):
        readers[bit].add((name, pin + half))
        wires[pin + half] = [bit]
