//! Checks the flash: which chip answers, and whether its images are complete.

use super::Finding;
use wire::flash::{Running, Slot};

/// What an area for an image holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Image {
    /// Nothing: it is erased.
    Empty,
    /// Something without a readable meta page.
    NoMeta,
    /// What its meta page says is what lies there.
    Whole {
        /// Its build id.
        build: u32,
        /// Its length.
        bytes: u32,
    },
    /// The bytes are others than its meta page says.
    Damaged {
        /// CRC by the meta page.
        said: u32,
        /// CRC of the bytes.
        counted: u32,
    },
    /// It is for another FPGA.
    Foreign(u32),
}

/// The facts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Facts {
    /// JEDEC id; 0 if no flash answers.
    pub jedec: u32,
    /// Bytes, if the layout is known.
    pub bytes: Option<u32>,
    /// Bytes that the platform's file gives its flash, if this tool knows the platform.
    pub expected: Option<u32>,
    /// It has a unique id.
    pub unique: bool,
    /// Which image runs.
    pub running: Running,
    /// Which one is to load at power-up.
    pub selected: Option<Slot>,
    /// The golden image is protected.
    pub protected: bool,
    /// The board has a key that this computer has not, so its images could not be read.
    pub locked: bool,
    /// Slot A, slot B, golden; empty if they could not be read.
    pub images: Vec<(&'static str, Image)>,
}

/// Judges them.
pub fn judge(facts: &Facts) -> Vec<Finding> {
    let mut findings = vec![chip(facts)];
    if facts.bytes.is_none() {
        return findings;
    }
    if !facts.unique {
        findings.push(Finding::note(
            "flash unique id",
            "none",
            "the MAC address is made from it, and two such boards would have the same",
            "`ferrocnc set BOARD --mac` gives it one",
        ));
    }
    findings.push(running(facts));
    if facts.locked {
        findings.push(Finding::skipped(
            "flash images",
            "not read: the board has a key",
            "operations of the flash are for computers with the key",
            "`--key FILE`, or run the test where the key is",
        ));
    }
    for (name, image) in &facts.images {
        findings.push(judge_image(name, image, facts));
    }
    if !facts.protected {
        findings.push(Finding::note(
            "flash protection",
            "the golden image is not protected",
            "the flash was written without its protection, or does not take it",
            "the next `ferrocnc update` sets it",
        ));
    }
    findings
}

fn chip(facts: &Facts) -> Finding {
    let (check, jedec) = ("flash", facts.jedec);
    match (jedec, facts.bytes, facts.expected) {
        (0 | 0xff_ffff, _, _) => Finding::bad(
            check,
            "no flash answers",
            "its data line stays at one level: a joint at the flash, or a chip that is not there",
            "reflow the flash; until then `ferrocnc flash load` by JTAG",
        ),
        (_, None, _) => Finding::bad(
            check,
            format!("JEDEC id {jedec:06x}, of an unknown kind"),
            "2 and 4 MiB flashes have a layout; or a data line is bad and the id is misread",
            "compare with the print on the chip; if that is 2 or 4 MiB, reflow it",
        ),
        (_, Some(bytes), Some(expected)) if bytes != expected => Finding::bad(
            check,
            format!("JEDEC id {jedec:06x}, {} MiB", bytes >> 20),
            &format!("this platform has {} MiB", expected >> 20),
            "another revision of the card, or a misread id: compare with the print on the chip",
        ),
        (_, Some(bytes), _) => {
            Finding::good(check, format!("JEDEC id {jedec:06x}, {} MiB", bytes >> 20))
        }
    }
}

fn running(facts: &Facts) -> Finding {
    let check = "flash image that runs";
    let next = match facts.selected {
        Some(slot) => format!("slot {slot}"),
        None => "golden".to_owned(),
    };
    let fact = format!("{}; after power-up {next}", facts.running);
    match (facts.running, facts.selected) {
        (Running::Golden, Some(_)) => Finding::bad(
            check,
            fact,
            "the selected image did not load, and the golden one came instead",
            "`ferrocnc update` with this board's .bit",
        ),
        (Running::Volatile, _) => Finding::note(
            check,
            fact,
            "JTAG loaded it, and it is gone with the power",
            "`ferrocnc flash write NAME.flash` makes it stay",
        ),
        (Running::A | Running::B | Running::Golden, _) => Finding::good(check, fact),
    }
}

fn judge_image(name: &str, image: &Image, facts: &Facts) -> Finding {
    let check = &format!("flash {name}");
    // If JTAG loaded the card and its flash was never written, everything is missing, and that is
    // already told.
    let blank = |(_, image): &(&str, Image)| *image == Image::Empty;
    let new = facts.running == Running::Volatile && facts.images.iter().all(blank);
    // Without it the board does not start, or does not survive a bad update.
    let needed =
        !new && name == "golden" || facts.selected.is_some_and(|slot| name == slot_name(slot));
    let remedy = match name {
        "golden" => "`ferrocnc flash write NAME.flash` by JTAG",
        _ => "`ferrocnc update` with this board's .bit",
    };
    match image {
        Image::Whole { build, bytes } => {
            Finding::good(check, format!("whole, build {build:08x}, {bytes} bytes"))
        }
        Image::Empty if !needed => {
            Finding::skipped(check, "empty", "nothing was written there", "")
        }
        Image::Empty => Finding::bad(
            check,
            "empty",
            "the image that the board loads or falls back to is missing",
            remedy,
        ),
        Image::NoMeta if !needed => Finding::note(
            check,
            "no whole image",
            "an update was cut short there, or the flash does not keep its bytes",
            remedy,
        ),
        Image::NoMeta => Finding::bad(
            check,
            "no readable meta page",
            "the image counts as not there",
            remedy,
        ),
        Image::Damaged { said, counted } => Finding::bad(
            check,
            format!("CRC {counted:08x}, its meta page says {said:08x}"),
            "bytes in the flash, or on their way out of it, are wrong",
            &format!(
                "run the self-test once more; the same CRC again: {remedy}; another: a joint at the flash"
            ),
        ),
        Image::Foreign(idcode) => Finding::bad(
            check,
            format!("for an FPGA with idcode {idcode:08x}"),
            "this FPGA does not load it",
            remedy,
        ),
    }
}

/// As [`Facts::images`] calls it.
pub const fn slot_name(slot: Slot) -> &'static str {
    match slot {
        Slot::A => "slot A",
        Slot::B => "slot B",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selftest::Verdict::{self, Bad, Good, Note, Skipped};

    fn healthy() -> Facts {
        let whole = Image::Whole {
            build: 1,
            bytes: 100,
        };
        Facts {
            jedec: 0xef_4016,
            bytes: Some(4 << 20),
            expected: Some(4 << 20),
            unique: true,
            running: Running::A,
            selected: Some(Slot::A),
            protected: true,
            locked: false,
            images: vec![
                ("slot A", whole.clone()),
                ("slot B", Image::Empty),
                ("golden", whole),
            ],
        }
    }

    fn verdicts(change: impl Fn(&mut Facts)) -> Vec<Verdict> {
        let mut facts = healthy();
        change(&mut facts);
        judge(&facts)
            .iter()
            .map(|finding| finding.verdict)
            .collect()
    }

    #[test]
    fn each_defect_of_a_flash_is_found_and_nothing_else_with_it() {
        assert_eq!(verdicts(|_| {}), [Good, Good, Good, Skipped, Good]);
        for jedec in [0, 0xff_ffff] {
            assert_eq!(verdicts(|f| (f.jedec, f.bytes) = (jedec, None)), [Bad]);
        }
        assert_eq!(verdicts(|f| (f.jedec, f.bytes) = (0xef_4018, None)), [Bad]);
        assert_eq!(verdicts(|f| f.bytes = Some(2 << 20))[0], Bad);
        assert_eq!(verdicts(|f| f.expected = None)[0], Good);
        assert_eq!(verdicts(|f| f.running = Running::Golden)[1], Bad);
        assert_eq!(verdicts(|f| f.running = Running::Volatile)[1], Note);
        let damaged = Image::Damaged {
            said: 1,
            counted: 2,
        };
        for n in 0..3 {
            assert_eq!(verdicts(|f| f.images[n].1 = damaged.clone())[2 + n], Bad);
        }
        assert_eq!(verdicts(|f| f.images[2].1 = Image::Empty)[4], Bad);
        assert_eq!(verdicts(|f| f.images[1].1 = Image::NoMeta)[3], Note);
        let new = |f: &mut Facts| {
            (f.running, f.selected, f.protected) = (Running::Volatile, None, false);
            f.images
                .iter_mut()
                .for_each(|(_, image)| *image = Image::Empty);
        };
        assert_eq!(verdicts(new), [Good, Note, Skipped, Skipped, Skipped, Note]);
        assert_eq!(verdicts(|f| f.protected = false)[5], Note);
        assert_eq!(verdicts(|f| f.locked = true)[2], Skipped);
    }
}
