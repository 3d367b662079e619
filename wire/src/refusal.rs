//! Every reason why the board drops a datagram. A refused datagram changes nothing.

macro_rules! refusals {
    ($($(#[doc = $doc:literal])+ $name:ident = $key:literal, $text:literal;)+) => {
        /// Why a datagram was refused. The discriminant is its place among the refusal counters
        /// ([`crate::map::COUNTERS_REFUSED`]).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum Refusal { $($(#[doc = $doc])+ $name),+ }

        impl Refusal {
            /// All of them, in counter order.
            pub const ALL: &'static [Refusal] = &[$(Refusal::$name),+];

            /// Short name for counters, logs and pins: lower case with hyphens.
            pub const fn key(self) -> &'static str {
                match self { $(Refusal::$name => $key),+ }
            }

            /// One sentence for people.
            pub const fn text(self) -> &'static str {
                match self { $(Refusal::$name => $text),+ }
            }
        }
    };
}

refusals! {
    /// Shorter than a packet header, or a probe without payload.
    Short = "short", "the datagram ends before its header does";
    /// More than [`crate::MAX_PAYLOAD`] bytes, or more than [`crate::GUEST_WORDS`] from another
    /// client than the owner while the machine is armed.
    Oversized = "oversized", "the datagram is longer than one frame, or than a guest of an armed machine may send";
    /// Not a whole number of 32-bit words.
    Ragged = "ragged", "the datagram is not a whole number of 32-bit words";
    /// Does not begin with `4e 6f`.
    Magic = "magic", "the datagram is not Etherbone";
    /// Etherbone version other than 1.
    Version = "version", "the Etherbone version is not 1";
    /// Address or port width other than 32 bits.
    Width = "width", "address or port width is not 32 bits";
    /// A probe reply: the sender answers a question that was not asked.
    ProbeReply = "probe-reply", "a probe reply arrived, but the board never probes";
    /// A record is longer than the datagram.
    Truncated = "truncated", "a record is longer than the datagram";
    /// A record that neither writes nor reads: padding, or an empty packet.
    Padded = "padded", "the datagram holds an empty record or padding";
    /// Byte enable other than `0x0f`.
    ByteEnable = "byte-enable", "only whole 32-bit words can be accessed";
    /// A record flag other than `cyc` or `bca`: configuration space and FIFO accesses do not exist
    /// here.
    RecordFlags = "record-flags", "the record asks for configuration space or FIFO access";
    /// The answer would not fit one frame.
    ReplyTooLong = "reply-too-long", "the answer would not fit one frame";
    /// Address bits 1:0 are not zero.
    Alignment = "alignment", "an address is not a multiple of 4";
    /// The address belongs to no window.
    Unmapped = "unmapped", "an address belongs to no window";
    /// A write to something that can only be read.
    ReadOnly = "read-only", "a write goes to a read-only address";
    /// A command block with another length than this board's.
    BlockLength = "block-length", "the command block has not this board's length";
    /// Mixed with an exchange, or an exchange that is not alone in its datagram.
    NotAlone = "not-alone", "an exchange must be alone in its datagram";
    /// The sender does not own the session, or its token is wrong.
    NotOwner = "not-owner", "the sender does not own the session";
    /// Sequence number equal to the last accepted one.
    Duplicate = "duplicate", "the sequence number was already executed";
    /// Sequence number older than the last accepted one.
    Stale = "stale", "the sequence number is older than the last executed one";
    /// Only possible while the machine is disarmed.
    Armed = "armed", "this cannot be changed while the machine is armed";
    /// A value outside what the register can hold or the machine allows.
    Value = "value", "a value is out of range";
    /// A wrong IPv4 or UDP checksum.
    Checksum = "checksum", "a checksum is wrong";
    /// An operation of the flash is running, or the datagram came while the board had no time for a
    /// guest of a moving machine; ask again.
    Busy = "busy", "a flash operation is running, or the machine moves and the board has no time; ask again";
    /// The board has a key, and the sender has not proved that it has it, too: no answer to the
    /// challenge, a wrong or a used one, or a late one.
    Key = "key", "the board has a key and the sender has not proved to have it";
}

/// The counter after those of the refusals: how often pulses may have been cut off since the
/// board's start. A board that does not count them reads 0 there.
pub const COUNTERS_CUTS: u32 = crate::map::COUNTERS_REFUSED + 4 * Refusal::COUNT as u32;

/// The two counters behind that: clocks of the longest call of the services since the board's
/// start, while a host moved the machine, and at any other time. Their first call is not counted:
/// it tests the SDRAM.
pub const COUNTERS_CALLS: u32 = COUNTERS_CUTS + 4;

/// The three words behind that: exchanges that the gateware executed and answered by itself,
/// exchanges that took the long way through the firmware, and the [`LongWay`] of the last of those.
pub const COUNTERS_WAYS: u32 = COUNTERS_CALLS + 8;

/// Why an exchange took the long way through the firmware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum LongWay {
    /// None did.
    #[default]
    None = 0,
    /// The board had not judged it in advance: the first one, arming, a stop, or it came too soon.
    NoPass = 1,
    /// Another sequence number than the next: a frame before it was lost.
    Sequence = 2,
    /// Other flags than those of the exchange before.
    Flags = 3,
    /// It has a time to be applied at, and the one before was still waiting for its own.
    Timed = 4,
    /// Its frame or the gate differed from what was judged: TOS, TTL, checksum, length.
    Frame = 5,
}

impl LongWay {
    /// All of them, in the order of their codes.
    pub const ALL: [LongWay; 6] = [
        LongWay::None,
        LongWay::NoPass,
        LongWay::Sequence,
        LongWay::Flags,
        LongWay::Timed,
        LongWay::Frame,
    ];

    /// The reason with this code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.get(code as usize).copied()
    }

    /// One sentence for people.
    pub const fn text(self) -> &'static str {
        match self {
            LongWay::None => "no exchange took it",
            LongWay::NoPass => "the board had not judged the exchange in advance",
            LongWay::Sequence => "an exchange before it was lost",
            LongWay::Flags => "its flags are new",
            LongWay::Timed => "a timed command was still waiting",
            LongWay::Frame => "its frame or the gate was not as expected",
        }
    }
}

impl Refusal {
    /// How many reasons there are: the number of refusal counters.
    pub const COUNT: usize = Self::ALL.len();

    /// The place of this reason among the refusal counters.
    pub const fn index(self) -> usize {
        self as usize
    }
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.text())
    }
}

impl core::error::Error for Refusal {}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn every_refusal_has_its_own_counter_and_says_its_sentence() {
        for (place, why) in Refusal::ALL.iter().enumerate() {
            assert_eq!(why.index(), place, "{}", why.key());
            assert_eq!(why.to_string(), why.text());
        }
    }
}
