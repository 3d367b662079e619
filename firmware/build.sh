#!/bin/bash
# Builds the firmware image: target/firmware/ferrocnc-firmware.elf, and says how big it is.
#
#   firmware/build.sh [cargo arguments]
#
# With rustup's riscv32im target if it is installed (rustup target add riscv32im-unknown-none-elf); otherwise with
# Debian's rustc-web and its sources (apt install rustc-web cargo-web rust-web-src lld).
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
target=riscv32im-unknown-none-elf
out=$root/target/firmware
# Names of this machine's folders are no use in panic messages.
flags="--remap-path-prefix=$root=. --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}/registry/src=deps"
common=(build --manifest-path "$root/Cargo.toml" --package ferrocnc-firmware --bin ferrocnc-firmware --features soc
    --profile firmware-image --target "$target" --target-dir "$out")

sysroot=$(rustc --print sysroot 2>/dev/null || true)
if [ -n "$sysroot" ] && ls "$sysroot/lib/rustlib/$target/lib/"libcore-*.rlib >/dev/null 2>&1; then
    RUSTFLAGS="$flags" cargo "${common[@]}" "$@"
elif [ -x /usr/bin/cargo ] && [ -d /usr/lib/rustlib/src/rust/library ] && command -v ld.lld >/dev/null; then
    # build-std: Debian ships core's sources, but not core built for this target.
    RUSTC=/usr/bin/rustc RUSTC_BOOTSTRAP=1 RUSTFLAGS="$flags" CARGO_TARGET_RISCV32IM_UNKNOWN_NONE_ELF_LINKER=ld.lld \
        /usr/bin/cargo "${common[@]}" -Zbuild-std=core "$@"
else
    echo "firmware: no Rust for $target: run 'rustup target add $target', or 'apt install rustc-web cargo-web rust-web-src lld'" >&2
    exit 1
fi

elf=$out/ferrocnc-firmware.elf
built=$out/$target/firmware-image/ferrocnc-firmware
cmp -s "$built" "$elf" || cp "$built" "$elf"
"$root/firmware/size.py" "$elf"
