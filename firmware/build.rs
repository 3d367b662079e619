//! Link arguments of the image. The memory map is the repository's generated `memory.x`; that of
//! the services is written here from `wire`.

use std::path::Path;
use std::{env, fs};
use wire::images::{PROGRAM_MAGIC, PROGRAM_MAX};
use wire::regmap::SDRAM_BASE;

/// Stack budget in bytes; the linker refuses an image that leaves less. Measured use is in the
/// console's `status`.
const STACK: u32 = 6 * 1024;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let target = env::var("TARGET").unwrap_or_default();
    if env::var_os("CARGO_FEATURE_SOC").is_none() || !target.starts_with("riscv32") {
        return;
    }
    let manifest = env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let root = Path::new(&manifest).parent().unwrap_or(Path::new("."));
    println!("cargo:rerun-if-changed={}", root.join("memory.x").display());
    println!("cargo:rustc-link-search={}", root.display());
    // riscv-rt evaluates ORIGIN(REGION_TEXT) when it reads link.x: memory.x has to come first.
    for script in ["memory.x", "link.x", "defmt.x"] {
        println!("cargo:rustc-link-arg-bin=ferrocnc-firmware=-T{script}");
    }
    println!("cargo:rustc-link-arg-bin=ferrocnc-firmware=--defsym=_hart_stack_size={STACK}");
    let services = Path::new(&manifest).join("services.x");
    println!("cargo:rerun-if-changed={}", services.display());
    let out = env::var("OUT_DIR").unwrap_or_default();
    let written = fs::write(Path::new(&out).join("services-memory.x"), services_memory());
    written.expect("cannot write services-memory.x");
    println!("cargo:rustc-link-search={out}");
    println!(
        "cargo:rustc-link-arg-bin=ferrocnc-services=-T{}",
        services.display()
    );
}

/// The memory of the services, for `services.x`, and what `program.py` reads of the ELF.
fn services_memory() -> String {
    format!(
        "MEMORY {{ sdram : ORIGIN = {SDRAM_BASE:#x}, LENGTH = {PROGRAM_MAX:#x} }}\n\
         __services_origin = {SDRAM_BASE:#x};\n\
         __services_room = {PROGRAM_MAX:#x};\n\
         __services_magic = {PROGRAM_MAGIC:#x};\n"
    )
}
