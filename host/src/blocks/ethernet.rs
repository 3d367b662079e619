//! `link.*`: the cable between this computer and the board, as the board's PHY sees it.
//!
//! | pin | | |
//! |---|---|---|
//! | `link.up` | bit out | the board answers and says its link is up |
//! | `link.speed` | s32 out | Mbit/s: 10, 100, 1000; 0 while it is down |
//! | `link.errors` | u32 out | frames the board's MAC threw away since load: wrong CRC or preamble, no room |
//!
//! A gigabit board at 100 Mbit/s works; the reason is a cable with two pairs only, or an old
//! switch.

use crate::hal::{ExportError, Exporter, Out};
use wire::exchange::StateWord;

/// The link's pins.
#[derive(Debug)]
pub struct Ethernet {
    up: Out<bool>,
    speed: Out<i32>,
    errors: Out<u32>,
    /// The board's own count, modulo 256.
    last: Option<u8>,
}

impl Ethernet {
    /// Exports the pins; the prefix is the board's.
    pub fn export(hal: &mut Exporter<'_>) -> Result<Self, ExportError> {
        let mut hal = hal.under("link");
        Ok(Ethernet {
            up: hal.output("up")?,
            speed: hal.output("speed")?,
            errors: hal.output("errors")?,
            last: None,
        })
    }

    /// Takes what an answer says. Fewer than 256 errors lie between two answers: an answer takes
    /// longer than a frame, and 256 frames thrown away between two would be 256 lost periods.
    pub fn sampled(&mut self, word: &StateWord) {
        self.up.set(word.link);
        self.speed.set(word.speed.mbit() as i32);
        let count = word.link_errors;
        let more = self.last.map_or(0, |last| count.wrapping_sub(last));
        self.last = Some(count);
        self.errors
            .set(self.errors.get().wrapping_add(u32::from(more)));
    }

    /// The board does not answer any more.
    pub fn lost(&self) {
        self.up.set(false);
        self.speed.set(0);
    }

    /// The board has restarted; its error count may begin anywhere.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;
    use wire::LinkSpeed;

    fn word(link: bool, speed: LinkSpeed, link_errors: u8) -> StateWord {
        StateWord {
            link,
            speed,
            link_errors,
            ..StateWord::from_word(0).unwrap()
        }
    }

    #[test]
    fn errors_are_counted_from_load_and_across_the_boards_wrap() {
        let mut hal = FakeHal::new();
        let mut link = Ethernet::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        for (count, expected) in [(250, 0), (255, 5), (3, 9), (3, 9)] {
            link.sampled(&word(true, LinkSpeed::M100, count));
            assert_eq!(hal.get::<u32>("b.link.errors"), expected, "{count}");
        }
        link.forget();
        link.sampled(&word(true, LinkSpeed::M100, 200));
        assert_eq!(hal.get::<u32>("b.link.errors"), 9, "another start");
    }

    #[test]
    fn a_silent_board_has_no_link() {
        let mut hal = FakeHal::new();
        let mut link = Ethernet::export(&mut Exporter::new(&mut hal, "b")).unwrap();
        link.sampled(&word(true, LinkSpeed::M1000, 0));
        assert!(hal.get::<bool>("b.link.up"));
        assert_eq!(hal.get::<i32>("b.link.speed"), 1000);
        link.lost();
        assert!(!hal.get::<bool>("b.link.up"));
        assert_eq!(hal.get::<i32>("b.link.speed"), 0);
    }
}
