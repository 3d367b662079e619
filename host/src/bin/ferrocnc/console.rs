//! `ferrocnc console`: connects to the board's debug console over TCP, interactively or for one
//! command.

use anyhow::{Context, Result, bail};
use ferrocnc::address::Address;
use ferrocnc::keys::KeyError;
use serde_json::json;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::Duration;

/// The prompt of the board.
const PROMPT: &str = "ferrocnc> ";
/// A board answers in milliseconds, a simulated one in seconds.
const PATIENCE: Duration = Duration::from_secs(20);
/// A healthy board hangs up within a round trip.
const FAREWELL: Duration = Duration::from_secs(2);

pub(crate) fn run(address: &Address, command: Option<&str>, as_json: bool) -> Result<()> {
    let stream = TcpStream::connect_timeout(&SocketAddr::V4(address.socket), PATIENCE)
        .with_context(|| format!("no console at {}; check address and port", address.socket))?;
    match command {
        Some(command) => {
            let mut line = TelnetLine::new(stream)?;
            let mut answer = line.ask(command)?;
            // Only a command that needs the key asks for it: a command that only reads costs no
            // extra time.
            if answer.starts_with(REFUSED) && line.login()? == Login::Welcome {
                answer = line.ask(command)?;
            }
            line.hang_up();
            let mut out = std::io::stdout().lock();
            if as_json {
                writeln!(out, "{}", json!({ "command": command, "answer": answer }))?;
            } else {
                writeln!(out, "{}", answer.trim_end())?;
            }
            Ok(())
        }
        None if as_json => bail!("--json needs a command: -c status"),
        None => talk(stream),
    }
}

/// How the board refuses a command that needs the key.
const REFUSED: &str = "refused: the board has a key";

/// How a login went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Login {
    Welcome,
    /// The board has no key.
    Needless,
    /// Its firmware is older than keys.
    Unknown,
}

/// A console, line by line.
struct TelnetLine {
    stream: TcpStream,
    greeted: bool,
}

impl TelnetLine {
    fn new(stream: TcpStream) -> Result<Self> {
        stream.set_read_timeout(Some(PATIENCE))?;
        Ok(TelnetLine {
            stream,
            greeted: false,
        })
    }

    /// One line there, its answer back. The line goes out before the greeting has come in: a
    /// simulated board's time only passes while it has something to do.
    fn ask(&mut self, command: &str) -> Result<String> {
        let line = format!("{}\r\n", command.trim());
        self.stream.write_all(line.as_bytes())?;
        // Behind the first answer the greeting is gone, and one prompt is enough.
        let mut text = match self.greeted {
            true => PROMPT.as_bytes().to_vec(),
            false => Vec::new(),
        };
        let before = text.len();
        let mut buffer = [0; 1024];
        loop {
            match self.stream.read(&mut buffer) {
                Ok(0) if text.len() == before => {
                    bail!("the board closed the console; it may have no place left")
                }
                Ok(0) => break,
                Ok(length) => text.extend_from_slice(&buffer[..length]),
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                {
                    bail!("the console said nothing for {} s", PATIENCE.as_secs())
                }
                Err(error) => return Err(error).context("the console's connection broke"),
            }
            if answered(&text).is_some() {
                break;
            }
        }
        self.greeted = true;
        let answer = answered(&text).unwrap_or(&text);
        Ok(String::from_utf8_lossy(answer).replace('\r', ""))
    }

    /// Shows the board that we have its key: every one it may have in turn, each for a challenge of
    /// its own.
    fn login(&mut self) -> Result<Login> {
        let mut left = None;
        let mut tried = Vec::new();
        loop {
            let said = self.ask("login")?;
            let Some((challenge, uid)) = challenge(&said) else {
                return Ok(Login::Unknown);
            };
            if challenge == wire::auth::NONE {
                return Ok(Login::Needless);
            }
            let keys = crate::keys();
            if left.is_none() {
                left = Some(keys.find(uid)?.into_iter());
            }
            let Some((key, path)) = left.as_mut().and_then(Iterator::next) else {
                return Err(KeyError::Wrong(tried).into());
            };
            let answer = key.login(challenge).map(|word| format!("{word:08x}"));
            let said = self.ask(&format!("login {}", answer.concat()))?;
            if said.trim() == "welcome" {
                keys.accepted(uid, &path);
                return Ok(Login::Welcome);
            }
            tried.push(path);
        }
    }

    /// The board has one line for one user: free it, and see it freed, before the next one dials.
    /// We close first (no `quit`): the side that closes first has to remember the connection for a
    /// while, and the board has no second one.
    fn hang_up(&mut self) {
        // The answer has arrived; an error while closing does no harm.
        let _ = self.stream.shutdown(Shutdown::Write);
        let _ = self.stream.set_read_timeout(Some(FAREWELL));
        let mut rest = [0; 256];
        while let Ok(1..) = self.stream.read(&mut rest) {}
    }
}

/// What `login` prints: the challenge and the board's id.
fn challenge(said: &str) -> Option<([u32; wire::auth::WORDS], [u32; 2])> {
    let digits = said.trim().strip_prefix("challenge ")?;
    let mut words = [0; wire::auth::WORDS + 2];
    if digits.len() != 8 * words.len() || !digits.is_ascii() {
        return None;
    }
    for (n, word) in words.iter_mut().enumerate() {
        *word = u32::from_str_radix(&digits[8 * n..][..8], 16).ok()?;
    }
    let [a, b, c, d, hi, lo] = words;
    Some(([a, b, c, d], [hi, lo]))
}

/// The text between the greeting's prompt and the prompt after the answer.
fn answered(text: &[u8]) -> Option<&[u8]> {
    let prompt = PROMPT.as_bytes();
    let text = text.strip_prefix(prompt).unwrap_or(text);
    text.strip_suffix(prompt)
}

/// Keyboard there, board back, until either ends.
fn talk(stream: TcpStream) -> Result<()> {
    let mut line = TelnetLine::new(stream)?;
    match line.login() {
        Ok(Login::Welcome) => eprintln!("logged in with the board's key"),
        Ok(Login::Needless | Login::Unknown) => {}
        // Reading needs no key.
        Err(error) => eprintln!("{error:#}; without the key this console can only read"),
    }
    let stream = line.stream;
    stream.set_read_timeout(None)?;
    print!("{PROMPT}");
    std::io::stdout().flush()?;
    let mut to_board = stream.try_clone()?;
    std::thread::spawn(move || {
        // The other direction reports a broken connection.
        let _ = std::io::copy(&mut std::io::stdin(), &mut to_board);
        let _ = to_board.shutdown(Shutdown::Write);
    });
    let mut stream = stream;
    let mut out = std::io::stdout();
    let mut buffer = [0; 1024];
    loop {
        match stream.read(&mut buffer).context("the connection broke")? {
            0 => return Ok(()),
            length => {
                out.write_all(&buffer[..length])?;
                out.flush()?;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{answered, challenge};

    #[test]
    fn an_answer_ends_with_the_second_prompt() {
        assert_eq!(answered(b"ferrocnc> "), None);
        assert_eq!(answered(b"ferrocnc> state arm"), None);
        assert_eq!(
            answered(b"ferrocnc> state\r\nferrocnc> "),
            Some(&b"state\r\n"[..])
        );
        assert_eq!(answered(b"state\r\nferrocnc> "), Some(&b"state\r\n"[..]));
    }

    #[test]
    fn a_challenge_is_four_words_and_the_boards_id() {
        let said = "challenge 00000001000000020000000300000004d1620c8a1b2c3d4e\n";
        let read = Some(([1, 2, 3, 4], [0xd162_0c8a, 0x1b2c_3d4e]));
        assert_eq!(challenge(said), read);
        for wrong in [
            "? try help",
            "challenge ",
            &said[..said.len() - 2],
            &said.replace('d', "x"),
        ] {
            assert_eq!(challenge(wrong), None, "{wrong}");
        }
    }
}
