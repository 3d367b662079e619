//! The status page: HTTP/1.1 on port 80, GET and HEAD only.
//!
//! ```text
//!   /             a page for people, which looks again once a second by itself
//!   /status.json  the same for programs
//!   /log          the journal as text
//! ```
//!
//! Nothing can be changed here. A connection has one request. Of that, only the first line is kept;
//! one that is longer than 128 bytes, or a request longer than 4096 bytes or slower than five
//! seconds, ends the connection. An answer is made in pieces while it is sent ([`page`]): a turn
//! makes one, of no more steps than there is time for. While a host moves the machine a piece is
//! one step; while there is no time even for that, the answer is 503, *busy*, and says when to come
//! again.

pub mod form;
pub mod page;
pub mod request;

use self::form::{PIECE, Piece};
use self::page::{Cursor, PageSource};
use self::request::{Ask, Reader, Request};
use crate::text::{Out, Sink};
use jobs::Outside;

/// Around a piece: its length in eight digits and two ends of a line; behind the last one a piece
/// of no bytes.
const FRAMING: usize = 8 + 2 + 2 + 5;
/// Bytes that [`Connection::turn`] writes at most.
pub const TURN_MAX: usize = PIECE + FRAMING;
/// A request has to be whole within this time.
const REQUEST_MS: u32 = 5000;
/// A client has to take the whole answer within this time.
const ANSWER_MS: u32 = 30_000;

/// How much time the machine leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// No host moves it: a turn may take some 50 000 clocks.
    Rest,
    /// A host moves it: small pieces.
    Moving,
    /// There is no time at all.
    Busy,
}

/// What came of a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Nothing to do.
    Idle,
    /// Bytes were written, and more follow.
    Wrote,
    /// The end: close the connection behind what was written.
    Close,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Reading,
    /// The head of the answer is next.
    Heading(Request),
    /// Its content.
    Content(Request),
    Over,
}

/// A client.
#[derive(Clone, Debug)]
pub struct Connection {
    reader: Reader,
    stage: Stage,
    cursor: Cursor,
    since: u32,
}

impl Default for Connection {
    fn default() -> Self {
        Self::new()
    }
}

/// A short answer: its status, a header of its own, and its text.
fn short(ask: Ask, load: Load) -> Option<(&'static str, &'static str, &'static str)> {
    Some(match ask {
        Ask::Bad => ("400 Bad Request", "", "this is no request\n"),
        Ask::Method => (
            "405 Method Not Allowed",
            "Allow: GET, HEAD\r\n",
            "only GET and HEAD: nothing can be changed here\n",
        ),
        Ask::Unknown => ("404 Not Found", "", "there are /, /status.json and /log\n"),
        Ask::Page | Ask::Json | Ask::Log => match load {
            Load::Rest | Load::Moving => return None,
            Load::Busy => (
                "503 Service Unavailable",
                "Retry-After: 2\r\n",
                "busy: the machine needs the time\n",
            ),
        },
    })
}

/// The page loads nothing from elsewhere, and no other page has it in a frame.
const HEADERS: &str = "Connection: close\r\nCache-Control: no-store\r\n\
    X-Content-Type-Options: nosniff\r\n\
    Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; \
    script-src 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'\r\n";

impl Connection {
    /// A client that has said nothing.
    pub const fn new() -> Self {
        Connection {
            reader: Reader::new(),
            stage: Stage::Reading,
            cursor: Cursor::START,
            since: 0,
        }
    }

    /// A client has connected at this time, in milliseconds.
    pub fn open(&mut self, now: u32) {
        *self = Connection {
            since: now,
            ..Connection::new()
        };
    }

    /// Takes bytes; returns how many. What comes behind the request is dropped.
    pub fn take(&mut self, bytes: &[u8], now: u32) -> usize {
        if self.stage != Stage::Reading {
            return bytes.len();
        }
        for byte in bytes {
            if let Some(request) = self.reader.push(*byte) {
                self.stage = Stage::Heading(request);
                self.since = now;
                break;
            }
        }
        bytes.len()
    }

    /// Has the client, or its line, been too slow? Then the connection is to be dropped.
    pub fn late(&self, now: u32) -> bool {
        let passed = now.wrapping_sub(self.since);
        match self.stage {
            Stage::Reading => passed >= REQUEST_MS,
            Stage::Heading(_) | Stage::Content(_) | Stage::Over => passed >= ANSWER_MS,
        }
    }

    /// Is there an answer to be written?
    pub fn answers(&self) -> bool {
        matches!(self.stage, Stage::Heading(_) | Stage::Content(_))
    }

    /// Writes the next piece of the answer into `sink`, which has room for [`TURN_MAX`] bytes.
    pub fn turn(
        &mut self,
        source: &PageSource,
        load: Load,
        sink: &mut dyn Sink,
        out: &mut impl Outside,
    ) -> Turn {
        match self.stage {
            Stage::Reading => Turn::Idle,
            Stage::Over => Turn::Close,
            Stage::Heading(request) => {
                self.cursor = Cursor::new(source.journal);
                let content = heading(&request, load, sink);
                self.stage = match content {
                    true => Stage::Content(request),
                    false => Stage::Over,
                };
                if content { Turn::Wrote } else { Turn::Close }
            }
            Stage::Content(request) => {
                let mut piece = Piece::new();
                let one_step = load != Load::Rest;
                self.cursor
                    .fill(request.ask, one_step, source, &mut piece, out);
                let done = self.cursor.done();
                put(&request, piece.bytes(), done, sink);
                if done {
                    self.stage = Stage::Over;
                }
                if done { Turn::Close } else { Turn::Wrote }
            }
        }
    }
}

/// Writes the head, and a short answer whole. True if content follows.
fn heading(request: &Request, load: Load, sink: &mut dyn Sink) -> bool {
    let mut out = Out(sink);
    if let Some((status, header, text)) = short(request.ask, load) {
        out.text("HTTP/1.1 ").text(status).text("\r\n");
        out.text("Connection: close\r\nContent-Type: text/plain\r\nContent-Length: ");
        out.number(text.len() as u32).text("\r\n");
        out.text(header).text("\r\n");
        out.text(if request.head { "" } else { text });
        return false;
    }
    let kind = match request.ask {
        Ask::Page => "text/html; charset=utf-8",
        Ask::Json => "application/json",
        Ask::Log | Ask::Unknown | Ask::Method | Ask::Bad => "text/plain; charset=utf-8",
    };
    out.text("HTTP/1.1 200 OK\r\nContent-Type: ").text(kind);
    out.text("\r\n").text(HEADERS);
    let pieces = "Transfer-Encoding: chunked\r\n";
    out.text(if request.pieces { pieces } else { "" })
        .text("\r\n");
    !request.head
}

/// Writes a piece of the content, with its length before it if the client knows that form.
fn put(request: &Request, bytes: &[u8], last: bool, sink: &mut dyn Sink) {
    if !request.pieces {
        return sink.put(bytes);
    }
    if !bytes.is_empty() {
        Out(sink).hex(bytes.len() as u32).text("\r\n");
        sink.put(bytes);
        sink.put(b"\r\n");
    }
    if last {
        sink.put(b"0\r\n\r\n");
    }
}

#[cfg(test)]
mod tests;
