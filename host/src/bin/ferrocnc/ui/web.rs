//! The pages, which are compiled in: what is shipped is their source, without a step of npm.

use super::answer::Refusal;
use axum::extract::Path;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

const HTML: &str = "text/html; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SVG: &str = "image/svg+xml";
const PLAIN: &str = "text/plain; charset=utf-8";

/// A file, its kind and its text.
macro_rules! files {
    ($($name:literal: $kind:expr),* $(,)?) => {
        &[$(($name, $kind, include_str!(concat!("web/", $name)))),*]
    };
}

const FILES: &[(&str, &str, &str)] = files![
    "index.html": HTML,
    "style.css": CSS,
    "icon.svg": SVG,
    "app.js": JS,
    "answers.js": JS,
    "parts.js": JS,
    "sending.js": JS,
    "boards.js": JS,
    "settings.js": JS,
    "keys.js": JS,
    "update.js": JS,
    "dashboard.js": JS,
    "configurator.js": JS,
    "card.js": JS,
    "moves.js": JS,
    "plots.js": JS,
    "doctor.js": JS,
    "bench.js": JS,
    "machine.js": JS,
    "jobs.js": JS,
    "files.js": JS,
    "vendor/preact-htm.js": JS,
    "vendor/uplot.js": JS,
    "vendor/uplot.css": CSS,
    "vendor/LICENSE-htm": PLAIN,
    "vendor/LICENSE-preact": PLAIN,
    "vendor/LICENSE-uplot": PLAIN,
];

/// The one page.
pub(super) async fn index() -> impl IntoResponse {
    file(Path("index.html".to_owned())).await
}

/// A file of it.
pub(super) async fn file(Path(name): Path<String>) -> Result<impl IntoResponse, Refusal> {
    let found = FILES.iter().find(|(known, _, _)| *known == name);
    let Some((_, kind, text)) = found else {
        return Err(missing().await);
    };
    Ok(([(CONTENT_TYPE, *kind)], *text))
}

/// No such file or answer.
pub(super) async fn missing() -> Refusal {
    Refusal::new(
        StatusCode::NOT_FOUND,
        "there is no such page; begin at the address that `ferrocnc ui` prints",
    )
}

#[cfg(test)]
mod tests {
    use super::FILES;

    fn text(name: &str) -> &'static str {
        let found = FILES.iter().find(|(known, _, _)| *known == name);
        found.unwrap_or_else(|| panic!("no {name}")).2
    }

    #[test]
    fn every_module_imports_what_is_there_and_nothing_from_outside() {
        for (name, kind, text) in FILES {
            if name.starts_with("vendor/") {
                continue;
            }
            assert!(!text.contains("https://"), "{name} names a server");
            if *kind != super::JS {
                continue;
            }
            for line in text.lines().filter(|line| line.contains(" from \"")) {
                let from = line.split('"').nth(1).expect("a module");
                self::text(from.trim_start_matches("./"));
            }
        }
    }

    #[test]
    fn the_vendored_files_are_those_that_their_readme_names() {
        use sha2::{Digest, Sha256};
        let readme = include_str!("web/vendor/README.md");
        for name in ["preact-htm.js", "uplot.js", "uplot.css"] {
            let sum: String = Sha256::digest(text(&format!("vendor/{name}")))
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect();
            let line = readme.lines().find(|line| line.contains(&sum));
            assert!(
                line.is_some_and(|line| line.contains(name)),
                "{sum} of {name} is not in vendor/README.md"
            );
        }
    }
}
