//! Reads a request as its bytes come, and keeps nothing of it but what is asked for.

/// Bytes of the first line that are read.
const LINE: usize = 128;
/// Bytes of a whole request that are read: browsers send some 500.
const WHOLE: u16 = 4096;

/// What the client wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// The page for people.
    Page,
    /// The same for programs.
    Json,
    /// The journal.
    Log,
    /// Something that there is not.
    Unknown,
    /// Something else than GET and HEAD.
    Method,
    /// No request at all, or one that is too long.
    Bad,
}

/// A request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// What is asked for.
    pub ask: Ask,
    /// The head of the answer is enough.
    pub head: bool,
    /// The client knows HTTP/1.1, and so an answer in pieces.
    pub pieces: bool,
}

/// Collects the bytes of a request.
#[derive(Clone, Debug)]
pub struct Reader {
    line: heapless::Vec<u8, LINE>,
    /// The first line is whole.
    ended: bool,
    /// The line that is read now has no byte yet.
    empty: bool,
    bytes: u16,
}

impl Default for Reader {
    fn default() -> Self {
        Self::new()
    }
}

impl Reader {
    /// No byte yet.
    pub const fn new() -> Self {
        Reader {
            line: heapless::Vec::new(),
            ended: false,
            empty: true,
            bytes: 0,
        }
    }

    /// Takes a byte; returns the request when it is whole, or is known to be none.
    pub fn push(&mut self, byte: u8) -> Option<Request> {
        const BAD: Request = Request {
            ask: Ask::Bad,
            head: false,
            pieces: false,
        };
        self.bytes = self.bytes.saturating_add(1);
        if self.bytes > WHOLE {
            return Some(BAD);
        }
        match byte {
            b'\r' => {}
            b'\n' if self.ended && self.empty => return Some(self.parse().unwrap_or(BAD)),
            // Empty lines before the first one are allowed.
            b'\n' => {
                self.ended |= !self.line.is_empty();
                self.empty = true;
                if self.ended && self.parse().is_none() {
                    return Some(BAD);
                }
            }
            _ if self.ended => self.empty = false,
            _ if self.line.push(byte).is_err() => return Some(BAD),
            _ => {}
        }
        None
    }

    fn parse(&self) -> Option<Request> {
        let line = core::str::from_utf8(&self.line).ok()?;
        let mut words = line.split(' ');
        let (method, target) = (words.next()?, words.next()?);
        let minor = words.next()?.strip_prefix("HTTP/1.")?;
        let token = |byte: u8| byte.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&byte);
        if words.next().is_some() || method.is_empty() || !method.bytes().all(token) {
            return None;
        }
        let pieces = match minor {
            "0" => false,
            "1" => true,
            _ => return None,
        };
        // A proxy's form names the host, too.
        let path = match target.strip_prefix("http://") {
            Some(rest) => rest.find('/').and_then(|at| rest.get(at..)).unwrap_or("/"),
            None => target,
        };
        if !path.starts_with('/') {
            return None;
        }
        let (path, _) = path.split_once('?').unwrap_or((path, ""));
        let ask = match (method, path) {
            ("GET" | "HEAD", "/" | "/index.html") => Ask::Page,
            ("GET" | "HEAD", "/status.json") => Ask::Json,
            ("GET" | "HEAD", "/log") => Ask::Log,
            ("GET" | "HEAD", _) => Ask::Unknown,
            _ => Ask::Method,
        };
        Some(Request {
            ask,
            head: method == "HEAD",
            pieces,
        })
    }
}
