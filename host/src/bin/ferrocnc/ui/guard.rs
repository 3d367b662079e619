//! Which requests are answered. A page of another origin can send requests to 127.0.0.1, and a name
//! of its own can point there (DNS rebinding). So the address must be ours, a page that asks must
//! be ours, and it must know a token that was made for this run.
//!
//! The token is the first part of the path. A cookie would go to every server of this computer,
//! whatever its port.

use super::answer::Refusal;
use anyhow::{Context, Result};
use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

/// 128 random bits: beyond guessing.
const TOKEN_BYTES: usize = 16;

/// On each answer: nothing from elsewhere, no frame around it, no trace of the token.
const HEADERS: [(HeaderName, &str); 5] = [
    (
        CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
         connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (REFERRER_POLICY, "no-referrer"),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (CACHE_CONTROL, "no-store"),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
];

/// What a request must know.
#[derive(Clone, Debug)]
pub(super) struct Guard(Arc<Secret>);

#[derive(Debug)]
struct Secret {
    token: String,
    port: u16,
}

impl Guard {
    /// A new token for the server at this port.
    pub(super) fn new(port: u16) -> Result<Self> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes).context("this computer has no random numbers for the token")?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Guard(Arc::new(Secret { token, port })))
    }

    pub(super) fn token(&self) -> &str {
        &self.0.token
    }

    /// The address to open.
    pub(super) fn address(&self, board: Option<&str>) -> String {
        let page = board.map_or(String::new(), |board| format!("#dashboard/{board}"));
        format!("http://127.0.0.1:{}/{}/{page}", self.0.port, self.0.token)
    }

    /// Why a request is refused, if it is.
    fn refusal(&self, headers: &HeaderMap, path: &str) -> Option<&'static str> {
        let is = |name: &HeaderName, wanted: &dyn Fn(&str) -> bool| {
            let mut all = headers.get_all(name).iter();
            let one = all.next().and_then(|value| value.to_str().ok());
            one.is_some_and(wanted) && all.next().is_none()
        };
        let ours = |host: &str| {
            let port = self.0.port;
            host == format!("127.0.0.1:{port}") || host == format!("localhost:{port}")
        };
        if !is(&HOST, &ours) {
            return Some("this server has no such name; use the address that `ferrocnc ui` prints");
        }
        let origin = |origin: &str| origin.strip_prefix("http://").is_some_and(ours);
        if headers.contains_key(ORIGIN) && !is(&ORIGIN, &origin) {
            return Some("a page of another origin may not ask");
        }
        let token = path.trim_start_matches('/').split('/').next();
        if !token.is_some_and(|token| same(token, &self.0.token)) {
            return Some(
                "the address does not have the token of this run; use the one that `ferrocnc ui` prints",
            );
        }
        None
    }
}

/// Compares in a time that does not tell where they differ.
fn same(a: &str, b: &str) -> bool {
    let pairs = a.bytes().zip(b.bytes());
    a.len() == b.len() && pairs.fold(0, |all, (a, b)| all | (a ^ b)) == 0
}

/// Lets a request through, or refuses it.
pub(super) async fn admit(State(guard): State<Guard>, request: Request, next: Next) -> Response {
    let mut answer = match guard.refusal(request.headers(), request.uri().path()) {
        Some(why) => Refusal::new(StatusCode::FORBIDDEN, why).into_response(),
        None => next.run(request).await,
    };
    for (name, value) in HEADERS {
        answer
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(guard: &Guard, headers: &[(&HeaderName, &str)], path: &str) -> bool {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append((*name).clone(), value.parse().unwrap());
        }
        guard.refusal(&map, path).is_some()
    }

    #[test]
    fn only_our_own_page_with_the_token_is_let_in() {
        let guard = Guard::new(8080).unwrap();
        let path = format!("/{}/api/discover", guard.token());
        let host = (&HOST, "127.0.0.1:8080");
        let let_in = |headers: &[(&HeaderName, &str)]| !refused(&guard, headers, &path);
        assert!(let_in(&[host]));
        assert!(let_in(&[(&HOST, "localhost:8080")]));
        assert!(let_in(&[host, (&ORIGIN, "http://127.0.0.1:8080")]));
        assert!(!let_in(&[]));
        assert!(!let_in(&[host, host]));
        for name in [
            "127.0.0.1",
            "127.0.0.1:80",
            "evil.example:8080",
            "[::1]:8080",
        ] {
            assert!(!let_in(&[(&HOST, name)]), "{name}");
        }
        for origin in [
            "null",
            "http://evil.example",
            "https://127.0.0.1:8080",
            "http://127.0.0.1:1",
        ] {
            assert!(!let_in(&[host, (&ORIGIN, origin)]), "{origin}");
        }
        for path in [
            "",
            "/",
            "/api/discover",
            &path[..20],
            "//",
            &path.to_uppercase(),
        ] {
            assert!(refused(&guard, &[host], path), "{path}");
        }
    }

    #[test]
    fn every_run_has_a_token_of_its_own() {
        let [a, b] = [1, 2].map(|port| Guard::new(port).unwrap());
        assert_ne!(a.token(), b.token());
        assert_eq!(a.token().len(), 2 * TOKEN_BYTES);
    }
}
