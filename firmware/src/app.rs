//! Ties the lib to the hardware: one loop, no interrupts, no heap.

use crate::soc::{self, Mac, Parts, RxFrame, Soc, TxSlot};
use firmware::console::{self, ANSWER_MAX, Ask, Vitals};
use firmware::exchange::SlotReply;
use firmware::machine::{BEHIND_A_FRAME, IDLE, Machine};
use firmware::net::{self, Class, Datagram, Lane, Us};
use firmware::text::Sink as _;
use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::socket::tcp;
use smoltcp::time::Instant;
use smoltcp::wire::{EthernetAddress, HardwareAddress, IpCidr, Ipv4Address};
use wire::{CONSOLE_PORT, Refusal};

/// Room for the longest answer and for what the other side has not acknowledged yet.
const CONSOLE_TEXT: usize = 2048;
/// Looks at the MAC between two looks at the clock: some 20 us.
const POLLS: u32 = 128;
/// 10 ms between two looks at TCP's timers.
const CHORES_PER_STACK: u8 = 10;

/// Memory for sockets; one of it, in `.bss`.
pub struct Memory {
    tcp_rx: [u8; 128],
    tcp_tx: [u8; CONSOLE_TEXT],
}

impl Memory {
    /// Before anybody uses it.
    pub const fn new() -> Self {
        Memory {
            tcp_rx: [0; 128],
            tcp_tx: [0; CONSOLE_TEXT],
        }
    }
}

/// What sockets are made of besides bytes; not all zeros, so it lies in `.data` and costs ROM.
pub type SocketMemory = [smoltcp::iface::SocketStorage<'static>; 1];

/// Everything that runs.
pub struct App {
    machine: Machine<Soc>,
    mac: Mac,
    lane: Option<Lane>,
    /// Something that is not the fast lane ran.
    cold: bool,
    stack: Stack,
    stack_in: u8,
}

/// The IP stack and what is spoken over it.
struct Stack {
    interface: Interface,
    sockets: SocketSet<'static>,
    console: SocketHandle,
    line: console::Line,
    greeted: bool,
}

impl App {
    /// Puts it together and ends start-up.
    pub fn new(parts: Parts) -> Self {
        let Parts {
            soc,
            mut mac,
            memory,
            boot,
            ident,
        } = parts;
        let machine = Machine::start(soc, ident, soc::ABI, boot);
        defmt::info!("boot {=u32:x}, reset {=u8}", boot.id, boot.reset.code());
        if ident.abi != soc::ABI {
            defmt::error!(
                "ABI: firmware {=u32:x}, gateware {=u32:x}; will not arm",
                soc::ABI,
                ident.abi
            );
        }
        let stack = Stack::new(
            &mut mac,
            &machine.us,
            &mut memory.tcp_rx,
            &mut memory.tcp_tx,
        );
        App {
            stack_in: CHORES_PER_STACK,
            machine,
            mac,
            lane: None,
            cold: false,
            stack,
        }
    }

    /// The loop.
    #[unsafe(link_section = ".trap.hot.run")]
    pub fn run(mut self) -> ! {
        loop {
            // Asked in a tight loop: whatever else stands in it is added to somebody's turnaround.
            let mut pending = false;
            for _ in 0..POLLS {
                pending = self.mac.pending();
                if pending {
                    break;
                }
            }
            if pending || self.cold {
                // One call of `exchange`, so that a rehearsal runs the very instructions of a performance.
                let stage = if pending {
                    Some((self.mac.frame(), self.mac.lane_slot()))
                } else {
                    self.rehearsal()
                };
                let done = match stage {
                    Some(((frame, length), slot)) => self.exchange(frame, length, slot, pending),
                    None => true,
                };
                if !done {
                    self.frame();
                }
                self.chores_if(BEHIND_A_FRAME);
            } else {
                // Somebody who exchanges gets his chores behind the answer; wait for that a while.
                self.chores_if(IDLE);
            }
        }
    }

    /// The fast lane. True if the frame was an exchange and is dealt with.
    #[inline(always)]
    fn exchange(&mut self, frame: RxFrame, length: usize, mut slot: TxSlot, genuine: bool) -> bool {
        let Some(lane) = &self.lane else {
            return false;
        };
        let Some(mut command) = lane.open(&frame, length) else {
            return false;
        };
        if !self.mac.lane_idle() {
            // The last answer has not left yet: nobody waits for this one.
            return false;
        }
        let shape = *self.machine.server.shape();
        let mut reply = SlotReply::resume(&mut slot);
        let peer = lane.datagram.peer;
        let Machine { board, server, .. } = &mut self.machine;
        let served = server.exchange(board, peer, &mut command, &mut reply);
        if !genuine {
            return true;
        }
        match served {
            Ok(()) => {
                self.mac
                    .send_lane(SlotReply::<TxSlot>::frame_length(&shape));
                self.machine.server.exchanged();
                self.machine.server.counters_mut().frames_tx += 1;
            }
            Err(why) => self.machine.server.refuse(why),
        }
        self.mac.release();
        self.machine.server.counters_mut().frames_rx += 1;
        true
    }

    /// Something else ran: makes up an exchange that walks the fast lane and does nothing, so that the
    /// next one finds its instructions in the cache. Cold it takes some 1500 clocks longer.
    #[inline(never)]
    fn rehearsal(&mut self) -> Option<((RxFrame, usize), TxSlot)> {
        self.cold = false;
        let lane = self
            .lane
            .as_ref()
            .filter(|_| self.machine.server.may_rehearse())?;
        let session = self.machine.server.session();
        let token = session.token_for(lane.datagram.peer);
        let sequence = session.last_sequence().wrapping_add(1);
        let length = lane.rehearse(token, sequence, self.mac.rehearsal_words()?);
        let (frame, slot) = self.mac.rehearsal();
        Some(((frame, length), slot))
    }

    /// Any frame, the long way.
    #[inline(never)]
    fn frame(&mut self) {
        self.cold = true;
        let (frame, length) = self.mac.frame();
        self.machine.server.counters_mut().frames_rx += 1;
        match net::classify(&frame, length, &self.machine.us) {
            Class::Ours(datagram) => {
                let words = self.copy_payload(&datagram);
                self.mac.release();
                match words {
                    Ok(count) => self.datagram(&datagram, count),
                    Err(why) => self.machine.server.refuse(why),
                }
            }
            Class::Refused(why) => {
                self.mac.release();
                self.machine.server.refuse(why);
            }
            Class::Other => {
                self.mac.take_for_stack();
                self.stack_poll();
            }
        }
    }

    fn copy_payload(&mut self, datagram: &Datagram) -> Result<usize, Refusal> {
        let count = net::payload_words(datagram.length)?;
        let (frame, _) = self.mac.frame();
        for (index, word) in self.mac.input.words().iter_mut().take(count).enumerate() {
            *word = net::payload_word(&frame, datagram.options, index);
        }
        Ok(count)
    }

    fn datagram(&mut self, datagram: &Datagram, count: usize) {
        let Mac { input, output, .. } = &mut self.mac;
        let words = input.words().get(..count).unwrap_or(&[]);
        let served = self.machine.datagram(words, datagram.peer, output.words());
        let Ok(reply) = served else {
            return;
        };
        let reply = reply.len();
        if reply != 0 {
            let mut slot = self.mac.slot();
            net::emit_headers(&mut slot, &self.machine.us, datagram, reply * 4);
            let words = self.mac.output.words().get(..reply).unwrap_or(&[]);
            let length = net::emit_payload(&mut slot, words);
            self.mac.send(length);
            self.machine.server.counters_mut().frames_tx += 1;
        }
        let opened = self
            .lane
            .is_some_and(|lane| lane.datagram.peer == datagram.peer);
        if !opened && datagram.options == 0 && self.machine.server.session().is_owner(datagram.peer)
        {
            self.open_lane(*datagram);
        }
        if self.machine.server.wants_restart() {
            defmt::warn!("restart on request");
            soc::restart();
        }
    }

    /// The owner's exchanges take the fast lane from now on.
    fn open_lane(&mut self, datagram: Datagram) {
        let shape = *self.machine.server.shape();
        self.mac.wait_lane();
        let payload = SlotReply::<TxSlot>::frame_length(&shape) - net::HEADERS;
        let us = self.machine.us;
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
        if self.machine.due(periods) {
            self.chores();
        }
    }

    #[inline(never)]
    #[unsafe(link_section = ".trap.hot.chores")]
    fn chores(&mut self) {
        if let Some((state, reason)) = self.machine.chores() {
            self.cold = true;
            defmt::info!("state {=u8}, reason {=u8}", state.code(), reason.code());
        }
        soc::check_stack();
        // A hundredth of a second is fine enough for TCP's timers.
        self.stack_in = self.stack_in.wrapping_sub(1);
        if self.stack_in == 0 {
            self.stack_in = CHORES_PER_STACK;
            if self.stack.busy() {
                self.stack_poll();
            }
        }
    }

    #[inline(never)]
    fn stack_poll(&mut self) {
        self.cold = true;
        let now = soc::instant(&mut self.machine.board);
        self.stack
            .interface
            .poll(now, &mut self.mac, &mut self.stack.sockets);
        self.console();
        self.stack
            .interface
            .poll(now, &mut self.mac, &mut self.stack.sockets);
        let sent = self.mac.sent_for_stack();
        let counters = self.machine.server.counters_mut();
        counters.frames_tx = counters.frames_tx.wrapping_add(sent);
    }

    fn console(&mut self) {
        let socket = self
            .stack
            .sockets
            .get_mut::<tcp::Socket>(self.stack.console);
        if socket.state() == tcp::State::TimeWait {
            // Both have said good bye; the next one shall not wait ten seconds for it.
            socket.abort();
        }
        if !socket.is_open() {
            self.stack.line = console::Line::default();
            self.stack.greeted = false;
            // Listening on a closed socket at a fixed port cannot fail.
            let _ = socket.listen(CONSOLE_PORT);
            return;
        }
        if socket.may_send() && !self.stack.greeted {
            self.stack.greeted = socket.send_slice(console::PROMPT.as_bytes()).is_ok();
        }
        // One line at a time, and only where its answer fits: so none is cut off.
        while socket.can_recv() && socket.send_capacity() - socket.send_queue() >= ANSWER_MAX {
            let line = &mut self.stack.line;
            let ask = socket
                .recv(|bytes| {
                    let mut ask = None;
                    let mut used = 0;
                    for byte in bytes.iter() {
                        used += 1;
                        ask = line.push(*byte);
                        if ask.is_some() {
                            break;
                        }
                    }
                    (used, ask)
                })
                .unwrap_or(None);
            let Some(ask) = ask else { continue };
            let vitals = Vitals {
                stack: soc::stack_used(),
                mac_errors: self.mac.errors(),
            };
            let mut sink = Sink::new(socket);
            self.machine.answer(ask, &vitals, &mut sink);
            if ask != Ask::Quit {
                sink.put(console::PROMPT.as_bytes());
            }
            sink.flush();
            if ask == Ask::Quit {
                socket.close();
                return;
            }
        }
        if socket.state() == tcp::State::CloseWait {
            // They hung up.
            socket.close();
        }
    }
}

/// The console's text goes into the socket in lines, more or less: a send costs some 700 clocks however
/// little it carries.
struct Sink<'a, 's> {
    socket: &'a mut tcp::Socket<'s>,
    line: heapless::Vec<u8, 96>,
}

impl<'a, 's> Sink<'a, 's> {
    fn new(socket: &'a mut tcp::Socket<'s>) -> Self {
        Sink {
            socket,
            line: heapless::Vec::new(),
        }
    }

    fn flush(&mut self) {
        // Too long an answer is cut off.
        let _ = self.socket.send_slice(&self.line);
        self.line.clear();
    }
}

impl firmware::text::Sink for Sink<'_, '_> {
    fn put(&mut self, text: &[u8]) {
        if self.line.extend_from_slice(text).is_err() {
            self.flush();
            let _ = self.line.extend_from_slice(text);
        }
    }
}

impl Stack {
    fn new(mac: &mut Mac, us: &Us, rx: &'static mut [u8], tx: &'static mut [u8]) -> Self {
        let address = HardwareAddress::Ethernet(EthernetAddress(us.mac));
        let mut interface = Interface::new(Config::new(address), mac, Instant::ZERO);
        interface.update_ip_addrs(|addresses| {
            // A /24, as everybody's bench network is; answers go to whoever asked anyway.
            let ip = Ipv4Address::from_bits(us.ip);
            let _ = addresses.push(IpCidr::new(ip.into(), 24));
        });
        let mut sockets = SocketSet::new(soc::sockets().as_mut_slice());
        let mut tcp = tcp::Socket::new(tcp::SocketBuffer::new(rx), tcp::SocketBuffer::new(tx));
        // Prompts are short and somebody waits for them.
        tcp.set_nagle_enabled(false);
        let console = sockets.add(tcp);
        let mut stack = Stack {
            interface,
            sockets,
            console,
            line: console::Line::default(),
            greeted: false,
        };
        let _ = stack
            .sockets
            .get_mut::<tcp::Socket>(console)
            .listen(CONSOLE_PORT);
        stack
    }

    /// Is somebody on the console, so that the stack's timers matter?
    fn busy(&mut self) -> bool {
        !self
            .sockets
            .get_mut::<tcp::Socket>(self.console)
            .is_listening()
    }
}
