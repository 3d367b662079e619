//! `cargo xtask docs`: builds the documentation site from `docs/` with mdBook, into `target/book`.
//!
//! The site has the pages of `docs/` only. A link that leaves `docs/` leads to the repository
//! there, so mdBook is given a copy in `target/book-src` with those links replaced.

mod links;
#[cfg(test)]
mod tests;

use crate::{root, setup, step, target};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Where the files outside of `docs/` are for a reader of the site.
const REPOSITORY: &str = "https://github.com/ferrocnc/ferrocnc/blob/main";

/// Checks the links, then builds.
pub fn run() -> Result<()> {
    step::heading("documentation");
    let dead = links::dead(root())?;
    if !dead.is_empty() {
        bail!("dead links:\n  {}", dead.join("\n  "));
    }
    step::note("every link between pages leads somewhere");
    let mdbook = setup::mdbook()?;
    let copy = target("book-src");
    if copy.exists() {
        fs::remove_dir_all(&copy)?;
    }
    copy_pages(&root().join("docs"), &copy, Path::new("docs"))?;
    let mut build = Command::new(mdbook);
    step::run("docs", "build the site", "5 s", build.arg("build"))?;
    step::note(&format!("{}", target("book/index.html").display()));
    Ok(())
}

/// Copies a folder of pages and pictures; `at` is its path in the repository.
fn copy_pages(from: &Path, to: &Path, at: &Path) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for entry in fs::read_dir(from).with_context(|| from.display().to_string())? {
        let entry = entry?;
        let (path, copy, at) = (
            entry.path(),
            to.join(entry.file_name()),
            at.join(entry.file_name()),
        );
        if path.is_dir() {
            copy_pages(&path, &copy, &at)?;
        } else if path.extension().is_some_and(|ending| ending == "md") {
            let page = fs::read_to_string(&path)?;
            fs::write(&copy, for_the_site(&page, &at))?;
        } else {
            fs::copy(&path, &copy)?;
        }
    }
    Ok(())
}

/// A page with the links that leave `docs/` turned into links to the repository. A README is the
/// index of its folder there; mdBook knows that in the summary only, not in links.
fn for_the_site(page: &str, at: &Path) -> String {
    links::replace(page, |target| {
        let (file, _) = links::split(target);
        let resolved = links::resolve(at, file)?;
        if !resolved.starts_with("docs") {
            return Some(format!("{REPOSITORY}/{}", resolved.display()));
        }
        let index = file.ends_with("README.md") && !at.ends_with("SUMMARY.md");
        index.then(|| target.replace("README.md", "index.md"))
    })
}
