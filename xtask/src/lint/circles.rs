//! Checks that no sibling modules, each with its submodules, depend on each other in a circle. A
//! module and its parent may. Tests and names from `use super::*` are left out.

#[cfg(test)]
use crate::root;
use crate::tree;
use anyhow::Result;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

type Name = Vec<String>;
/// The modules of a crate, each with its words and signs.
type Modules = BTreeMap<Name, Vec<String>>;

/// Words, `::`, and other signs, without comments and without items for tests, which end where a
/// line as far to the left does.
fn tokens(text: &str) -> Vec<String> {
    let (mut tokens, mut test) = (Vec::new(), None);
    for line in text.lines().filter(|line| !line.trim().is_empty()) {
        let indent = line.len() - line.trim_start().len();
        let line = line.split("//").next().unwrap().trim();
        if line.starts_with("#[cfg(test)]") || line.starts_with("#[cfg(all(test") {
            test = Some(indent);
        } else if let Some(of) = test {
            test = test.filter(|_| indent > of || !line.ends_with([';', '}']));
        } else {
            let line = line.replace("::", "\u{0}");
            let parts = line.split_inclusive(|c: char| c != '_' && !c.is_alphanumeric());
            let parts = parts.flat_map(|part| {
                let sign = part.find(|c: char| c != '_' && !c.is_alphanumeric());
                let (word, sign) = part.split_at(sign.unwrap_or(part.len()));
                [word.to_owned(), sign.replace('\u{0}', "::")]
            });
            tokens.extend(parts.filter(|part| !part.trim().is_empty()));
        }
    }
    tokens
}

/// Reads a module's file, and those of the modules below it.
fn read(file: &Path, folder: &Path, name: Name, into: &mut Modules) {
    let text = std::fs::read_to_string(file).unwrap();
    let tokens = tokens(&text);
    for words in tokens.windows(3).filter(|w| w[0] == "mod" && w[2] == ";") {
        let (folder, child) = (folder.join(&words[1]), [&name, &words[1..2]].concat());
        let file = folder.with_extension("rs");
        if file.exists() {
            read(&file, &folder, child, into);
        }
    }
    into.insert(name, tokens);
}

/// The paths in a tree as `use` takes it; returns how many tokens it has.
fn paths(tokens: &[String], before: &[String], found: &mut Vec<Name>) -> usize {
    let (mut name, mut at) = (before.to_vec(), 0);
    let is = |at: usize, what| tokens.get(at).is_some_and(|token| token == what);
    while let Some(token) = tokens.get(at) {
        if token == "{" {
            at += 1;
            while at < tokens.len() && !is(at, "}") {
                at += match tokens[at].as_str() {
                    "as" => 2,
                    "," => 1,
                    _ => paths(&tokens[at..], &name, found).max(1),
                };
            }
            return at + 1;
        }
        if !token.starts_with(|c: char| c == '_' || c.is_alphabetic()) {
            break;
        }
        name.push(token.clone());
        at += 1;
        if !is(at, "::") {
            break;
        }
        at += 1;
    }
    found.push(name);
    at
}

/// The paths a module names, from the root of its crate; true for those of its `use`.
fn named(modules: &Modules, module: &Name) -> Vec<(Name, bool)> {
    let (tokens, mut found) = (&modules[module], Vec::new());
    for at in 1..tokens.len().saturating_sub(1) {
        let used = tokens[at - 1] == "use";
        let child = used && modules.contains_key(&[module, &tokens[at..=at]].concat());
        let begins = ["crate", "self", "super"].contains(&tokens[at].as_str());
        if child || begins && tokens[at + 1] == "::" && tokens[at - 1] != "::" {
            let mut new = Vec::new();
            paths(&tokens[at..], &[], &mut new);
            found.extend(new.into_iter().map(|path| (path, used)));
        }
    }
    let from_root = |path: Name| {
        let ups = path.iter().take_while(|word| *word == "super").count();
        match path[0].as_str() {
            "crate" => path[1..].to_vec(),
            "super" => [
                &module[..module.len() - ups.min(module.len())],
                &path[ups..],
            ]
            .concat(),
            "self" => [module, &path[1..]].concat(),
            _ => [&module[..], &path].concat(),
        }
    };
    let found = found.into_iter();
    found.map(|(path, used)| (from_root(path), used)).collect()
}

/// The module a path leads to, also through what modules on its way `use`.
fn leads_to(named: &BTreeMap<Name, Vec<(Name, bool)>>, path: &Name, further: u8) -> Name {
    let mut lengths = (0..=path.len()).rev();
    let known = lengths.find(|n| named.contains_key(&path[..*n])).unwrap();
    let again = path.get(known).filter(|_| further > 0).and_then(|name| {
        let mut uses = named[&path[..known]].iter().filter(|(_, used)| *used);
        uses.find(|(path, _)| path.last() == Some(name))
    });
    again.map_or(path[..known].to_vec(), |(path, _)| {
        leads_to(named, path, further - 1)
    })
}

/// Every use that is part of a circle.
fn circles(modules: &Modules) -> Vec<String> {
    let mut uses: BTreeMap<Name, BTreeMap<Name, String>> = BTreeMap::new();
    let name = |module: &Name| (module.clone(), named(modules, module));
    let named: BTreeMap<_, _> = modules.keys().map(name).collect();
    for (module, paths) in &named {
        for (path, _) in paths {
            let to = leads_to(&named, path, 8);
            let same = module.iter().zip(&to).take_while(|(a, b)| a == b).count();
            if module.len() > same && to.len() > same {
                let said = format!("{} uses {}", module.join("::"), path.join("::"));
                let of = uses.entry(module[..=same].to_vec()).or_default();
                of.insert(to[..=same].to_vec(), said);
            }
        }
    }
    let reaches = |from: &Name, to: &Name| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(name) = open.pop() {
            if seen.insert(name) {
                open.extend(uses.get(name).into_iter().flat_map(BTreeMap::keys));
            }
        }
        seen.contains(to)
    };
    let all = uses
        .iter()
        .flat_map(|(from, to)| to.iter().map(move |(to, said)| (from, to, said)));
    let bad = all.filter(|(from, to, _)| reaches(to, from));
    bad.map(|(.., said)| said.clone()).collect()
}

/// The crates of a tree: the file that each begins with.
fn crates(root: &Path) -> Result<Vec<PathBuf>> {
    let mut files = tree::with_ending(root, "rs")?;
    files.retain(|file| {
        let generated = file.starts_with("pac");
        !generated && (file.ends_with("src/lib.rs") || file.ends_with("main.rs"))
    });
    Ok(files)
}

/// Every use of a tree that is part of a circle.
pub fn all(root: &Path) -> Result<Vec<String>> {
    let mut found = Vec::new();
    for file in crates(root)? {
        let (whole, mut modules) = (root.join(&file), Modules::new());
        let folder = whole.with_file_name("");
        read(&whole, &folder, Name::new(), &mut modules);
        let circle = |said| format!("{}: {said}", file.display());
        found.extend(circles(&modules).into_iter().map(circle));
    }
    Ok(found)
}

#[test]
fn no_modules_use_each_other_in_a_circle() {
    let crates = crates(root()).unwrap().len();
    assert!(crates > 10, "{crates} crates were found");
    let found = all(root()).unwrap();
    assert!(
        found.is_empty(),
        "modules use each other:\n{}",
        found.join("\n")
    );
}

#[test]
fn a_circle_is_found_and_what_is_none_is_not() {
    let circles_of = |b: &str| {
        let a = "use crate::b::{self, Bee as Bug};\nuse super::Sea;";
        let files = [("", "pub use c::Sea;"), ("a", a), ("b", b), ("c", "")];
        let name = |name: &str| (!name.is_empty()).then(|| name.to_owned());
        let modules =
            files.map(|(module, text)| (name(module).into_iter().collect(), tokens(text)));
        circles(&modules.into_iter().collect())
    };
    let both = ["a uses b::Bee", "b uses a::f"];
    assert_eq!(circles_of("fn f() {\n    crate::a::f();\n}"), both);
    assert_eq!(circles_of("use super::{c, a::{g, f}};"), both);
    for none in [
        "// crate::a::f",
        "use super::Sea;",
        "#[cfg(test)]\nmod tests {\n    use crate::a::f;\n}",
        "use super::{c as a, Sea};",
    ] {
        assert_eq!(circles_of(none), [""; 0], "{none}");
    }
}
