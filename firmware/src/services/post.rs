//! A UDP port over the stack: a datagram that came waits here for its turn, and one that is to be
//! sent waits for its way out.

use super::Network;
use super::stack::Stack;
use smoltcp::iface::{SocketHandle, SocketSet, SocketStorage};
use smoltcp::socket::udp::{PacketBuffer, PacketMetadata, Socket};
use smoltcp::time::Instant;
use smoltcp::wire::{IpAddress, IpEndpoint, Ipv4Address};

/// An address and a UDP port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Party {
    /// IPv4 address.
    pub ip: u32,
    /// UDP port.
    pub port: u16,
}

/// The memory of a port, for datagrams of at most `IN` bytes that come and `OUT` that are sent.
#[derive(Debug)]
pub struct Place<'m, const IN: usize, const OUT: usize> {
    socket: [SocketStorage<'m>; 1],
    came: [PacketMetadata; 1],
    goes: [PacketMetadata; 1],
    came_bytes: [u8; IN],
    goes_bytes: [u8; OUT],
}

impl<const IN: usize, const OUT: usize> Place<'_, IN, OUT> {
    /// Without a port.
    pub const fn new() -> Self {
        Place {
            socket: [SocketStorage::EMPTY],
            came: [PacketMetadata::EMPTY],
            goes: [PacketMetadata::EMPTY],
            came_bytes: [0; IN],
            goes_bytes: [0; OUT],
        }
    }
}

impl<const IN: usize, const OUT: usize> Default for Place<'_, IN, OUT> {
    fn default() -> Self {
        Self::new()
    }
}

/// The port.
pub struct Post<'m> {
    sockets: SocketSet<'m>,
    handle: SocketHandle,
}

impl core::fmt::Debug for Post<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Post")
    }
}

impl<'m> Post<'m> {
    /// Opens this port; its datagrams live for so many routers.
    pub fn new<const IN: usize, const OUT: usize>(
        place: &'m mut Place<'m, IN, OUT>,
        port: u16,
        hops: u8,
    ) -> Self {
        let came = PacketBuffer::new(&mut place.came[..], &mut place.came_bytes[..]);
        let goes = PacketBuffer::new(&mut place.goes[..], &mut place.goes_bytes[..]);
        let mut socket = Socket::new(came, goes);
        socket.set_hop_limit(Some(hops));
        // A port that is not 0, and a socket that is closed: it cannot fail.
        let _ = socket.bind(port);
        let mut sockets = SocketSet::new(&mut place.socket[..]);
        let handle = sockets.add(socket);
        Post { sockets, handle }
    }

    fn socket(&mut self) -> &mut Socket<'m> {
        self.sockets.get_mut(self.handle)
    }

    /// Takes a frame. If a datagram waits already, or this one is longer than its room, it is lost.
    pub fn frame(&mut self, frame: &[u8], stack: &mut Stack, now: Instant, out: &mut impl Network) {
        stack.take(frame, &mut self.sockets, now, out);
    }

    /// Gives the datagram that waits. True if there was one.
    pub fn read(&mut self, take: impl FnOnce(Party, &[u8])) -> bool {
        let Ok((datagram, from)) = self.socket().recv() else {
            return false;
        };
        let IpAddress::Ipv4(ip) = from.endpoint.addr;
        let port = from.endpoint.port;
        take(
            Party {
                ip: ip.to_bits(),
                port,
            },
            datagram,
        );
        true
    }

    /// Is there room for a datagram to be sent?
    pub fn free(&mut self) -> bool {
        self.socket().send_queue() == 0
    }

    /// Leaves a datagram to be sent.
    pub fn write(&mut self, to: Party, datagram: &[u8]) {
        let to = IpEndpoint::new(IpAddress::Ipv4(Ipv4Address::from_bits(to.ip)), to.port);
        // It was asked before whether there is room.
        let _ = self.socket().send_slice(datagram, to);
    }

    /// Forgets what waits: its receiver is not asked any more.
    pub fn forget(&mut self) {
        let socket = self.socket();
        let port = socket.endpoint().port;
        socket.close();
        let _ = socket.bind(port);
    }

    /// Sends what waits. True if it has left; false, too, if its receiver's MAC address is asked
    /// for first.
    pub fn send(&mut self, stack: &mut Stack, now: Instant, out: &mut impl Network) -> bool {
        !self.free() && stack.send(&mut self.sockets, now, out)
    }
}
