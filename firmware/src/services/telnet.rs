//! Telnet's negotiation of options, as much of it as a line editor needs.
//!
//! ```text
//!   client                             board
//!   IAC DO SUPPRESS-GO-AHEAD   ---->   the client speaks telnet
//!                              <----   IAC WILL ECHO, IAC WILL SUPPRESS-GO-AHEAD
//!   IAC DO ECHO                ---->   the client sends each key, and the board echoes it
//! ```
//!
//! The board says nothing of its own accord: `nc` would print it, and a program would take it for
//! text. A client that begins to negotiate speaks telnet, as every telnet program does at port 23;
//! it is offered an echo once. One that does not want it, or never negotiates, edits its lines
//! itself and sends whole ones.
//!
//! An option changes as in RFC 1143: a request for what is already so is not answered, and only a
//! request is. So two ends that both follow it stop talking, whatever they want. Options that the
//! board does not know are refused each time they are requested.

use crate::text::Sink;

/// Interpret as command: the next byte is one. Twice: a byte of data.
pub const IAC: u8 = 255;
/// The other end should not use an option.
pub const DONT: u8 = 254;
/// The other end should use an option.
pub const DO: u8 = 253;
/// This end does not use an option.
pub const WONT: u8 = 252;
/// This end wants to use an option.
pub const WILL: u8 = 251;
/// Parameters of an option follow, up to [`SE`].
const SB: u8 = 250;
/// The user wants to erase the line, erase a character, interrupt the process.
const ERASE_LINE: u8 = 248;
const ERASE_CHARACTER: u8 = 247;
const INTERRUPT: u8 = 244;
/// End of parameters.
const SE: u8 = 240;

/// The option: the receiver of keys echoes them.
pub const ECHO: u8 = 1;
/// The option: each end may send at any time.
pub const SUPPRESS_GO_AHEAD: u8 = 3;

/// An option at one end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    No,
    /// This end has asked, and waits for the answer.
    Asked,
    Yes,
}

/// Where the next byte belongs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Parse {
    #[default]
    Data,
    Command,
    /// The option of this verb.
    Option(u8),
    Parameters,
    /// An [`IAC`] among parameters.
    ParametersCommand,
}

/// One client's options.
#[derive(Clone, Debug, Default)]
pub struct Telnet {
    parse: Parse,
    offered: bool,
    /// The board echoes.
    echo: State,
    /// The board suppresses its go-ahead.
    ahead: State,
    /// The client suppresses its own.
    client_ahead: State,
}

impl Telnet {
    /// No byte yet.
    pub const fn new() -> Self {
        Telnet {
            parse: Parse::Data,
            offered: false,
            echo: State::No,
            ahead: State::No,
            client_ahead: State::No,
        }
    }

    /// Has the client agreed that the board echoes? Then each key comes as it is pressed.
    pub fn echoes(&self) -> bool {
        self.echo == State::Yes
    }

    /// Takes one byte; returns the byte if it is data, or the control character that a command
    /// stands for. Answers go to `out`.
    pub fn push(&mut self, byte: u8, out: &mut dyn Sink) -> Option<u8> {
        match (self.parse, byte) {
            (Parse::Data, IAC) => self.parse = Parse::Command,
            (Parse::Data, _) => return Some(byte),
            (Parse::Command, WILL..=DONT) => self.parse = Parse::Option(byte),
            (Parse::Command, SB) => self.parse = Parse::Parameters,
            (Parse::Command, _) => {
                self.parse = Parse::Data;
                return match byte {
                    IAC => Some(IAC),
                    ERASE_CHARACTER => Some(0x7f),
                    ERASE_LINE => Some(0x15),
                    INTERRUPT => Some(0x03),
                    _ => None,
                };
            }
            (Parse::Option(verb), option) => {
                self.parse = Parse::Data;
                self.offer(out);
                self.negotiate(verb, option, out);
            }
            (Parse::Parameters, IAC) => self.parse = Parse::ParametersCommand,
            (Parse::Parameters, _) => {}
            (Parse::ParametersCommand, SE) => self.parse = Parse::Data,
            (Parse::ParametersCommand, _) => self.parse = Parse::Parameters,
        }
        None
    }

    /// Once: the board would like to echo.
    fn offer(&mut self, out: &mut dyn Sink) {
        if !core::mem::replace(&mut self.offered, true) {
            for (option, state) in [(ECHO, &mut self.echo), (SUPPRESS_GO_AHEAD, &mut self.ahead)] {
                *state = State::Asked;
                out.put(&[IAC, WILL, option]);
            }
        }
    }

    fn negotiate(&mut self, verb: u8, option: u8, out: &mut dyn Sink) {
        let ours = matches!(verb, DO | DONT);
        let (yes, no) = if ours { (WILL, WONT) } else { (DO, DONT) };
        let state = match option {
            ECHO if ours => &mut self.echo,
            SUPPRESS_GO_AHEAD if ours => &mut self.ahead,
            SUPPRESS_GO_AHEAD => &mut self.client_ahead,
            _ => {
                if matches!(verb, DO | WILL) {
                    out.put(&[IAC, no, option]);
                }
                return;
            }
        };
        let wanted = matches!(verb, DO | WILL);
        let answer = match (*state, wanted) {
            (State::No, true) => Some(yes),
            (State::Yes, false) => Some(no),
            // It is so already, or this is the answer.
            (State::No | State::Asked, false) | (State::Yes | State::Asked, true) => None,
        };
        *state = if wanted { State::Yes } else { State::No };
        if let Some(answer) = answer {
            out.put(&[IAC, answer, option]);
        }
    }
}

#[cfg(test)]
mod tests;
