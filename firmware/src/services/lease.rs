//! An address from a DHCP server: smoltcp's client, with the board's name in its messages.
//!
//! What it gets it tells the ROM ([`Network::leased`]), which puts the address into force when no
//! host owns the session, and uses the static one if none has come after ten seconds
//! ([`crate::machine::FALLBACK_SECONDS`]).

use super::Network;
use super::stack::Stack;
use crate::machine::Lease;
use smoltcp::iface::{SocketHandle, SocketSet, SocketStorage};
use smoltcp::socket::dhcpv4::{Event, Socket};
use smoltcp::time::{Duration, Instant};
use smoltcp::wire::DhcpOption;
use wire::Name;

/// UDP port of clients.
pub const PORT: u16 = crate::net::DHCP_CLIENT;
/// UDP port of servers.
pub const SERVER_PORT: u16 = crate::net::DHCP_SERVER;
/// Option: the client's name.
const HOST_NAME: u8 = 12;
/// Three tries before the board uses its static address.
const DISCOVER: Duration = Duration::from_secs(3);
/// A server on the same cable answers at once.
const REQUEST: Duration = Duration::from_secs(2);

/// The memory of the client.
#[derive(Debug)]
pub struct Place<'m> {
    socket: [SocketStorage<'m>; 1],
    name: [u8; Name::LEN],
    options: [DhcpOption<'m>; 1],
}

impl Place<'_> {
    /// Without a client.
    pub const fn new() -> Self {
        Place {
            socket: [SocketStorage::EMPTY],
            name: [0; Name::LEN],
            options: [DhcpOption {
                kind: HOST_NAME,
                data: &[],
            }],
        }
    }
}

impl Default for Place<'_> {
    fn default() -> Self {
        Self::new()
    }
}

/// The client.
pub struct Client<'m> {
    sockets: SocketSet<'m>,
    handle: SocketHandle,
    /// Nothing is due before this.
    due: Instant,
}

impl core::fmt::Debug for Client<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Client")
    }
}

impl<'m> Client<'m> {
    /// Begins to ask.
    pub fn new(place: &'m mut Place<'m>, name: &Name) -> Self {
        let Place {
            socket: storage,
            name: room,
            options,
        } = place;
        let text = name.text().as_bytes();
        // A name is not longer than its room.
        let (room, _) = room.split_at_mut(text.len().min(Name::LEN));
        room.copy_from_slice(text);
        let [option] = &mut *options;
        option.data = room;
        let mut socket = Socket::new();
        let mut retry = socket.get_retry_config();
        (retry.discover_timeout, retry.initial_request_timeout) = (DISCOVER, REQUEST);
        socket.set_retry_config(retry);
        if !name.text().is_empty() {
            socket.set_outgoing_options(options);
        }
        // The state at the start is no news.
        let _ = socket.poll();
        let mut sockets = SocketSet::new(&mut storage[..]);
        let handle = sockets.add(socket);
        Client {
            sockets,
            handle,
            due: Instant::ZERO,
        }
    }

    /// Takes a server's frame.
    pub fn take(&mut self, frame: &[u8], stack: &mut Stack, now: Instant, out: &mut impl Network) {
        stack.take(frame, &mut self.sockets, now, out);
        self.due = now;
    }

    /// Does one thing that is due: tells the board what has changed, or sends a message. True if
    /// there was something to do.
    pub fn turn(&mut self, stack: &mut Stack, now: Instant, out: &mut impl Network) -> bool {
        if now < self.due {
            return false;
        }
        let socket: &mut Socket = self.sockets.get_mut(self.handle);
        match socket.poll() {
            Some(Event::Configured(config)) => {
                out.leased(Some(Lease {
                    ip: config.address.address().to_bits(),
                    prefix: config.address.prefix_len(),
                    gateway: config.router.map_or(0, |router| router.to_bits()),
                }));
                true
            }
            Some(Event::Deconfigured) => {
                out.leased(None);
                true
            }
            None => {
                let sent = stack.send(&mut self.sockets, now, out);
                self.due = stack.due(&self.sockets, now);
                sent
            }
        }
    }
}

#[cfg(test)]
mod tests;
