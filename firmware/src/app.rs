//! Ties the lib to the hardware: one loop, no interrupts, no heap.

use crate::soc::{self, Mac, Parts, RxFrame, Soc, TxSlot};
use core::ffi::c_void;
use firmware::console::{self, ANSWER_MAX, Ask, Vitals};
use firmware::exchange::{FRAME_FLAGS, SlotReply};
use firmware::ip::{Ip, Taker, Text};
use firmware::jobs::abi;
use firmware::machine::{BEHIND_A_FRAME, IDLE, Machine};
use firmware::net::{self, Class, Datagram, Frame as _, Lane, Us};
use firmware::session::Peer;
use firmware::text::Sink as _;
use wire::describe::JobsState;
use wire::{CONSOLE_PORT, MAX_WORDS, Refusal};

/// Looks at the MAC between two looks at the clock: some 20 us.
const POLLS: u32 = 128;
/// Longest ping or console segment while the machine is not at rest: summing, copying and answering one is 20 clocks a byte. A
/// console's visitor never sends more, our window is shorter.
const GUEST_FRAME: usize = 256;
/// 10 ms between two looks at TCP's timers.
const CHORES_PER_IP: u8 = 10;

/// What is too large for the stack; one of it, in `.bss`.
pub struct Memory {
    ip: Ip,
}

impl Memory {
    /// Before anybody uses it.
    pub const fn new() -> Self {
        Memory { ip: Ip::new() }
    }
}

/// Everything that runs.
pub struct App {
    machine: Machine<Soc>,
    mac: Mac,
    lane: Option<Lane>,
    /// Something that is not the fast lane ran.
    cold: bool,
    ip: &'static mut Ip,
    line: console::Line,
    ip_in: u8,
    /// A copy of [`Ip::busy`]: looking there itself costs the next exchange a line of the data cache.
    talking: bool,
    /// The jobs program.
    jobs: Option<abi::Entry>,
    /// The jobs program wants to be called in every turn.
    restless: bool,
}

impl App {
    /// Puts it together and ends start-up.
    pub fn new(parts: Parts) -> Self {
        let Parts {
            soc,
            mac,
            memory,
            boot,
            ident,
        } = parts;
        let mut app = App {
            machine: Machine::asleep(soc, ident, soc::ABI, boot),
            ip_in: CHORES_PER_IP,
            mac,
            lane: None,
            cold: false,
            ip: &mut memory.ip,
            talking: false,
            jobs: None,
            restless: false,
            line: console::Line::default(),
        };
        app.machine.wake();
        defmt::info!("boot {=u32:x}, reset {=u8}", boot.id, boot.reset.code());
        if ident.abi != soc::ABI {
            defmt::error!(
                "ABI: firmware {=u32:x}, gateware {=u32:x}; will not arm",
                soc::ABI,
                ident.abi
            );
        }
        app.ip.listen(CONSOLE_PORT, ANSWER_MAX);
        app.begin_jobs();
        app.mac.address(net::to_mac(app.machine.us.mac));
        app
    }

    /// The loop.
    #[unsafe(link_section = ".trap.hot.run")]
    pub fn run(mut self) -> ! {
        loop {
            // Asked in a tight loop: whatever else stands in it is added to somebody's turnaround.
            let pending = (0..POLLS).any(|_| self.mac.pending());
            if pending || self.cold {
                // One call of `exchange`, so that a rehearsal runs the very instructions of a performance.
                let (frame, length, slot) = if pending {
                    let (frame, length) = self.mac.frame();
                    (frame, length, self.mac.lane_slot())
                } else {
                    let length = self.rehearsal();
                    let (frame, slot) = self.mac.rehearsal();
                    (frame, length, slot)
                };
                let done = self.exchange(frame, length, slot);
                // A rehearsal that does not come off is no frame: there is none, or one that nobody has looked at yet.
                if !done && frame.genuine() {
                    self.frame();
                }
                if self.machine.server.owes_path() {
                    self.hold_path();
                }
                self.chores_if(BEHIND_A_FRAME);
            } else {
                // Somebody who exchanges gets his chores behind the answer; wait for that a while.
                self.chores_if(IDLE);
            }
            // Nobody exchanges whom it could keep waiting.
            if self.restless && self.lane.is_none() {
                self.jobs(core::ptr::null(), abi::POLL);
            }
        }
    }

    /// The fast lane. True if the frame was an exchange and is dealt with.
    #[inline(always)]
    fn exchange(&mut self, frame: RxFrame, length: usize, mut slot: TxSlot) -> bool {
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
        let mut reply = SlotReply::resume(&mut slot);
        let peer = lane.datagram.peer;
        let Machine { board, server, .. } = &mut self.machine;
        let served = server.exchange(board, peer, &mut command, &mut reply);
        if !frame.genuine() {
            return true;
        }
        match served {
            Ok(()) => {
                self.mac.send_lane();
                // Read again: kept in a register it would push another out.
                let flags = frame.word(FRAME_FLAGS);
                self.machine.server.exchanged(flags);
                self.machine.server.counters_mut().frames_tx += 1;
            }
            Err(why) => self.machine.server.refuse(why),
        }
        self.mac.release();
        self.machine.server.counters_mut().frames_rx += 1;
        true
    }

    /// Something else ran: makes up an exchange that walks the fast lane and does nothing, so that the
    /// next one finds its instructions in the cache. Cold it takes some 1500 clocks longer. Returns the frame's length, which is
    /// nobody's if there is nothing to rehearse. It has its place beside the lane: elsewhere its own lines may push those out that
    /// only a performance needs.
    #[inline(never)]
    #[unsafe(link_section = ".trap.hot.rehearsal")]
    fn rehearsal(&mut self) -> usize {
        self.cold = false;
        let Some(lane) = &self.lane else {
            return 0;
        };
        let session = self.machine.server.session();
        let token = session.token_for(lane.datagram.peer);
        let sequence = session.last_sequence().wrapping_add(1);
        match self.mac.rehearsal_words() {
            Some(words) if self.machine.server.may_rehearse() => {
                lane.rehearse(token, sequence, words)
            }
            Some(_) | None => 0,
        }
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
                self.mac.dismiss();
                match words {
                    Ok(count) if datagram.length.is_multiple_of(4) => {
                        self.datagram(&datagram, count);
                    }
                    Ok(_) => self.machine.server.refuse(Refusal::Ragged),
                    Err(why) => self.machine.server.refuse(why),
                }
            }
            Class::Discovery(datagram) => {
                let words = self.copy_payload(&datagram);
                self.mac.dismiss();
                match words {
                    Ok(count) if datagram.length.is_multiple_of(4) => {
                        self.discover(count, datagram.peer.port);
                    }
                    Ok(_) => self.machine.server.refuse(Refusal::Ragged),
                    Err(why) => self.machine.server.refuse(why),
                }
            }
            Class::Dhcp(datagram) => {
                let words = self.copy_payload(&datagram);
                self.mac.dismiss();
                let words = self.mac.input.words().get(..words.unwrap_or(0));
                self.machine.offered(words.unwrap_or(&[]), datagram.length);
                self.shout();
            }
            Class::Refused(why) => {
                self.mac.dismiss();
                self.machine.server.refuse(why);
            }
            Class::Other
                if length > GUEST_FRAME
                    && self.lane.is_some()
                    && !self.machine.server.safety().at_rest() =>
            {
                self.mac.dismiss();
                self.machine.server.refuse(Refusal::Oversized);
            }
            Class::Other => {
                let length = self.mac.take_bytes();
                let frame = self.mac.input.bytes().as_ptr();
                if self.jobs(frame, length) & abi::TAKEN == 0 {
                    self.talk(Some(length));
                }
            }
            Class::Nothing => self.mac.dismiss(),
        }
    }

    fn copy_payload(&mut self, datagram: &Datagram) -> Result<usize, Refusal> {
        // A DHCP server's options are as many bytes as they are.
        let count = net::payload_words(datagram.length.next_multiple_of(4))?;
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
        if reply != 0
            && let Some(mut slot) = self.mac.slot()
        {
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
        self.restart_if();
    }

    fn restart_if(&self) {
        if self.machine.server.wants_restart() {
            defmt::warn!("restart on request");
            // The last answer shall be out, if the wire takes it.
            let _ = self.mac.wait_lane();
            soc::restart();
        }
    }

    /// Somebody looks for boards, or tells one who to be.
    fn discover(&mut self, count: usize, port: u16) {
        let Mac { input, output, .. } = &mut self.mac;
        let words = input.words().get(..count).unwrap_or(&[]);
        let reply = self.machine.discover(words, port, output.words()).len();
        if reply != 0 {
            let us = Us {
                port: wire::DISCOVERY_PORT,
                ..self.machine.us
            };
            self.broadcast(&us, port, reply);
        }
    }

    /// Sends what has to be told to everybody.
    #[cold]
    #[inline(never)]
    fn shout(&mut self) {
        self.cold = true;
        if let Some(shout) = self.machine.shout(self.mac.output.words()) {
            let us = Us {
                mac: self.machine.us.mac,
                ip: shout.from_ip,
                port: shout.from_port,
            };
            self.broadcast(&us, shout.to_port, shout.words);
        }
        self.restart_if();
        if self.machine.moved() {
            defmt::info!("address {=u32:x}", self.machine.us.ip);
            // Nobody owns the session, or it would have waited.
            self.close_lane();
            self.ip.reset();
        }
    }

    /// Sends words of `output` to 255.255.255.255.
    fn broadcast(&mut self, us: &Us, port: u16, words: usize) {
        let Some(mut slot) = self.mac.slot() else {
            return;
        };
        net::emit_headers(&mut slot, us, &Datagram::everybody(port), words * 4);
        let words = self.mac.output.words().get(..words).unwrap_or(&[]);
        let length = net::emit_payload(&mut slot, words);
        self.mac.send(length);
        self.machine.server.counters_mut().frames_tx += 1;
    }

    /// The owner's exchanges take the fast lane from now on.
    fn open_lane(&mut self, datagram: Datagram) {
        let shape = *self.machine.server.shape();
        if !self.mac.wait_lane() {
            return;
        }
        let length = SlotReply::<TxSlot>::frame_length(&shape);
        let payload = length - net::HEADERS;
        let us = self.machine.us;
        let mut slot = self.mac.lane_slot();
        SlotReply::prepare(
            &mut slot,
            |slot| net::emit_headers(slot, &us, &datagram, payload),
            &self.machine.server,
        );
        self.mac.aim(length);
        let lane = Lane::new(&us, datagram, shape.command);
        self.mac.guard(&lane);
        self.lane = Some(lane);
    }

    /// Nobody owns the session: everybody may come.
    #[cold]
    #[inline(never)]
    fn close_lane(&mut self) {
        self.lane = None;
        self.mac.open();
    }

    /// The answer is on its way: time to see to the axes' decelerations.
    #[inline(never)]
    #[unsafe(link_section = ".trap.hot.path")]
    fn hold_path(&mut self) {
        let Machine { board, server, .. } = &mut self.machine;
        server.hold_path(board);
        // It may have pushed a line of the fast lane out of the cache.
        self.cold = true;
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
        if self.machine.has_to_shout() {
            self.shout();
        }
        soc::check_stack();
        // A guest is work for so long at most; the owner's next frame is on its way, but a period off. Not while there is a frame: it
        // may be a guest's, and with a second one in the other slot the owner would find none.
        if !self.mac.pending() {
            self.mac.admit();
        }
        let session = self.machine.server.session();
        if self
            .lane
            .is_some_and(|lane| !session.is_owner(lane.datagram.peer))
        {
            self.close_lane();
        }
        // A hundredth of a second is fine enough for TCP's timers.
        self.ip_in = self.ip_in.wrapping_sub(1);
        if self.ip_in == 0 {
            self.ip_in = CHORES_PER_IP;
            if self.talking {
                self.talk(None);
            }
            // Asked here: the call alone may push lines of the fast lane out, and nobody rehearses behind it where there is no program.
            if self.jobs.is_some() {
                self.jobs(core::ptr::null(), abi::POLL);
            }
        }
    }

    /// Looks for a jobs program, and says what came of it.
    #[inline(never)]
    fn begin_jobs(&mut self) {
        let state = match soc::load(&mut self.machine) {
            Err(why) => why,
            Ok(entry) => {
                self.jobs = Some(entry);
                if self.jobs(core::ptr::null(), abi::START) & abi::FAILED == 0 {
                    JobsState::Alive
                } else {
                    self.jobs = None;
                    JobsState::Sdram
                }
            }
        };
        self.machine.server.jobs(state);
    }

    /// Calls the jobs program, if there is one. What it answers is 0 without.
    #[cold]
    #[inline(never)]
    fn jobs(&mut self, frame: *const u8, length: usize) -> u32 {
        let Some(entry) = self.jobs else {
            return 0;
        };
        self.cold = true;
        let rom = abi::Rom {
            datagram,
            send,
            output: self.mac.output.bytes().as_mut_ptr().cast(),
            us: &raw const self.machine.us,
            context: (&raw mut *self).cast(),
        };
        let answer = entry(&rom, frame, length);
        self.restless = answer & abi::RESTLESS != 0;
        answer
    }

    /// ARP, ping and the console: a frame of so many bytes in `input`, and what there is to say beyond an answer.
    #[inline(never)]
    fn talk(&mut self, mut length: Option<usize>) {
        self.cold = true;
        while self.converse(length) {
            self.ask_jobs();
            length = None;
        }
        self.restart_if();
    }

    /// The jobs program answers the console's line. Its text lies where frames are made, so no frame is made meanwhile.
    fn ask_jobs(&mut self) {
        let line = self.line.job();
        let trusted = usize::from(self.machine.trusted()) * abi::TRUSTED;
        let length = line.len() | abi::LINE | trusted;
        let count = self.jobs(line.as_ptr(), length) >> abi::TEXT;
        let text = self.mac.output.bytes().get(..count as usize);
        self.ip.say(text.unwrap_or(&[]));
        self.ip.say(console::PROMPT.as_bytes());
    }

    /// See [`App::talk`]. True if the console's line is the jobs program's to answer.
    #[inline(always)]
    fn converse(&mut self, length: Option<usize>) -> bool {
        let mut asked = false;
        let now = soc::milliseconds(&mut self.machine.board);
        let us = self.machine.us;
        let Mac { input, output, .. } = &mut self.mac;
        let mut visitor = Visitor {
            machine: &mut self.machine,
            line: &mut self.line,
            jobs: self.jobs.is_some(),
            asked: &mut asked,
        };
        let frame = length.and_then(|length| input.bytes().get(..length));
        let mut sent = 0;
        let mut answer = frame
            .and_then(|frame| self.ip.frame(frame, &us, now, &mut visitor, output.bytes()))
            .or_else(|| self.ip.poll(&us, now, &mut visitor, output.bytes()));
        while let Some(length) = answer {
            output.send(length);
            sent += 1;
            answer = self.ip.poll(&us, now, &mut visitor, output.bytes());
        }
        self.talking = self.ip.busy();
        let counters = self.machine.server.counters_mut();
        counters.frames_tx = counters.frames_tx.wrapping_add(sent);
        asked
    }
}

/// [`abi::Rom::datagram`].
extern "C" fn datagram(
    context: *mut c_void,
    request: *const u32,
    words: usize,
    reply: &mut [u32; MAX_WORDS],
) -> isize {
    // SAFETY: `context` is the app that waits in `App::jobs` and touches nothing meanwhile; the program says how long its request is.
    let (app, request) = unsafe {
        (
            &mut *context.cast::<App>(),
            core::slice::from_raw_parts(request, words),
        )
    };
    let answer = match app.machine.inside(request, reply) {
        Ok(reply) => reply.len() as isize,
        Err(why) => -1 - why as isize,
    };
    if app.machine.server.owes_path() {
        app.hold_path();
    }
    answer
}

/// [`abi::Rom::send`].
extern "C" fn send(context: *mut c_void, length: usize) {
    // SAFETY: as above.
    let app = unsafe { &mut *context.cast::<App>() };
    app.mac.output.send(length);
}

/// Somebody at the console.
struct Visitor<'a> {
    machine: &'a mut Machine<Soc>,
    line: &'a mut console::Line,
    /// There is a program that answers what is asked about jobs.
    jobs: bool,
    /// It has to: nothing more is taken before.
    asked: &'a mut bool,
}

impl Taker for Visitor<'_> {
    fn greet(&mut self, out: &mut Text) {
        *self.line = console::Line::default();
        self.machine.greet();
        out.put(console::PROMPT.as_bytes());
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        if *self.asked {
            return 0;
        }
        let mut used = 0;
        for byte in bytes {
            used += 1;
            if let Some(ask) = self.line.push(*byte) {
                let server = &self.machine.server;
                let short = matches!(ask, Ask::Nothing | Ask::Quit)
                    // While a job moves something nobody else waits.
                    || ask == Ask::Job && server.session().is_owner(Peer::INSIDE);
                if !short && !server.safety().at_rest() {
                    // An answer takes up to a servo period to write, and the owner would wait for it.
                    out.put(b"? not while armed\r\n");
                    out.put(console::PROMPT.as_bytes());
                    break;
                }
                if ask == Ask::Job && self.jobs {
                    *self.asked = true;
                    break;
                }
                let vitals = Vitals {
                    stack: soc::stack_used(),
                    mac_errors: self.machine.board.mac_errors(),
                };
                self.machine.answer(ask, &vitals, out);
                if ask == Ask::Quit {
                    out.close = true;
                } else {
                    out.put(console::PROMPT.as_bytes());
                }
                break;
            }
        }
        used
    }
}
