//! The Ethernet link: up or down, speed, errors.
//!
//! The link counts as down after three samples in a row, a millisecond apart, have shown it down: a
//! PHY that renegotiates reports it for longer, and a wrong sample of its in-band status is
//! shorter. A PHY that never reported "up" is not believed to be down: some do not report in band,
//! and a client that asks came over the link.

use crate::cores;
use wire::LinkSpeed;
use wire::flash::LinkWord;

/// Looks in a row.
const LOOKS: u8 = 3;

/// What is known of the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link {
    /// The last status, if no error has to be counted.
    settled: Option<cores::Link>,
    word: LinkWord,
    /// It was up once.
    known: bool,
    /// Looks in a row that saw it down.
    downs: u8,
}

impl Default for Link {
    fn default() -> Self {
        Self::new()
    }
}

impl Link {
    /// Never looked at.
    pub const fn new() -> Self {
        Link {
            settled: None,
            word: LinkWord {
                speed: LinkSpeed::Down,
                full_duplex: false,
                errors: 0,
            },
            known: false,
            downs: 0,
        }
    }

    /// Is this the same status, with no error to count?
    #[inline(always)]
    pub fn same(&self, now: cores::Link) -> bool {
        self.settled
            .is_some_and(|last| last.status == now.status && last.errors == now.errors)
    }

    /// Takes a status; true if the link goes down with it.
    pub fn look(&mut self, now: cores::Link) -> bool {
        self.word.errors = now.errors & 0xff_ffff;
        self.settled = Some(now);
        if now.status & 1 != 0 {
            self.known = true;
            self.downs = 0;
            self.word.full_duplex = now.status >> 3 & 1 != 0;
            self.word.speed = match now.status >> 1 & 3 {
                0 => LinkSpeed::M10,
                1 => LinkSpeed::M100,
                _ => LinkSpeed::M1000,
            };
            return false;
        }
        if !self.known || self.downs == LOOKS {
            return false;
        }
        self.downs += 1;
        if self.downs < LOOKS {
            self.settled = None;
            return false;
        }
        self.word.speed = LinkSpeed::Down;
        self.word.full_duplex = false;
        true
    }

    /// Is the link up, or not known to be down?
    pub const fn up(&self) -> bool {
        self.downs < LOOKS
    }

    /// The link's word in the flash window.
    pub const fn word(&self) -> LinkWord {
        self.word
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: u32 = 0b1101;
    const DOWN: u32 = 0;

    fn look(link: &mut Link, status: u32) -> bool {
        let now = cores::Link { status, errors: 0 };
        !link.same(now) && link.look(now)
    }

    #[test]
    fn it_goes_down_at_the_third_look_in_a_row_and_only_once() {
        let mut link = Link::new();
        for (status, went_down) in [
            (UP, false),
            (DOWN, false),
            (DOWN, false),
            (UP, false),
            (DOWN, false),
            (DOWN, false),
            (DOWN, true),
            (DOWN, false),
            (DOWN, false),
        ] {
            assert_eq!(look(&mut link, status), went_down);
        }
        assert!(!link.up() && link.word().speed == LinkSpeed::Down);
        look(&mut link, UP);
        assert!(link.up() && link.word().speed == LinkSpeed::M1000 && link.word().full_duplex);
    }

    #[test]
    fn a_phy_that_says_nothing_in_band_is_not_a_link_that_is_down() {
        let mut link = Link::new();
        for _ in 0..10 {
            assert!(!look(&mut link, DOWN));
        }
        assert!(link.up() && link.word().speed == LinkSpeed::Down);
    }

    #[test]
    fn speed_and_errors_are_told() {
        for (status, speed) in [
            (0b0001, LinkSpeed::M10),
            (0b0011, LinkSpeed::M100),
            (0b0101, LinkSpeed::M1000),
        ] {
            let mut link = Link::new();
            link.look(cores::Link { status, errors: 7 });
            assert_eq!((link.word().speed, link.word().errors), (speed, 7));
        }
    }
}
