//! Turns values of a board into text for the operator.

/// A MAC: `02:00:00:1b:2c:3d`.
pub(crate) fn mac_text(mac: [u8; 6]) -> String {
    mac.map(|byte| format!("{byte:02x}")).join(":")
}

/// A version: `1.2.3`.
pub(crate) fn version(word: u32) -> String {
    format!("{}.{}.{}", word >> 16, word >> 8 & 0xff, word & 0xff)
}
