//! The generated files: register map -> SVD, memory.x, docs/registers.md, ABI constants -> PAC; board files -> the twin's boards.

use crate::{build, root, setup, step, target};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Every file the generators write.
const GENERATED: &[&str] = &[
    "pac/soc.svd",
    "memory.x",
    "docs/registers.md",
    "pac/src/abi.rs",
    "pac/src/lib.rs",
    "sim/boards/75b_v8_14o11i6s6e6p/board.bin",
    "sim/boards/75b_v8_14o11i6s6e6p/manifest.json",
    "sim/boards/max/board.bin",
    "sim/boards/max/manifest.json",
    "sim/boards/mill6/board.bin",
    "sim/boards/mill6/manifest.json",
];

/// Writes them again, or with `check` only compares what is committed with what they would be.
pub fn run(check: bool) -> Result<()> {
    setup::run(setup::Need::Gateware)?;
    generate(check)
}

/// As [`run`], on a machine that is set up.
pub fn generate(check: bool) -> Result<()> {
    step::heading("generated files");
    let scratch = target("regen");
    if scratch.exists() {
        fs::remove_dir_all(&scratch)?;
    }
    fs::create_dir_all(scratch.join("pac/src"))?;
    fs::create_dir_all(scratch.join("docs"))?;
    let mut export = build::gateware("export");
    export.arg("--root").arg(&scratch);
    step::run("export", "export the register map", "10 s", &mut export)?;
    peripheral_access(&scratch)?;
    let mut boards = Command::new(setup::python());
    boards
        .arg("sim/boards/regen.py")
        .arg("--out")
        .arg(scratch.join("sim/boards"));
    step::run("boards", "describe the twin's boards", "1 s", &mut boards)?;

    let mut stale = Vec::new();
    for file in GENERATED {
        let fresh = fs::read(scratch.join(file))
            .with_context(|| format!("the generators wrote no {file}"))?;
        let committed = root().join(file);
        if fs::read(&committed).is_ok_and(|found| found == fresh) {
            continue;
        }
        stale.push(*file);
        if !check {
            fs::write(&committed, fresh)
                .with_context(|| format!("cannot write {}", committed.display()))?;
        }
    }
    match (stale.is_empty(), check) {
        (true, _) => step::note(&format!(
            "all {} generated files are fresh",
            GENERATED.len()
        )),
        (false, false) => step::note(&format!("written: {}", stale.join(", "))),
        (false, true) => bail!(
            "stale generated files: {}; run `cargo xtask regen` and commit them",
            stale.join(", ")
        ),
    }
    Ok(())
}

/// svd2rust, then rustfmt, then the line that says what the file is.
fn peripheral_access(scratch: &Path) -> Result<()> {
    let svd2rust = setup::svd2rust()?;
    let folder = scratch.join("svd2rust");
    fs::create_dir_all(&folder)?;
    let mut generate = build::gateware("pac");
    generate
        .arg("--svd")
        .arg(scratch.join("pac/soc.svd"))
        .arg("--svd2rust")
        .arg(svd2rust);
    generate.arg("--out").arg(scratch.join("pac/src/lib.rs"));
    step::run("pac", "make the PAC (svd2rust)", "10 s", &mut generate)
}
