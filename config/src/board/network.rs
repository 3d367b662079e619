//! The addresses in a board file.

use crate::error::Error;
use crate::tree::At;

/// The MAC address; `None`: the board makes one.
pub(super) fn mac(at: &At<'_>) -> Result<Option<[u8; 6]>, Error> {
    let Some(text) = at.text("mac") else {
        return Ok(None);
    };
    let shown = format!("{text:?}");
    let bytes: Vec<u8> = text
        .split(':')
        .filter(|part| part.len() == 2)
        .filter_map(|part| u8::from_str_radix(part, 16).ok())
        .collect();
    let mac: Option<[u8; 6]> = bytes.try_into().ok().filter(|_| {
        text.len() == 17
            && text
                .bytes()
                .all(|b| b == b':' || b.is_ascii_hexdigit() && !b.is_ascii_uppercase())
    });
    let Some(mac) = mac else {
        return Err(at.error(
            "mac",
            &shown,
            "is not six bytes in lower case hexadecimal",
            "write it as in \"10:e2:d5:00:00:01\", or leave it out and the board makes one",
        ));
    };
    if mac[0] & 1 == 1 {
        return Err(at.error(
            "mac",
            &shown,
            "is a group address, which no board can have",
            "make the first byte even",
        ));
    }
    if mac == [0; 6] {
        return Err(at.error(
            "mac",
            &shown,
            "is no address at all",
            "write one, or leave it out and the board makes one",
        ));
    }
    Ok(Some(mac))
}

/// The built-in IPv4 address.
pub(super) fn ipv4(at: &At<'_>) -> Result<[u8; 4], Error> {
    let text = at.text("ipv4").unwrap_or_default();
    let shown = format!("{text:?}");
    let Ok(address) = text.parse::<std::net::Ipv4Addr>() else {
        return Err(at.error(
            "ipv4",
            &shown,
            "is not an IPv4 address",
            "write it as in \"192.168.2.50\"",
        ));
    };
    if address.is_multicast()
        || address.is_broadcast()
        || address.is_unspecified()
        || address.is_loopback()
    {
        return Err(at.error(
            "ipv4",
            &shown,
            "is not an address one board can have",
            "write one of your network, as in \"192.168.2.50\"",
        ));
    }
    Ok(address.octets())
}
