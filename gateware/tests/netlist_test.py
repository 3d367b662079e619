"""`netlist.trim` changes no output of a netlist: random chains before and after, for random
inputs."""

import copy
import itertools
import json
import random
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc import netlist  # noqa: E402

ADDER = 0b1001_0110_1010_1010  # yosys maps every $alu to this


def cell(kind, parameters, inputs, outputs):
    return {"hide_name": 0, "type": kind, "parameters": parameters, "attributes": {},
            "port_directions": {**dict.fromkeys(inputs, "input"), **dict.fromkeys(outputs, "output")},
            "connections": {pin: [bit] for pin, bit in {**inputs, **outputs}.items()}}


def chain(r):
    """An adder, subtracter, comparison or counter of a few cells as yosys leaves it, some inputs
    behind LUTs, some outputs unread."""
    inputs, cells, bits = list(range(2, 2 + r.randint(1, 10))), {}, itertools.count(100)
    first = r.choice(["0", "1", *inputs[:1]])
    inverted = r.choice(["0", "1", first])
    carry, read = first, []
    shared = r.choice(inputs)

    def operand():
        kind = r.random()
        if kind < 0.2:
            return r.choice("01")
        if kind < 0.5:
            return r.choice(inputs)
        pins = [r.choice([*inputs, "0", "1"]), shared, r.choice([*inputs, "0", "0"]), "0"]
        r.shuffle(pins)
        out = next(bits)
        cells[f"lut{out}"] = cell("LUT4", {"INIT": f"{r.getrandbits(16):016b}"}, dict(zip("ABCD", pins)), {"Z": out})
        if r.random() < 0.2:
            read.append(out)  # a LUT with another reader stays
        return out

    for n in range(r.randint(1, 4)):
        outs = {"S0": next(bits), "S1": next(bits), "COUT": next(bits)}
        pins = {"CIN": carry} | {f"{pin}{half}": bit for half in "01" for pin, bit in zip("ABCD", (operand(), operand(), inverted, "1"))}
        cells[f"c{n}"] = cell("CCU2C", {"INIT0": f"{ADDER:016b}", "INIT1": f"{ADDER:016b}", "INJECT1_0": "NO", "INJECT1_1": "NO"}, pins, outs)
        carry = outs["COUT"]
        read += [bit for pin, bit in outs.items() if pin != "COUT" and r.random() < 0.8]
    read += [carry] if r.random() < 0.5 else []
    return {"modules": {"top": {"attributes": {"top": "1"}, "cells": cells, "netnames": {}, "ports": {
        "i": {"direction": "input", "bits": inputs}, "o": {"direction": "output", "bits": read}}}}}


def outputs(module, levels, floating):
    """Levels of the outputs for these of the inputs; an unconnected input has the level
    `floating`."""
    known, waiting = {**levels, "0": 0, "1": 1, "x": floating}, list(module["cells"].values())
    while waiting:
        for c in list(waiting):
            at = {pin: known.get(bit) for pin, (bit,) in c["connections"].items() if c["port_directions"][pin] == "input"}
            if None in at.values():
                continue
            waiting.remove(c)
            if c["type"] == "LUT4":
                known[c["connections"]["Z"][0]] = int(c["parameters"]["INIT"], 2) >> sum(at[pin] << n for n, pin in enumerate("ABCD")) & 1
                continue
            carry = at["CIN"]
            for half in "01":
                init = int(c["parameters"][f"INIT{half}"], 2)
                f = init >> sum(at[pin + half] << n for n, pin in enumerate("ABCD")) & 1
                g = init >> sum(at[pin + half] << n for n, pin in enumerate("AB")) & 1
                if c["connections"][f"S{half}"][0] != "x":
                    known[c["connections"][f"S{half}"][0]] = f ^ carry
                carry = carry if f else g
            if c["connections"]["COUT"][0] != "x":
                known[c["connections"]["COUT"][0]] = carry
    return [known[bit] for bit in module["ports"]["o"]["bits"]]


def main():
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    r, did = random.Random(seed), dict.fromkeys(("carries", "firsts", "luts"), 0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "top.json"
        for case in range(400):
            before = chain(r)
            path.write_text(json.dumps(before))
            netlist.trim(path)
            old, new = (copy.deepcopy(d["modules"]["top"]) for d in (before, json.loads(path.read_text())))
            for _ in range(40):
                levels = {bit: r.getrandbits(1) for bit in old["ports"]["i"]["bits"]}
                wanted = outputs(old, levels, 0)
                for floating in (0, 1):
                    assert outputs(new, levels, floating) == wanted, f"netlist: seed {seed}, case {case}, inputs {levels}"
            for name, c in old["cells"].items():
                now = new["cells"].get(name)
                did["luts"] += now is None
                if c["type"] == "CCU2C":
                    did["carries"] += now["connections"]["COUT"] == ["x"]
                    did["firsts"] += now["connections"]["CIN"] == ["x"]
    assert min(did.values()) > 100, did
    print(f"PASS netlist: 400 random chains, seed {seed}, the same outputs without {did['carries']} loose carries, {did['firsts']} constant ones and {did['luts']} LUTs")


if __name__ == "__main__":
    main()
