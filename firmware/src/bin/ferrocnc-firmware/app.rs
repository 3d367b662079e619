//! Ties the lib to the hardware: one loop, no heap, and no interrupt but the one that ends services
//! which do not come back.

use crate::soc::{self, Loader, Mac, Parts, RxFrame, Soc};
use core::arch::global_asm;
use core::ffi::c_void;
use core::sync::atomic::{AtomicPtr, Ordering::Relaxed};
use firmware::machine::{IDLE, Lease, Machine, Shared, VISIT_WORDS, Verb, Verdict, hold_path};
use firmware::net::{self, Class, Datagram, HEADERS, UdpPorts, Us};
use firmware::reserve;
use firmware::services::abi;
use wire::describe::JobsState;
use wire::{MAX_WORDS, Refusal};

/// The loop looks at the MAC this many times between two looks at the clock: about 20 us.
const POLLS: u32 = 128;
/// 10 ms between two turns of services that have nothing to do: precise enough for TCP's timers.
const HOUSEKEEPING_PER_TURN: u8 = 10;

/// Pieces of the services that are loaded in a row: 1.3 ms.
const PIECES: usize = 8;

/// Longest call of the services in clocks, behind which they are ended: while an owner moves the
/// machine, ...
const MOVING: u32 = 20_000;
/// ... while the owner's machine is at rest, well before a watchdog bites, ...
const AT_REST: u32 = 100_000;
/// ... and while there is no owner.
const LEISURE: u32 = 0xff_ffff;

/// How often services that failed are loaded again.
const RELOADS: u8 = 3;

/// Everything that runs on the board.
pub struct App {
    machine: Shared<Soc>,
    mac: Mac,
    /// The host whose next exchange can be judged in advance, and its token.
    owner: Option<(Datagram, u32)>,
    /// Housekeepings until the next turn of the services.
    turn_in: u8,
    /// The services, if they run.
    services: Option<abi::Entry>,
    /// Where they listen.
    ports: UdpPorts,
    /// Sums their code while the machine is at rest.
    patrol: abi::Patrol,
    /// They want to be called in every turn.
    restless: bool,
    /// A call of theirs has ended with a frame pending while the machine moves.
    crowded: bool,
    /// They are about to run.
    coming: Option<Coming>,
    /// How often they are still loaded again when they fail.
    reloads: u8,
}

/// The services before they run.
enum Coming {
    /// They are being copied and checked.
    Loading(Loader),
    /// They begin, in calls of this length and the next ones: [`abi::START`].
    Starting(abi::Header, usize),
}

impl App {
    /// Builds the application and ends start-up.
    pub fn new(parts: Parts) -> Self {
        let Parts {
            soc,
            mac,
            boot,
            ident,
        } = parts;
        let mut app = App {
            machine: Shared::new(Machine::asleep(soc, ident, soc::ABI, boot)),
            turn_in: HOUSEKEEPING_PER_TURN,
            mac,
            owner: None,
            services: None,
            ports: [0; 8],
            patrol: abi::Patrol::new(),
            restless: false,
            crowded: false,
            coming: Some(Coming::Loading(Loader::new())),
            reloads: RELOADS,
        };
        app.machine.alone().wake();
        defmt::info!("boot {=u32:x}, reset {=u8}", boot.id, boot.reset.code());
        if ident.abi != soc::ABI {
            defmt::error!(
                "ABI: firmware {=u32:x}, gateware {=u32:x}; will not arm",
                soc::ABI,
                ident.abi
            );
        }
        soc::watch_services();
        app.machine.alone().jobs(JobsState::Loading);
        app.load();
        app.mac.address(net::to_mac(app.machine.us.mac));
        app
    }

    /// The loop.
    pub fn run(mut self) -> ! {
        loop {
            // Services that want their turn, or are still loaded, get it at once if there is no
            // owner to wait for.
            let busy = self.restless || self.coming.is_some();
            let polls = match busy && self.owner.is_none() {
                true => 1,
                false => POLLS,
            };
            let something = (0..polls).any(|_| self.mac.pending() || self.machine.executed());
            let executed = self.machine.executed();
            let mut owners = executed;
            if executed {
                self.machine.alone();
            } else if self.mac.pending() {
                owners = self.frame();
            }
            if self.machine.owes_path() {
                hold_path(self.machine.alone());
            }
            // Before any guest's frame, so that the owner's next exchange does not wait for it. All
            // that took longer than the answer takes on the wire, but for slow links.
            if executed && soc::answered() {
                self.offer();
            }
            // While a host exchanges, housekeeping runs right after an answer; without one it waits
            // for some periods. Without a host it waits for nothing.
            let patience = match something || self.owner.is_none() {
                true => self.machine.patience(owners),
                false => IDLE,
            };
            if self.machine.due(patience) {
                self.housekeeping();
            }
            self.offer();
            // The services run here only while there is no exchange that they could delay.
            let something = self.services.is_some() || self.coming.is_some();
            if self.owner.is_none() && something {
                self.leisure();
            }
        }
    }

    /// The next exchange of the owner may be executed without the CPU. A frame that is there before
    /// the first exchange of a session may be that: a pass would come too late for it.
    fn offer(&mut self) {
        if self.owner.is_some() && (self.machine.exchanges() || !self.mac.pending()) {
            self.machine.offer();
        }
    }

    /// Does a host move the machine?
    fn moving(&self) -> bool {
        self.owner.is_some() && !self.machine.at_rest()
    }

    /// Any frame, the long way. True if it was the owner's.
    #[inline(never)]
    fn frame(&mut self) -> bool {
        let (frame, length) = self.mac.frame();
        self.machine.received();
        let payload = self.mac.input.words();
        match net::classify(&frame, length, &self.machine.us, &self.ports, payload) {
            Class::Ours(ref datagram) => {
                self.mac.dismiss();
                let owner = self.machine.session().is_owner(datagram.peer);
                if owner || !self.yields() {
                    self.datagram(datagram, owner);
                }
                return self.machine.session().is_owner(datagram.peer);
            }
            Class::Discovery(datagram) => {
                self.mac.dismiss();
                if !self.yields() {
                    self.discover(&datagram);
                }
            }
            Class::Refused(why) => {
                self.mac.dismiss();
                self.machine.refuse(why);
            }
            Class::Services
                if length > net::longest_in_motion(&frame, self.services.is_some())
                    && self.moving() =>
            {
                self.mac.dismiss();
                self.machine.refuse(Refusal::Oversized);
            }
            Class::Services => {
                // Behind a turn the ROM answers the owner's ARP, because the services take longer.
                let owners = net::is_arp(&frame) && self.is_from_owner(&frame);
                let length = self.mac.take_bytes();
                let late = self.behind_a_turn();
                if late && !owners {
                    self.machine.refuse(Refusal::Busy);
                } else if self.services.is_some() && !late {
                    let at = self.mac.input.bytes().as_ptr();
                    self.services(at, length);
                } else {
                    self.reserve(length);
                }
            }
            Class::Nothing => self.mac.dismiss(),
        }
        false
    }

    /// Did the frame that is being served come during a call of the services or in front of it, and
    /// is another one behind it, which may be the owner's next exchange?
    fn behind_a_turn(&mut self) -> bool {
        self.crowded &= self.mac.pending();
        self.crowded
    }

    /// As [`App::behind_a_turn`], for a guest's frame. The owner has waited for the turn: it does
    /// not wait for the guest, too, whose frame is refused.
    fn yields(&mut self) -> bool {
        let yields = self.behind_a_turn();
        if yields {
            self.machine.refuse(Refusal::Busy);
        }
        yields
    }

    /// Does the frame come from the host that owns the machine?
    fn is_from_owner(&self, frame: &RxFrame) -> bool {
        self.owner
            .is_some_and(|(datagram, _)| net::sender(frame) == datagram.mac)
    }

    fn datagram(&mut self, datagram: &Datagram, owner: bool) {
        // Where no frame leaves the board, the answer goes nowhere.
        let mut slot = self.mac.slot();
        let Mac { input, output, .. } = &mut self.mac;
        let words = input.words().get(..datagram.words()).unwrap_or(&[]);
        let peer = datagram.peer;
        let room = match &mut slot {
            Some(slot) => slot.payload(),
            None => output.words(),
        };
        let served = match owner {
            true => self.machine.alone().datagram(words, peer, room),
            false => self.machine.guest().datagram(words, peer, room),
        };
        let Ok(reply) = served else {
            return;
        };
        let bytes = reply.len() * 4;
        if bytes != 0
            && let Some(mut slot) = slot
        {
            net::emit_headers(&mut slot, &self.machine.us, datagram, bytes);
            self.mac.send(HEADERS + bytes);
            self.machine.sent(1);
        }
        let session = self.machine.session();
        if datagram.options == 0 && session.is_owner(datagram.peer) {
            let datagram = Datagram {
                length: 0,
                ..*datagram
            };
            let owner = (datagram, session.token_for(datagram.peer));
            if self.owner != Some(owner) {
                self.open_fast_path(owner);
            }
        }
        self.restart_if();
    }

    fn restart_if(&self) {
        if self.machine.wants_restart() {
            defmt::warn!("restart on request");
            // The last answer should leave first, if the wire takes it.
            let _ = self.mac.drained();
            soc::restart();
        }
    }

    /// A host looks for boards, or gives a board its settings.
    fn discover(&mut self, datagram: &Datagram) {
        let Mac { input, output, .. } = &mut self.mac;
        let words = input.words().get(..datagram.words()).unwrap_or(&[]);
        let port = datagram.peer.port;
        let reply = self.machine.guest().discover(words, port, output.words());
        let reply = reply.len();
        if reply != 0 {
            let us = Us {
                port: wire::DISCOVERY_PORT,
                ..self.machine.us
            };
            self.broadcast(&us, port, reply);
        }
    }

    /// Broadcasts what is waiting to be broadcast.
    #[cold]
    #[inline(never)]
    fn send_broadcasts(&mut self) {
        let words = self.mac.output.words();
        if let Some(broadcast) = self.machine.alone().next_broadcast(words) {
            let us = Us {
                mac: self.machine.us.mac,
                ip: broadcast.from_ip,
                port: broadcast.from_port,
            };
            self.broadcast(&us, broadcast.to_port, broadcast.words);
        }
        self.restart_if();
        if self.machine.alone().moved() {
            defmt::info!("address {=u32:x}", self.machine.us.ip);
            // The session has no owner, or the change of address would have waited.
            self.close_fast_path();
        }
    }

    /// Sends words of `output` to 255.255.255.255.
    fn broadcast(&mut self, us: &Us, port: u16, words: usize) {
        let Some(mut slot) = self.mac.slot() else {
            return;
        };
        net::emit_headers(&mut slot, us, &Datagram::broadcast(port), words * 4);
        let words = self.mac.output.words().get(..words).unwrap_or(&[]);
        let length = net::emit_payload(&mut slot, words);
        self.mac.send(length);
        self.machine.sent(1);
    }

    /// This owner's exchanges can be judged in advance from now on.
    fn open_fast_path(&mut self, owner: (Datagram, u32)) {
        let (datagram, token) = owner;
        let machine = self.machine.alone();
        if !self.mac.drained() {
            return;
        }
        let boot_id = machine.boot_id();
        self.mac
            .guard(&datagram, token, &machine.us, machine.shape(), boot_id);
        self.owner = Some(owner);
    }

    /// The session has no owner: the MAC admits every sender again.
    #[cold]
    #[inline(never)]
    fn close_fast_path(&mut self) {
        self.machine.alone();
        self.owner = None;
        self.mac.open();
    }

    #[inline(never)]
    fn housekeeping(&mut self) {
        if let Some((state, reason)) = self.machine.housekeeping() {
            defmt::info!("state {=u8}, reason {=u8}", state.code(), reason.code());
        }
        if self.machine.has_broadcast() {
            self.send_broadcasts();
        }
        soc::check_stack();
        self.crowded = false;
        // Admits one frame of a guest, a sender that does not own the session. The owner's next
        // frame is most of a servo period away, and serving one guest takes less. Not while a frame
        // is pending: that may be a guest's, and the owner's frame waits for one of them at most.
        if !self.mac.pending() {
            self.mac.admit();
        }
        let session = self.machine.session();
        if self
            .owner
            .is_some_and(|(datagram, _)| !session.is_owner(datagram.peer))
        {
            self.close_fast_path();
        }
        // A turn of the services does not delay an exchange that has a pass.
        self.offer();
        self.turn_in = self.turn_in.wrapping_sub(1);
        let due = self.turn_in == 0;
        if due {
            self.turn_in = HOUSEKEEPING_PER_TURN;
        }
        if self.services.is_some() {
            if due || self.restless {
                self.services(core::ptr::null(), abi::POLL);
            } else if self.owner.is_some() && self.machine.at_rest() {
                self.patrol();
            }
        }
    }

    /// Sums a piece of the services' code. One that has changed is not called again.
    #[cold]
    #[inline(never)]
    fn patrol(&mut self) {
        if !soc::patrol(&mut self.patrol) {
            defmt::error!("services failed: their code has changed in the SDRAM");
            self.ended();
        }
    }

    /// No host exchanges: a turn of the services, the sum of a piece of them, or the next piece of
    /// them from the flash.
    #[cold]
    #[inline(never)]
    fn leisure(&mut self) {
        if self.restless {
            self.services(core::ptr::null(), abi::POLL);
        } else if self.machine.may_load() && self.machine.at_rest() {
            match self.coming {
                Some(_) => self.load_some(),
                None => self.patrol(),
            }
        }
    }

    /// Loads until a frame comes, but not for long: housekeeping takes half as long as a piece.
    fn load_some(&mut self) {
        for _ in 0..PIECES {
            self.load();
            if self.mac.pending() || !matches!(self.coming, Some(Coming::Loading(_))) {
                return;
            }
        }
    }

    /// Loads a piece of the services, or makes the next call of their beginning. At the end it
    /// records the result.
    #[inline(never)]
    fn load(&mut self) {
        let state = match &mut self.coming {
            None => return,
            Some(Coming::Loading(loader)) => match loader.step(self.machine.alone()) {
                None => return,
                Some(Ok((header, patrol))) => {
                    self.patrol = patrol;
                    self.coming = Some(Coming::Starting(header, abi::START));
                    return;
                }
                Some(Err(why)) => why,
            },
            Some(Coming::Starting(header, length)) => {
                let (abi::Header { entry, ports, .. }, call) = (*header, *length);
                *length += 1;
                match self.call(entry, core::ptr::null(), call) {
                    abi::DEAD | abi::MORE => return,
                    abi::FAILED => JobsState::Sdram,
                    _ => {
                        (self.services, self.ports) = (Some(entry), ports);
                        JobsState::Alive
                    }
                }
            }
        };
        self.coming = None;
        self.machine.alone().jobs(state);
    }

    /// Calls the services. If they fail, the machine goes on without them.
    fn services(&mut self, frame: *const u8, length: usize) {
        if let Some(entry) = self.services {
            self.call(entry, frame, length);
            self.crowded = self.moving() && self.mac.pending();
        }
    }

    #[cold]
    #[inline(never)]
    fn call(&mut self, entry: abi::Entry, frame: *const u8, length: usize) -> u32 {
        let moving = self.moving();
        let rom = abi::Rom {
            datagram: services_datagram,
            send: services_send,
            console: services_console,
            leased: services_leased,
            output: self.mac.output.bytes().as_mut_ptr().cast(),
            us: &raw const self.machine.us,
            moving,
            context: core::ptr::null_mut(),
        };
        CALLER.store(self, Relaxed);
        let clocks = match &self.owner {
            None => LEISURE,
            Some(_) if !moving => AT_REST,
            Some(_) => MOVING,
        };
        let begun = self.machine.now_lo();
        let answer = soc::call_services(entry, &rom, frame, length, clocks);
        let clocks = self.machine.now_lo().wrapping_sub(begun);
        // Not the beginning, when there is nothing to delay.
        if self.services.is_some() {
            self.machine.guest().called(clocks, moving);
        }
        self.restless = answer == abi::RESTLESS;
        if answer == abi::DEAD {
            let (cause, at) = soc::last_trap();
            defmt::error!("services failed: cause {=u32} at {=u32:x}", cause, at);
            self.ended();
        }
        // The last text of a console should leave first.
        if !self.restless {
            self.restart_if();
        }
        answer
    }

    /// The services have failed: they are loaded again, unless that was done too often.
    #[cold]
    #[inline(never)]
    fn ended(&mut self) {
        self.services = None;
        self.restless = false;
        let state = match self.reloads.checked_sub(1) {
            Some(left) => {
                self.reloads = left;
                self.coming = Some(Coming::Loading(Loader::new()));
                JobsState::Ended
            }
            None => {
                self.coming = None;
                // A lease that is not renewed is over some day.
                self.machine.guest().leased(None);
                JobsState::GivenUp
            }
        };
        self.machine.alone().jobs(state);
    }

    /// Where there are no services: answers a frame of `length` bytes from `input`.
    #[cold]
    #[inline(never)]
    fn reserve(&mut self, length: usize) {
        let Mac { input, output, .. } = &mut self.mac;
        let frame = input.bytes().get(..length).unwrap_or(&[]);
        if let Some(length) = reserve::answer(frame, &self.machine.us, output.frame()) {
            output.send(length);
            self.machine.sent(1);
        }
    }
}

// What the services call: the functions below, through `services_enter`, which opens the guard and
// closes it again behind them.
global_asm!(
    ".macro called_back name, function",
    ".section .text.services_\\name,\"ax\",@progbits",
    ".type services_\\name, @function",
    ".global services_\\name",
    "services_\\name:",
    "    la      t2, \\function",
    "    j       services_enter",
    ".endm",
    "called_back datagram, {datagram}",
    "called_back send, {send}",
    "called_back console, {console}",
    "called_back leased, {leased}",
    datagram = sym datagram,
    send = sym send,
    console = sym console,
    leased = sym leased,
);

unsafe extern "C" {
    safe fn services_datagram(
        context: *mut c_void,
        request: *const u32,
        words: usize,
        reply: &mut [u32; MAX_WORDS],
    ) -> isize;
    safe fn services_send(context: *mut c_void, length: usize);
    safe fn services_console(
        context: *mut c_void,
        visitor: usize,
        verb: u32,
        words: &mut [u32; VISIT_WORDS],
    ) -> u32;
    safe fn services_leased(context: *mut c_void, ip: u32, prefix: u32, gateway: u32);
}

/// The app whose services ask for something. What they give as the context may be anything.
static CALLER: AtomicPtr<App> = AtomicPtr::new(core::ptr::null_mut());

/// Runs `serve` on the app; `None` without one.
fn caller<R>(serve: impl FnOnce(&mut App) -> R) -> Option<R> {
    // SAFETY: it waits in `App::services` and touches nothing meanwhile; at no other time is there
    // a caller.
    unsafe { CALLER.load(Relaxed).as_mut() }.map(serve)
}

/// [`abi::Rom::datagram`].
extern "C" fn datagram(
    _context: *mut c_void,
    request: *const u32,
    words: usize,
    reply: *mut [u32; MAX_WORDS],
) -> isize {
    const REFUSED: isize = -1 - Refusal::Oversized as isize;
    let fits = words <= MAX_WORDS
        && soc::theirs(request.addr(), words * 4)
        && soc::theirs(reply.addr(), size_of::<[u32; MAX_WORDS]>());
    if !fits {
        return REFUSED;
    }
    // SAFETY: both lie in the SDRAM, where every word may be read and written; the program waits.
    let (request, reply) = unsafe { (core::slice::from_raw_parts(request, words), &mut *reply) };
    caller(|app| match app.machine.guest().inside(request, reply) {
        Ok(reply) => reply.len() as isize,
        Err(why) => -1 - why as isize,
    })
    .unwrap_or(REFUSED)
}

/// [`abi::Rom::send`].
extern "C" fn send(_context: *mut c_void, length: usize) {
    caller(|app| {
        app.mac.output.send(length.min(abi::FRAME_MAX));
        app.machine.sent(1);
    });
}

/// [`abi::Rom::console`].
extern "C" fn console(
    _context: *mut c_void,
    visitor: usize,
    verb: u32,
    words: *mut [u32; VISIT_WORDS],
) -> u32 {
    let verdict = match Verb::from_code(verb) {
        Some(verb) if soc::theirs(words.addr(), size_of::<[u32; VISIT_WORDS]>()) => {
            // SAFETY: as above.
            let words = unsafe { &mut *words };
            caller(|app| app.machine.guest().visit(visitor, verb, words))
        }
        Some(_) | None => None,
    };
    verdict.unwrap_or(Verdict::NotNow) as u32
}

/// [`abi::Rom::leased`].
extern "C" fn leased(_context: *mut c_void, ip: u32, prefix: u32, gateway: u32) {
    let prefix = u8::try_from(prefix).unwrap_or(0);
    let lease = Lease {
        ip,
        prefix,
        gateway,
    };
    caller(|app| app.machine.guest().leased((prefix != 0).then_some(lease)));
}
