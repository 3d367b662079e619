//! Finds boards at any address, and gives them an address. UDP, port [`crate::DISCOVERY_PORT`].
//!
//! ```text
//! word 0 "FDIS"   1 version, 1   2 kind   3 nonce   4, 5 unique id hi, lo   6.. payload
//!
//! kind  message  sender   payload
//! 1     Discover host    none                 ids 0: any board answers; else only that one
//! 2     Here     board    [`Here`], 32 words
//! 3     Set      host     [`Settings`]         only the board with that unique id takes it
//! 4     Done     board    [`OpResult`]         once the settings are in flash, or why not
//! 5     Prove    board    4 words              answer to a Set, if the board has a key: the challenge ([`crate::auth`])
//! 6     Proven   host     [`Settings`], 4 words   the Set with the answer to it
//! ```
//!
//! Requests go to 255.255.255.255, a subnet's broadcast address or the board's own. Answers go to
//! 255.255.255.255 and the sender's port, so they arrive even if board and host are in different
//! nets; the nonce tells which request an answer belongs to. A datagram of another form is counted
//! and not answered. A request with another board's unique id is not answered either, and not
//! counted.
//!
//! A board with a key answers Prove to a Set, and to a Proven with a wrong answer. In all other
//! respects a Proven is a Set.
//!
//! A saved Set is in force after the next start, and the board restarts by itself right after its
//! Done. A Set while the machine is armed or owned is answered [`OpResult::Armed`]. A repeated Set
//! (its Done was lost) is answered again; settings equal to the saved ones are not written twice.

use crate::flash::{OpResult, Origin, Running};
use crate::settings::{self, Settings, mac_from_words, mac_to_words};
use crate::{LinkSpeed, Name, Refusal, auth};

/// "FDIS".
pub const MAGIC: u32 = 0x4644_4953;
/// Version of the layout.
pub const VERSION: u32 = 1;
/// Words before the payload.
pub const HEAD: usize = 6;
/// Words of a [`Here`].
pub const HERE_WORDS: usize = 8 + 3 * Name::WORDS;
/// Words of a Proven.
const PROVEN_WORDS: usize = settings::WORDS + auth::WORDS;
/// Words of the longest message.
pub const WORDS_MAX: usize = HEAD + PROVEN_WORDS;

const _: () = assert!(HERE_WORDS < PROVEN_WORDS);

const DISCOVER: u32 = 1;
const HERE: u32 = 2;
const SET: u32 = 3;
const DONE: u32 = 4;
const PROVE: u32 = 5;
const PROVEN: u32 = 6;

/// A message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message {
    /// Repeated in the answer.
    pub nonce: u32,
    /// The flash's unique id, hi and lo: of the board that is asked, or that answers. Zeros: any
    /// board, or a board without one.
    pub uid: [u32; 2],
    /// The content.
    pub body: Body,
}

/// The content of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// Which boards are there?
    Discover,
    /// This board is there.
    Here(Here),
    /// Take these settings.
    Set(Settings),
    /// The settings were taken, or not.
    Done(OpResult),
    /// The key has to be proved first: with the answer to this challenge.
    Prove([u32; auth::WORDS]),
    /// Take these settings; this is the answer.
    Proven(Settings, [u32; auth::WORDS]),
}

/// A board's answer to a host that looks for boards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Here {
    /// MAC address.
    pub mac: [u8; 6],
    /// IPv4 address in force.
    pub ip: u32,
    /// UDP port of the Etherbone server.
    pub port: u16,
    /// A DHCP server gave the address.
    pub dhcp: bool,
    /// The machine is not at rest.
    pub armed: bool,
    /// A host owns the session.
    pub owned: bool,
    /// The board has a key.
    pub keyed: bool,
    /// The image that runs.
    pub running: Running,
    /// Where the settings are from.
    pub origin: Origin,
    /// The link's speed.
    pub speed: LinkSpeed,
    /// Version of this crate on the board.
    pub wire_version: u32,
    /// Major << 16 | minor << 8 | patch.
    pub firmware_version: u32,
    /// Build id, 0 if never packed.
    pub build_id: u32,
    /// Name from the settings.
    pub name: Name,
    /// Name of the configuration.
    pub configuration: Name,
    /// Name of the platform.
    pub platform: Name,
}

impl Here {
    /// As words.
    pub fn to_words(&self) -> [u32; HERE_WORDS] {
        let [mac_hi, mac_lo] = mac_to_words(self.mac);
        let flags = u32::from(self.dhcp)
            | u32::from(self.armed) << 1
            | u32::from(self.owned) << 2
            | u32::from(self.keyed) << 3
            | self.running.code() << 4
            | self.origin.code() << 8
            | (self.speed as u32) << 12;
        let head = [
            mac_hi,
            mac_lo,
            self.ip,
            u32::from(self.port),
            flags,
            self.wire_version,
            self.firmware_version,
            self.build_id,
        ];
        let names = [self.name, self.configuration, self.platform];
        let mut words = [0; HERE_WORDS];
        let all = head
            .into_iter()
            .chain(names.into_iter().flat_map(Name::to_words));
        for (place, word) in words.iter_mut().zip(all) {
            *place = word;
        }
        words
    }

    /// Reads and checks. Unknown flags are ignored, so that an older host finds a newer board.
    pub fn parse(words: &[u32; HERE_WORDS]) -> Result<Self, Refusal> {
        let [
            mac_hi,
            mac_lo,
            ip,
            port,
            flags,
            wire_version,
            firmware_version,
            build_id,
            names @ ..,
        ] = words;
        let name = |n: usize| {
            let words = names.as_chunks().0.get(n).ok_or(Refusal::Value)?;
            Name::from_words(words)
        };
        Ok(Here {
            mac: mac_from_words([*mac_hi, *mac_lo]).ok_or(Refusal::Value)?,
            ip: *ip,
            port: u16::try_from(*port).map_err(|_| Refusal::Value)?,
            dhcp: flags & 1 != 0,
            armed: flags >> 1 & 1 != 0,
            owned: flags >> 2 & 1 != 0,
            keyed: flags >> 3 & 1 != 0,
            running: Running::from_code(flags >> 4 & 3).ok_or(Refusal::Value)?,
            origin: Origin::from_code(flags >> 8 & 3).ok_or(Refusal::Value)?,
            speed: LinkSpeed::from_code((flags >> 12 & 3) as u8).ok_or(Refusal::Value)?,
            wire_version: *wire_version,
            firmware_version: *firmware_version,
            build_id: *build_id,
            name: name(0)?,
            configuration: name(1)?,
            platform: name(2)?,
        })
    }
}

impl Message {
    /// Writes it; returns the words used.
    pub fn emit<'b>(&self, buffer: &'b mut [u32; WORDS_MAX]) -> &'b [u32] {
        match &self.body {
            Body::Discover => self.emit_as(DISCOVER, &[], buffer),
            Body::Set(settings) => self.emit_as(SET, &settings.to_words(), buffer),
            Body::Proven(settings, answer) => {
                let mut words = [0; PROVEN_WORDS];
                let all = settings.to_words().into_iter().chain(*answer);
                for (place, word) in words.iter_mut().zip(all) {
                    *place = word;
                }
                self.emit_as(PROVEN, &words, buffer)
            }
            Body::Here(_) | Body::Done(_) | Body::Prove(_) => self.emit_answer(buffer),
        }
    }

    /// Writes an answer of a board; nothing for a request.
    pub fn emit_answer<'b>(&self, buffer: &'b mut [u32; WORDS_MAX]) -> &'b [u32] {
        match &self.body {
            Body::Here(here) => self.emit_as(HERE, &here.to_words(), buffer),
            Body::Done(result) => self.emit_as(DONE, &[result.code()], buffer),
            Body::Prove(challenge) => self.emit_as(PROVE, challenge, buffer),
            Body::Discover | Body::Set(_) | Body::Proven(..) => &[],
        }
    }

    fn emit_as<'b>(
        &self,
        kind: u32,
        payload: &[u32],
        buffer: &'b mut [u32; WORDS_MAX],
    ) -> &'b [u32] {
        let [uid_hi, uid_lo] = self.uid;
        let head = [MAGIC, VERSION, kind, self.nonce, uid_hi, uid_lo];
        for (place, word) in buffer.iter_mut().zip(head.iter().chain(payload)) {
            *place = *word;
        }
        buffer.get(..HEAD + payload.len()).unwrap_or(&[])
    }

    /// Reads and checks a request to a board. Answers of other boards are refused. A Proven is read
    /// as a Set; [`proof`] reads its proof.
    pub fn parse_request(words: &[u32]) -> Result<Self, Refusal> {
        Self::parse_with(words, |_, _| Err(Refusal::Value))
    }

    /// Reads and checks a message of any kind.
    pub fn parse(words: &[u32]) -> Result<Self, Refusal> {
        let mut message = Self::parse_with(words, |kind, payload| match kind {
            HERE => Ok(Body::Here(Here::parse(exactly(payload)?)?)),
            DONE => {
                let [code] = *exactly(payload)?;
                Ok(Body::Done(OpResult::from_code(code).ok_or(Refusal::Value)?))
            }
            PROVE => Ok(Body::Prove(*exactly(payload)?)),
            _ => Err(Refusal::Value),
        })?;
        if let (Body::Set(settings), Some((_, answer))) = (message.body, proof(words)) {
            message.body = Body::Proven(settings, *answer);
        }
        Ok(message)
    }

    fn parse_with(
        words: &[u32],
        answer: impl FnOnce(u32, &[u32]) -> Result<Body, Refusal>,
    ) -> Result<Self, Refusal> {
        let Some((&[magic, version, kind, nonce, uid_hi, uid_lo], payload)) =
            words.split_first_chunk::<HEAD>()
        else {
            return Err(Refusal::Short);
        };
        if magic != MAGIC {
            return Err(Refusal::Magic);
        }
        if version != VERSION {
            return Err(Refusal::Version);
        }
        let body = match kind {
            DISCOVER if payload.is_empty() => Body::Discover,
            SET | PROVEN => {
                let payload = match kind {
                    PROVEN => payload.split_last_chunk::<{ auth::WORDS }>(),
                    _ => Some((payload, &auth::NONE)),
                };
                let (payload, _) = payload.ok_or(Refusal::BlockLength)?;
                Body::Set(Settings::parse(exactly(payload)?).map_err(|_| Refusal::Value)?)
            }
            DISCOVER => return Err(Refusal::BlockLength),
            kind => answer(kind, payload)?,
        };
        Ok(Message {
            nonce,
            uid: [uid_hi, uid_lo],
            body,
        })
    }
}

/// The words a Proven signs, and their tag; `None` for any other message.
pub fn proof(words: &[u32]) -> Option<(&[u32], &[u32; auth::WORDS])> {
    // No other message has this length.
    words
        .split_last_chunk()
        .filter(|_| words.len() == WORDS_MAX)
}

fn exactly<const N: usize>(words: &[u32]) -> Result<&[u32; N], Refusal> {
    words.try_into().map_err(|_| Refusal::BlockLength)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn here() -> Here {
        Here {
            mac: [2, 1, 2, 3, 4, 5],
            ip: 0xc0a8_0232,
            port: 1234,
            dhcp: true,
            armed: false,
            owned: true,
            keyed: true,
            running: Running::Golden,
            origin: Origin::FactoryPin,
            speed: LinkSpeed::M100,
            wire_version: crate::WIRE_VERSION,
            firmware_version: 0x100,
            build_id: 9,
            name: Name::new("mill").unwrap(),
            configuration: Name::new("75b_v8_26o23i6p").unwrap(),
            platform: Name::new("5a-75b-8.0").unwrap(),
        }
    }

    fn message(body: Body) -> Message {
        Message {
            nonce: 77,
            uid: [1, 2],
            body,
        }
    }

    #[test]
    fn every_message_survives_the_wire() {
        for body in [
            Body::Discover,
            Body::Here(here()),
            Body::Set(Settings::default()),
            Body::Done(OpResult::Armed),
            Body::Prove([1, 2, 3, 4]),
            Body::Proven(Settings::default(), [5, 6, 7, 8]),
        ] {
            let mut buffer = [0; WORDS_MAX];
            let words = message(body).emit(&mut buffer);
            assert_eq!(Message::parse(words), Ok(message(body)));
        }
    }

    #[test]
    fn a_message_cut_short_or_too_long_is_refused() {
        for body in [
            Body::Discover,
            Body::Here(here()),
            Body::Set(Settings::default()),
            Body::Done(OpResult::Ok),
            Body::Prove([1, 2, 3, 4]),
            Body::Proven(Settings::default(), [5, 6, 7, 8]),
        ] {
            let mut buffer = [0; WORDS_MAX];
            let length = message(body).emit(&mut buffer).len();
            let mut longer = [0; WORDS_MAX + 1];
            longer[..WORDS_MAX].copy_from_slice(&buffer);
            for other in (0..=length + 1).filter(|other| *other != length) {
                let parsed = Message::parse(&longer[..other]);
                let why = if other < HEAD {
                    Refusal::Short
                } else {
                    Refusal::BlockLength
                };
                assert_eq!(parsed, Err(why), "{other} of {length} words");
            }
        }
    }

    #[test]
    fn what_is_no_message_says_why() {
        let mut buffer = [0; WORDS_MAX];
        message(Body::Set(Settings::default())).emit(&mut buffer);
        for (word, value, why) in [
            (0, 0x4e6f_1044, Refusal::Magic),
            (1, 2, Refusal::Version),
            (2, 9, Refusal::Value),
            (HEAD + 31, 0, Refusal::Value), // the settings' CRC
        ] {
            let mut bad = buffer;
            bad[word] = value;
            let words = &bad[..HEAD + settings::WORDS];
            assert_eq!(Message::parse(words), Err(why), "word {word}");
            assert_eq!(Message::parse_request(words), Err(why), "word {word}");
        }
    }

    #[test]
    fn a_board_takes_questions_only() {
        for (body, question) in [
            (Body::Discover, true),
            (Body::Set(Settings::default()), true),
            (Body::Here(here()), false),
            (Body::Done(OpResult::Ok), false),
            (Body::Prove([1, 2, 3, 4]), false),
            (Body::Proven(Settings::default(), [5, 6, 7, 8]), true),
        ] {
            let mut buffer = [0; WORDS_MAX];
            let parsed = Message::parse_request(message(body).emit(&mut buffer));
            assert_eq!(parsed.is_ok(), question);
        }
    }
}
