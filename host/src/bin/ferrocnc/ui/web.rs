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
    "boards.js": JS,
    "dashboard.js": JS,
    "configurator.js": JS,
    "card.js": JS,
    "doctor.js": JS,
    "bench.js": JS,
    "machine.js": JS,
    "jobs.js": JS,
    "files.js": JS,
    "vendor/preact-htm.js": JS,
    "vendor/LICENSE-htm": PLAIN,
    "vendor/LICENSE-preact": PLAIN,
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
    fn the_vendored_module_is_the_one_that_its_readme_names() {
        use sha2::{Digest, Sha256};
        let sum: String = Sha256::digest(text("vendor/preact-htm.js"))
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        let readme = include_str!("web/vendor/README.md");
        assert!(readme.contains(&sum), "{sum} is not in vendor/README.md");
    }
}
