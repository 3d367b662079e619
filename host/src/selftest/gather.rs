//! Reads the facts from a board and changes nothing. It takes a session only to compute the CRCs of
//! the flash of a board with a key.

use super::{Time, board, clock, flash, link, ways};
use crate::client::{Client, ClientError, Identity};
use crate::flash::{FlashError, Flasher, Overview, PATIENCE};
use std::collections::HashMap;
use std::time::Duration;
use wire::board::Kind;
use wire::describe::{Channels, Describe, FEATURE_READBACK};
use wire::flash::{Area, LinkWord};
use wire::images::{META_BYTES, Meta, idcode_of};
use wire::regmap::{self, gpio, gpio_high, pads, timebase};
use wire::{GUEST_READS, MAX_WORDS, Refusal, Request, map};

/// Registers in front of the outputs' pads.
const OUT_NOW: [u32; 2] = [
    regmap::address(gpio::BASE, gpio::OUT_NOW),
    regmap::address(gpio_high::BASE, gpio_high::OUT_NOW),
];
/// Those behind the pads.
const OUT_PADS: [u32; 2] = [
    regmap::address(pads::BASE, pads::OUTPUTS),
    regmap::address(pads::BASE, pads::OUTPUTS_HIGH),
];
/// The stamp of the frame now looked at, which is the one that asks for it.
const ARRIVAL: [u32; 2] = [
    regmap::address(timebase::BASE, timebase::ARRIVAL_LO),
    regmap::address(timebase::BASE, timebase::ARRIVAL_HI),
];
/// What the gateware catches together, and again what tells whether it has done so meanwhile.
const CAUGHT: [u32; 3] = [map::TIMEBASE_NOW, map::ETH_BEATS, map::TIMEBASE_NOW];
/// Stamps at the beginning and at the end, close together: the tightest of each counts.
const LOOKS: usize = 40;
/// Between two of them.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// What the board says of itself.
pub fn board(client: &mut Client, describe: Describe) -> Result<board::Facts, ClientError> {
    let head = client.read(&[map::PANIC, map::PANIC + 4])?;
    let (panics, length) = (head[0], head[1].min(map::PANIC_TEXT_LEN));
    let words = client.read_from(map::PANIC_TEXT, length.div_ceil(4) as usize)?;
    let mut bytes = vec![0; words.len() * 4];
    wire::words_to_bytes(&words, &mut bytes);
    bytes.truncate(length as usize);
    Ok(board::Facts {
        describe,
        panics,
        panic: String::from_utf8_lossy(&bytes).into_owned(),
    })
}

/// The flash; its images are summed up by the board, which takes some seconds. `expected` is what
/// the platform's file says.
pub fn flash(
    mut client: Client,
    identity: &Identity,
    expected: Option<u32>,
) -> Result<flash::Facts, FlashError> {
    let overview = Overview::read(&mut client)?;
    let fpga = identity
        .blob()
        .text(wire::board::Kind::Fpga, 0)
        .and_then(idcode_of);
    let (mut images, mut locked) = (Vec::new(), false);
    if let Some(layout) = overview.layout {
        let mut flasher = Flasher::new(client, PATIENCE, |_| {});
        for (name, area) in [
            ("slot A", layout.slot_a),
            ("slot B", layout.slot_b),
            ("golden", layout.golden),
        ] {
            match image(&mut flasher, area, fpga) {
                Ok(image) => images.push((name, image)),
                Err(FlashError::Client(ClientError::Key(..))) => {
                    locked = true;
                    break;
                }
                Err(error) => return Err(error),
            }
        }
    }
    Ok(flash::Facts {
        jedec: overview.jedec,
        bytes: overview.layout.map(|layout| layout.size),
        expected,
        unique: overview.uid != [0, 0],
        running: overview.running,
        selected: overview.selected,
        protected: overview.protected,
        locked,
        images,
    })
}

fn image(
    flasher: &mut Flasher<'_>,
    area: Area,
    fpga: Option<u32>,
) -> Result<flash::Image, FlashError> {
    let page = flasher.read(area.meta(), META_BYTES as u32)?;
    if page.iter().all(|byte| *byte == 0xff) {
        return Ok(flash::Image::Empty);
    }
    let Some(meta) = Meta::from_page(&page, area) else {
        return Ok(flash::Image::NoMeta);
    };
    if fpga.is_some_and(|fpga| fpga != meta.idcode) {
        return Ok(flash::Image::Foreign(meta.idcode));
    }
    let counted = flasher.crc(area.start, meta.length)?;
    Ok(match counted == meta.crc {
        true => flash::Image::Whole {
            build: meta.build_id,
            bytes: meta.length,
        },
        false => flash::Image::Damaged {
            said: meta.crc,
            counted,
        },
    })
}

/// Words of the blob, which stay as they are, in another order each time.
fn places(words: usize, seed: &mut u64) -> Vec<u32> {
    let pick = || {
        // Knuth's MMIX; any numbers do that are the same every time.
        *seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 33) as usize % words.max(1)
    };
    let place = |n: usize| map::DESCRIBE_BLOB + 4 * n as u32;
    std::iter::repeat_with(pick)
        .take(GUEST_READS)
        .map(place)
        .collect()
}

/// Asks this many questions, each once, and looks what became of them.
pub fn link(
    client: &mut Client,
    identity: &Identity,
    asked: u32,
    time: &mut dyn Time,
) -> Result<link::Facts, ClientError> {
    let refusals = |client: &mut Client| -> Result<u32, ClientError> {
        let words = client.read_from(map::COUNTERS_REFUSED, Refusal::COUNT)?;
        Ok(words
            .iter()
            .fold(0, |sum: u32, word| sum.wrapping_add(*word)))
    };
    let before = LinkWord::from_word(client.read(&[map::FLASH_LINK])?[0]);
    let refused = refusals(client)?;
    let blob = identity.describe.blob_words as usize;
    let right = client.read_from(map::DESCRIBE_BLOB, blob)?;
    let right = |place: u32| {
        right
            .get((place - map::DESCRIBE_BLOB) as usize / 4)
            .copied()
    };

    let (mut seed, mut trips, mut wrong) = (1, Vec::new(), 0);
    let mut open: HashMap<u32, Vec<u32>> = HashMap::new();
    let first = client.next_tag();
    for _ in 0..asked {
        let tag = client.next_tag();
        let places = places(blob, &mut seed);
        let mut words = [0; MAX_WORDS];
        let request = Request::new(&mut words).read(tag, &places).words();
        let began = time.now();
        open.insert(tag, places);
        // Silence is a finding; a socket error is not the board's.
        let mut heard = client.once(request.unwrap_or_default(), first..=tag, GUEST_READS);
        while let Ok(Some((which, words))) = &heard {
            if let Some(places) = open.remove(which) {
                let as_before = places
                    .iter()
                    .map(|place| right(*place))
                    .eq(words.iter().map(|w| Some(*w)));
                wrong += u32::from(!as_before);
            }
            if *which == tag {
                trips.push(time.now().saturating_sub(began));
                break;
            }
            heard = client.wait(first..=tag, GUEST_READS);
        }
    }
    // What comes late has not been lost.
    while !open.is_empty() {
        let Ok(Some((which, _))) = client.wait(first..=first.wrapping_add(asked), GUEST_READS)
        else {
            break;
        };
        open.remove(&which);
    }
    trips.sort_unstable();
    let trip = |n: usize| trips.get(n).copied().unwrap_or_default();
    // The firmware looks at its MAC once in a millisecond.
    time.pause(Duration::from_millis(5));
    let after = LinkWord::from_word(client.read(&[map::FLASH_LINK])?[0]);
    Ok(link::Facts {
        before,
        after,
        asked,
        missing: open.len() as u32,
        wrong,
        refused: refusals(client)?.wrapping_sub(refused),
        trips: [
            trip(0),
            trip(trips.len() / 2),
            trip(trips.len().saturating_sub(1)),
        ],
    })
}

/// Which way the exchanges took since the board started.
pub fn ways(client: &mut Client) -> Result<ways::Facts, ClientError> {
    let words = client.read(&crate::blocks::ways::WORDS)?;
    Ok(ways::Facts::from_words([words[0], words[1], words[2]]))
}

/// The gateware reads the pads that it drives, each as that of a channel. Where pins are configured
/// a pad is a line's, and no channel has one of its own.
pub fn reads_pads(identity: &Identity) -> bool {
    identity.describe.features & FEATURE_READBACK != 0 && !identity.has_configured_pins()
}

/// The numbers of the channels of a kind, as places.
pub(super) fn numbers(identity: &Identity, kind: Kind) -> Vec<usize> {
    let numbers = identity.numbers(kind).into_iter();
    numbers.map(usize::from).collect()
}

/// The general outputs with the gate closed: what drives them, and their pads.
pub fn rest(client: &mut Client, channels: Channels) -> Result<[u64; 2], ClientError> {
    Ok([
        bits(client, channels, OUT_NOW)?,
        bits(client, channels, OUT_PADS)?,
    ])
}

/// The levels in front of the outputs' pads, a bit each.
pub(super) fn driven(client: &mut Client, channels: Channels) -> Result<u64, ClientError> {
    bits(client, channels, OUT_NOW)
}

/// A bit for each output, of one register or two.
pub(super) fn bits(
    client: &mut Client,
    channels: Channels,
    registers: [u32; 2],
) -> Result<u64, ClientError> {
    let words = client.read(&registers[..1 + channels.outputs_high()])?;
    let high = words.get(1).copied().unwrap_or(0);
    Ok(u64::from(high) << u32::BITS | u64::from(words[0]))
}

/// Looks at the board's clocks for so long.
pub fn clock(
    client: &mut Client,
    readback: bool,
    long: Duration,
    time: &mut dyn Time,
) -> Result<Vec<clock::Sample>, ClientError> {
    let mut samples = Vec::new();
    let between = long.saturating_sub(LOOK_EVERY * 2 * LOOKS as u32) / LOOKS as u32;
    for pause in [LOOK_EVERY, between, LOOK_EVERY] {
        for _ in 0..LOOKS {
            let before = time.now();
            let asked = [&ARRIVAL[..], if readback { &CAUGHT } else { &[] }].concat();
            let words = client.read(&asked)?;
            let caught = match words[2..] {
                [now, beats, same] if now == same => Some([now, beats]),
                _ => None,
            };
            samples.push(clock::Sample {
                before,
                board: u64::from(words[1]) << 32 | u64::from(words[0]),
                after: time.now(),
                caught,
            });
            time.pause(pause);
        }
    }
    Ok(samples)
}
