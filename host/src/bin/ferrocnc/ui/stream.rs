//! Commands of a page that take long: the request has the file, and the answer is told while they
//! work, an object per line. A command goes on if the page is closed: what is written half would
//! only have to be written again.

use crate::progress::Progress;
use crate::text::Told;
use crate::{config, update};
use anyhow::Result;
use axum::body::{Body, Bytes};
use axum::extract::Query;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use serde_json::{Value, json};
use std::cell::Cell;
use std::convert::Infallible;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::channel;
use tokio_stream::wrappers::ReceiverStream;

/// Lines that a page may be late with. What it does not take is not waited for: the last line only.
const WAITING: usize = 16;
/// Between two lines of progress, as often as `watch` looks.
const EVERY: Duration = Duration::from_millis(200);

/// `ferrocnc update`.
pub(super) async fn update(
    Query(wanted): Query<update::Wanted>,
    bytes: Bytes,
) -> impl IntoResponse {
    told(move |say| wanted.take(&bytes, say))
}

/// `ferrocnc config apply` of a board file that is only on the page.
pub(super) async fn config_apply(
    Query(wanted): Query<config::Applied>,
    toml: String,
) -> impl IntoResponse {
    told(move |say| wanted.take(&toml, say))
}

/// Lines `{"step", "part"}`, `{"word"}`, and at the end `{"done", "text"}` or `{"error"}`.
fn told(
    work: impl FnOnce(&dyn Fn(Progress)) -> Result<Told> + Send + 'static,
) -> impl IntoResponse {
    let (sender, receiver) = channel::<Result<String, Infallible>>(WAITING);
    tokio::task::spawn_blocking(move || {
        let line = |value: &Value| Ok(format!("{value}\n"));
        let told = Cell::new(None::<(&str, Instant)>);
        let say = |progress| {
            let value = match progress {
                Progress::Step(step, part) => {
                    let before = told.get();
                    if before.is_some_and(|(it, at)| it == step && at.elapsed() < EVERY) {
                        return;
                    }
                    told.set(Some((step, Instant::now())));
                    json!({ "step": step, "part": part })
                }
                Progress::Word(word) => json!({ "word": word }),
            };
            let _ = sender.try_send(line(&value));
        };
        let last = match work(&say) {
            Ok(told) => json!({ "done": told.json, "text": told.text }),
            Err(error) => json!({ "error": format!("{error:#}") }),
        };
        // The page may have gone.
        let _ = sender.blocking_send(line(&last));
    });
    let body = Body::from_stream(ReceiverStream::new(receiver));
    ([(CONTENT_TYPE, "application/x-ndjson")], body)
}
