#!/bin/bash
# Builds the firmware image, target/firmware/ferrocnc-firmware.elf, and the services of boards
# with SDRAM: target/firmware/ferrocnc-services.bin for boards with jobs and
# ferrocnc-services-without-jobs.bin for the others. It prints their sizes.
#
#   firmware/build.sh [cargo arguments]
#   firmware/build.sh clippy    checks them with clippy instead, for the softcore
#
# It uses rustup's compiler if the library's sources are installed (rustup component add rust-src);
# otherwise Debian's rustc-web (apt install rustc-web cargo-web rust-web-src lld). `core` is built
# from its sources, for size: the `core` of `rustup target add riscv32im-unknown-none-elf` is built
# for speed, and with it the image is 5.2 KiB too large for its ROM.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
target=riscv32im-unknown-none-elf
out=$root/target/firmware
# `relax` lets the linker shorten calls, 2.5 KiB. Functions begin at a line of the instruction
# cache, 32 bytes: the code of an exchange that takes the long way is cold, and a line costs 13
# clocks. That is 2.3 KiB more and 100 to 300 clocks less. The passes remove arguments that are not
# read after inlining: the messages of panics, 5 KiB with the code that formats them (see
# soc/postmortem.rs of the image). With `save-restore` functions share the instructions that save
# registers (src/bin/saves.s), 2.9 KiB. The remapping keeps this machine's folder names out of panic
# messages, where they cost ROM.
flags="-Ctarget-feature=+relax,+save-restore -Cllvm-args=-align-all-functions=5"
flags+=" -Cpasses=deadargelim,function(dse,adce),deadargelim,globaldce"
flags+=" --remap-path-prefix=$root/="
for folder in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*/; do flags+=" --remap-path-prefix=$folder="; done
verb=build options=("$@")
if [ "${1:-}" = clippy ]; then
    verb=clippy options=(--lib --bins -- -D warnings)
fi
common=("$verb" --manifest-path "$root/Cargo.toml" --package ferrocnc-firmware
    --profile firmware-image --target "$target" --target-dir "$out")

# defmt logs only errors by default; transitions are `info`, and nothing is logged per period.
export DEFMT_LOG=${DEFMT_LOG:-info}

common+=(-Zbuild-std=core -Zbuild-std-features=optimize_for_size)
# These options are unstable: a released compiler needs this variable to accept them.
export RUSTC_BOOTSTRAP=1

# `run` is cargo with these options.
library=$(rustc --print sysroot 2>/dev/null || true)/lib/rustlib/src/rust/library
if [ -d "$library/core" ]; then
    run() { RUSTFLAGS="$flags --remap-path-prefix=$library/=" cargo "${common[@]}" "$@"; }
elif [ -x /usr/bin/cargo ] && [ -d /usr/lib/rustlib/src/rust/library ]; then
    # Debian's lld (14) cannot relax, GNU ld can.
    if command -v riscv64-unknown-elf-ld >/dev/null; then
        linker=riscv64-unknown-elf-ld flags+=" -Clink-arg=-melf32lriscv"
    else
        linker=ld.lld
    fi
    # Of rustup's tools and Debian's, `cargo clippy` takes those in front.
    run() {
        PATH=/usr/bin:$PATH RUSTC=/usr/bin/rustc \
            CARGO_TARGET_RISCV32IM_UNKNOWN_NONE_ELF_LINKER=$linker \
            RUSTFLAGS="$flags --remap-path-prefix=/usr/lib/rustlib/src/rust/library/=" \
            /usr/bin/cargo "${common[@]}" "$@"
    }
else
    echo "firmware: no sources of Rust's core to build for $target: run 'rustup component add rust-src', or" >&2
    echo "  apt install rustc-web cargo-web rust-web-src binutils-riscv64-unknown-elf" >&2
    exit 1
fi
if [ "$verb" = clippy ]; then
    run --no-default-features --features soc "${options[@]}"
    run --features soc "${options[@]}"
    exit
fi

# What was built under this name; it keeps its date if it is the same.
keep() {
    local built=$out/$target/firmware-image/$1
    cmp -s "$built" "$out/$2.elf" || cp "$built" "$out/$2.elf"
}
run --no-default-features --features soc --bin ferrocnc-services "${options[@]}"
keep ferrocnc-services ferrocnc-services-without-jobs
run --features soc "${options[@]}"
keep ferrocnc-firmware ferrocnc-firmware
keep ferrocnc-services ferrocnc-services
"$root/firmware/size.py" "$out/ferrocnc-firmware.elf"
for name in ferrocnc-services ferrocnc-services-without-jobs; do
    "$root/firmware/program.py" "$out/$name.elf" "$out/$name.bin"
done
