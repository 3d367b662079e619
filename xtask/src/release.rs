//! `cargo xtask release`: all that a release has, in one folder. Packages, images, a bill of
//! materials for each program, the section of the changelog, and SHA-256 sums of everything.
//!
//! The same tag gives the same bytes: every time is the commit's, and every path of this computer
//! is that of the packages' programs.

use crate::{deb, root, setup, step, target, tree};
use anyhow::{Context, Result, bail};
use clap::Args;
use std::fs;
use std::path::Path;
use std::process::Command;

/// What is asked for.
#[derive(Args)]
pub struct Options {
    /// Of what is here, tagged or not, with the unreleased section of the changelog.
    #[arg(long)]
    draft: bool,
}

/// The version in the workspace's Cargo.toml.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The crates of the programs that are given out, each with its bill of materials.
const PROGRAMS: [(&str, &str); 3] = [
    ("host", "ferrocnc"),
    ("sim", "ferrocnc-sim"),
    ("firmware", "ferrocnc-firmware"),
];

/// Makes the release, says where it is.
pub fn run(options: &Options) -> Result<()> {
    let (name, section) = match options.draft {
        true => (format!("{VERSION}-draft"), "Unreleased"),
        false => (VERSION.to_owned(), VERSION),
    };
    if !options.draft {
        of_a_tag(
            &git(&["status", "--porcelain"])?,
            &git(&["tag", "--points-at", "HEAD"])?,
        )?;
    }
    let changelog = fs::read_to_string(root().join("CHANGELOG.md")).context("CHANGELOG.md")?;
    let notes = notes(&changelog, section)?;
    setup::run(setup::Need::Packages)?;
    step::heading("release");
    let packages = deb::check()?;
    let to = target("releases").join(format!("ferrocnc-{name}"));
    if to.exists() {
        fs::remove_dir_all(&to)?;
    }
    fs::create_dir_all(&to)?;
    for package in packages {
        copy(&package, &to.join(package.file_name().context("a name")?))?;
    }
    let images = target("deb/files/images");
    if images.exists() {
        for file in tree::files(&images)? {
            copy(&images.join(&file), &to.join("images").join(&file))?;
        }
    }
    bills(&to)?;
    fs::write(to.join("NOTES.md"), notes)?;
    let sums = deb::sums(&to)?;
    fs::write(to.join("SHA256SUMS"), sums)?;
    step::note(&format!("{}", to.display()));
    Ok(())
}

/// Refuses what no tag says: changes that are in no commit, and a commit without the tag.
fn of_a_tag(changes: &str, tags: &str) -> Result<()> {
    let tag = format!("v{VERSION}");
    if !changes.trim().is_empty() {
        bail!("the tree has changes that are in no commit: commit them, or give --draft");
    }
    if !tags.lines().any(|known| known == tag) {
        bail!(
            "this commit has no tag {tag}, the version in Cargo.toml: `git tag {tag}`, or give --draft"
        );
    }
    Ok(())
}

/// The section of the changelog with this heading.
fn notes(changelog: &str, heading: &str) -> Result<String> {
    let mut lines = changelog.lines();
    let begins = |line: &str| {
        let words = line.strip_prefix("## ");
        words.and_then(|it| it.split_whitespace().next()) == Some(heading)
    };
    lines.by_ref().find(|line| begins(line)).with_context(|| {
        format!("CHANGELOG.md has no section `## {heading}`: give the unreleased one that heading")
    })?;
    let section: Vec<&str> = lines.take_while(|line| !line.starts_with("## ")).collect();
    let text = section.join("\n");
    match text.trim() {
        "" => bail!("CHANGELOG.md says nothing below `## {heading}`"),
        said => Ok(format!("# FerroCNC {heading}\n\n{said}\n")),
    }
}

/// Writes the bill of materials of each program. cargo-cyclonedx writes beside every Cargo.toml of
/// a workspace, so it gets a copy of the commit.
fn bills(to: &Path) -> Result<()> {
    let tool = setup::cargo_cyclonedx()?;
    let copy_of = target("releases/source");
    tree::check_out("HEAD", &copy_of)?;
    let mut list = Command::new(tool);
    list.args(["cyclonedx", "--format", "json", "--spec-version", "1.5"])
        .args(["--target", "all", "--override-filename", "bill"])
        .arg("--manifest-path")
        .arg(copy_of.join("host/Cargo.toml"))
        .env("SOURCE_DATE_EPOCH", deb::time_of_the_commit()?);
    step::run(
        "cyclonedx",
        "list what the programs are made of",
        "5 s",
        &mut list,
    )?;
    for (folder, name) in PROGRAMS {
        let bill = copy_of.join(folder).join("bill.json");
        let text = fs::read_to_string(&bill).with_context(|| bill.display().to_string())?;
        fs::write(
            to.join(format!("{name}.cdx.json")),
            without(&text, &copy_of),
        )?;
    }
    fs::remove_dir_all(copy_of).context("the copy of the commit")
}

/// The text with the place of the programs' sources in place of this one.
fn without(text: &str, place: &Path) -> String {
    text.replace(&place.display().to_string(), deb::SOURCES)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::copy(from, to).with_context(|| from.display().to_string())?;
    Ok(())
}

fn git(arguments: &[&str]) -> Result<String> {
    let mut git = Command::new("git");
    git.current_dir(root()).args(arguments);
    setup::output(&mut git).with_context(|| format!("git {} failed", arguments.join(" ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANGES: &str = "# Changelog\n\n## Unreleased\n\n* new\n\n## 0.2.0 (2026-12-01)\n\n* old\n  line\n\n## 0.1.0\n";

    #[test]
    fn the_notes_are_the_section_of_the_version_and_nothing_else() {
        assert_eq!(
            notes(CHANGES, "0.2.0").unwrap(),
            "# FerroCNC 0.2.0\n\n* old\n  line\n"
        );
        assert_eq!(
            notes(CHANGES, "Unreleased").unwrap(),
            "# FerroCNC Unreleased\n\n* new\n"
        );
        for (heading, part) in [("0.3.0", "no section"), ("0.1.0", "says nothing")] {
            let why = notes(CHANGES, heading).unwrap_err().to_string();
            assert!(why.contains(part), "{heading}: {why}");
        }
    }

    #[test]
    fn the_changelog_has_notes_for_a_draft() {
        let changelog = fs::read_to_string(root().join("CHANGELOG.md")).unwrap();
        assert!(notes(&changelog, "Unreleased").unwrap().contains("\n* "));
    }

    #[test]
    fn only_a_clean_tree_at_the_tag_of_its_version_is_released() {
        let tag = format!("nightly\nv{VERSION}\n");
        assert!(of_a_tag("", &tag).is_ok());
        for (changes, tags, part) in [
            (" M README.md\n", tag.as_str(), "in no commit"),
            ("", "v0.0.1\n", "has no tag"),
            ("", "", "has no tag"),
        ] {
            let why = of_a_tag(changes, tags).unwrap_err().to_string();
            assert!(why.contains(part) && why.contains("--draft"), "{why}");
        }
    }

    #[test]
    fn a_bill_names_no_place_of_this_computer() {
        let place = Path::new("/home/x/checkout");
        let bill = "\"path+file:///home/x/checkout/wire#ferrocnc-wire@0.1.0\"";
        let said = without(bill, place);
        assert_eq!(
            said,
            "\"path+file:///usr/src/ferrocnc/wire#ferrocnc-wire@0.1.0\""
        );
    }
}
