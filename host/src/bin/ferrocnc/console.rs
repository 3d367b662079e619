//! `ferrocnc console`: the board's debug console over TCP, for hands or for one command.

use anyhow::{Context, Result, bail};
use ferrocnc::address::Address;
use serde_json::json;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::Duration;

/// What the board says when it wants a line.
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
            let answer = ask(stream, command)?;
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

/// One line there, its answer back. The line goes out before the greeting has come in: a simulated
/// board's time only passes while it has something to do.
fn ask(mut stream: TcpStream, command: &str) -> Result<String> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.write_all(format!("{}\r\n", command.trim()).as_bytes())?;
    let mut text = Vec::new();
    let mut buffer = [0; 1024];
    loop {
        match stream.read(&mut buffer) {
            Ok(0) if text.is_empty() => bail!("the board closed the console; one user at a time"),
            Ok(0) => break,
            Ok(length) => text.extend_from_slice(&buffer[..length]),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                bail!("the console said nothing for {} s", PATIENCE.as_secs())
            }
            Err(error) => return Err(error).context("the console's connection broke"),
        }
        if answered(&text).is_some() {
            break;
        }
    }
    hang_up(&mut stream);
    let answer = answered(&text).unwrap_or(&text);
    Ok(String::from_utf8_lossy(answer).replace('\r', ""))
}

/// The board has one line for one user: free it, and see it freed, before the next one dials. We close
/// first (no `quit`): whoever closes first has to remember the connection for a while, and the board
/// has no second one.
fn hang_up(stream: &mut TcpStream) {
    // The answer is in; a farewell that fails harms nobody.
    let _ = stream.shutdown(Shutdown::Write);
    let _ = stream.set_read_timeout(Some(FAREWELL));
    let mut rest = [0; 256];
    while let Ok(1..) = stream.read(&mut rest) {}
}

/// What stands between the greeting's prompt and the one after the answer.
fn answered(text: &[u8]) -> Option<&[u8]> {
    let prompt = PROMPT.as_bytes();
    let text = text.strip_prefix(prompt).unwrap_or(text);
    text.strip_suffix(prompt)
}

/// Keyboard there, board back, until either ends.
fn talk(stream: TcpStream) -> Result<()> {
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
    use super::answered;

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
}
