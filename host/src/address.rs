//! Addresses of boards: the text after `boards=` and the tool's `ADDR`.

use std::net::{SocketAddr, SocketAddrV4, ToSocketAddrs};

/// Most boards one module drives.
pub const MAX_BOARDS: usize = 4;

/// A board's address: what was written, and what it resolved to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// As the user wrote it; messages repeat it.
    pub text: String,
    /// Where to send.
    pub socket: SocketAddrV4,
}

impl core::fmt::Display for Address {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let resolved = self.socket.to_string();
        if resolved == self.text || resolved.strip_suffix(":1234") == Some(&self.text) {
            f.write_str(&self.text)
        } else {
            write!(f, "{} ({resolved})", self.text)
        }
    }
}

/// Why a text names no board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AddressError {
    /// `boards=` is missing or empty.
    None,
    /// More than [`MAX_BOARDS`].
    TooMany(usize),
    /// Two commas in a row, or one at an end.
    Empty(String),
    /// What follows the colon is no port.
    Port(String),
    /// The same board twice.
    Twice(String),
    /// It cannot be resolved; with the system's reason.
    Unresolved(String, String),
}

impl core::fmt::Display for AddressError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            AddressError::None => f.write_str("no board named; say boards=192.168.2.50"),
            AddressError::TooMany(count) => write!(
                f,
                "{count} boards named, {MAX_BOARDS} is the most; name fewer"
            ),
            AddressError::Empty(text) => write!(
                f,
                "\"{text}\" has an empty entry; write IP[:port] separated by single commas"
            ),
            AddressError::Port(text) => write!(
                f,
                "\"{text}\" is not IP[:port]: the port must be a number from 1 to 65535"
            ),
            AddressError::Twice(text) => {
                write!(f, "\"{text}\" is named twice; name every board once")
            }
            AddressError::Unresolved(text, why) => write!(
                f,
                "\"{text}\" is not an IPv4 address or a known host name ({why}); write it as 192.168.2.50 or 192.168.2.50:1234"
            ),
        }
    }
}

impl std::error::Error for AddressError {}

/// One board, `IP[:port]` or `NAME[:port]`. A name that ends in `.local` is resolved by multicast
/// DNS ([`crate::mdns`]), for three seconds at most.
pub fn parse(text: &str, default_port: u16) -> Result<Address, AddressError> {
    let text = text.trim();
    let (host, port) = match text.rsplit_once(':') {
        None => (text, default_port),
        Some((host, port)) => match port.parse::<u16>() {
            Ok(port) if port != 0 => (host, port),
            _ => return Err(AddressError::Port(text.to_owned())),
        },
    };
    let unresolved = |why: String| AddressError::Unresolved(text.to_owned(), why);
    if host.is_empty() {
        return Err(unresolved("nothing before the port".to_owned()));
    }
    // Multicast DNS without anything installed; a resolver of the system may know it all the same.
    if crate::mdns::is_local(host)
        && let Ok(Some(ip)) = crate::mdns::resolve(host)
    {
        return Ok(Address {
            text: text.to_owned(),
            socket: SocketAddrV4::new(ip, port),
        });
    }
    let mut found = (host, port)
        .to_socket_addrs()
        .map_err(|error| unresolved(error.to_string()))?;
    let socket = found.find_map(|address| match address {
        SocketAddr::V4(address) => Some(address),
        SocketAddr::V6(_) => None,
    });
    let socket = socket.ok_or_else(|| unresolved("it has no IPv4 address".to_owned()))?;
    Ok(Address {
        text: text.to_owned(),
        socket,
    })
}

/// The whole of `boards=`.
pub fn parse_list(text: &str) -> Result<Vec<Address>, AddressError> {
    if text.trim().is_empty() {
        return Err(AddressError::None);
    }
    let entries: Vec<&str> = text.split(',').map(str::trim).collect();
    if entries.iter().any(|entry| entry.is_empty()) {
        return Err(AddressError::Empty(text.to_owned()));
    }
    if entries.len() > MAX_BOARDS {
        return Err(AddressError::TooMany(entries.len()));
    }
    let mut boards: Vec<Address> = Vec::new();
    for entry in entries {
        let board = parse(entry, wire::DEFAULT_PORT)?;
        if boards.iter().any(|known| known.socket == board.socket) {
            return Err(AddressError::Twice(board.text));
        }
        boards.push(board);
    }
    Ok(boards)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_boards_is_understood() {
        let boards = parse_list("192.168.2.50, 127.0.0.1:4321").unwrap();
        let sockets: Vec<String> = boards.iter().map(|b| b.socket.to_string()).collect();
        assert_eq!(sockets, ["192.168.2.50:1234", "127.0.0.1:4321"]);
    }

    #[test]
    fn every_malformed_list_is_refused_by_its_own_text() {
        for (text, named) in [
            ("", "no board named"),
            ("127.0.0.1,", "\"127.0.0.1,\""),
            ("127.0.0.1:0", "\"127.0.0.1:0\""),
            ("127.0.0.1:port", "\"127.0.0.1:port\""),
            ("127.0.0.1:99999", "\"127.0.0.1:99999\""),
            (":1234", "\":1234\""),
            ("127.0.0.1,127.0.0.1:1234", "twice"),
            (
                "127.0.0.1,127.0.0.2,127.0.0.3,127.0.0.4,127.0.0.5",
                "5 boards",
            ),
            ("127.0.0.999", "\"127.0.0.999\""),
        ] {
            let message = parse_list(text).unwrap_err().to_string();
            assert!(message.contains(named), "{text:?}: {message}");
        }
    }
}
