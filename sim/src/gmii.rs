//! Ethernet frames as the bytes a PHY sees: preamble, start delimiter, padding, FCS, inter-frame
//! gap.
//!
//! Knows nothing above layer 1. One byte per 125 MHz clock each way:
//!
//! ```text
//! dv    ____/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\____________/‾‾
//! data      | 55 x7 | d5 | frame, >= 60 | FCS 4  |  >= 12     | 55
//!           ^ first                              ^ last
//! ```

use std::collections::VecDeque;

// Ethernet's FCS and the board blob's checksum are the same CRC-32.
use wire::board::crc32;

/// Shortest frame without FCS (IEEE 802.3); shorter ones are padded with zeros.
pub const MIN_FRAME: usize = 60;
/// Byte times between two frames (IEEE 802.3).
pub const INTER_FRAME_GAP: u32 = 12;
/// Bytes before the frame: seven of preamble and the start delimiter.
pub const PREAMBLE: [u8; 8] = [0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0xd5];

/// Wrap a frame (destination MAC .. payload) for the wire: preamble, padding to [`MIN_FRAME`], FCS.
pub fn encode(frame: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(PREAMBLE.len() + frame.len().max(MIN_FRAME) + 4);
    out.extend(PREAMBLE);
    out.extend(frame);
    out.resize(out.len().max(PREAMBLE.len() + MIN_FRAME), 0);
    let fcs = crc32(&out[PREAMBLE.len()..]);
    out.extend(fcs.to_le_bytes());
    out
}

/// Why bytes seen on the wire are not a valid frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Malformed {
    /// No start delimiter where it belongs.
    Preamble,
    /// Fewer than 64 bytes with FCS.
    Runt,
    /// The FCS does not match.
    Fcs,
}

/// Unwrap what [`encode`] made: the frame without preamble and FCS, padding included.
pub fn decode(wire: &[u8]) -> Result<&[u8], Malformed> {
    let body = wire.strip_prefix(&PREAMBLE).ok_or(Malformed::Preamble)?;
    if body.len() < MIN_FRAME + 4 {
        return Err(Malformed::Runt);
    }
    let (frame, fcs) = body.split_at(body.len() - 4);
    if crc32(frame).to_le_bytes() != *fcs {
        Err(Malformed::Fcs)
    } else {
        Ok(frame)
    }
}

/// Bytes that went over the wire, with the times of their first and last byte.
///
/// Times are ticks of the board's clockwork ([`crate::board::Clockwork`]). `first` is the edge
/// after which the first byte stands on the wire, `last` the edge at which the receiver takes the
/// last one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Number given by [`Feeder::push`], or counted up by [`Collector`].
    pub id: u64,
    /// Everything from the preamble to the FCS.
    pub wire: Vec<u8>,
    /// Start of the first preamble byte, ticks.
    pub first: u64,
    /// End of the last FCS byte, ticks.
    pub last: u64,
}

/// Times of a transfer without its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    /// Number given by [`Feeder::push`].
    pub id: u64,
    /// Start of the first byte, ticks.
    pub first: u64,
    /// End of the last byte, ticks.
    pub last: u64,
}

/// Feeds queued frames to the board's receiver, a byte per edge of the Ethernet clock.
#[derive(Debug, Default)]
pub struct Feeder {
    queue: VecDeque<(u64, Vec<u8>)>,
    position: usize,
    gap: u32,
    first: u64,
    next_id: u64,
    /// Byte on the wire now; `None` between frames.
    byte: Option<u8>,
}

impl Feeder {
    /// Queue wire bytes (usually from [`encode`]); returns the number under which [`Sent`] reports
    /// them.
    pub fn push(&mut self, wire: Vec<u8>) -> u64 {
        let id = self.next_id;
        self.next_id += 1;
        if !wire.is_empty() {
            self.queue.push_back((id, wire));
        }
        id
    }

    /// Nothing on the wire, nothing queued, gap over.
    pub fn idle(&self) -> bool {
        self.queue.is_empty() && self.gap == 0 && self.byte.is_none()
    }

    /// The byte that stands on the wire now.
    pub fn byte(&self) -> Option<u8> {
        self.byte
    }

    /// One rising edge at `now` has taken the present byte; put the next one. Returns the frame
    /// this edge finished.
    pub fn edge(&mut self, now: u64) -> Option<Sent> {
        if let Some((id, wire)) = self.queue.front() {
            if self.gap == 0 && self.position < wire.len() {
                if self.position == 0 {
                    self.first = now;
                }
                self.byte = Some(wire[self.position]);
                self.position += 1;
                return None;
            }
            if self.byte.is_some() {
                let sent = Sent {
                    id: *id,
                    first: self.first,
                    last: now,
                };
                self.queue.pop_front();
                self.position = 0;
                self.byte = None;
                // This very edge opens the gap.
                self.gap = INTER_FRAME_GAP - 1;
                return Some(sent);
            }
        }
        self.gap = self.gap.saturating_sub(1);
        None
    }
}

/// Gathers what the board transmits into frames.
#[derive(Debug, Default)]
pub struct Collector {
    bytes: Vec<u8>,
    first: u64,
    count: u64,
}

impl Collector {
    /// In the middle of a frame.
    pub fn active(&self) -> bool {
        !self.bytes.is_empty()
    }

    /// Outputs after the rising edge at `now`. Returns a frame when this edge ended one.
    pub fn edge(&mut self, now: u64, enable: bool, data: u8) -> Option<Transfer> {
        if enable {
            if self.bytes.is_empty() {
                self.first = now;
            }
            self.bytes.push(data);
            return None;
        }
        if self.bytes.is_empty() {
            return None;
        }
        let id = self.count;
        self.count += 1;
        Some(Transfer {
            id,
            wire: std::mem::take(&mut self.bytes),
            first: self.first,
            last: now,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_of_the_textbook() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn short_frames_are_padded_and_come_back() {
        let wire = encode(&[1, 2, 3]);
        assert_eq!(wire.len(), 8 + 60 + 4);
        let frame = decode(&wire).unwrap();
        assert_eq!((frame.len(), &frame[..4]), (60, &[1, 2, 3, 0][..]));
    }

    #[test]
    fn long_frames_keep_their_length() {
        let frame: Vec<u8> = (0..1514).map(|i| i as u8).collect();
        assert_eq!(decode(&encode(&frame)), Ok(&frame[..]));
    }

    #[test]
    fn damage_is_named() {
        let good = encode(&[7; 64]);
        let mut bad = good.clone();
        bad[20] ^= 1;
        assert_eq!(decode(&bad), Err(Malformed::Fcs));
        assert_eq!(decode(&good[..40]), Err(Malformed::Runt));
        assert_eq!(decode(&good[1..]), Err(Malformed::Preamble));
        assert_eq!(decode(&[]), Err(Malformed::Preamble));
    }

    /// Run a feeder into a collector edge by edge, as the board does; ticks are 12 per edge.
    fn loopback(frames: &[Vec<u8>], edges: u64) -> (Vec<Sent>, Vec<Transfer>) {
        let (mut feeder, mut collector) = (Feeder::default(), Collector::default());
        for frame in frames {
            feeder.push(frame.clone());
        }
        let (mut sent, mut got) = (vec![], vec![]);
        for n in 0..edges {
            sent.extend(feeder.edge(12 * n));
            let byte = feeder.byte();
            got.extend(collector.edge(12 * n, byte.is_some(), byte.unwrap_or(0)));
        }
        (sent, got)
    }

    #[test]
    fn frames_travel_whole_with_a_gap_between() {
        let frames = [encode(&[1; 60]), encode(&[2; 100])];
        let (sent, got) = loopback(&frames, 300);
        assert_eq!(
            got.iter().map(|t| t.wire.clone()).collect::<Vec<_>>(),
            frames
        );
        assert_eq!(sent.iter().map(|s| s.id).collect::<Vec<_>>(), [0, 1]);
        assert_eq!(got[1].first - got[0].last, 12 * u64::from(INTER_FRAME_GAP));
    }

    #[test]
    fn times_span_the_bytes_exactly() {
        let (sent, got) = loopback(&[encode(&[0; 60])], 100);
        assert_eq!(sent[0].last - sent[0].first, 12 * 72);
        assert_eq!((got[0].first, got[0].last), (sent[0].first, sent[0].last));
    }

    #[test]
    fn back_to_back_queue_goes_idle() {
        let mut feeder = Feeder::default();
        assert!(feeder.idle());
        feeder.push(encode(&[0; 60]));
        let mut edges = 0;
        while !feeder.idle() {
            feeder.edge(edges);
            edges += 1;
        }
        assert_eq!(edges, 72 + u64::from(INTER_FRAME_GAP));
    }
}
