//! What a board is doing, as server-sent events: the event `line` has what `watch --json` or
//! `log --json` prints; `away` says why nothing comes, until it comes again by itself.

use super::api::At;
use crate::log::{self, Said};
use crate::{job, watch};
use anyhow::{Result, bail};
use axum::extract::Query;
use axum::response::sse::{Event, KeepAlive, KeepAliveStream, Sse};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio_stream::wrappers::ReceiverStream;

/// Between two looks at a board: five a second, as `ferrocnc watch` does.
const LOOK: Duration = Duration::from_millis(200);
/// Before a board that did not answer is asked again.
const PAUSE: Duration = Duration::from_millis(500);
/// A page that does not take so many events has gone or sleeps; looks wait for it.
const WAITING: usize = 16;

/// Events for a page.
pub(super) type Events = Sse<KeepAliveStream<ReceiverStream<Result<Event, Infallible>>>>;

/// Where a command puts its lines.
pub(super) struct Page(Sender<Result<Event, Infallible>>);

impl Page {
    /// An error if the page has gone.
    pub(super) fn send(&self, kind: &str, value: &Value) -> Result<()> {
        let event = Event::default().event(kind).data(value.to_string());
        Ok(self.0.blocking_send(Ok(event))?)
    }

    fn is_gone(&self) -> bool {
        self.0.is_closed()
    }
}

/// `ferrocnc watch BOARD`.
pub(super) async fn watch(Query(at): Query<At>) -> Events {
    stream(move |page| {
        let mut client = crate::open(&at.board)?;
        watch::each(&mut client, LOOK, |look, identity| {
            page.send("line", &look.to_json(identity))
        })
    })
}

/// `ferrocnc log BOARD --follow`.
pub(super) async fn log(Query(at): Query<At>) -> Events {
    stream(move |page| {
        let mut client = crate::open(&at.board)?;
        log::each(
            &mut client,
            &log::Texts::default(),
            true,
            |said| match said {
                Said::Line(frame) => page.send("line", &log::to_json(frame)),
                Said::Note(note) => page.send("note", &json!({ "note": note })),
                Said::Looked if page.is_gone() => bail!("the page has gone"),
                Said::Looked => Ok(()),
            },
        )
    })
}

/// `ferrocnc job watch BOARD`; it keeps a job going that was started from the page.
pub(super) async fn jobs(Query(at): Query<At>) -> Events {
    stream(move |page| {
        let mut board = job::open(&at.board)?;
        loop {
            page.send("line", &job::look(&mut board)?)?;
            std::thread::sleep(LOOK);
        }
    })
}

/// Repeats a command that only ends with an error, until the page has gone.
pub(super) fn stream(mut command: impl FnMut(&Page) -> Result<()> + Send + 'static) -> Events {
    let (sender, receiver): (_, Receiver<_>) = channel(WAITING);
    tokio::task::spawn_blocking(move || {
        let page = Page(sender);
        loop {
            let Err(error) = command(&page) else { return };
            let away = json!({ "error": format!("{error:#}") });
            if page.is_gone() || page.send("away", &away).is_err() {
                return;
            }
            std::thread::sleep(PAUSE);
        }
    });
    Sse::new(ReceiverStream::new(receiver)).keep_alive(KeepAlive::default())
}
