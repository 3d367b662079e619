//! Checks that a comment has at most 100 columns, as prose has (`docs::tests::prose_is_narrow`).
//! Tables and drawings may be wider.

use crate::{root, tree};
use std::fs;

/// Columns of a comment, with what stands before it.
const WIDTH: usize = 100;

/// Endings of files with comments, and the signs a comment begins with.
const MARKS: [(&str, &str); 12] = [
    ("c", "//"),
    ("cpp", "//"),
    ("h", "//"),
    ("rs", "//"),
    ("sv", "//"),
    ("hal", "#"),
    ("inc", "#"),
    ("ini", "#"),
    ("py", "#"),
    ("sh", "#"),
    ("toml", "#"),
    ("yml", "#"),
];

/// Not narrowed yet: the cores and their tests.
const LATER: &str = "gateware";

/// The line is a comment and wider than it may be.
fn wide(line: &str, mark: &str) -> bool {
    let text = line.trim_start().trim_start_matches(['/', '!', '#']).trim();
    let drawn = text.starts_with('|') || text.contains("  ") || text.contains("->");
    line.trim_start().starts_with(mark) && !drawn && line.chars().count() > WIDTH
}

#[test]
fn comments_are_narrow() {
    let (mut found, mut read) = (Vec::new(), 0);
    for (ending, mark) in MARKS {
        for file in tree::with_ending(root(), ending).unwrap() {
            if file.starts_with(LATER) || file.starts_with("pac") {
                continue;
            }
            read += 1;
            let text = fs::read_to_string(root().join(&file)).unwrap();
            let lines = text.lines().zip(1..);
            let lines = lines.filter(|(line, _)| wide(line, mark));
            found.extend(lines.map(|(_, number)| format!("{}:{number}", file.display())));
        }
    }
    assert!(read > 400, "only {read} files found");
    assert!(
        found.is_empty(),
        "wider than {WIDTH} columns:\n{}",
        found.join("\n")
    );
}

#[test]
fn a_wide_comment_is_found_and_a_wide_table_is_none() {
    let words = "word ".repeat(20);
    assert!(wide(&format!("    /// {words}"), "//"));
    assert!(!wide(&format!("/// {}", &words[..90]), "//"));
    assert!(!wide(&format!("//! | {words} |"), "//"));
    assert!(!wide(&format!("//! step {words}   end"), "//"));
    assert!(!wide(&format!("let x = \"{words}\"; // short"), "//"));
}
