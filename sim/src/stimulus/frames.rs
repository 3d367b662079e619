//! Frames for the fast path: what firmware writes for an owner's, and their words, one after the
//! other. Most are as expected, the others differ in one thing.

use super::{Chance, Write};
use crate::model::board::pages;
use crate::model::rx_admission::Word;
use firmware::block::Shape;
use firmware::net::{self, Datagram, Slot, Us};
use firmware::pass::{self, Expected, FLAGS_PLACE, SEQUENCE_PLACE};
use firmware::session::Peer;
use rand::Rng;
use wire::describe::Channels;
use wire::etherbone::{HEADER, record};
use wire::exchange::PWM_ENABLE;
use wire::map;
use wire::regmap::{fast_path, rx_admission};

/// The owner's token.
pub(crate) const TOKEN: u32 = 0x1234_5678;
/// The board.
pub(crate) const US: Us = Us {
    mac: [0x10, 0xe2, 0xd5, 0, 0, 1],
    ip: 0xc0a8_0232,
    port: 1234,
};
/// The owner.
pub(crate) const HOST: Us = Us {
    mac: [2, 0, 0, 0, 0, 1],
    ip: 0xc0a8_0201,
    port: 40_000,
};
/// The word with a frame's number, ...
const NUMBER: usize = 5;
/// ... and those with its checksums.
const IP_SUM: usize = 6;
const UDP_SUM: usize = 10;

/// Words of a frame.
#[derive(Debug, Default)]
struct Words(Vec<u32>);

impl Slot for Words {
    fn put(&mut self, index: usize, word: u32) {
        self.0.resize(self.0.len().max(index + 1), 0);
        self.0[index] = word;
    }
}

/// The other end of a datagram.
pub(crate) fn datagram(of: &Us) -> Datagram {
    let [high, low] = net::to_mac(of.mac);
    let peer = Peer {
        ip: of.ip,
        port: of.port,
    };
    Datagram {
        mac: (high as u16, low),
        peer,
        ttl: 64,
        ..Datagram::broadcast(of.port)
    }
}

/// The ones' complement of the sum of all halves.
fn checksum(words: impl Iterator<Item = u32>) -> u32 {
    let mut sum: u64 = words.map(u64::from).sum();
    while sum >> 16 != 0 {
        sum = (sum >> 16) + (sum & 0xffff);
    }
    !sum as u32 & 0xffff
}

/// The checksum of a frame's datagram, as slot words, whose own checksum is 0.
pub(crate) fn udp_checksum(frame: &[u32]) -> u32 {
    let pseudo = [frame[7], frame[8], 17, frame[10] >> 16];
    checksum(pseudo.into_iter().chain(frame[9..].iter().copied()))
}

/// A datagram of the owner's as slot words, without a checksum.
pub(crate) fn from_owner(payload: &[u32]) -> Vec<u32> {
    let mut words = Words::default();
    net::emit_headers(&mut words, &HOST, &datagram(&US), payload.len() * 4);
    net::emit_payload(&mut words, payload);
    words.0
}

/// A host that owns a board, and the firmware of that.
#[derive(Clone, Debug)]
pub struct Owner {
    channels: Channels,
    sequence: u32,
    flags: u32,
}

fn write(page: u32, word: usize, data: u32) -> Write {
    (page, word as u32, data)
}

impl Owner {
    /// Of a board with these channels.
    pub fn new(channels: Channels) -> Self {
        Owner {
            channels,
            sequence: 0,
            flags: 3,
        }
    }

    fn shape(&self) -> Shape {
        Shape::new(self.channels)
    }

    /// What firmware writes once for an owner.
    pub fn prepare(&self, mode: u32) -> impl Iterator<Item = Write> + use<> {
        let shape = self.shape();
        let expected = Expected::new(&US, &datagram(&HOST), shape.command, TOKEN);
        let header =
            move |(place, word)| write(pages::RX_ADMISSION, rx_admission::HEADER0 + place, word);
        let run = |(number, run)| write(pages::FAST_PATH, fast_path::RUN0 + number, run);
        let length = pass::answer_length(&shape) as u32 + 2;
        expected
            .words
            .into_iter()
            .enumerate()
            .map(header)
            .chain(pass::runs(&shape).into_iter().enumerate().map(run))
            .chain([
                write(pages::FAST_PATH, fast_path::IP_SUM, expected.ip_sum),
                write(pages::FAST_PATH, fast_path::UDP_SUM, expected.udp_sum),
                write(pages::FAST_PATH, fast_path::LENGTH, length),
                write(pages::RX_ADMISSION, rx_admission::MODE, mode),
            ])
    }

    /// What it writes for each command: a pass while the gate reads this.
    pub fn hand_out(&mut self, random: &mut impl Rng, gate: u32) -> [Write; 4] {
        self.sequence = self.sequence.wrapping_add(1);
        self.flags = random.below(8);
        let (header, fast) = (rx_admission::HEADER0, pages::FAST_PATH);
        let executes = match random.below(4) {
            0 => random.below(4),
            1 => 3,
            _ => 1,
        };
        let condition = gate | (executes * fast_path::GATE_EXECUTES);
        [
            write(pages::RX_ADMISSION, header + SEQUENCE_PLACE, self.sequence),
            write(pages::RX_ADMISSION, header + FLAGS_PLACE, self.flags),
            write(fast, fast_path::GATE, condition),
            write(fast, fast_path::PASS, 1),
        ]
    }

    /// The frame of this command, to be applied at `at`.
    pub fn frame(&self, random: &mut impl Rng, at: u64) -> Vec<Word> {
        let mut words = self.words(random, at);
        words[NUMBER] = words[NUMBER] & 0xffff | random.below(1 << 16) << 16;
        words[IP_SUM] &= 0xffff_0000;
        words[IP_SUM] |= checksum(words[4..9].iter().copied());
        if random.one_in(2) {
            words[UDP_SUM] |= udp_checksum(&words);
        }
        let (mut bytes, mut bad) = (words.len() * 4, false);
        match random.below(20) {
            0..4 => {
                let n = random.below(words.len() as u32) as usize;
                words[n] ^= 1 << random.below(32);
            }
            4 => words.truncate(1 + random.below(words.len() as u32) as usize),
            5 => words.extend((0..=random.below(4)).map(|_| random.random::<u32>())),
            6 => words.iter_mut().for_each(|word| *word = random.random()),
            7 => bytes += 1 + random.below(3) as usize,
            8 => bad = true,
            _ => {}
        }
        let room = !random.one_in(20);
        let bytes = if bytes == words.len() * 4 { 0 } else { bytes };
        Word::of_frame(&words, bytes)
            .map(|word| Word {
                bad: bad && word.last,
                room,
                ..word
            })
            .collect()
    }

    fn words(&self, random: &mut impl Rng, at: u64) -> Vec<u32> {
        let c = self.channels;
        let count = self.shape().command;
        let mostly = random.random::<u32>() | random.random::<u32>();
        let probe_arms = random.random::<u32>() & if random.one_in(20) { !0 } else { 0x1f_ffff };
        let mut payload = vec![
            HEADER,
            0,
            record(count, 0),
            map::COMMAND,
            TOKEN,
            self.sequence,
            self.flags,
            at as u32,
            (at >> 32) as u32,
            mostly,
            random.random(),
            random.random::<u32>() | random.random::<u32>(),
            probe_arms,
        ];
        for _ in 0..c.stepgens {
            let velocity = random.spread();
            let back = random.one_in(2);
            payload.push(if back {
                velocity.wrapping_neg()
            } else {
                velocity
            });
            payload.push(random.spread() | 1 << 16);
        }
        payload.extend((0..c.pwms).map(|_| random.below(400 << 8) | PWM_ENABLE));
        payload.extend((0..c.outputs_high()).map(|_| random.random::<u32>()));
        from_owner(&payload)
    }
}
