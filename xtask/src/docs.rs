//! `cargo xtask docs`: builds the documentation site from `docs/` with mdBook, into `target/book`.
//!
//! The site has the pages of `docs/` only. A link that leaves `docs/` leads to the repository
//! there, so mdBook is given a copy in `target/book-src` with those links replaced.

mod links;
#[cfg(test)]
mod tests;

use crate::{root, setup, step, target, tree};
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
    copy_pages(&copy)?;
    let mut build = Command::new(mdbook);
    step::run("docs", "build the site", "5 s", build.arg("build"))?;
    step::note(&format!("{}", target("book/index.html").display()));
    Ok(())
}

/// Copies the pages and pictures of `docs/`.
fn copy_pages(to: &Path) -> Result<()> {
    let docs = Path::new("docs");
    for file in tree::files(&root().join(docs))? {
        let (from, copy) = (root().join(docs).join(&file), to.join(&file));
        let folder = copy.parent().context("a copy lies in a folder")?;
        fs::create_dir_all(folder).with_context(|| format!("no {}", folder.display()))?;
        if file.extension().is_some_and(|ending| ending == "md") {
            let page = fs::read_to_string(&from)?;
            fs::write(&copy, for_the_site(&page, &docs.join(&file)))?;
        } else {
            fs::copy(&from, &copy)?;
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
