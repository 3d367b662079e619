//! Multicast DNS (RFC 6762) and DNS-SD (RFC 6763): messages, and the names of our services.
//!
//! A reader that never panics and does bounded work on any bytes, and a writer into a fixed buffer.
//! The board answers with them, and the tool asks with them. Names are written without compression,
//! and read with it.

/// The group that questions and answers go to, 224.0.0.251.
pub const GROUP: u32 = 0xe000_00fb;
/// UDP port of both.
pub const PORT: u16 = 5353;
/// The service that every board offers: Etherbone over UDP ([`crate::DEFAULT_PORT`]).
pub const FERROCNC: [&str; 3] = ["_ferrocnc", "_udp", "local"];
/// The board's status page.
pub const HTTP: [&str; 3] = ["_http", "_tcp", "local"];
/// The list of services.
pub const SERVICES: [&str; 4] = ["_services", "_dns-sd", "_udp", "local"];
/// Key of the TXT record: the unique id in 16 hexadecimal digits.
pub const UID: &str = "uid=";

/// An IPv4 address.
pub const A: u16 = 1;
/// A pointer from a service to its instances.
pub const PTR: u16 = 12;
/// Facts as `key=value`.
pub const TXT: u16 = 16;
/// An IPv6 address; boards have none.
pub const AAAA: u16 = 28;
/// Host and port of an instance.
pub const SRV: u16 = 33;
/// Which kinds of records there are.
pub const NSEC: u16 = 47;
/// In a question: every kind.
pub const ANY: u16 = 255;
/// The internet.
pub const IN: u16 = 1;
/// Bit of a question's class: an answer by unicast is welcome. Of a record's: it replaces all
/// others of its name and kind.
pub const TOP: u16 = 0x8000;
/// Bit of the header's flags: a response.
pub const RESPONSE: u16 = 0x8000;
/// Bit of the header's flags: authoritative, as all responses are.
pub const AUTHORITY: u16 = 0x0400;
/// Bit of the header's flags: more known answers follow in another message.
pub const TRUNCATED: u16 = 0x0200;

/// Longest label in bytes.
pub const LABEL: usize = 63;
/// Longest name in bytes, with the length of each label.
const NAME: usize = 255;
const HEADER: usize = 12;
/// Questions that are read; a host that looks for a board asks three.
pub const QUESTIONS: usize = 16;
/// Records that are read.
pub const RECORDS: usize = 32;

/// A name in a message; its labels may be elsewhere in it.
#[derive(Clone, Copy, Debug)]
pub struct DomainName<'m> {
    message: &'m [u8],
    at: usize,
}

impl<'m> DomainName<'m> {
    /// The name at this place, and where the bytes after it begin. `None` if it is cut off, too
    /// long, or a loop: each jump has to go to a place before the part of the name it is in.
    pub fn parse(message: &'m [u8], at: usize) -> Option<(Self, usize)> {
        let (mut place, mut part, mut length, mut end) = (at, at, 0, None);
        loop {
            match usize::from(*message.get(place)?) {
                0 => break,
                label @ 1..=LABEL => {
                    length += label + 1;
                    place += label + 1;
                    message.get(..place)?;
                }
                high if high >> 6 == 3 => {
                    let to = (high & 0x3f) << 8 | usize::from(*message.get(place + 1)?);
                    end = end.or(Some(place + 2));
                    if to >= part {
                        return None;
                    }
                    (place, part) = (to, to);
                }
                _ => return None,
            }
            if length >= NAME {
                return None;
            }
        }
        Some((DomainName { message, at }, end.unwrap_or(place + 1)))
    }

    /// The labels, without the empty one at the end.
    pub fn labels(&self) -> impl Iterator<Item = &'m [u8]> + use<'m> {
        let (message, mut at) = (self.message, self.at);
        // `parse` has seen that this ends.
        core::iter::from_fn(move || {
            loop {
                let length = usize::from(*message.get(at)?);
                if length >> 6 == 3 {
                    at = (length & 0x3f) << 8 | usize::from(*message.get(at + 1)?);
                    continue;
                }
                let label = message.get(at + 1..at + 1 + length)?;
                at += 1 + length;
                return (length > 0).then_some(label);
            }
        })
    }

    /// Does it consist of these labels? Letters are the same in both cases.
    pub fn is(&self, labels: &[&str]) -> bool {
        let mut mine = self.labels();
        let same = labels.iter().all(|label| {
            mine.next()
                .is_some_and(|mine| mine.eq_ignore_ascii_case(label.as_bytes()))
        });
        same && mine.next().is_none()
    }

    /// Is it an instance of this service? Then the instance's label.
    pub fn instance_of(&self, service: &[&str]) -> Option<&'m [u8]> {
        let mut labels = self.labels();
        let instance = labels.next()?;
        let same = service.iter().all(|label| {
            labels
                .next()
                .is_some_and(|mine| mine.eq_ignore_ascii_case(label.as_bytes()))
        });
        (same && labels.next().is_none()).then_some(instance)
    }
}

/// A question.
#[derive(Clone, Copy, Debug)]
pub struct Question<'m> {
    /// What is asked about.
    pub name: DomainName<'m>,
    /// The kind of record.
    pub kind: u16,
    /// [`IN`], and perhaps [`TOP`].
    pub class: u16,
}

/// The part of a message that a record is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// Answers; in a question: what the sender knows already.
    Answer,
    /// In a question: what the sender is going to claim.
    Authority,
    /// What is of use besides.
    Additional,
}

/// A record.
#[derive(Clone, Copy, Debug)]
pub struct Record<'m> {
    /// Where it stands.
    pub section: Section,
    /// Whose it is.
    pub name: DomainName<'m>,
    /// Its kind.
    pub kind: u16,
    /// [`IN`], and perhaps [`TOP`].
    pub class: u16,
    /// Seconds it may be kept.
    pub ttl: u32,
    /// Its content.
    pub data: &'m [u8],
    message: &'m [u8],
    at: usize,
}

impl<'m> Record<'m> {
    /// The name in the content, which begins there: of a [`PTR`] at 0, of an [`SRV`] at 6.
    pub fn name_at(&self, offset: usize) -> Option<DomainName<'m>> {
        let (name, end) = DomainName::parse(self.message, self.at + offset)?;
        (end <= self.at + self.data.len()).then_some(name)
    }

    /// The address of an [`A`].
    pub fn ip(&self) -> Option<u32> {
        let bytes = self.data.try_into().ok()?;
        (self.kind == A).then(|| u32::from_be_bytes(bytes))
    }

    /// The port of an [`SRV`].
    pub fn port(&self) -> Option<u16> {
        let bytes = self.data.get(4..6)?.first_chunk()?;
        (self.kind == SRV).then(|| u16::from_be_bytes(*bytes))
    }

    /// The strings of a [`TXT`].
    pub fn strings(&self) -> impl Iterator<Item = &'m [u8]> + use<'m> {
        let mut rest = if self.kind == TXT { self.data } else { &[] };
        core::iter::from_fn(move || {
            let (length, behind) = rest.split_first()?;
            let (string, behind) = behind.split_at_checked(usize::from(*length))?;
            rest = behind;
            Some(string)
        })
    }
}

/// A message whose header is whole. What it holds is read up to the first thing that is wrong.
#[derive(Clone, Copy, Debug)]
pub struct Message<'m> {
    bytes: &'m [u8],
    /// Number of the question; 0 but for one-shot questions and their answers.
    pub id: u16,
    /// Flags.
    pub flags: u16,
    counts: [u16; 4],
}

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    let bytes = bytes.get(at..at + 2)?.first_chunk()?;
    Some(u16::from_be_bytes(*bytes))
}

impl<'m> Message<'m> {
    /// Reads the header.
    pub fn parse(bytes: &'m [u8]) -> Option<Self> {
        let field = |n: usize| word(bytes, 2 * n);
        Some(Message {
            bytes,
            id: field(0)?,
            flags: field(1)?,
            counts: [field(2)?, field(3)?, field(4)?, field(5)?],
        })
    }

    /// Is it a response?
    pub fn is_response(&self) -> bool {
        self.flags & RESPONSE != 0
    }

    fn question(&self, at: usize) -> Option<(Question<'m>, usize)> {
        let (name, end) = DomainName::parse(self.bytes, at)?;
        let question = Question {
            name,
            kind: word(self.bytes, end)?,
            class: word(self.bytes, end + 2)?,
        };
        Some((question, end + 4))
    }

    /// The questions.
    pub fn questions(&self) -> impl Iterator<Item = Question<'m>> + use<'m> {
        let (message, mut at) = (*self, HEADER);
        let count = usize::from(self.counts[0]).min(QUESTIONS);
        (0..count).map_while(move |_| {
            let (question, end) = message.question(at)?;
            at = end;
            Some(question)
        })
    }

    /// The records after the questions. None if there are too many questions, or a wrong one.
    pub fn records(&self) -> impl Iterator<Item = Record<'m>> + use<'m> {
        let [questions, answers, authorities, additionals] = self.counts.map(usize::from);
        let message = *self;
        let mut at = Some(HEADER);
        if questions > QUESTIONS {
            at = None;
        }
        for _ in 0..questions.min(QUESTIONS) {
            at = at.and_then(|at| Some(message.question(at)?.1));
        }
        let count = at.map_or(0, |_| answers + authorities + additionals);
        let mut at = at.unwrap_or(HEADER);
        (0..count.min(RECORDS)).map_while(move |n| {
            let section = match n {
                _ if n < answers => Section::Answer,
                _ if n < answers + authorities => Section::Authority,
                _ => Section::Additional,
            };
            let (record, end) = message.record(section, at)?;
            at = end;
            Some(record)
        })
    }

    fn record(&self, section: Section, at: usize) -> Option<(Record<'m>, usize)> {
        let bytes = self.bytes;
        let (name, end) = DomainName::parse(bytes, at)?;
        let ttl = u32::from(word(bytes, end + 4)?) << 16 | u32::from(word(bytes, end + 6)?);
        let length = usize::from(word(bytes, end + 8)?);
        let at = end + 10;
        let record = Record {
            section,
            name,
            kind: word(bytes, end)?,
            class: word(bytes, end + 2)?,
            ttl,
            data: bytes.get(at..at + length)?,
            message: bytes,
            at,
        };
        Some((record, at + length))
    }
}

/// Writes a message. What does not fit is left out, whole records at a time.
#[derive(Debug)]
pub struct Writer<'b> {
    bytes: &'b mut [u8],
    used: usize,
    counts: [u16; 4],
}

impl<'b> Writer<'b> {
    /// A message without anything in it.
    pub fn new(bytes: &'b mut [u8], id: u16, flags: u16) -> Self {
        let mut writer = Writer {
            bytes,
            used: 0,
            counts: [0; 4],
        };
        let [i, d] = id.to_be_bytes();
        let [f, g] = flags.to_be_bytes();
        writer.put(&[i, d, f, g, 0, 0, 0, 0, 0, 0, 0, 0]);
        writer
    }

    fn put(&mut self, bytes: &[u8]) -> bool {
        let end = self.used + bytes.len();
        let Some(place) = self.bytes.get_mut(self.used..end) else {
            return false;
        };
        place.copy_from_slice(bytes);
        self.used = end;
        true
    }

    fn name(&mut self, labels: &[&str]) -> bool {
        labels.iter().all(|label| {
            let length = label.len();
            (1..=LABEL).contains(&length) && self.put(&[length as u8]) && self.put(label.as_bytes())
        }) && self.put(&[0])
    }

    fn words(&mut self, words: &[u16]) -> bool {
        words.iter().all(|word| self.put(&word.to_be_bytes()))
    }

    /// Keeps what was written if it is whole, and counts it.
    fn settle(&mut self, begin: usize, whole: bool, section: usize) {
        if whole {
            if let Some(count) = self.counts.get_mut(section) {
                *count += 1;
            }
        } else {
            self.used = begin;
        }
    }

    /// A question.
    pub fn question(&mut self, name: &[&str], kind: u16, class: u16) {
        let begin = self.used;
        let whole = self.name(name) && self.words(&[kind, class]);
        self.settle(begin, whole, 0);
    }

    /// A record, whose content `data` writes.
    pub fn record(
        &mut self,
        section: Section,
        (name, kind, class, ttl): (&[&str], u16, u16, u32),
        data: impl FnOnce(&mut Data) -> bool,
    ) {
        let begin = self.used;
        let mut whole = self.name(name)
            && self.words(&[kind, class, (ttl >> 16) as u16, ttl as u16])
            && self.words(&[0]);
        if whole {
            let at = self.used;
            whole = data(&mut Data(self.bytes, &mut self.used));
            let length = (self.used - at) as u16;
            if let Some(place) = self.bytes.get_mut(at - 2..at) {
                place.copy_from_slice(&length.to_be_bytes());
            }
        }
        let section = match section {
            Section::Answer => 1,
            Section::Authority => 2,
            Section::Additional => 3,
        };
        self.settle(begin, whole, section);
    }

    /// Is there nothing but the header in it?
    pub fn is_empty(&self) -> bool {
        self.used == HEADER
    }

    /// Bytes of the whole message.
    pub fn finish(self) -> usize {
        for (at, count) in (4..).step_by(2).zip(self.counts) {
            if let Some(place) = self.bytes.get_mut(at..at + 2) {
                place.copy_from_slice(&count.to_be_bytes());
            }
        }
        self.used
    }
}

/// The content of a record.
#[derive(Debug)]
pub struct Data<'w>(&'w mut [u8], &'w mut usize);

impl Data<'_> {
    /// Bytes. False if there was no room.
    pub fn put(&mut self, bytes: &[u8]) -> bool {
        let end = *self.1 + bytes.len();
        let Some(place) = self.0.get_mut(*self.1..end) else {
            return false;
        };
        place.copy_from_slice(bytes);
        *self.1 = end;
        true
    }

    /// A name.
    pub fn name(&mut self, labels: &[&str]) -> bool {
        labels
            .iter()
            .all(|label| self.put(&[label.len() as u8]) && self.put(label.as_bytes()))
            && self.put(&[0])
    }

    /// A string of a [`TXT`], of two pieces.
    pub fn string(&mut self, key: &[u8], value: &[u8]) -> bool {
        let length = (key.len() + value.len()).min(255);
        self.put(&[length as u8]) && self.put(key) && self.put(value)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    fn message() -> Vec<u8> {
        let mut room = [0; 512];
        let mut writer = Writer::new(&mut room, 7, RESPONSE | AUTHORITY);
        writer.question(&["mill", "local"], ANY, IN | TOP);
        let a = (&["mill", "local"][..], A, IN | TOP, 120);
        writer.record(Section::Answer, a, |data| data.put(&[192, 168, 2, 50]));
        let srv = (&["mill", "_ferrocnc", "_udp", "local"][..], SRV, IN, 120);
        writer.record(Section::Additional, srv, |data| {
            data.put(&[0, 0, 0, 0, 4, 210]) && data.name(&["mill", "local"])
        });
        let txt = (&["mill", "_ferrocnc", "_udp", "local"][..], TXT, IN, 4500);
        writer.record(Section::Additional, txt, |data| {
            data.string(UID.as_bytes(), b"0123456789abcdef")
        });
        let length = writer.finish();
        room[..length].to_vec()
    }

    #[test]
    fn what_is_written_is_read() {
        let bytes = message();
        let message = Message::parse(&bytes).unwrap();
        assert!(message.is_response() && message.id == 7);
        let asked: Vec<_> = message.questions().collect();
        assert_eq!(asked.len(), 1);
        assert!(asked[0].name.is(&["MILL", "local"]) && asked[0].kind == ANY);
        let records: Vec<_> = message.records().collect();
        assert_eq!(records.len(), 3);
        assert_eq!(records[0].ip(), Some(0xc0a8_0232));
        assert_eq!(records[1].port(), Some(1234));
        assert!(records[1].name_at(6).unwrap().is(&["mill", "local"]));
        assert_eq!(records[1].name.instance_of(&FERROCNC), Some(&b"mill"[..]));
        let strings: Vec<_> = records[2].strings().collect();
        assert_eq!(strings, [&b"uid=0123456789abcdef"[..]]);
    }

    #[test]
    fn a_message_that_is_cut_off_gives_what_is_whole() {
        let bytes = message();
        for length in 0..bytes.len() {
            if let Some(message) = Message::parse(&bytes[..length]) {
                assert!(message.records().count() < 3, "{length}");
                message.questions().for_each(drop);
            }
        }
    }

    #[test]
    fn a_jump_that_goes_nowhere_back_is_no_name() {
        // To itself, to each other, forwards, and beyond.
        for bytes in [
            &[0xc0, 0][..],
            &[1, b'a', 0xc0, 0],
            &[0xc0, 2, 0xc0, 0],
            &[0xc0, 2, 0],
            &[0xff, 0xff],
            &[0x40, 0],
            &[0x80],
        ] {
            assert!(DomainName::parse(bytes, 0).is_none(), "{bytes:?}");
        }
        let bytes = [1, b'b', 0, 1, b'a', 0xc0, 0];
        let (name, end) = DomainName::parse(&bytes, 3).unwrap();
        assert!(name.is(&["a", "b"]) && end == 7);
    }

    #[test]
    fn a_name_of_more_than_255_bytes_is_none() {
        let mut bytes = Vec::new();
        for _ in 0..5 {
            bytes.push(63);
            bytes.extend([b'x'; 63]);
        }
        bytes.push(0);
        assert!(DomainName::parse(&bytes, 0).is_none());
        assert!(DomainName::parse(&bytes, 64 * 2).is_some());
    }

    #[test]
    fn what_does_not_fit_is_left_out_whole() {
        let mut room = [0; 60];
        let mut writer = Writer::new(&mut room, 0, 0);
        let name = &["mill", "local"][..];
        for _ in 0..3 {
            writer.record(Section::Answer, (name, A, IN, 1), |data| data.put(&[1; 4]));
        }
        let length = writer.finish();
        let message = Message::parse(&room[..length]).unwrap();
        assert_eq!(message.records().count(), 1);
    }
}
