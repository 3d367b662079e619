//! Ties the lib to the hardware: one loop, no interrupts, no heap.

use crate::soc::{self, Mac, Parts, Soc, TxSlot};
use firmware::console::{self, Ask, Vitals};
use firmware::exchange::SlotReply;
use firmware::net::{self, Class, Datagram, Lane, Us};
use firmware::server::Server;
use heapless::String;
use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::socket::udp;
use smoltcp::time::Instant;
use smoltcp::wire::{EthernetAddress, HardwareAddress, IpAddress, IpCidr, IpEndpoint, Ipv4Address};
use wire::{CONSOLE_PORT, MAX_WORDS, Refusal};

/// Longest answer of a console command, in bytes: sixteen encoders.
const CONSOLE_TEXT: usize = 1280;
/// A thousand chores a second: TCP timers and the LED are in no hurry, a bite should be told soon.
const CHORES_PER_SECOND: u32 = 1000;

/// Memory for sockets and datagrams; one of it, in `.bss`.
pub struct Memory {
    request: [u32; MAX_WORDS],
    reply: [u32; MAX_WORDS],
    tcp_rx: [u8; 128],
    tcp_tx: [u8; CONSOLE_TEXT],
    udp_rx: [u8; wire::MAX_PAYLOAD],
    udp_tx: [u8; wire::MAX_PAYLOAD],
}

impl Memory {
    /// Before anybody uses it.
    pub const fn new() -> Self {
        Memory {
            request: [0; MAX_WORDS],
            reply: [0; MAX_WORDS],
            tcp_rx: [0; 128],
            tcp_tx: [0; CONSOLE_TEXT],
            udp_rx: [0; wire::MAX_PAYLOAD],
            udp_tx: [0; wire::MAX_PAYLOAD],
        }
    }
}

/// What sockets are made of besides bytes; not all zeros, so it lies in `.data` and costs ROM.
pub struct SocketMemory {
    sockets: [smoltcp::iface::SocketStorage<'static>; 2],
    udp_rx: [udp::PacketMetadata; 1],
    udp_tx: [udp::PacketMetadata; 1],
}

impl SocketMemory {
    /// Before anybody uses it.
    pub const fn new() -> Self {
        SocketMemory {
            sockets: [smoltcp::iface::SocketStorage::EMPTY; 2],
            udp_rx: [udp::PacketMetadata::EMPTY; 1],
            udp_tx: [udp::PacketMetadata::EMPTY; 1],
        }
    }
}

/// Everything that runs.
pub struct App {
    soc: Soc,
    mac: Mac,
    server: Server,
    us: Us,
    lane: Option<Lane>,
    stack: Stack,
    request: &'static mut [u32; MAX_WORDS],
    reply: &'static mut [u32; MAX_WORDS],
    chores_at: u32,
    chores_every: u32,
    told: wire::State,
}

/// The IP stack and what is spoken over it.
struct Stack {
    interface: Interface,
    sockets: SocketSet<'static>,
    etherbone: SocketHandle,
    line: console::Line,
    greeted: bool,
}

impl App {
    /// Puts it together and ends start-up.
    pub fn new(parts: Parts) -> Self {
        let Parts {
            mut soc,
            mut mac,
            memory,
            boot,
            ident,
            us,
        } = parts;
        let mut server = Server::new(ident, soc::ABI, boot.id);
        server.start(&mut soc, boot.crashed);
        defmt::info!("boot {=u32:x}, crashed {=bool}", boot.id, boot.crashed);
        if ident.abi != soc::ABI {
            defmt::error!(
                "ABI: firmware {=u32:x}, gateware {=u32:x}; will not arm",
                soc::ABI,
                ident.abi
            );
        }
        let stack = Stack::new(
            &mut mac,
            &us,
            soc::sockets(),
            Buffers {
                tcp_rx: &mut memory.tcp_rx,
                tcp_tx: &mut memory.tcp_tx,
                udp_rx: &mut memory.udp_rx,
                udp_tx: &mut memory.udp_tx,
            },
        );
        App {
            chores_at: soc.now_lo(),
            chores_every: ident.clock_hz / CHORES_PER_SECOND,
            told: server.safety().state(),
            soc,
            mac,
            server,
            us,
            lane: None,
            stack,
            request: &mut memory.request,
            reply: &mut memory.reply,
        }
    }

    /// The loop.
    pub fn run(mut self) -> ! {
        loop {
            if self.mac.pending() {
                if self.exchange() {
                    self.chores_if(1);
                } else {
                    self.frame();
                    self.chores_if(1);
                }
            } else {
                // Somebody who exchanges gets his chores behind the answer; wait for that a while.
                self.chores_if(3);
            }
        }
    }

    /// The fast lane. True if the frame was an exchange and is dealt with.
    #[inline(always)]
    fn exchange(&mut self) -> bool {
        let Some(lane) = &self.lane else {
            return false;
        };
        let (frame, length) = self.mac.frame();
        let Some(mut command) = lane.open(&frame, length) else {
            return false;
        };
        if !self.mac.lane_idle() {
            // The last answer has not left yet: nobody waits for this one.
            return false;
        }
        let shape = *self.server.shape();
        let mut slot = self.mac.lane_slot();
        let mut reply = SlotReply::resume(&mut slot, &shape);
        let peer = lane.datagram.peer;
        match self
            .server
            .exchange(&mut self.soc, peer, &mut command, &mut reply)
        {
            Ok(()) => {
                reply.finish();
                self.mac
                    .send_lane(SlotReply::<TxSlot>::frame_length(&shape));
                self.server.counters_mut().frames_tx += 1;
            }
            Err(why) => self.server.refuse(why),
        }
        self.mac.release();
        self.server.counters_mut().frames_rx += 1;
        true
    }

    /// Any frame, the long way.
    #[inline(never)]
    fn frame(&mut self) {
        let (frame, length) = self.mac.frame();
        self.server.counters_mut().frames_rx += 1;
        match net::classify(&frame, length, &self.us) {
            Class::Ours(datagram) => {
                let words = self.copy_payload(&datagram);
                self.mac.release();
                match words {
                    Ok(count) => self.datagram(&datagram, count),
                    Err(why) => self.server.refuse(why),
                }
            }
            Class::Refused(why) => {
                self.mac.release();
                self.server.refuse(why);
            }
            Class::Other => {
                self.mac.take_for_stack();
                self.stack_poll();
            }
        }
    }

    fn copy_payload(&mut self, datagram: &Datagram) -> Result<usize, Refusal> {
        if datagram.length > wire::MAX_PAYLOAD {
            return Err(Refusal::Oversized);
        }
        if !datagram.length.is_multiple_of(4) {
            return Err(Refusal::Ragged);
        }
        let count = datagram.length / 4;
        let (frame, _) = self.mac.frame();
        for (index, word) in self.request.iter_mut().take(count).enumerate() {
            *word = net::payload_word(&frame, index);
        }
        Ok(count)
    }

    fn datagram(&mut self, datagram: &Datagram, count: usize) {
        let words = self.request.get(..count).unwrap_or(&[]);
        let before = self.server.counters().exchanges;
        let Ok(reply) = self
            .server
            .datagram(&mut self.soc, words, datagram.peer, self.reply)
        else {
            return;
        };
        if !reply.is_empty() {
            let mut slot = self.mac.slot();
            net::emit_headers(&mut slot, &self.us, datagram, reply.len() * 4);
            let length = net::emit_payload(&mut slot, reply);
            self.mac.send(length);
            self.server.counters_mut().frames_tx += 1;
        }
        if self.server.counters().exchanges != before {
            self.open_lane(*datagram);
        }
        if self.server.wants_restart() {
            defmt::warn!("restart on request");
            soc::restart();
        }
    }

    /// The next exchange of this host takes the fast lane.
    fn open_lane(&mut self, datagram: Datagram) {
        let shape = *self.server.shape();
        self.mac.wait_lane();
        let payload = SlotReply::<TxSlot>::frame_length(&shape) - net::HEADERS;
        let us = self.us;
        let mut slot = self.mac.lane_slot();
        SlotReply::prepare(
            &mut slot,
            |slot| net::emit_headers(slot, &us, &datagram, payload),
            &shape,
        );
        self.lane = Some(Lane::new(&us, datagram, shape.command));
    }

    /// Does the chores if `periods` of theirs have passed.
    #[inline(always)]
    fn chores_if(&mut self, periods: u32) {
        let now = self.soc.now_lo();
        if now.wrapping_sub(self.chores_at) >= self.chores_every * periods {
            self.chores_at = now;
            self.chores();
        }
    }

    #[inline(never)]
    fn chores(&mut self) {
        self.server.poll(&mut self.soc);
        let state = self.server.safety().state();
        if state != self.told {
            self.told = state;
            defmt::info!(
                "state {=u8}, reason {=u8}",
                state.code(),
                self.server.safety().reason().code()
            );
        }
        soc::check_stack();
        if self.stack.due(&mut self.soc) {
            self.stack_poll();
        }
    }

    #[inline(never)]
    fn stack_poll(&mut self) {
        let now = soc::instant(&mut self.soc);
        self.stack
            .interface
            .poll(now, &mut self.mac, &mut self.stack.sockets);
        self.etherbone_socket();
        self.console();
        self.stack
            .interface
            .poll(now, &mut self.mac, &mut self.stack.sockets);
        let sent = self.mac.sent_for_stack();
        let counters = self.server.counters_mut();
        counters.frames_tx = counters.frames_tx.wrapping_add(sent);
    }

    /// Etherbone in frames that are not plain: IP options, broadcast.
    fn etherbone_socket(&mut self) {
        let socket = self
            .stack
            .sockets
            .get_mut::<udp::Socket>(self.stack.etherbone);
        let Ok((bytes, meta)) = socket.recv() else {
            return;
        };
        let IpAddress::Ipv4(ip) = meta.endpoint.addr;
        let peer = firmware::session::Peer {
            ip: ip.to_bits(),
            port: meta.endpoint.port,
        };
        let words = match wire::words_from_bytes(bytes, self.request) {
            Ok(words) => words,
            Err(why) => return self.server.refuse(why),
        };
        let Ok(reply) = self.server.datagram(&mut self.soc, words, peer, self.reply) else {
            return;
        };
        if reply.is_empty() {
            return;
        }
        let mut to = udp::UdpMetadata::from(IpEndpoint::new(meta.endpoint.addr, peer.port));
        to.local_address = Some(Ipv4Address::from_bits(self.us.ip).into());
        if let Ok(buffer) = socket.send(reply.len() * 4, to) {
            wire::words_to_bytes(reply, buffer);
        }
    }

    fn console(&mut self) {}
}

struct Buffers {
    tcp_rx: &'static mut [u8],
    tcp_tx: &'static mut [u8],
    udp_rx: &'static mut [u8],
    udp_tx: &'static mut [u8],
}

impl Stack {
    fn new(mac: &mut Mac, us: &Us, storage: &'static mut SocketMemory, buffers: Buffers) -> Self {
        let address = HardwareAddress::Ethernet(EthernetAddress(us.mac));
        let mut interface = Interface::new(Config::new(address), mac, Instant::ZERO);
        interface.update_ip_addrs(|addresses| {
            // A /24, as everybody's bench network is; answers go to whoever asked anyway.
            let ip = Ipv4Address::from_bits(us.ip);
            let _ = addresses.push(IpCidr::new(ip.into(), 24));
        });
        let mut sockets = SocketSet::new(storage.sockets.as_mut_slice());
        let _ = (buffers.tcp_rx, buffers.tcp_tx);
        let mut udp = udp::Socket::new(
            udp::PacketBuffer::new(storage.udp_rx.as_mut_slice(), buffers.udp_rx),
            udp::PacketBuffer::new(storage.udp_tx.as_mut_slice(), buffers.udp_tx),
        );
        // Binding a fresh socket to a port that is not 0 cannot fail.
        let _ = udp.bind(us.port);
        let etherbone = sockets.add(udp);
        let mut stack = Stack {
            interface,
            sockets,
            etherbone,
            line: console::Line::default(),
            greeted: false,
        };
        stack
    }

    /// Is a timer of the stack due? Nobody connected means no timers, and no division either.
    fn due(&mut self, _soc: &mut Soc) -> bool {
        false
    }
}
