//! What can be wrong with a board, as numbers for the pin `fault-code` and as words for the
//! operator: the one table of both. The reasons that the board itself says are
//! [`wire::FaultReason`]'s, with its numbers and words; from 16 on follow those that only this
//! computer knows.
//!
//! The driver's messages take their remedies from here, and `ferrocnc panel` writes operator panels
//! from it.

use wire::FaultReason;

/// Numbers of the board's own reasons are below: they have four bits on the wire.
const OURS: u32 = 16;

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The board stopped by itself, or nothing is wrong.
    Board(FaultReason),
    /// The board does not answer.
    Silent,
    /// The servo thread came later than the watchdog waits.
    HeldUp,
    /// The board has restarted.
    Restarted,
    /// Something else answers at its address.
    Stranger,
    /// Another host drives it.
    Owned,
    /// It refuses its settings.
    Settings,
    /// `write` is called without `read`.
    Unread,
    /// Functions of one board are in two threads.
    Collided,
    /// Datagrams without end.
    Flooded,
    /// Another board of the group has stopped.
    Group,
    /// The driver has halted.
    Halted,
}

impl Fault {
    /// Those that only this computer knows, by their numbers.
    const KNOWN_HERE: [Fault; 11] = [
        Fault::Silent,
        Fault::HeldUp,
        Fault::Restarted,
        Fault::Stranger,
        Fault::Owned,
        Fault::Settings,
        Fault::Unread,
        Fault::Collided,
        Fault::Flooded,
        Fault::Group,
        Fault::Halted,
    ];

    /// All of them, by their numbers.
    pub fn all() -> impl Iterator<Item = Fault> {
        let boards = FaultReason::ALL.iter().map(|reason| Fault::Board(*reason));
        boards.chain(Fault::KNOWN_HERE)
    }

    /// The number on the pin `fault-code`; below 32.
    pub const fn code(self) -> u32 {
        match self {
            Fault::Board(reason) => reason.code() as u32,
            Fault::Silent => OURS,
            Fault::HeldUp => OURS + 1,
            Fault::Restarted => OURS + 2,
            Fault::Stranger => OURS + 3,
            Fault::Owned => OURS + 4,
            Fault::Settings => OURS + 5,
            Fault::Unread => OURS + 6,
            Fault::Collided => OURS + 7,
            Fault::Flooded => OURS + 8,
            Fault::Group => OURS + 9,
            Fault::Halted => OURS + 10,
        }
    }

    /// What it is.
    pub const fn text(self) -> &'static str {
        match self {
            Fault::Board(FaultReason::None) => "in order",
            Fault::Board(reason) => reason.text(),
            Fault::Silent => "the board does not answer",
            Fault::HeldUp => "the servo thread came later than the watchdog waits",
            Fault::Restarted => "the board has restarted",
            Fault::Stranger => "another board or firmware answers at this address",
            Fault::Owned => "another computer drives the board",
            Fault::Settings => "the board refuses its settings",
            Fault::Unread => "write is called again without a read between",
            Fault::Collided => "two threads call the functions of one board",
            Fault::Flooded => "far more datagrams than a board sends come from its address",
            Fault::Group => "another board of the group has stopped",
            Fault::Halted => "the driver has failed and halted",
        }
    }

    /// What to do about it.
    pub const fn remedy(self) -> &'static str {
        match self {
            Fault::Board(reason) => reason.remedy(),
            Fault::Silent => "check cable and power of the board",
            Fault::HeldUp => "find what holds the thread up, then enable again",
            Fault::Restarted => "home and enable again when the machine is in order",
            Fault::Stranger => "restart LinuxCNC to use it",
            Fault::Owned => "stop LinuxCNC there to take it back",
            Fault::Settings => "compare versions with ferrocnc describe",
            Fault::Unread => "addf its read before its write, to one thread",
            Fault::Collided => "addf its read and its write to one thread",
            Fault::Flooded => "find what floods the network, or answers will be lost",
            Fault::Group => "remove what stopped the other board, then enable again",
            Fault::Halted => "restart LinuxCNC, and report its messages",
        }
    }

    /// Both as sentences.
    pub fn sentences(self) -> String {
        format!("{} {}", sentence(self.text()), sentence(self.remedy()))
    }
}

/// Begins with a capital letter, ends with a full stop.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|letter| letter.to_ascii_uppercase());
    let mut said: String = first.into_iter().chain(letters).collect();
    if !said.ends_with('.') {
        said.push('.');
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_has_a_number_of_its_own_below_32() {
        let codes: Vec<u32> = Fault::all().map(Fault::code).collect();
        assert!(codes.is_sorted_by(|a, b| a < b), "{codes:?}");
        assert!(codes.iter().all(|code| *code < 32), "{codes:?}");
    }

    #[test]
    fn a_fault_is_told_in_sentences() {
        assert_eq!(
            Fault::Silent.sentences(),
            "The board does not answer. Check cable and power of the board."
        );
        assert_eq!(
            Fault::Board(FaultReason::EStop).sentences(),
            "E-stop input. Release the emergency stop, then enable again."
        );
    }

    #[test]
    fn the_driver_has_what_it_tells_of_in_the_list() {
        for fault in Fault::KNOWN_HERE {
            assert!(fault.code() >= OURS, "{fault:?}");
            assert_eq!(Fault::all().filter(|it| *it == fault).count(), 1);
        }
    }
}
