"""Writes a bench's top: `ports` of it become the pins of a module in one file."""

from pathlib import Path

from litex.gen.fhdl import verilog

from ferrocnc import sim


def write(top, name, folder, **options):
    """Writes `folder / NAME.v`. `options` are those of LiteX's conversion."""
    for port, signal in top.ports.items():
        signal.name_override = port
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    text = verilog.convert(top, set(top.ports.values()), name=name, **options)
    (out / f"{name}.v").write_text(sim._self_contained(text))
