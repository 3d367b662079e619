"""`python -m ferrocnc`: elaborate, export, bitstream. Errors name the file, the key, the value and the remedy."""

import argparse
import logging
import sys
from pathlib import Path

from .board import BoardError, read_board

ROOT = Path(__file__).resolve().parents[2]


def main(argv=None):
    parser = argparse.ArgumentParser(prog="ferrocnc", description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--verbose", action="store_true", help="show what LiteX says")
    sub = parser.add_subparsers(dest="command", required=True)

    p = sub.add_parser("elaborate", help="write the Verilog of a board and what belongs to it")
    p.add_argument("--target", choices=("sim", "board", "cores"), required=True,
                   help="sim: the SoC with plain ports; board: the SoC on its FPGA; cores: cores and banks behind a bare CSR bus")
    p.add_argument("--board", required=True, help="boards/NAME.toml")
    p.add_argument("--out", required=True)

    p = sub.add_parser("export", help="write pac/soc.svd, pac/src/abi.rs, memory.x and docs/registers.md")
    p.add_argument("--root", default=str(ROOT), help="the tree to write into (default: this one)")
    p.add_argument("--check-out", metavar="DIR", help="the same as --root DIR: write into a scratch tree to compare with")

    p = sub.add_parser("pac", help="make the PAC's lib.rs from the exported SVD")
    p.add_argument("--svd", default=str(ROOT / "pac" / "soc.svd"))
    p.add_argument("--svd2rust", help="svd2rust 0.37.1 (default: target/tools/bin/svd2rust, then PATH)")
    p.add_argument("--out", default=str(ROOT / "pac" / "src" / "lib.rs"))

    p = sub.add_parser("bitstream", help="synthesise, place, route and pack a board; a missed clock is a failed build")
    p.add_argument("--board", required=True, help="boards/NAME.toml")
    p.add_argument("--out", required=True)
    p.add_argument("--firmware", help="image to put into the ROM: an ELF file or a flat binary")
    p.add_argument("--seed", type=int, default=1, help="nextpnr's seed")
    p.add_argument("--json", help="write the report here")

    p = sub.add_parser("bench", help="synthesise the cores and the named boards and say how big they are")
    p.add_argument("--out", required=True)
    p.add_argument("--json", help="write the report here")
    p.add_argument("--document", help="write the tables as Markdown here")
    p.add_argument("--seed", type=int, help="place and route the boards, too, with this seed")

    sub.add_parser("tools", help="say which FPGA tools will run")

    args = parser.parse_args(argv)
    # LiteX logs to the root logger at INFO, in colours, hundreds of lines.
    logging.disable(logging.NOTSET if args.verbose else logging.WARNING)
    try:
        return {"elaborate": _elaborate, "export": _export, "pac": _pac, "bitstream": _bitstream, "bench": _bench, "tools": _tools}[args.command](args)
    except BoardError as e:
        print(f"error: {e}", file=sys.stderr)
        return 1


def _tools(_args):
    from . import tools
    for line in tools.report():
        print(line)


def _elaborate(args):
    board = read_board(args.board)
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
        build.elaborate(board, args.out)
        print(f"{args.out}/top.v: {board.name}, {board.sys_clk_hz / 1e6:g} MHz")
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
    return build.bitstream(read_board(args.board), Path(args.out), args.firmware, args.seed, args.json)


def _bench(args):
    from . import build
    return build.bench(ROOT, Path(args.out), args.json, args.seed, args.document)


if __name__ == "__main__":
    sys.exit(main())
