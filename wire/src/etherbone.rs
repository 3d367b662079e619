//! Etherbone packets: checked completely, then read as numbers.
//!
//! ```text
//! word 0   4e6f | version 4 | - nr pr pf | 4 | 4       4e6f1044 normal, 4e6f1144 probe
//! word 1   padding
//! then records, each:
//!   word   flags 8 | byte enable 8 | wcount 8 | rcount 8
//!   if wcount:  base write address, wcount data words
//!   if rcount:  base return address, rcount read addresses
//! ```
//!
//! The reply to reads is itself a write record: `rcount` becomes `wcount` and the base return
//! address comes back in the base write address' place. That word is the only sequence number
//! plain Etherbone has.
//!
//! Gateware Etherbone as LiteEth builds it executes while it parses: a truncated write makes later
//! packets land in registers, padding writes 0 to address 0, and too long a read hangs it until
//! power-off. Here [`Packet::new_checked`] first walks every record to the end of the datagram, so
//! no record can fail afterwards.

use crate::{MAX_WORDS, Refusal};

/// First word of a packet without flags: magic, version 1, 32-bit addresses, 32-bit data.
pub const HEADER: u32 = 0x4e6f_1044;
/// First word of a probe.
pub const HEADER_PROBE: u32 = 0x4e6f_1144;
/// First word of a probe's reply.
pub const HEADER_PROBE_REPLY: u32 = 0x4e6f_1244;

/// Words before the first record.
pub const HEADER_WORDS: usize = 2;
/// Words of a packet of one record before what the record writes or reads, and so of an answer
/// before the words that were read: header, padding, record header, base address.
pub const OVERHEAD: usize = HEADER_WORDS + 2;
/// The only valid byte enable, at its place in a record header.
pub const BYTE_ENABLE: u32 = 0x000f_0000;

/// The header of a record that writes and reads this many words, each at most 255.
pub const fn record(writes: usize, reads: usize) -> u32 {
    BYTE_ENABLE | (writes as u32) << 8 | reads as u32
}

/// How many words a record with this header writes and reads.
pub const fn counts(header: u32) -> (usize, usize) {
    ((header >> 8 & 0xff) as usize, (header & 0xff) as usize)
}

/// Upper half of a packet's first word.
pub const MAGIC: u32 = 0x4e6f;
/// Bit of a packet's first word: a probe.
pub const FLAG_PROBE: u32 = 1 << 8;
const FLAG_PROBE_REPLY: u32 = 1 << 9;
const FLAG_NO_READS: u32 = 1 << 10;
/// Record flags that ask for anything but plain memory: rca, rff, reserved, wca, wff, reserved.
const FORBIDDEN_RECORD_FLAGS: u32 = 0b1110_1110 << 24;

/// A packet with all its records inside its datagram.
#[derive(Clone, Copy, Debug)]
pub struct Packet<'w> {
    header: u32,
    body: &'w [u32],
    /// The only record, if there is one.
    sole: Option<Record<'w>>,
}

/// One record: the words to write and where, the addresses to read and what to echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'w> {
    /// Address of the first written word; the next words follow upwards.
    pub write_base: u32,
    /// The words to write, possibly none.
    pub writes: &'w [u32],
    /// Comes back unchanged with the read words.
    pub return_base: u32,
    /// Absolute addresses to read, possibly none.
    pub reads: &'w [u32],
}

impl<'w> Packet<'w> {
    /// Checks a whole datagram: header, then every record against the end of the datagram, then the
    /// size of the answer. It does not check addresses; the server does.
    pub fn new_checked(words: &'w [u32]) -> Result<Self, Refusal> {
        let [header, _padding, body @ ..] = words else {
            // A wrong first byte makes a packet foreign rather than short.
            return Err(match words.first() {
                Some(first) if first >> 16 != MAGIC => Refusal::Magic,
                _ => Refusal::Short,
            });
        };
        let mut packet = Packet {
            header: *header,
            body,
            sole: None,
        };
        if header >> 16 != MAGIC {
            return Err(Refusal::Magic);
        }
        if header >> 12 & 0xf != 1 {
            return Err(Refusal::Version);
        }
        if header & 0xff != 0x44 {
            return Err(Refusal::Width);
        }
        if header & FLAG_PROBE_REPLY != 0 {
            return Err(Refusal::ProbeReply);
        }
        if words.len() > MAX_WORDS {
            return Err(Refusal::Oversized);
        }
        if packet.is_probe() {
            return if body.is_empty() {
                Err(Refusal::Short)
            } else {
                Ok(packet)
            };
        }
        let mut rest = body;
        let mut reply = HEADER_WORDS;
        if rest.is_empty() {
            return Err(Refusal::Short);
        }
        let whole = rest.len();
        while !rest.is_empty() {
            let (record, after) = split_record(rest)?;
            if !record.reads.is_empty() {
                reply += 2 + record.reads.len();
            }
            packet.sole = (rest.len() == whole).then_some(record);
            rest = after;
        }
        if reply > MAX_WORDS {
            return Err(Refusal::ReplyTooLong);
        }
        Ok(packet)
    }

    /// Is this a probe? It asks whether there is an Etherbone server here; its payload is echoed.
    pub fn is_probe(&self) -> bool {
        self.header & FLAG_PROBE != 0
    }

    /// "No reads": do not send the words that are read.
    pub fn no_reads(&self) -> bool {
        self.header & FLAG_NO_READS != 0
    }

    /// The words after the header: a probe's payload, or the records.
    pub fn body(&self) -> &'w [u32] {
        self.body
    }

    /// The packet's record, if it has no other.
    pub fn sole(&self) -> Option<Record<'w>> {
        self.sole
    }

    /// The records in order; none for a probe.
    pub fn records(&self) -> Records<'w> {
        Records {
            rest: if self.is_probe() { &[] } else { self.body },
        }
    }
}

/// Iterator over the records of a checked packet.
#[derive(Clone, Debug)]
pub struct Records<'w> {
    rest: &'w [u32],
}

impl<'w> Iterator for Records<'w> {
    type Item = Record<'w>;

    fn next(&mut self) -> Option<Record<'w>> {
        // `new_checked` walked this same slice, so an error can only mean the end.
        let (record, rest) = split_record(self.rest).ok()?;
        self.rest = rest;
        Some(record)
    }
}

fn split_record(words: &[u32]) -> Result<(Record<'_>, &[u32]), Refusal> {
    let (&header, rest) = words.split_first().ok_or(Refusal::Truncated)?;
    let (write_count, read_count) = counts(header);
    if write_count == 0 && read_count == 0 {
        return Err(Refusal::Padded);
    }
    if header & 0x00ff_0000 != BYTE_ENABLE {
        return Err(Refusal::ByteEnable);
    }
    if header & FORBIDDEN_RECORD_FLAGS != 0 {
        return Err(Refusal::RecordFlags);
    }
    let (write_base, writes, rest) = split_half(rest, write_count)?;
    let (return_base, reads, rest) = split_half(rest, read_count)?;
    Ok((
        Record {
            write_base,
            writes,
            return_base,
            reads,
        },
        rest,
    ))
}

/// Splits off a base word and the `count` words after it; nothing at all if `count` is 0.
fn split_half(words: &[u32], count: usize) -> Result<(u32, &[u32], &[u32]), Refusal> {
    if count == 0 {
        return Ok((0, &[], words));
    }
    let (&base, rest) = words.split_first().ok_or(Refusal::Truncated)?;
    let (body, rest) = rest.split_at_checked(count).ok_or(Refusal::Truncated)?;
    Ok((base, body, rest))
}

/// Builds packets, both requests and replies, in a word buffer. Every method returns `false`
/// instead of writing past the buffer's end.
#[derive(Debug)]
pub struct ReplyWriter<'b> {
    buffer: &'b mut [u32],
    used: usize,
}

impl<'b> ReplyWriter<'b> {
    /// Starts a packet with this first word.
    pub fn new(buffer: &'b mut [u32], header: u32) -> Self {
        let mut writer = ReplyWriter { buffer, used: 0 };
        writer.push(header);
        writer.push(0);
        writer
    }

    /// Appends one word.
    pub fn push(&mut self, word: u32) -> bool {
        let Some(slot) = self.buffer.get_mut(self.used) else {
            return false;
        };
        *slot = word;
        self.used += 1;
        true
    }

    /// Appends words.
    pub fn extend(&mut self, words: &[u32]) -> bool {
        let Some(places) = self.places(words.len()) else {
            return false;
        };
        for (place, word) in places.iter_mut().zip(words) {
            *place = *word;
        }
        true
    }

    /// Appends so many words, to be written by the caller.
    pub fn room<const N: usize>(&mut self) -> Option<&mut [u32; N]> {
        self.places(N)?.first_chunk_mut()
    }

    /// The same for a number that is only known at run time.
    pub fn places(&mut self, count: usize) -> Option<&mut [u32]> {
        let places = self.buffer.get_mut(self.used..)?.get_mut(..count)?;
        self.used += count;
        Some(places)
    }

    /// Opens a record that carries `count` words for `base`; push exactly that many afterwards.
    pub fn write_record(&mut self, base: u32, count: u8) -> bool {
        self.push(record(count.into(), 0)) && self.push(base)
    }

    /// A whole record that reads `addresses` and asks for the words under `return_base`.
    pub fn read_record(&mut self, return_base: u32, addresses: &[u32]) -> bool {
        let Ok(count) = u8::try_from(addresses.len()) else {
            return false;
        };
        self.push(record(0, count.into())) && self.push(return_base) && self.extend(addresses)
    }

    /// The packet so far.
    pub fn words(&self) -> &[u32] {
        self.buffer.get(..self.used).unwrap_or(&[])
    }
}

/// A request of the host: whole records that write words or read them, in one packet.
#[derive(Debug)]
pub struct Request<'b> {
    packet: ReplyWriter<'b>,
    whole: bool,
}

impl<'b> Request<'b> {
    /// Starts a request in this buffer.
    pub fn new(buffer: &'b mut [u32]) -> Self {
        Request {
            packet: ReplyWriter::new(buffer, HEADER),
            whole: true,
        }
    }

    /// Writes these words from an address on; no words make no record.
    #[must_use]
    pub fn write(mut self, base: u32, words: &[u32]) -> Self {
        if words.is_empty() {
            return self;
        }
        self.whole &= u8::try_from(words.len())
            .is_ok_and(|count| self.packet.write_record(base, count) && self.packet.extend(words));
        self
    }

    /// Reads these addresses: the answer carries the tag, and the words in this order.
    #[must_use]
    pub fn read(mut self, tag: u32, addresses: &[u32]) -> Self {
        self.whole &= self.packet.read_record(tag, addresses);
        self
    }

    /// Writes these words, then reads these addresses, in one record; the answer is that of
    /// [`Request::read`].
    #[must_use]
    pub fn write_then_read(mut self, base: u32, words: &[u32], tag: u32, reads: &[u32]) -> Self {
        if words.is_empty() || reads.is_empty() {
            self.whole = false;
            return self;
        }
        self.whole &= u8::try_from(words.len().max(reads.len())).is_ok()
            && self.packet.push(record(words.len(), reads.len()))
            && self.packet.push(base)
            && self.packet.extend(words)
            && self.packet.push(tag)
            && self.packet.extend(reads);
        self
    }

    /// The packet; `None` if a record did not fit.
    pub fn words(self) -> Option<&'b [u32]> {
        let buffer: &'b [u32] = self.packet.buffer;
        buffer
            .get(..self.packet.used)
            .filter(|_| self.whole && self.packet.used >= HEADER_WORDS)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    #[test]
    fn a_request_is_whole_or_none() {
        fn request(buffer: &mut [u32]) -> Option<&[u32]> {
            Request::new(buffer)
                .write(0x10, &[])
                .write(0x20, &[1, 2])
                .read(7, &[0x30])
                .words()
        }
        let mut buffer = [0; 9];
        let words = request(&mut buffer[..]).unwrap();
        let records: Vec<_> = Packet::new_checked(words).unwrap().records().collect();
        assert_eq!(records.len(), 2);
        assert_eq!(
            (records[0].write_base, records[0].writes),
            (0x20, &[1, 2][..])
        );
        assert_eq!((records[1].return_base, records[1].reads), (7, &[0x30][..]));
        for room in 0..9 {
            assert_eq!(request(&mut buffer[..room]), None, "{room} words");
        }
        assert_eq!(
            Request::new(&mut [0; 300]).write(0, &[0; 256]).words(),
            None
        );
    }

    #[test]
    fn a_record_that_writes_and_reads_is_whole_or_none() {
        fn request(buffer: &mut [u32]) -> Option<&[u32]> {
            let request = Request::new(buffer);
            request.write_then_read(0x20, &[1, 2], 7, &[0x30]).words()
        }
        let mut buffer = [0; 8];
        let words = request(&mut buffer[..]).unwrap();
        let packet = Packet::new_checked(words).unwrap();
        let record = Record {
            write_base: 0x20,
            writes: &[1, 2],
            return_base: 7,
            reads: &[0x30],
        };
        assert_eq!(packet.sole(), Some(record));
        for room in 0..8 {
            assert_eq!(request(&mut buffer[..room]), None, "{room} words");
        }
        let long = [0; 256];
        for (writes, reads) in [
            (&[][..], &[1][..]),
            (&[1], &[]),
            (&long, &[1]),
            (&[1], &long),
        ] {
            let mut buffer = [0; 600];
            let request = Request::new(&mut buffer).write_then_read(0, writes, 0, reads);
            assert_eq!(request.words(), None);
        }
    }

    fn refused(words: &[u32]) -> Refusal {
        Packet::new_checked(words).expect_err("should be refused")
    }

    #[test]
    fn the_golden_read_is_understood() {
        let words = [HEADER, 0, 0x000f_0002, 0xdead_beef, 0x100, 0x104];
        let packet = Packet::new_checked(&words).unwrap();
        let records: Vec<_> = packet.records().collect();
        assert_eq!(
            records,
            [Record {
                write_base: 0,
                writes: &[],
                return_base: 0xdead_beef,
                reads: &[0x100, 0x104]
            }]
        );
        assert!(!packet.no_reads());
    }

    #[test]
    fn the_golden_write_is_understood() {
        let words = [HEADER, 0, 0x000f_0200, 0x20, 0x1122_3344, 0x5566_7788];
        let record = Packet::new_checked(&words)
            .unwrap()
            .records()
            .next()
            .unwrap();
        assert_eq!((record.write_base, record.writes), (0x20, &words[4..6]));
        assert!(record.reads.is_empty());
    }

    #[test]
    fn a_record_may_write_and_read_and_more_records_may_follow() {
        let words = [
            HEADER,
            0,
            0x000f_0101,
            0x20,
            7,
            0xaa,
            0x100,
            0x000f_0001,
            0xbb,
            0x104,
        ];
        let records: Vec<_> = Packet::new_checked(&words).unwrap().records().collect();
        assert_eq!(records[0].writes, [7]);
        assert_eq!(
            (records[0].return_base, records[0].reads),
            (0xaa, &[0x100][..])
        );
        assert_eq!(
            (records[1].return_base, records[1].reads),
            (0xbb, &[0x104][..])
        );
    }

    #[test]
    fn a_probe_needs_a_payload() {
        assert_eq!(refused(&[HEADER_PROBE, 0]), Refusal::Short);
        let words = [HEADER_PROBE, 0, 0x1234_5678];
        let packet = Packet::new_checked(&words).unwrap();
        assert!(packet.is_probe());
        assert_eq!(packet.body(), [0x1234_5678]);
        assert_eq!(packet.records().count(), 0);
    }

    #[test]
    fn every_bad_header_has_its_own_reason() {
        assert_eq!(refused(&[]), Refusal::Short);
        assert_eq!(refused(&[HEADER]), Refusal::Short);
        assert_eq!(refused(&[HEADER, 0]), Refusal::Short);
        assert_eq!(refused(&[0x1234_1044]), Refusal::Magic);
        assert_eq!(
            refused(&[0x1234_1044, 0, 0x000f_0001, 0, 0]),
            Refusal::Magic
        );
        assert_eq!(
            refused(&[0x4e6f_2044, 0, 0x000f_0001, 0, 0]),
            Refusal::Version
        );
        assert_eq!(
            refused(&[0x4e6f_1011, 0, 0x000f_0001, 0, 0]),
            Refusal::Width
        );
        assert_eq!(refused(&[HEADER_PROBE_REPLY, 0, 1]), Refusal::ProbeReply);
    }

    #[test]
    fn what_liteeth_would_execute_by_mistake_is_refused_whole() {
        let truncated_write = [HEADER, 0, 0x000f_0200, 0x20, 1];
        assert_eq!(refused(&truncated_write), Refusal::Truncated);
        let truncated_read = [HEADER, 0, 0x000f_0002, 0, 0x100];
        assert_eq!(refused(&truncated_read), Refusal::Truncated);
        let padded_write = [HEADER, 0, 0x000f_0100, 0x20, 1, 0];
        assert_eq!(refused(&padded_write), Refusal::Padded);
        assert_eq!(refused(&[HEADER, 0, 0x000f_0000, 0]), Refusal::Padded);
        assert_eq!(
            refused(&[HEADER, 0, 0x0003_0100, 0x20, 1]),
            Refusal::ByteEnable
        );
        assert_eq!(
            refused(&[HEADER, 0, 0x400f_0100, 0x20, 1]),
            Refusal::RecordFlags
        );
    }

    #[test]
    fn every_bit_of_a_packets_header_is_judged_for_itself() {
        for bit in 0..32 {
            let words = [HEADER ^ 1 << bit, 0, 0x000f_0100, 0x20, 7];
            let wanted = match bit {
                0..=7 => Some(Refusal::Width),
                9 => Some(Refusal::ProbeReply),
                12..=15 => Some(Refusal::Version),
                16.. => Some(Refusal::Magic),
                _ => None,
            };
            let packet = Packet::new_checked(&words);
            assert_eq!(packet.map(drop).err(), wanted, "bit {bit}");
            let flags = packet.map(|packet| (packet.is_probe(), packet.no_reads()));
            assert!(wanted.is_some() || flags == Ok((bit == 8, bit == 10)));
        }
    }

    #[test]
    fn every_bit_of_a_records_header_is_judged_for_itself() {
        for bit in 16..32 {
            let words = [HEADER, 0, 0x000f_0100 ^ 1 << bit, 0x20, 7];
            let wanted = match bit {
                16..=23 => Some(Refusal::ByteEnable),
                // CYC and similar flags: hints for the bus, not other address spaces.
                24 | 28 => None,
                _ => Some(Refusal::RecordFlags),
            };
            assert_eq!(Packet::new_checked(&words).map(drop).err(), wanted, "{bit}");
        }
    }

    #[test]
    fn the_longest_datagram_is_taken_and_its_answer_fits_and_a_word_more_is_not() {
        // 255 reads and 104: with two records' overhead as long as a frame.
        let mut words = std::vec![HEADER, 0, 0x000f_00ff];
        words.resize(3 + 256, 0x100);
        let left = MAX_WORDS - words.len() - 2;
        words.push(0x000f_0000 | left as u32);
        words.resize(MAX_WORDS, 0x100);
        let packet = Packet::new_checked(&words).unwrap();
        let mut reply = [0; MAX_WORDS];
        let mut writer = ReplyWriter::new(&mut reply, HEADER);
        for record in packet.records() {
            assert!(writer.write_record(record.return_base, record.reads.len() as u8));
            assert!(writer.extend(record.reads));
        }
        assert_eq!(writer.words().len(), MAX_WORDS);
        words.push(0);
        assert_eq!(refused(&words), Refusal::Oversized);
    }

    #[test]
    fn a_record_of_reads_is_what_the_parser_takes() {
        let mut buffer = [0; 7];
        let mut writer = ReplyWriter::new(&mut buffer, HEADER);
        assert!(!writer.read_record(9, &[0x100; 256]), "no byte says 256");
        assert!(writer.read_record(9, &[0x100, 0x104]));
        assert!(!writer.extend(&[1, 2, 3]));
        let words = writer.words();
        assert_eq!(words, [HEADER, 0, 0x000f_0002, 9, 0x100, 0x104]);
        let record = Packet::new_checked(words).unwrap().records().next();
        assert_eq!(record.unwrap().reads, [0x100, 0x104]);
    }

    #[test]
    fn a_good_first_record_does_not_save_a_bad_second_one() {
        let words = [HEADER, 0, 0x000f_0100, 0x20, 1, 0x000f_0300, 0x24, 2];
        assert_eq!(refused(&words), Refusal::Truncated);
    }

    #[test]
    fn an_answer_that_would_not_fit_one_frame_is_refused() {
        // The request of two full reads does not fit a frame either; the header check sees it
        // first.
        let mut words = std::vec![HEADER, 0];
        for _ in 0..2 {
            words.push(0x000f_00ff);
            words.resize(words.len() + 256, 0x100);
        }
        assert_eq!(refused(&words), Refusal::Oversized);
    }

    #[test]
    fn every_prefix_of_a_good_packet_is_refused_or_good_and_never_panics() {
        let words = [
            HEADER,
            0,
            0x000f_0101,
            0x20,
            7,
            0xaa,
            0x100,
            0x000f_0001,
            0xbb,
            0x104,
        ];
        for length in 0..words.len() {
            let checked = Packet::new_checked(&words[..length]);
            assert_eq!(checked.is_ok(), length == 7, "prefix of {length} words");
        }
    }

    #[test]
    fn a_writer_never_writes_past_its_buffer() {
        let mut buffer = [0; 4];
        let mut writer = ReplyWriter::new(&mut buffer, HEADER);
        assert!(writer.write_record(9, 3));
        assert!(!writer.push(1) && !writer.extend(&[1, 2]));
        assert_eq!(writer.words(), [HEADER, 0, 0x000f_0300, 9]);
    }
}
