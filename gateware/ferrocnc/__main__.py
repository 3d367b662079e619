"""`python -m ferrocnc`: elaborate, export, bitstream. Errors name the file, the key, the value and
the remedy."""

import argparse
import logging
import sys
from pathlib import Path

from .board import BoardError, BoardFile, PlatformImage, read_board
from .tools import ToolError

ROOT = Path(__file__).resolve().parents[2]


def main(argv=None):
    parser = argparse.ArgumentParser(prog="ferrocnc", description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--verbose", action="store_true", help="show LiteX's messages")
    sub = parser.add_subparsers(dest="command", required=True)

    p = sub.add_parser("elaborate", help="write the Verilog of a board and its companion files")
    p.add_argument("--target", choices=("sim", "board", "cores"), required=True,
                   help="sim: the SoC with plain ports; board: the SoC on its FPGA; cores: cores and banks behind a bare CSR bus")
    which = p.add_mutually_exclusive_group(required=True)
    which.add_argument("--board", help="boards/NAME.toml")
    which.add_argument("--platform", help="the image of boards/platforms/NAME.toml: its pins are configured on the board")
    _channels(p)
    p.add_argument("--out", required=True)
    p.add_argument("--without-pins", action="store_true", help="board: even if it has no pins")
    _network(p)

    p = sub.add_parser("export", help="write pac/soc.svd, wire/src/regmap.rs, memory.x and docs/registers.md")
    p.add_argument("--root", default=str(ROOT), help="the tree to write into (default: this one)")
    p.add_argument("--check-out", metavar="DIR", help="the same as --root DIR: write into a scratch tree to compare with")

    p = sub.add_parser("pac", help="make the PAC's lib.rs from the exported SVD")
    p.add_argument("--svd", default=str(ROOT / "pac" / "soc.svd"))
    p.add_argument("--svd2rust", help="svd2rust 0.37.1 (default: target/tools/bin/svd2rust, then PATH)")
    p.add_argument("--out", default=str(ROOT / "pac" / "src" / "lib.rs"))

    p = sub.add_parser("bitstream", help="synthesise, place, route and pack boards; a missed clock is a failed build")
    which = p.add_mutually_exclusive_group(required=True)
    which.add_argument("--board", nargs="+", help="boards/NAME.toml, several side by side")
    which.add_argument("--platform", nargs="+", help="the images of these platforms")
    _channels(p)
    p.add_argument("--out", required=True, help="the folder for a folder per board")
    p.add_argument("--firmware", help="image to put into the ROM: an ELF file or a flat binary; without it nothing is packed")
    p.add_argument("--first-seed", type=int, default=1, help="nextpnr's first seed")
    p.add_argument("--seeds", type=int, default=6, help="how many seeds to try")
    p.add_argument("--jobs", type=int, help="how many tools at once (default: one per core)")
    p.add_argument("--slack", type=float, default=5.0, help="per cent every clock must have to spare")
    p.add_argument("--firmware-only", action="store_true", help="use the existing routed design, even if the gateware has changed")
    p.add_argument("--without-pins", action="store_true", help="build a board without pins, too, to measure it; it gets no images")
    p.add_argument("--json", help="write the report here")
    p.add_argument("--document", help="write the table into this Markdown file, between the marks of its kind")
    p.add_argument("--prove", action="store_true", help="unpack the built files and compare them with the firmware; pack again and compare")
    _network(p)

    p = sub.add_parser("gates", help="write what nextpnr made of a board as Verilog for the simulator")
    p.add_argument("--board", required=True, help="boards/NAME.toml")
    p.add_argument("--built", required=True, help="the board's folder, written by `bitstream`")
    p.add_argument("--out", required=True)

    p = sub.add_parser("bench", help="synthesise the cores and the named boards and print their sizes")
    p.add_argument("--out", required=True)
    p.add_argument("--json", help="write the report here")
    p.add_argument("--document", help="write the tables as Markdown here")
    p.add_argument("--seed", type=int, help="place and route the boards, too, with this seed")

    sub.add_parser("tools", help="print which FPGA tools will run")

    args = parser.parse_args(argv)
    # LiteX logs to the root logger at INFO, in colours, hundreds of lines.
    logging.disable(logging.NOTSET if args.verbose else logging.WARNING)
    try:
        return {"elaborate": _elaborate, "export": _export, "pac": _pac, "bitstream": _bitstream, "gates": _gates, "bench": _bench, "tools": _tools}[args.command](args)
    except (BoardError, ToolError) as e:
        print(f"error: {e}", file=sys.stderr)
        return 1


def _channels(parser):
    parser.add_argument("--channels", help="of an image: step generators, encoders, PWM generators (default: those of an image that is given out)")


def _network(parser):
    for name in ("ip", "port", "mac"):
        parser.add_argument(f"--{name}", help=f"this {name} instead of the board file's")


def _network_of(args):
    return {name: value for name in ("ip", "port", "mac") if (value := getattr(args, name)) is not None}


def _tools(_args):
    from . import tools
    for line in tools.report():
        print(line)


def _elaborate(args):
    board = _subject(args, args.board, args.platform).read()
    if args.target == "sim":
        from . import sim
        sim.elaborate(board, args.out)
        print(f"{args.out}/sim.v: {board.name}, {board.sys_clk_hz / 1e6:g} MHz")
    elif args.target == "cores":
        from . import sim
        sim.elaborate_cores(board, args.out)
        print(f"{args.out}/cores.v: {board.name}, {board.sys_clk_hz / 1e6:g} MHz")
    else:
        from . import build
        build.elaborate(board, args.out, all_pins=not args.without_pins)
        print(f"{args.out}/top.v: {board.name}, {board.sys_clk_hz / 1e6:g} MHz")
    return 0


def _subject(args, board, platform):
    """What is named: a board file or a platform."""
    network = _network_of(args)
    if board:
        return BoardFile(board, network)
    if network:
        raise BoardError("--platform", "", "an image has no address of its own to change; the board's settings have, or a board file")
    return PlatformImage(platform, args.channels)


def _gates(args):
    import json

    from . import gates
    built = Path(args.built)
    seed = json.loads((built / "report.json").read_text())["seed"]
    found = gates.write(read_board(args.board), built / "work", f"routed{seed}.json", args.out)
    print(f"{args.out}/gates.v: " + ", ".join(f"{count} {cell}" for cell, count in sorted(found.items())))
    return 0


def _export(args):
    from . import export
    for path in export.export(Path(args.check_out or args.root), ROOT):
        print(path)
    return 0


def _pac(args):
    from . import export
    export.pac(args.svd, args.out, args.svd2rust or export.find_svd2rust(ROOT))
    print(args.out)
    return 0


def _bitstream(args):
    from . import build
    subjects = [_subject(args, board, None) for board in args.board or ()] + [_subject(args, None, platform) for platform in args.platform or ()]
    options = build.Options(args.firmware, args.first_seed, args.seeds, args.jobs, args.slack, args.firmware_only, args.without_pins, len(subjects))
    return build.bitstreams(subjects, Path(args.out), options, args.json, args.document, args.prove)


def _bench(args):
    from . import build
    return build.bench(ROOT, Path(args.out), args.json, args.seed, args.document)


if __name__ == "__main__":
    sys.exit(main())
