//! Checks that a comment or a docstring has at most 100 columns, as prose
//! has (`docs::tests::prose_is_narrow`).
//! Tables and drawings may be wider.

use crate::{root, tree};
use std::fs;

/// Columns of a comment, with what stands before it.
const WIDTH: usize = 100;

/// Endings of files with comments, and the signs a comment begins with.
const COMMENT_SIGNS: [(&str, &str); 14] = [
    ("c", "//"),
    ("cpp", "//"),
    ("h", "//"),
    ("rs", "//"),
    ("sv", "//"),
    ("hal", "#"),
    ("inc", "#"),
    ("ini", "#"),
    ("proofs", "#"),
    ("py", "#"),
    ("sh", "#"),
    ("toml", "#"),
    ("txt", "#"),
    ("yml", "#"),
];

/// What a docstring of Python begins and ends with.
const QUOTES: &str = "\"\"\"";

/// The line is a comment and wider than it may be.
fn wide(line: &str, mark: &str) -> bool {
    line.trim_start().starts_with(mark) && too_long(line)
}

/// The line is wider than it may be, and neither a table nor a drawing.
fn too_long(line: &str) -> bool {
    let text = line.trim_start().trim_start_matches(['/', '!', '#']).trim();
    let drawn = text.starts_with('|') || text.contains("  ") || text.contains("->");
    !drawn && line.chars().count() > WIDTH
}

/// Numbers of the lines of a file whose comments are wider than they may be; of Python its
/// docstrings, too.
fn wide_lines(text: &str, mark: &str, python: bool) -> Vec<usize> {
    // Within a string of several lines: is it a docstring?
    let mut inside = None;
    let mut found = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let begins = inside.is_none() && line.trim_start().starts_with(QUOTES);
        let doc = python && (begins || inside == Some(true));
        if wide(line, mark) && inside != Some(false) || doc && too_long(line) {
            found.push(number);
        }
        if python && line.matches(QUOTES).count() % 2 == 1 {
            inside = inside.xor(Some(begins));
        }
    }
    found
}

#[test]
fn comments_are_narrow() {
    let (mut found, mut read) = (Vec::new(), 0);
    for (ending, mark) in COMMENT_SIGNS {
        for file in tree::with_ending(root(), ending).unwrap() {
            if file.starts_with("pac") {
                continue;
            }
            read += 1;
            let text = fs::read_to_string(root().join(&file)).unwrap();
            let lines = wide_lines(&text, mark, ending == "py");
            found.extend(
                lines
                    .iter()
                    .map(|number| format!("{}:{number}", file.display())),
            );
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

#[test]
fn a_wide_docstring_is_found_and_a_wide_string_is_none() {
    let words = "word ".repeat(20);
    let python =
        format!("def f():\n    \"\"\"One.\n\n    {words}\n    \"\"\"\n    x = \"{words}\"\n");
    assert_eq!(wide_lines(&python, "#", true), [4]);
    let string = format!("x = \"\"\"\n# {words}\n\"\"\"\n# {words}\n");
    assert_eq!(wide_lines(&string, "#", true), [4]);
}
