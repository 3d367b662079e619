//! The links of Markdown pages: which there are, and which lead nowhere. It knows inline links and
//! pictures, `[text](target)`; nothing in fenced blocks or code spans is a link.

use crate::tree;
use anyhow::{Context, Result};
use std::collections::HashMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

/// Every link to a file or an anchor of this repository that is not there, each as a sentence.
pub fn dead(root: &Path) -> Result<Vec<String>> {
    let pages = tree::with_ending(root, "md")?;
    let mut texts = HashMap::new();
    for page in &pages {
        let text = fs::read_to_string(root.join(page))
            .with_context(|| format!("cannot read {}", page.display()))?;
        texts.insert(page.clone(), text);
    }
    let mut dead = Vec::new();
    for page in &pages {
        for (line, target) in links(&texts[page]) {
            if let Some(why) = judge(root, page, &target, &texts) {
                dead.push(format!("{}:{line}: {target}: {why}", page.display()));
            }
        }
    }
    Ok(dead)
}

/// Why a link is dead, if it is.
fn judge(
    root: &Path,
    page: &Path,
    target: &str,
    texts: &HashMap<PathBuf, String>,
) -> Option<String> {
    if target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let (file, anchor) = split(target);
    let file = match file {
        "" => page.to_path_buf(),
        file => match resolve(page, file) {
            Some(file) => file,
            None => return Some("leaves the repository".to_owned()),
        },
    };
    if !root.join(&file).exists() {
        return Some("no such file".to_owned());
    }
    let anchor = anchor?;
    match texts.get(&file) {
        None => Some(format!(
            "{} is not a page and has no anchors",
            file.display()
        )),
        Some(text) if anchors(text).iter().any(|known| known == anchor) => None,
        Some(_) => Some(format!("{} has no such heading", file.display())),
    }
}

/// A link's file and its anchor.
pub fn split(target: &str) -> (&str, Option<&str>) {
    match target.split_once('#') {
        Some((file, anchor)) => (file, Some(anchor)),
        None => (target, None),
    }
}

/// Where a link of a page leads, relative to the root; nowhere if it leaves the root.
pub fn resolve(page: &Path, file: &str) -> Option<PathBuf> {
    let mut resolved: Vec<_> = page.parent()?.components().collect();
    for component in Path::new(file).components() {
        match component {
            Component::ParentDir => drop(resolved.pop()?),
            Component::CurDir => {}
            other => resolved.push(other),
        }
    }
    Some(resolved.iter().collect())
}

/// The links of a page, each with its line.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    each_line_of_prose(text, |number, line| {
        for (start, end) in targets(line) {
            found.push((number, line[start..end].to_owned()));
        }
    });
    found
}

/// The page with some of its links replaced.
pub fn replace(text: &str, new: impl Fn(&str) -> Option<String>) -> String {
    let mut replaced: Vec<String> = text.split('\n').map(str::to_owned).collect();
    each_line_of_prose(text, |number, line| {
        for (start, end) in targets(line).into_iter().rev() {
            if let Some(new) = new(&line[start..end]) {
                replaced[number - 1].replace_range(start..end, &new);
            }
        }
    });
    replaced.join("\n")
}

/// Calls `tell` with every line outside of fenced blocks, counted from 1.
pub fn each_line_of_prose(text: &str, mut tell: impl FnMut(usize, &str)) {
    let mut fenced = false;
    for (n, line) in text.split('\n').enumerate() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            tell(n + 1, line);
        }
    }
}

/// Where in a line the targets of links are; none in code spans.
fn targets(line: &str) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut code = false;
    for (at, byte) in line.bytes().enumerate() {
        match byte {
            b'`' => code = !code,
            b']' if !code && line[at..].starts_with("](") => {
                let start = at + 2;
                if let Some(length) = line[start..].find(')') {
                    found.push((start, start + length));
                }
            }
            _ => {}
        }
    }
    found
}

/// The anchors of a page, as GitHub and mdBook make them of headings: lower case, blanks are
/// hyphens, everything but letters, digits, hyphens and underscores is left out.
fn anchors(text: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    each_line_of_prose(text, |_, line| {
        let title = line.trim_start_matches('#');
        let depth = line.len() - title.len();
        if !(1..=6).contains(&depth) || !title.starts_with(' ') {
            return;
        }
        let anchor: String = title
            .trim()
            .to_lowercase()
            .chars()
            .filter_map(|c| match c {
                ' ' => Some('-'),
                c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
                _ => None,
            })
            .collect();
        let twins = found.iter().filter(|known| **known == anchor).count();
        found.push(match twins {
            0 => anchor,
            n => format!("{anchor}-{n}"),
        });
    });
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_outside_of_code() {
        let page = "see [a](b.md#c) and ![d](e.png)\n```\n[no](no.md)\n```\n`[no](no.md)` [x](#y)";
        let found: Vec<_> = links(page).into_iter().map(|(_, target)| target).collect();
        assert_eq!(found, ["b.md#c", "e.png", "#y"]);
    }

    #[test]
    fn a_heading_is_an_anchor_as_github_makes_it() {
        let page = "# The first: power-up\n## `set` and go\n## Twin\n```\n# no\n```\n## Twin\n";
        let wanted = ["the-first-power-up", "set-and-go", "twin", "twin-1"];
        assert_eq!(anchors(page), wanted);
    }

    #[test]
    fn a_dead_link_is_told_with_its_line() {
        let root = crate::target("tmp/dead-links");
        fs::create_dir_all(root.join("docs")).unwrap();
        let page =
            "# One\n[a](docs/two.md#here)\n[b](three.md)\n[c](docs/two.md#there)\n[d](#one)\n";
        fs::write(root.join("one.md"), page).unwrap();
        fs::write(
            root.join("docs/two.md"),
            "# Here\n[e](../../x.md) [f](../one.md)\n",
        )
        .unwrap();
        let dead = dead(&root).unwrap();
        fs::remove_dir_all(&root).unwrap();
        assert_eq!(dead.len(), 3, "{dead:?}");
        assert!(dead[0].starts_with("docs/two.md:2:"), "{dead:?}");
        assert!(dead[1].starts_with("one.md:3:"), "{dead:?}");
        assert!(dead[2].starts_with("one.md:4:"), "{dead:?}");
    }

    #[test]
    fn links_are_replaced_in_place() {
        let page = "[a](x.md) [b](y.md)\n```\n[c](x.md)\n```\n";
        let new = replace(page, |target| {
            (target == "x.md").then(|| "long/z.md".to_owned())
        });
        assert_eq!(new, "[a](long/z.md) [b](y.md)\n```\n[c](x.md)\n```\n");
    }
}
