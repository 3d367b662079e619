//! The description of the fake board.

use super::{ABI, CLOCK_HZ, Mind};
use wire::GateClose;
use wire::board;
use wire::describe::{self, Describe};

/// The `mill6` board's names.
pub const MILL6: &[(u8, u8, &str)] = &[
    (1, 0, "fake"),
    (13, 0, "LFE5U-25F-6BG256C"),
    (14, 0, "5a-75b-8.0"),
    (2, 0, "mill6"),
    (3, 0, "x"),
    (3, 1, "y"),
    (3, 2, "z"),
    (3, 3, "a"),
    (3, 4, "b"),
    (3, 5, "c"),
    (4, 0, "x"),
    (4, 1, "y"),
    (4, 2, "z"),
    (4, 3, "a"),
    (4, 4, "b"),
    (4, 5, "spindle"),
    (5, 0, "spindle"),
    (5, 1, "coolant"),
    (5, 2, "laser"),
    (5, 3, "fan"),
    (5, 4, "aux-0"),
    (5, 5, "aux-1"),
    (6, 0, "limit-x"),
    (6, 1, "limit-y"),
    (6, 2, "limit-z"),
    (6, 3, "home-x"),
    (6, 4, "home-y"),
    (6, 5, "home-z"),
    (6, 6, "probe"),
    (6, 7, "door"),
    (7, 0, "drive-enable"),
    (7, 1, "spindle-on"),
    (7, 2, "spindle-reverse"),
    (7, 3, "mist"),
    (7, 4, "flood"),
    (7, 5, "brake"),
    (7, 6, "lamp"),
    (6, 11, "estop"),
    (8, 0, "sstep=j1:0 dir=j1:1"),
    (8, 2, "sstep=j1:4 dir=j1:5 type=quadrature"),
    (8, 3, "sstep=j1:6 dir=j2:0 type=of-next-year"),
    (8, 1, "ppin=j3:1 dir=j3:2"),
    (8, 4, "ppin=j3:4 type=pdm"),
    (8, 11, "ipin=bus:7 estop=high"),
];

/// What an import of LiteX-CNC's would say of this board: outputs and inputs in turn.
pub const MILL6_ROW: &[(u8, u8, &str)] = &[
    (8, 0, "ogpio=0"),
    (8, 0, "igpio=1"),
    (8, 1, "ogpio=2"),
    (8, 1, "igpio=3"),
    (8, 2, "ogpio=4"),
    (8, 3, "ogpio=5"),
    (8, 2, "igpio=6"),
    (8, 6, "igpio=7"),
    (8, 4, "ogpio=8"),
];

impl Mind {
    pub(super) fn describe(&self) -> Describe {
        let abi_gateware = self.knobs.abi_gateware.unwrap_or(ABI);
        Describe {
            wire_version: wire::WIRE_VERSION,
            abi_firmware: ABI,
            abi_gateware,
            firmware_version: 0x0000_0100,
            gateware_version: 0x0000_0100,
            clock_hz: CLOCK_HZ,
            channels: self.channels,
            features: {
                let key = self.key.map_or(0, |_| describe::FEATURE_KEY);
                key | self.pins.map_or(0, |_| describe::FEATURE_PINS)
            },
            boot_id: self.boot_id,
            blob_words: self.blob().len() as u32 / 4,
            state: self.state_word(false),
            obstacles: if abi_gateware == ABI {
                self.obstacle_of_pins()
            } else {
                describe::OBSTACLE_ABI
            },
            reset_reason: self.reset_reason,
            gate_close: GateClose::Never,
        }
    }

    pub(super) fn blob(&self) -> Vec<u8> {
        if let Some(blob) = &self.described {
            return blob.clone();
        }
        let mut body = Vec::new();
        for (kind, channel, text) in &self.names {
            body.extend([*kind, *channel, text.len() as u8, 0]);
            body.extend_from_slice(text.as_bytes());
            body.resize(body.len().next_multiple_of(4), 0);
        }
        let crc = board::crc32(&body) ^ u32::from(self.knobs.bad_blob);
        let mut bytes = Vec::new();
        for word in [
            board::MAGIC,
            board::VERSION,
            (board::HEADER_LEN + body.len()) as u32,
            crc,
        ] {
            bytes.extend(word.to_be_bytes());
        }
        bytes.extend(body);
        bytes
    }
}
