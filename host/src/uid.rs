//! The unique id of a board's flash, which identifies the board at any address, and the MAC address
//! that is made of it.

/// A unique id as people read it: `d162-0c8a-1b2c-3d4e`.
pub fn uid_text([hi, lo]: [u32; 2]) -> String {
    format!(
        "{:04x}-{:04x}-{:04x}-{:04x}",
        hi >> 16,
        hi & 0xffff,
        lo >> 16,
        lo & 0xffff
    )
}

/// A MAC address: `02:00:00:1b:2c:3d`.
pub fn mac_text(mac: [u8; 6]) -> String {
    mac.map(|byte| format!("{byte:02x}")).join(":")
}

/// A unique id as people write it: 16 hex digits, with or without separators.
pub fn uid_parse(text: &str) -> Option<[u32; 2]> {
    let digits: String = text
        .chars()
        .filter(|c| !matches!(c, '-' | ':' | ' '))
        .collect();
    if digits.len() != 16 || !digits.chars().all(|c| c.is_ascii_hexdigit()) {
        return None;
    }
    let id = u64::from_str_radix(&digits, 16).ok()?;
    Some([(id >> 32) as u32, id as u32])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unique_id_is_read_as_it_is_written() {
        let uid = [0xd162_0c8a, 0x1b2c_3d4e];
        assert_eq!(uid_text(uid), "d162-0c8a-1b2c-3d4e");
        for text in [
            "d162-0c8a-1b2c-3d4e",
            "D1620C8A1B2C3D4E",
            "d1:62:0c:8a:1b:2c:3d:4e",
        ] {
            assert_eq!(uid_parse(text), Some(uid), "{text}");
        }
        for text in [
            "",
            "d162",
            "d162-0c8a-1b2c-3d4",
            "d162-0c8a-1b2c-3d4g",
            "+1620c8a1b2c3d4e",
        ] {
            assert_eq!(uid_parse(text), None, "{text}");
        }
    }
}
