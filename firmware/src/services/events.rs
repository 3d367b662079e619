//! What is worth a line of the log: changes of what the board says of itself, seen by looking at
//! its words from turn to turn. So the log needs nothing of the ROM, and misses what came and went
//! between two looks.

use super::journal::{Journal, Severity, Stamp};
use super::look::ask;
use crate::text::{Out, Paper};
use core::mem::replace;
use jobs::Outside;
use wire::describe::{BOOT_ID_AT, RESET_REASON_AT, address};
use wire::exchange::StateWord;
use wire::{FaultReason, ResetReason, State, map};

/// Words of the text of the last crash that are read at once.
const PIECE: usize = 16;

/// The last look.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    seen: Option<StateWord>,
    owner: u32,
    /// The start that has been logged.
    boot: Option<u32>,
    /// How much of the text of the last crash has been logged, and how much there is.
    obituary: Option<(u32, u32)>,
}

impl Watch {
    /// Nothing was seen.
    pub const fn new() -> Self {
        Watch {
            seen: None,
            owner: 0,
            boot: None,
            obituary: None,
        }
    }

    /// The start of the firmware, once it is known.
    pub fn boot(&self) -> Option<u32> {
        self.boot
    }

    /// Looks, and logs the first thing that has changed: true, and the others with the next looks.
    /// It asks for sixteen words at most.
    pub fn look(&mut self, stamp: Stamp, journal: &mut Journal, out: &mut impl Outside) -> bool {
        if self.boot.is_none() {
            self.started(stamp, journal, out);
            return self.boot.is_some();
        }
        if let Some((from, length)) = self.obituary {
            self.mourn(from, length, stamp, journal, out);
            return self.obituary != Some((from, length));
        }
        let Some([word, owner]) = ask([map::STATUS, map::SESSION_OWNER_IP], out) else {
            return false;
        };
        let Ok(now) = StateWord::from_word(word) else {
            return false;
        };
        let mut logged = |severity, pieces: &[&str]| line(journal, stamp, severity, pieces);
        if owner != self.owner {
            let mut room = [0; 48];
            let mut paper = Paper::new(&mut room);
            let mut text = Out(&mut paper);
            match owner {
                0 => text.text("no host drives the board any more"),
                owner => {
                    text.text("driven by ");
                    for (n, byte) in owner.to_be_bytes().into_iter().enumerate() {
                        text.text(if n == 0 { "" } else { "." }).number(byte.into());
                    }
                    &mut text
                }
            };
            let used = paper.used();
            let text = core::str::from_utf8(room.get(..used).unwrap_or(&[])).unwrap_or("");
            logged(Severity::Info, &[text]);
            self.owner = owner;
            return true;
        }
        let change = self.seen.get_or_insert(now).change(&now);
        if let Some((severity, pieces)) = change {
            logged(severity, &pieces);
        }
        change.is_some()
    }

    /// The firmware has started: why, and if it crashed, its last words.
    fn started(&mut self, stamp: Stamp, journal: &mut Journal, out: &mut impl Outside) {
        let at = [
            address(BOOT_ID_AT),
            address(RESET_REASON_AT),
            map::PANIC + 4,
        ];
        let Some([boot, why, length]) = ask(at, out) else {
            return;
        };
        self.boot = Some(boot);
        let stamp = Stamp { boot, ..stamp };
        // The services may have been loaded again within one start.
        let numbers = journal.numbers();
        let last = numbers.rev().find_map(|number| journal.entry(number));
        if last.is_some_and(|last| last.stamp.boot == boot) {
            return line(
                journal,
                stamp,
                Severity::Warning,
                &["services started again"],
            );
        }
        let reason = ResetReason::from_code(why as u8).unwrap_or(ResetReason::Unknown);
        let (severity, crashed) = match reason {
            ResetReason::PowerUp | ResetReason::Requested => (Severity::Info, false),
            ResetReason::Panic | ResetReason::Trap => (Severity::Error, true),
            ResetReason::Unknown => (Severity::Warning, false),
        };
        line(
            journal,
            stamp,
            severity,
            &["firmware started: ", reason.text()],
        );
        if crashed {
            self.obituary = Some((0, length.min(map::PANIC_TEXT_LEN)));
        }
    }

    /// A piece of the text of the last crash.
    fn mourn(
        &mut self,
        from: u32,
        length: u32,
        stamp: Stamp,
        journal: &mut Journal,
        out: &mut impl Outside,
    ) {
        let at = |n: usize| map::PANIC_TEXT + from + 4 * n as u32;
        let Some(words) = ask::<PIECE>(core::array::from_fn(at), out) else {
            return;
        };
        let mut bytes = [0; 4 * PIECE];
        wire::words_to_bytes(&words, &mut bytes);
        let here = bytes.len().min(length.saturating_sub(from) as usize);
        let mut room = [0; 4 * PIECE];
        let mut paper = Paper::new(&mut room);
        Out(&mut paper).ascii(bytes.get(..here).unwrap_or(&[]));
        let used = paper.used();
        let text = core::str::from_utf8(room.get(..used).unwrap_or(&[])).unwrap_or("");
        journal.log(stamp, Severity::Error, text);
        let from = from + 4 * PIECE as u32;
        self.obituary = (from < length).then_some((from, length));
    }
}

/// Logs a line of several pieces.
fn line(journal: &mut Journal, stamp: Stamp, severity: Severity, pieces: &[&str]) {
    let mut room = [0; super::journal::TEXT];
    let mut paper = Paper::new(&mut room);
    for piece in pieces {
        Out(&mut paper).text(piece);
    }
    let used = paper.used();
    let text = core::str::from_utf8(room.get(..used).unwrap_or(&[])).unwrap_or("");
    journal.log(stamp, severity, text);
}

/// What was seen, and follows the board one change at a time.
trait Follow {
    /// The first thing that is worth a line and different `now`.
    fn change(&mut self, now: &StateWord) -> Option<(Severity, [&'static str; 2])>;
}

impl Follow for StateWord {
    fn change(&mut self, now: &StateWord) -> Option<(Severity, [&'static str; 2])> {
        let last = replace(&mut self.state, now.state);
        if last != now.state {
            let reason = now.reason.text();
            let stopped = now.reason != FaultReason::None;
            match now.state {
                State::Boot => {}
                State::Armed => return Some((Severity::Notice, ["armed", ""])),
                State::Stopping => return Some((Severity::Warning, ["stopping: ", reason])),
                State::Faulted => return Some((Severity::Error, ["stopped: ", reason])),
                State::Disarmed if stopped && last != State::Faulted => {
                    return Some((Severity::Notice, ["disarmed: ", reason]));
                }
                State::Disarmed => return Some((Severity::Notice, ["disarmed", ""])),
            }
        }
        if replace(&mut self.position_trusted, now.position_trusted) && !now.position_trusted {
            let text = "positions are not trusted any more";
            return Some((Severity::Warning, [text, ""]));
        }
        if replace(&mut self.estop, now.estop) != now.estop {
            let text = ["e-stop cleared", "e-stop tripped"][usize::from(now.estop)];
            return Some((Severity::Warning, [text, ""]));
        }
        if replace(&mut self.link, now.link) != now.link {
            let text = ["link down", "link up"][usize::from(now.link)];
            return Some((Severity::Warning, [text, ""]));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::journal::BYTES;
    use super::*;
    use wire::describe::JobsState;
    use wire::{LinkSpeed, MAX_WORDS};

    const STAMP: Stamp = Stamp {
        boot: 9,
        uptime: 5,
        unix: None,
    };

    struct Board {
        state: StateWord,
        owner: u32,
        reset: ResetReason,
        obituary: &'static str,
    }

    impl Outside for Board {
        fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
            assert!(request.len() <= 4 + wire::GUEST_READS);
            for (place, at) in reply[4..].iter_mut().zip(&request[4..]) {
                *place = match *at {
                    map::STATUS => self.state.to_word(),
                    map::SESSION_OWNER_IP => self.owner,
                    at if at == address(BOOT_ID_AT) => 9,
                    at if at == address(RESET_REASON_AT) => self.reset as u32,
                    at if at == map::PANIC + 4 => self.obituary.len() as u32,
                    at => {
                        let from = (at - map::PANIC_TEXT) as usize;
                        let byte = |n: usize| self.obituary.as_bytes().get(from + n);
                        let bytes = [0, 1, 2, 3].map(|n| byte(n).copied().unwrap_or(0));
                        u32::from_be_bytes(bytes)
                    }
                };
            }
            request.len()
        }
        fn read_segments(&mut self, _: usize) -> u32 {
            0
        }
        fn write_segments(&mut self, _: usize, _: u32) {}
        fn now(&mut self) -> u64 {
            0
        }
    }

    fn board() -> Board {
        Board {
            state: StateWord {
                state: State::Disarmed,
                reason: FaultReason::None,
                position_trusted: true,
                enabled: false,
                session_yours: false,
                bitten: false,
                external_reset: false,
                accepted: false,
                link: true,
                estop: false,
                speed: LinkSpeed::M1000,
                services: JobsState::None,
                link_errors: 0,
            },
            owner: 0,
            reset: ResetReason::PowerUp,
            obituary: "",
        }
    }

    fn texts(journal: &Journal) -> Vec<String> {
        let entries = journal.numbers().filter_map(|n| journal.entry(n));
        entries.map(|entry| entry.text.to_owned()).collect()
    }

    #[test]
    fn every_change_is_a_line_and_no_change_is_none() {
        let mut memory = vec![0; BYTES];
        let mut journal = Journal::open(&mut memory);
        let (mut watch, mut board) = (Watch::new(), board());
        let mut look = |watch: &mut Watch, board: &mut Board| {
            for _ in 0..3 {
                watch.look(STAMP, &mut journal, board);
            }
        };
        look(&mut watch, &mut board);
        board.owner = 0xc0a8_0201;
        look(&mut watch, &mut board);
        board.state.state = State::Armed;
        look(&mut watch, &mut board);
        board.state.state = State::Faulted;
        board.state.reason = FaultReason::Watchdog;
        board.state.link = false;
        look(&mut watch, &mut board);
        board.state.state = State::Disarmed;
        board.owner = 0;
        look(&mut watch, &mut board);
        assert_eq!(
            texts(&journal),
            [
                "firmware started: power-up",
                "driven by 192.168.2.1",
                "armed",
                "stopped: watchdog: no accepted command within the timeout",
                "link down",
                "no host drives the board any more",
                "disarmed",
            ]
        );
    }

    #[test]
    fn the_last_words_of_a_crash_are_kept() {
        let mut memory = vec![0; BYTES];
        let mut journal = Journal::open(&mut memory);
        let (mut watch, mut board) = (Watch::new(), board());
        board.reset = ResetReason::Panic;
        board.obituary =
            "panicked at firmware/src/server.rs:100: a text of more than sixty-four bytes\n\x1b[2J";
        for _ in 0..10 {
            watch.look(STAMP, &mut journal, &mut board);
        }
        let texts = texts(&journal);
        assert_eq!(texts[0], "firmware started: firmware panic");
        let whole = board.obituary.replace(['\n', '\x1b'], ".");
        assert_eq!(texts[1..].concat(), whole);
    }

    #[test]
    fn services_that_come_again_say_so() {
        let mut memory = vec![0; BYTES];
        let mut journal = Journal::open(&mut memory);
        let mut board = board();
        for _ in 0..2 {
            let mut watch = Watch::new();
            watch.look(STAMP, &mut journal, &mut board);
            watch.look(STAMP, &mut journal, &mut board);
        }
        assert_eq!(
            texts(&journal),
            ["firmware started: power-up", "services started again"]
        );
    }
}
