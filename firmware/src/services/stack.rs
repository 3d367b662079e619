//! smoltcp's interface over the board's frames: ARP, ping, groups, datagrams, and the segments of
//! the connections.
//!
//! A call does one thing ([`Stack::take`], [`Stack::send`]): smoltcp's own `poll` would do all that
//! is due, and the owner's exchange would wait for it. Each connection has a socket set of its own,
//! so that no socket takes another one's turn or its segments ([`super::port`] chooses the set).

use super::Network;
use crate::net::Us;
use smoltcp::iface::{Config, Interface, PollResult, SocketSet};
use smoltcp::phy::{Device, DeviceCapabilities, Medium, RxToken, TxToken};
use smoltcp::time::{Duration, Instant};
use smoltcp::wire::{EthernetAddress, IpCidr, Ipv4Address, Ipv4Cidr};

/// Bytes of the longest frame.
pub const FRAME: usize = super::abi::FRAME_MAX;
/// Bytes of an ARP message behind its Ethernet header.
const ARP: usize = 42;

/// The interface.
pub struct Stack {
    iface: Interface,
    us: Us,
}

impl core::fmt::Debug for Stack {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Stack").field("us", &self.us).finish()
    }
}

impl Stack {
    /// A stack without an address. `seed`: of the first sequence numbers.
    pub fn new(seed: u64, out: &mut impl Network) -> Self {
        let us = out.us();
        let mut config = Config::new(EthernetAddress(us.mac).into());
        config.random_seed = seed;
        let mut wire = Wire {
            received: None,
            sent: false,
            out,
        };
        let mut iface = Interface::new(config, &mut wire, Instant::ZERO);
        // The first group of a few that it has room for.
        let _ = iface.join_multicast_group(Ipv4Address::from_bits(wire::mdns::GROUP));
        let us = Us { ip: 0, ..us };
        Stack { iface, us }
    }

    /// Our address, whatever it is now. True if it has changed.
    pub fn settle(&mut self, us: Us) -> bool {
        let moved = us.ip != self.us.ip;
        if moved {
            self.iface.update_ip_addrs(|all| {
                all.clear();
                // Every client is on the link: an answer goes to the MAC address the question came
                // from, which may be a router's.
                let ip = Ipv4Address::from_bits(us.ip);
                if !ip.is_unspecified() && !ip.is_multicast() && !ip.is_broadcast() {
                    let _ = all.push(IpCidr::Ipv4(Ipv4Cidr::new(ip, 0)));
                }
            });
        }
        self.us = us;
        moved
    }

    /// Takes a frame; sends its answer, if there is one that needs no socket's turn.
    pub fn take(
        &mut self,
        frame: &[u8],
        sockets: &mut SocketSet,
        now: Instant,
        out: &mut impl Network,
    ) {
        let mut wire = Wire {
            received: Some(frame),
            sent: false,
            out,
        };
        self.iface.poll_ingress_single(now, &mut wire, sockets);
    }

    /// Sends a segment that is due, or a report of the multicast groups. True if there was one.
    pub fn send(&mut self, sockets: &mut SocketSet, now: Instant, out: &mut impl Network) -> bool {
        let mut wire = Wire {
            received: None,
            sent: false,
            out,
        };
        let changed = self.iface.poll_egress(now, &mut wire, sockets);
        wire.sent || changed == PollResult::SocketStateChanged
    }

    /// When one of these sockets has something to send; at most a second from now.
    pub fn due(&mut self, sockets: &SocketSet, now: Instant) -> Instant {
        let second = now + Duration::from_secs(1);
        let due = self.iface.poll_at(now, sockets);
        due.map_or(second, |due| due.min(second))
    }

    /// A client's MAC address, from its own frame: smoltcp would ask for it, and asks only once a
    /// second, for all clients together.
    pub fn introduce(
        &mut self,
        (mac, ip): ([u8; 6], [u8; 4]),
        sockets: &mut SocketSet,
        now: Instant,
        out: &mut impl Network,
    ) {
        let mut arp = [0; ARP];
        let ours = self.us.ip.to_be_bytes();
        let parts: [&[u8]; 7] = [
            &self.us.mac,
            &mac,
            &[8, 6, 0, 1, 8, 0, 6, 4, 0, 2],
            &mac,
            &ip,
            &self.us.mac,
            &ours,
        ];
        for (place, byte) in arp.iter_mut().zip(parts.into_iter().flatten()) {
            *place = *byte;
        }
        self.take(&arp, sockets, now, out);
    }
}

/// At most one frame that came, and the way out for one frame. smoltcp would send a report of its
/// multicast groups after a socket's frame, in the same call; it keeps the report for the next one.
struct Wire<'a, O> {
    received: Option<&'a [u8]>,
    sent: bool,
    out: &'a mut O,
}

struct Received<'a>(&'a [u8]);

struct Answer<'a, O> {
    sent: &'a mut bool,
    out: &'a mut O,
}

impl RxToken for Received<'_> {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, take: F) -> R {
        take(self.0)
    }
}

impl<O: Network> TxToken for Answer<'_, O> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, write: F) -> R {
        // smoltcp keeps to the longest frame that `capabilities` says.
        *self.sent = true;
        self.out.send_with(length, write)
    }
}

impl<O: Network> Device for Wire<'_, O> {
    type RxToken<'t>
        = Received<'t>
    where
        Self: 't;
    type TxToken<'t>
        = Answer<'t, O>
    where
        Self: 't;

    fn receive(&mut self, now: Instant) -> Option<(Received<'_>, Answer<'_, O>)> {
        let frame = self.received.take()?;
        Some((Received(frame), self.transmit(now)?))
    }

    fn transmit(&mut self, _: Instant) -> Option<Answer<'_, O>> {
        let sent = &mut self.sent;
        (!*sent).then_some(Answer {
            sent,
            out: self.out,
        })
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = FRAME;
        capabilities.max_burst_size = Some(1);
        capabilities
    }
}
/// The ports a frame comes from and goes to, if it is UDP.
pub(super) fn udp_ports(frame: &[u8]) -> Option<(u16, u16)> {
    let udp = frame.get(12..14)? == [8, 0] && *frame.get(23)? == 17;
    let at = 14 + usize::from(frame.get(14)? & 15) * 4;
    let [a, b, c, d] = *frame.get(at..)?.first_chunk()?;
    udp.then_some((u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d])))
}
