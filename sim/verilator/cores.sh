#!/bin/bash
# Turn the cores and banks of a board into a shared library for the lock-step test
# (tests/tests/lockstep/main.rs).
#
#   sim/verilator/cores.sh [NAME [DIR]]
#
# Reads boards/NAME.toml (mill6) or tests/boards/NAME.toml; writes DIR/libferrocnc_cores.so
# (target/sim/cores-NAME).
#
# RTL=DIR takes the cores from elsewhere: a broken one must make the test fail. Skips in a blink
# when no input changed. Verilator and Python as for build.sh.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
repo=$(cd "$here/../.." && pwd)
board=${1:-mill6}
out=${2:-$repo/target/sim/cores-$board}
rtl=${RTL:-$repo/gateware/rtl}
venv=${FERROCNC_VENV:-$repo/target/venv}
mkdir -p "$out"
out=$(cd "$out" && pwd)

file=$repo/boards/$board.toml
[ -e "$file" ] || file=$repo/tests/boards/$board.toml
PYTHONPATH=$repo/gateware "$venv/bin/python" -m ferrocnc elaborate --target cores --board "$file" --out "$out" > "$out/elaborate.log" \
    || { cat "$out/elaborate.log" >&2; exit 1; }

if command -v verilator >/dev/null && [ "$(verilator --version | sed -E 's/^Verilator ([0-9]+).*/\1/')" -ge 5 ]; then
    verilator=$(command -v verilator)
else
    VERILATOR_ROOT=$(echo "$venv"/lib/python3*/site-packages/verilator)
    export VERILATOR_ROOT
    verilator=$VERILATOR_ROOT/bin/verilator
    [ -x "$verilator" ] || { echo "sim: no Verilator 5 in PATH and none in $venv: run 'cargo xtask setup'" >&2; exit 1; }
    export PATH=$venv/bin:$PATH # its makefile calls `python`
fi
sources=("$out/cores.v" "$rtl"/*.sv)
stamp=$(cat "$0" "$here/cores.cpp" "${sources[@]}" | sha256sum | cut -d' ' -f1)
if [ -f "$out/libferrocnc_cores.so" ] && [ "$(cat "$out/stamp" 2>/dev/null)" = "$stamp" ]; then
    echo "sim: $out/libferrocnc_cores.so is up to date"
    exit 0
fi
started=$(date +%s)
obj=$out/obj
rm -rf "$obj"
# The cores rely on power-up values, as the ECP5 has them: no random initial values.
"$verilator" --cc -O3 --x-assign fast --x-initial fast --noassert -Wno-fatal -Wno-lint -Wno-style --top-module cores --prefix Vcores \
    --Mdir "$obj" -CFLAGS "-fPIC" "${sources[@]}" > "$out/build.log" 2>&1 || { tail -40 "$out/build.log" >&2; exit 1; }
make -C "$obj" -f Vcores.mk -j "${FERROCNC_JOBS:-$(nproc)}" CFG_CXXFLAGS_PCH_I=-include OPT_FAST=-O2 OPT_SLOW=-O1 OPT_GLOBAL=-O2 \
    Vcores__ALL.a verilated.o verilated_threads.o >> "$out/build.log" 2>&1 || { tail -40 "$out/build.log" >&2; exit 1; }
include=$(sed -nE 's/^VERILATOR_ROOT = (.*)/\1/p' "$obj/Vcores.mk")/include
g++ -O2 -std=gnu++17 -fPIC -shared -I"$include" -I"$include/vltstd" -I"$obj" "$here/cores.cpp" "$obj/Vcores__ALL.a" "$obj"/verilated*.o \
    -o "$out/libferrocnc_cores.so.new" -pthread -latomic >> "$out/build.log" 2>&1 || { tail -40 "$out/build.log" >&2; exit 1; }
mv "$out/libferrocnc_cores.so.new" "$out/libferrocnc_cores.so"
echo "$stamp" > "$out/stamp"
echo "sim: $out/libferrocnc_cores.so ready after $(( $(date +%s) - started )) s"
