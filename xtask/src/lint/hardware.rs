//! Checks that only `firmware/src/bin` accesses the hardware; the rest of the tree runs on a PC.

use crate::{root, tree};
use std::fs;

#[test]
fn only_the_binaries_of_the_firmware_name_the_pac() {
    let (mut named, mut wrong) = (0, Vec::new());
    for file in tree::with_ending(root(), "rs").unwrap() {
        if file.starts_with("pac") || file.starts_with("xtask") {
            continue;
        }
        if fs::read_to_string(root().join(&file))
            .unwrap()
            .contains("litex_pac::")
        {
            match file.starts_with("firmware/src/bin") {
                true => named += 1,
                false => wrong.push(file.display().to_string()),
            }
        }
    }
    assert!(named > 5, "only {named} files name it");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
