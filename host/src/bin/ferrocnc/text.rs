//! Turns values of a board into text for the operator.

/// A version: `1.2.3`.
pub(crate) fn version(word: u32) -> String {
    format!("{}.{}.{}", word >> 16, word >> 8 & 0xff, word & 0xff)
}
