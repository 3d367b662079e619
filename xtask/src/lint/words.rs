//! Checks that no line of the tree uses a vague word for the board, the host or the client, in
//! prose, names and messages.

use crate::{root, tree};
use std::fs;
use std::path::Path;

/// The words, in halves: this file is read, too.
const VAGUE: [(&str, &str); 6] = [
    ("some", "body"),
    ("no", "body"),
    ("any", "body"),
    ("every", "body"),
    ("w", "ho"),
    ("w", "hoever"),
];

/// Endings of text that is ours. Files without an ending are inputs of the fuzzer.
const TEXTS: [&str; 24] = [
    "asm", "c", "cpp", "css", "h", "hal", "html", "inc", "ini", "js", "json", "md", "ngc",
    "proofs", "py", "rs", "s", "sh", "sv", "tbl", "toml", "txt", "v", "yml",
];

/// The first vague word of a line; the words of a name are read, too.
fn vague(line: &str) -> Option<&str> {
    let mut words = line.split(|c: char| !c.is_alphanumeric());
    words.find(|word| {
        let is = |(a, b): &(&str, &str)| word.eq_ignore_ascii_case(&format!("{a}{b}"));
        word.len() <= 9 && VAGUE.iter().any(is)
    })
}

/// Licences say what they say.
fn is_ours(file: &Path) -> bool {
    let ending = file.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| TEXTS.contains(&ending))
        && !file
            .components()
            .any(|part| part.as_os_str() == "proptest-regressions")
}

#[test]
fn no_line_hides_what_acts() {
    let (mut wrong, mut read) = (Vec::new(), 0);
    for file in tree::files(root()).unwrap() {
        let text = match is_ours(&file) {
            true => fs::read_to_string(root().join(&file)).unwrap(),
            false => continue,
        };
        read += 1;
        for (n, line) in text.lines().enumerate() {
            if let Some(word) = vague(line) {
                wrong.push(format!("{}:{}: {word}", file.display(), n + 1));
            }
        }
    }
    assert!(read > 500, "only {read} files found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_vague_word_is_found_whole_and_in_any_case() {
    for (a, b) in VAGUE {
        let word = format!("{a}{b}");
        assert_eq!(vague(&format!("// ask {word}, please")), Some(&word[..]));
        assert_eq!(vague(&format!("let {word} = 1;")), Some(&word[..]));
        let capital = word.to_uppercase();
        assert_eq!(vague(&format!("{capital} acts")), Some(&capital[..]));
        assert_eq!(vague(&format!("fn told_{word}_to")), Some(&word[..]));
        assert_eq!(vague(&format!("{word}le")), None);
    }
}
