//! Checks the output of `cargo metadata`: each dependency has an allowed licence and comes from
//! crates.io.

use anyhow::{Context, Result, bail};
use serde_json::Value;

/// Where dependencies come from.
const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";

/// Judges `cargo metadata`; how many dependencies there are.
pub fn judge(metadata: &Value, allowed: &[&str]) -> Result<usize> {
    let packages = metadata["packages"].as_array().context("no packages")?;
    let mut wrong = Vec::new();
    let mut judged = 0;
    for package in packages {
        // Ours have no source.
        let Some(source) = package["source"].as_str() else {
            continue;
        };
        judged += 1;
        let name = format!("{} {}", text(package, "name"), text(package, "version"));
        if source != REGISTRY {
            wrong.push(format!("{name} comes from {source}"));
        }
        let licence = text(package, "license");
        if !may_use(licence, allowed) {
            wrong.push(format!("{name} has the licence {licence:?}"));
        }
    }
    match wrong.is_empty() {
        true => Ok(judged),
        false => bail!("{}", wrong.join("; ")),
    }
}

fn text<'a>(package: &'a Value, key: &str) -> &'a str {
    package[key].as_str().unwrap_or("")
}

/// Whether an SPDX expression can be met with these licences. `/` is an old way to write `OR`.
fn may_use(expression: &str, allowed: &[&str]) -> bool {
    let spaced = expression
        .replace('/', " OR ")
        .replace('(', " ( ")
        .replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut rest = words.as_slice();
    either(&mut rest, allowed) == Some(true) && rest.is_empty()
}

/// A OR B; `None` is no expression.
fn either(rest: &mut &[&str], allowed: &[&str]) -> Option<bool> {
    let mut met = both(rest, allowed)?;
    while next_is(rest, "OR") {
        met |= both(rest, allowed)?;
    }
    Some(met)
}

/// A AND B, which binds tighter.
fn both(rest: &mut &[&str], allowed: &[&str]) -> Option<bool> {
    let mut met = one(rest, allowed)?;
    while next_is(rest, "AND") {
        met &= one(rest, allowed)?;
    }
    Some(met)
}

/// A licence, with or without an exception, or an expression in parentheses.
fn one(rest: &mut &[&str], allowed: &[&str]) -> Option<bool> {
    if next_is(rest, "(") {
        let met = either(rest, allowed)?;
        return next_is(rest, ")").then_some(met);
    }
    let (licence, behind) = rest.split_first()?;
    *rest = behind;
    let mut met = allowed.contains(licence);
    if next_is(rest, "WITH") {
        let (exception, behind) = rest.split_first()?;
        *rest = behind;
        met = allowed.contains(&format!("{licence} WITH {exception}").as_str());
    }
    Some(met)
}

/// Takes a word if it is the next.
fn next_is(rest: &mut &[&str], word: &str) -> bool {
    match rest.split_first() {
        Some((first, behind)) if *first == word => {
            *rest = behind;
            true
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const ALLOWED: &[&str] = &["MIT", "Zlib", "Unicode-3.0"];

    #[test]
    fn an_expression_is_met_by_what_it_offers() {
        for good in [
            "MIT",
            "MIT OR Apache-2.0",
            "Apache-2.0/MIT",
            "(MIT OR Apache-2.0) AND Unicode-3.0",
            "GPL-3.0 AND Zlib OR MIT",
        ] {
            assert!(may_use(good, ALLOWED), "{good}");
        }
        for bad in [
            "",
            "GPL-3.0",
            "MIT AND GPL-3.0",
            "(GPL-3.0 OR X) AND MIT",
            "MIT WITH X-exception",
            "(MIT",
            "MIT Zlib",
        ] {
            assert!(!may_use(bad, ALLOWED), "{bad}");
        }
    }

    #[test]
    fn a_dependency_from_elsewhere_or_without_a_licence_is_named() {
        let package = |name: &str, licence: Option<&str>, source: Option<&str>| json!({"name": name, "version": "1.0.0", "license": licence, "source": source});
        let judged = |packages: &[Value]| judge(&json!({ "packages": packages }), ALLOWED);
        let fine = package("fine", Some("MIT"), Some(REGISTRY));
        let ours = package("ours", None, None);
        assert_eq!(judged(&[fine.clone(), ours]).unwrap(), 1);
        let bare = package("bare", None, Some(REGISTRY));
        let from_git = package("git", Some("MIT"), Some("git+https://x.y"));
        for (bad, name) in [(bare, "bare"), (from_git, "git")] {
            let told = judged(&[fine.clone(), bad]).unwrap_err().to_string();
            assert!(told.starts_with(name), "{told}");
        }
    }
}
