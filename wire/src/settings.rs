//! The settings of a board that survive a power cycle: its name, its addresses and its key.
//!
//! ```text
//! word  0 "FSET"          5 prefix length       10..17 name
//!       1 version, 1      6 gateway, 0 none     18..21 key
//!       2 sequence        7 MAC, upper 16       22 syslog server, 0 none
//!       3 flags           8 MAC, lower 32       23 SNTP server, 0 none
//!       4 IPv4 address    9 UDP port            24..30 zero
//!                                               31 CRC-32 of words 0..30
//! ```
//!
//! Words 22 and 23 were zero before there were these servers. An older firmware takes settings with
//! a server for invalid ones, and those built into the image apply.
//!
//! There are two copies in flash, a sector each. The newest whole one is in force; a save writes
//! the other one, so a power cut at any moment leaves the old or the new. The board numbers the
//! sequence itself.
//!
//! The key ([`crate::auth`]) cannot be read back: the flash window shows zeros in its place, and
//! `Read` does not reach the settings' sectors. [`Settings::keep_key`] saves all other settings and
//! keeps the key.

use crate::crc::crc32_words;
use crate::flash::is_newer;
use crate::{DEFAULT_PORT, DISCOVERY_PORT, Name};

/// "FSET".
pub const MAGIC: u32 = 0x4653_4554;
/// Version of the layout.
pub const VERSION: u32 = 1;
/// Words.
pub const WORDS: usize = 32;

/// Flag: ask a DHCP server for the address; `ip` is the fallback.
pub const FLAG_DHCP: u32 = 1 << 0;
/// Flag, only in settings to be saved: keep the saved key.
pub const FLAG_KEEP_KEY: u32 = 1 << 1;

/// A board's settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// The higher one of two copies is newer, modulo 2^32.
    pub sequence: u32,
    /// Ask a DHCP server; `ip` is the fallback.
    pub dhcp: bool,
    /// Save with the key that is already saved. Not kept in flash.
    pub keep_key: bool,
    /// IPv4 address.
    pub ip: u32,
    /// Bits of the netmask, 1..=30.
    pub prefix: u8,
    /// IPv4 address of the gateway, 0 for none.
    pub gateway: u32,
    /// MAC address; all zeros: made from the flash's unique id ([`mac_of_uid`]).
    pub mac: [u8; 6],
    /// UDP port of the Etherbone server.
    pub port: u16,
    /// Name of the board.
    pub name: Name,
    /// Pre-shared key, all zeros for none.
    pub key: [u32; 4],
    /// IPv4 address of the syslog server that gets the board's events, 0 for none.
    pub syslog: u32,
    /// IPv4 address of the SNTP server that knows the time, 0 for none.
    pub sntp: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self::BUILT_IN
    }
}

impl Settings {
    /// The default, if the bitstream names no settings: 192.168.2.50, as Lcnc, and a MAC derived
    /// from the unique id.
    pub const BUILT_IN: Settings = Settings {
        sequence: 0,
        dhcp: false,
        keep_key: false,
        ip: 0xc0a8_0232,
        prefix: 24,
        gateway: 0,
        mac: [0; 6],
        port: DEFAULT_PORT,
        name: Name::EMPTY,
        key: [0; 4],
        syslog: 0,
        sntp: 0,
    };
}

/// Why words are not valid settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingsError {
    /// Does not begin with "FSET": erased, or something else.
    Magic,
    /// Another layout.
    Version(u32),
    /// The CRC does not fit.
    Crc,
    /// A value out of range; its word.
    Value(usize),
}

impl core::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            SettingsError::Magic => f.write_str("no settings are saved"),
            SettingsError::Version(theirs) => write!(
                f,
                "the saved settings have layout {theirs}, this side knows {VERSION}; set them again"
            ),
            SettingsError::Crc => {
                f.write_str("the saved settings are damaged (CRC); set them again")
            }
            SettingsError::Value(word) => {
                write!(f, "word {word} of the settings is out of range")
            }
        }
    }
}

impl core::error::Error for SettingsError {}

impl Settings {
    /// As words, CRC included.
    pub fn to_words(&self) -> [u32; WORDS] {
        let [m0, m1, m2, m3, m4, m5] = self.mac;
        let mut words = [0; WORDS];
        let head = [
            MAGIC,
            VERSION,
            self.sequence,
            u32::from(self.dhcp) | u32::from(self.keep_key) << 1,
            self.ip,
            u32::from(self.prefix),
            self.gateway,
            u32::from(u16::from_be_bytes([m0, m1])),
            u32::from_be_bytes([m2, m3, m4, m5]),
            u32::from(self.port),
        ];
        let all = head.into_iter().chain(self.name.to_words()).chain(self.key);
        let all = all.chain([self.syslog, self.sntp]);
        for (place, word) in words.iter_mut().zip(all) {
            *place = word;
        }
        words[WORDS - 1] = sum(&words);
        words
    }

    /// Reads and checks everything.
    pub fn parse(words: &[u32; WORDS]) -> Result<Self, SettingsError> {
        let [
            magic,
            version,
            sequence,
            flags,
            ip,
            prefix,
            gateway,
            mac_hi,
            mac_lo,
            port,
            n0,
            n1,
            n2,
            n3,
            n4,
            n5,
            n6,
            n7,
            k0,
            k1,
            k2,
            k3,
            syslog,
            sntp,
            rest @ ..,
            crc,
        ] = *words;
        if magic != MAGIC {
            return Err(SettingsError::Magic);
        }
        if version != VERSION {
            return Err(SettingsError::Version(version));
        }
        if crc != sum(words) {
            return Err(SettingsError::Crc);
        }
        if flags & !(FLAG_DHCP | FLAG_KEEP_KEY) != 0 {
            return Err(SettingsError::Value(3));
        }
        let settings = Settings {
            sequence,
            dhcp: flags & FLAG_DHCP != 0,
            keep_key: flags & FLAG_KEEP_KEY != 0,
            ip,
            prefix: u8::try_from(prefix).map_err(|_| SettingsError::Value(5))?,
            gateway,
            mac: mac_from_words([mac_hi, mac_lo]).ok_or(SettingsError::Value(7))?,
            port: u16::try_from(port).map_err(|_| SettingsError::Value(9))?,
            name: Name::from_words(&[n0, n1, n2, n3, n4, n5, n6, n7])
                .map_err(|_| SettingsError::Value(10))?,
            key: [k0, k1, k2, k3],
            syslog,
            sntp,
        };
        if rest.iter().any(|word| *word != 0) {
            return Err(SettingsError::Value(24));
        }
        settings.check()?;
        Ok(settings)
    }

    /// Are these settings usable? [`Settings::parse`] has checked that.
    pub fn check(&self) -> Result<(), SettingsError> {
        if !matches!(self.prefix, 1..=30) {
            return Err(SettingsError::Value(5));
        }
        if !host_address(self.ip, self.prefix) {
            return Err(SettingsError::Value(4));
        }
        if self.gateway != 0 && !unicast(self.gateway) {
            return Err(SettingsError::Value(6));
        }
        if self.mac[0] & 1 != 0 {
            return Err(SettingsError::Value(7)); // a multicast address
        }
        if self.port == 0 || self.port == DISCOVERY_PORT {
            return Err(SettingsError::Value(9));
        }
        for (word, server) in [(22, self.syslog), (23, self.sntp)] {
            if server != 0 && !unicast(server) {
                return Err(SettingsError::Value(word));
            }
        }
        Ok(())
    }

    /// The settings without the key, for any client.
    pub fn blanked(mut self) -> Self {
        self.key = [0; 4];
        self
    }

    /// Is this copy newer than the other? It works across the wrap of the sequence.
    pub fn newer_than(&self, other: &Settings) -> bool {
        is_newer(self.sequence, other.sequence)
    }
}

/// CRC-32 of everything before the CRC.
fn sum(words: &[u32; WORDS]) -> u32 {
    let [body @ .., _] = words;
    crc32_words(body)
}

/// Can one host have this address? Not a loopback, a multicast or the zero address.
pub const fn unicast(ip: u32) -> bool {
    let first = ip >> 24;
    first != 0 && first != 127 && first < 224
}

/// Can one host of its net have this address? Not the net's own or its broadcast address.
pub const fn host_address(ip: u32, prefix: u8) -> bool {
    let host = ip & !netmask(prefix);
    unicast(ip) && host != 0 && host != !netmask(prefix)
}

/// The netmask with this many bits.
pub const fn netmask(prefix: u8) -> u32 {
    match u32::MAX.checked_shr(prefix as u32) {
        Some(host) => !host,
        None => u32::MAX,
    }
}

/// A MAC address from its upper 16 and lower 32 bits; `None` when the upper word has more.
pub const fn mac_from_words([hi, lo]: [u32; 2]) -> Option<[u8; 6]> {
    if hi >> 16 != 0 {
        return None;
    }
    let ([_, _, a, b], [c, d, e, f]) = (hi.to_be_bytes(), lo.to_be_bytes());
    Some([a, b, c, d, e, f])
}

/// A MAC address as its upper 16 and lower 32 bits.
pub const fn mac_to_words([a, b, c, d, e, f]: [u8; 6]) -> [u32; 2] {
    [
        u32::from_be_bytes([0, 0, a, b]),
        u32::from_be_bytes([c, d, e, f]),
    ]
}

/// A board's own MAC address: locally administered, the rest a hash of the flash's unique id, so
/// that new boards have different ones.
pub fn mac_of_uid([hi, lo]: [u32; 2]) -> [u8; 6] {
    let first = crc32_words(&[hi, lo]);
    let second = crc32_words(&[lo, hi, first]);
    let [a, b, c, d] = first.to_be_bytes();
    // 0x02: locally administered, one station.
    [0x02, second as u8, a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> Settings {
        Settings {
            sequence: 7,
            dhcp: true,
            gateway: 0xc0a8_0201,
            mac: [2, 1, 2, 3, 4, 5],
            name: Name::new("mill").unwrap(),
            key: [1, 2, 3, 4],
            syslog: 0xc0a8_0202,
            sntp: 0xc0a8_0203,
            ..Settings::default()
        }
    }

    fn with(word: usize, value: u32) -> Result<Settings, SettingsError> {
        let mut words = settings().to_words();
        words[word] = value;
        words[WORDS - 1] = sum(&words);
        Settings::parse(&words)
    }

    #[test]
    fn settings_survive_the_flash() {
        for settings in [settings(), Settings::default()] {
            assert_eq!(Settings::parse(&settings.to_words()), Ok(settings));
        }
    }

    #[test]
    fn settings_from_before_there_were_servers_are_valid() {
        let mut words = settings().to_words();
        (words[22], words[23]) = (0, 0);
        words[WORDS - 1] = sum(&words);
        let old = Settings::parse(&words).unwrap();
        assert_eq!((old.syslog, old.sntp), (0, 0));
        assert_eq!(old.to_words(), words);
    }

    #[test]
    fn any_flipped_bit_is_noticed() {
        let good = settings().to_words();
        for bit in 0..WORDS * 32 {
            let mut bad = good;
            bad[bit / 32] ^= 1 << (bit % 32);
            assert!(Settings::parse(&bad).is_err(), "bit {bit}");
        }
        assert_eq!(
            Settings::parse(&[u32::MAX; WORDS]),
            Err(SettingsError::Magic)
        );
        assert_eq!(Settings::parse(&[0; WORDS]), Err(SettingsError::Magic));
    }

    #[test]
    fn a_board_that_no_host_could_reach_is_refused_even_with_a_right_crc() {
        for (word, value) in [
            (3, 4),           // an unknown flag
            (4, 0),           // no address
            (4, 0x7f00_0001), // itself
            (4, 0xe000_0001), // multicast
            (4, 0xc0a8_02ff), // broadcast
            (4, 0xc0a8_0200), // the net
            (5, 0),
            (5, 31),
            (5, 280),
            (6, 0xffff_ffff),
            (7, 0x0100), // a multicast MAC
            (7, 0x1_0200),
            (9, 0),
            (9, 51234),
            (9, 65536),
            (10, 0x0a00_0000), // a control character
            (22, 0x7f00_0001), // itself
            (22, 1),
            (23, 0xffff_ffff),
            (24, 1),
            (30, 1),
        ] {
            assert_eq!(
                with(word, value),
                Err(SettingsError::Value(word.min(24))),
                "{word} {value:x}"
            );
        }
        assert_eq!(with(1, 2), Err(SettingsError::Version(2)));
        assert!(with(9, 1).is_ok() && with(5, 30).is_ok());
    }

    #[test]
    fn newer_is_newer_across_the_wrap() {
        let at = |sequence| Settings {
            sequence,
            ..settings()
        };
        assert!(at(1).newer_than(&at(0)) && !at(0).newer_than(&at(1)));
        assert!(at(0).newer_than(&at(u32::MAX)) && !at(u32::MAX).newer_than(&at(0)));
        assert!(!at(5).newer_than(&at(5)));
    }

    #[test]
    fn the_key_can_be_blanked() {
        assert_eq!(settings().blanked().key, [0; 4]);
    }

    #[test]
    fn a_mac_of_the_unique_id_is_ours_alone_and_its_own() {
        let (one, other) = (mac_of_uid([1, 2]), mac_of_uid([1, 3]));
        assert_ne!(one, other);
        assert_eq!((one[0], other[0]), (2, 2));
        assert_eq!(mac_from_words(mac_to_words(one)), Some(one));
    }
}
