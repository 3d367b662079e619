//! Finds the functions of a file in Python: from the line of `def` to the last line that is further
//! in. Those inside of another count on their own, too.

/// Every function: its line, its name and how many lines it has.
pub fn functions(text: &str) -> Vec<(usize, String, usize)> {
    let lines = outside_strings(text);
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let Some(rest) = line.and_then(|line| line.trim_start().strip_prefix("def ")) else {
            continue;
        };
        let mut last = at;
        for (behind, line) in lines.iter().enumerate().skip(at + 1) {
            match line {
                Some("") => {}
                Some(line) if ends(line, depth(&lines, at)) => break,
                Some(_) | None => last = behind,
            }
        }
        let name = rest.split('(').next().unwrap_or(rest);
        found.push((at + 1, name.to_owned(), last + 1 - at));
    }
    found
}

/// How far in a line stands.
fn depth(lines: &[Option<&str>], at: usize) -> usize {
    lines[at].map_or(0, |line| line.len() - line.trim_start().len())
}

/// Whether this line is no part any more of a function that stands so far in. A bracket may close
/// its arguments there.
fn ends(line: &str, depth: usize) -> bool {
    let text = line.trim_start();
    line.len() - text.len() <= depth && !text.starts_with([')', ']', '}', '#'])
}

/// The lines, without the end of each; nothing for one that begins in a string of several lines.
fn outside_strings(text: &str) -> Vec<Option<&str>> {
    let mut inside = false;
    text.lines()
        .map(|line| {
            let was = inside;
            let marks = line.matches("\"\"\"").count() + line.matches("'''").count();
            inside ^= marks % 2 == 1;
            (!was).then(|| line.trim_end())
        })
        .collect()
}

#[test]
fn functions_are_found_with_their_strings_and_arguments() {
    let text = "\
class A:
    def first(self, a,
              b):
        \"\"\"It says
no more.\"\"\"

        def inner():
            return 1
        return inner

    def second(
        self,
    ):
        pass

x = 1
";
    let found = functions(text);
    let expected = [(2, "first", 8), (7, "inner", 2), (11, "second", 4)];
    assert_eq!(
        found,
        expected.map(|(line, name, lines)| (line, name.to_owned(), lines))
    );
}
