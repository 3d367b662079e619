//! What a line means.

use crate::auth::Words;

/// What a line means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// The list of commands.
    Help,
    /// State, session, memory.
    Status,
    /// Frame and refusal counters.
    Net,
    /// All pages, or one.
    Regs(Option<u8>),
    /// All stepgens, or one.
    Stepgen(Option<u8>),
    /// All encoders, or one.
    Encoder(Option<u8>),
    /// All PWMs, or one.
    Pwm(Option<u8>),
    /// Inputs.
    Gpio,
    /// The watchdog.
    Watchdog,
    /// Log and last panic.
    Log,
    /// The Ethernet link.
    Link,
    /// The flash and its images.
    Flash,
    /// The settings in force.
    Settings,
    /// A challenge, or the answer to one.
    Login(Option<Words>),
    /// Something about jobs: the whole line says what.
    Job,
    /// Restart the firmware.
    Restart,
    /// Hang up.
    Quit,
    /// An empty line.
    Nothing,
    /// A line that was cut off.
    TooLong,
    /// Anything else.
    Unknown,
}

impl Ask {
    /// Reads a line. It never fails; a line may be [`Ask::Unknown`].
    pub fn parse(line: &str) -> Ask {
        let mut words = line.split_ascii_whitespace();
        let Some(command) = words.next() else {
            return Ask::Nothing;
        };
        if command == "job" {
            return Ask::Job;
        }
        let argument = words.next();
        if words.next().is_some() {
            return Ask::Unknown;
        }
        if command == "login" {
            return match argument.map(hex_words) {
                None => Ask::Login(None),
                Some(Some(answer)) => Ask::Login(Some(answer)),
                Some(None) => Ask::Unknown,
            };
        }
        let number = match argument.map(str::parse::<u8>) {
            None => None,
            Some(Ok(number)) => Some(number),
            Some(Err(_)) => return Ask::Unknown,
        };
        let ask = match command {
            "regs" => return Ask::Regs(number),
            "stepgen" => return Ask::Stepgen(number),
            "encoder" => return Ask::Encoder(number),
            "pwm" => return Ask::Pwm(number),
            "help" | "?" => Ask::Help,
            "status" => Ask::Status,
            "net" => Ask::Net,
            "gpio" => Ask::Gpio,
            "watchdog" => Ask::Watchdog,
            "log" => Ask::Log,
            "link" => Ask::Link,
            "flash" => Ask::Flash,
            "settings" => Ask::Settings,
            "restart" => Ask::Restart,
            "quit" | "exit" => Ask::Quit,
            _ => Ask::Unknown,
        };
        if number.is_some() { Ask::Unknown } else { ask }
    }
}

/// 32 hex digits.
pub(super) fn hex_words(text: &str) -> Option<Words> {
    let mut words = Words::default();
    let (chunks, []) = text.as_bytes().as_chunks::<8>() else {
        return None;
    };
    if chunks.len() != words.len() {
        return None;
    }
    for (word, digits) in words.iter_mut().zip(chunks) {
        for digit in digits {
            *word = *word << 4 | char::from(*digit).to_digit(16)?;
        }
    }
    Some(words)
}
