//! `ferrocnc update` of a page: the request has the file, and the answer is told while it is done,
//! an object per line. An update goes on if the page is closed: a slot that is written half would
//! only have to be written again.

use crate::update::{Progress, Wanted};
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

/// Lines `{"step", "part"}`, `{"word"}`, and at the end `{"done", "text"}` or `{"error"}`.
pub(super) async fn update(Query(wanted): Query<Wanted>, bytes: Bytes) -> impl IntoResponse {
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
        let last = match wanted.take(&bytes, &say) {
            Ok(told) => json!({ "done": told.json, "text": told.text }),
            Err(error) => json!({ "error": format!("{error:#}") }),
        };
        // The page may have gone.
        let _ = sender.blocking_send(line(&last));
    });
    let body = Body::from_stream(ReceiverStream::new(receiver));
    ([(CONTENT_TYPE, "application/x-ndjson")], body)
}
