//! `cargo xtask pictures`: the pictures of the tool's pages in docs/ui.md, taken anew by the tests
//! of the pages. The doctor's page is not among them: it shows the computer that it was taken on.

use crate::{root, step, target, test};
use anyhow::{Context, Result};
use std::fs;

/// A picture of each of these pages.
const PAGES: [&str; 6] = [
    "boards",
    "dashboard",
    "configurator",
    "machine",
    "jobs",
    "bench",
];

/// Runs the tests, and takes what they leave.
pub fn run() -> Result<()> {
    test::pages()?;
    for page in PAGES {
        let name = format!("ui-{page}.png");
        let taken = target("reports").join(&name);
        fs::copy(&taken, root().join("docs/img").join(&name))
            .with_context(|| format!("cannot take {}", taken.display()))?;
        step::note(&format!("docs/img/{name}"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_is_shown_and_there() {
        let text = fs::read_to_string(root().join("docs/ui.md")).unwrap();
        for page in PAGES {
            let name = format!("img/ui-{page}.png");
            assert!(text.contains(&name), "docs/ui.md does not show {name}");
            assert!(root().join("docs").join(&name).is_file(), "no {name}");
        }
    }
}
