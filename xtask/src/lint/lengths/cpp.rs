//! Finds the functions of a file in C or C++: those of namespaces and classes. A lambda is part of
//! the function it stands in.

/// Every function: its line, its name and how many lines it has.
pub fn functions(text: &str) -> Vec<(usize, String, usize)> {
    let mut found = Vec::new();
    // What every open brace began: the line and the name of a function, or nothing.
    let mut open: Vec<Option<(usize, String)>> = Vec::new();
    let (mut head, mut line) = (String::new(), 1);
    for sign in code(text).chars() {
        match sign {
            '{' => {
                let inside = open.iter().any(Option::is_some);
                let begins = line - head.trim_start().matches('\n').count();
                let name = name(&head).filter(|_| !inside);
                open.push(name.map(|name| (begins, name)));
            }
            '}' => {
                if let Some((first, name)) = open.pop().flatten() {
                    found.push((first, name, line + 1 - first));
                }
            }
            _ => {}
        }
        line += usize::from(sign == '\n');
        match sign {
            '{' | '}' | ';' => head.clear(),
            _ => head.push(sign),
        }
    }
    found
}

/// The name of the function whose body follows this head; a type, a namespace and a table have no
/// arguments, or an equals sign in front of them.
fn name(head: &str) -> Option<String> {
    let (before, _) = head.split_once('(')?;
    if before.contains("operator") {
        return Some("operator".to_owned());
    }
    if before.contains('=') {
        return None;
    }
    let outside = head.split(['(', ')']).step_by(2);
    if outside.skip(1).any(|part| part.contains('=')) {
        return None;
    }
    let name = before.trim_end();
    let begins = name.rfind(|sign: char| !sign.is_alphanumeric() && sign != '_');
    let name = name[begins.map_or(0, |at| at + 1)..].to_owned();
    (!name.is_empty()).then_some(name)
}

/// What is left of a text without comments, strings and directives, line by line.
fn code(text: &str) -> String {
    let mut code = String::new();
    let mut rest = text;
    while let Some(sign) = rest.chars().next() {
        let last = code.chars().next_back();
        let starts = code
            .rsplit('\n')
            .next()
            .is_some_and(|line| line.trim().is_empty());
        let skipped = match sign {
            '/' if rest.starts_with("//") => line_end(rest),
            '/' if rest.starts_with("/*") => rest.find("*/").map_or(rest.len(), |at| at + 2),
            '#' if starts => line_end(rest),
            '"' => quoted(rest, '"'),
            // Not between two digits of a number.
            '\'' if !last.is_some_and(char::is_alphanumeric) => quoted(rest, '\''),
            _ => 0,
        };
        match skipped {
            0 => code.push(sign),
            _ => code.extend(rest[..skipped].chars().filter(|sign| *sign == '\n')),
        }
        rest = &rest[skipped.max(sign.len_utf8())..];
    }
    code
}

/// Where a comment or a directive ends: a line with a backslash at its end goes on.
fn line_end(text: &str) -> usize {
    let mut ends = text.match_indices('\n').map(|(at, _)| at);
    ends.find(|at| !text[..*at].ends_with('\\'))
        .unwrap_or(text.len())
}

/// How long the quoted text at the beginning is.
fn quoted(text: &str, mark: char) -> usize {
    let mut escaped = false;
    for (at, sign) in text.char_indices().skip(1) {
        match sign {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            _ if sign == mark => return at + 1,
            _ => {}
        }
    }
    text.len()
}

#[test]
fn functions_are_found_in_namespaces_and_classes_with_all_that_stands_in_them() {
    let text = "\
#define CHECK(b, ...) \\
    do { b.fail(); } while (0)  // an open brace {
namespace a {
struct B : C {
    int table[2] = {f(1), 2};
    B() : C(1) {}
    [[noreturn]] void fail(const char *why = \"{\") const {
        auto lambda = [&](int n) {
            return n ? '{' : '\\'';
        };
        /* { */ const int big = 1'000;
    }
};
}
static std::map<int, int>
find(int n)
{
    if (n) { return {}; }
}
extern \"C\" {
void declared(int);
}
enum { LAST };
bool operator==(const B &a, const B &b) { if (true) { return true; } }
static const std::function<void()> acts[] = {
    [&] { go(); },
};
";
    let found = functions(text);
    let names: Vec<_> = found.iter().map(|(_, name, _)| name.as_str()).collect();
    assert_eq!(names, ["B", "fail", "find", "operator"]);
    assert_eq!(found[1], (7, "fail".to_owned(), 6));
    assert_eq!(found[2], (15, "find".to_owned(), 5));
}
