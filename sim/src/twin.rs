//! The twin: the firmware's library on the models of the cores, with the same sockets as the
//! Verilated board.
//!
//! No CPU, no MAC: a datagram goes into [`firmware::machine::Machine`] as the image would put it
//! there, and the verbs of [`firmware::cores::Board`] become register writes of
//! [`crate::model::Board`]. Its network is datagrams and this machine's TCP, or Ethernet frames
//! ([`Twin::plug_in`]). The pins behave as the gateware's, clock by clock; the times of the
//! firmware's actions are round figures (see [`ANSWER`]), because no instructions are executed
//! here.
//!
//! Time passes from event to event, so an idle board takes almost no computing time.

mod ethernet;
mod fast_path;
mod letters;
mod programs;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use letters::{Letter, Request};
use programs::programs;

use firmware::machine::{IDLE, Machine, Shared};
use firmware::net::Datagram;
use firmware::postmortem::Record;
use firmware::services;
use firmware::services::console::{Console, Reader, Visit};
use firmware::services::port::CONSOLES;
use firmware::session::Peer;
use wire::regmap;
use wire::{MAX_WORDS, ResetReason};

use crate::board::Clockwork;
use crate::board_facts::BoardFacts;
use crate::edges::Recorder;
use crate::environment::PinEnvironment;
use crate::error::Error;
use crate::exchange::{Meter, StatusHead, is_request, sequence, wants_reply};
use crate::faults::{Act, Cargo as _, Direction, OneWay, Plan, Script};
use crate::jobs;
use crate::lan_segment::CONSOLE_PORT;
use crate::lease::DhcpClient;
use crate::model_board::{ACCESS, ModelBoard, RECEIVING, Setup, ident};
use crate::plant::Plant;
use crate::report::{Counters, FrameCounts, Report, Seen};
use crate::server::{Addresses, Device, Reply, Service};
use crate::services::Services;
use crate::soc::LINK_1000;

/// Clocks from a request's arrival to its execution, and from there to its answer, the long way.
/// Less than the image takes, which is some 6000 (`cargo xtask bench exchange`).
pub const ANSWER: [u64; 2] = [480, 490];
/// Clocks between two slices of an operation of the flash: what a slice takes the image, some 256
/// bytes of SPI.
const SLICE: u64 = 12_000;
/// Clocks from a start to the first frame that is looked at: what the image takes on the Verilated
/// board (`ferrocnc-sim --backend rtl` prints 198 662 from power-up with the first question).
pub const STARTING: u64 = 190_000;
/// The host's address on the board's cable, as the Verilated board sees it.
const HOST: u32 = 0xc0a8_0201;

/// A client at a console, or at the port of jobs.
#[derive(Debug, Default)]
struct Visitor {
    console: Console,
    /// Its number at the board; `None`: it is at the port of jobs.
    number: Option<usize>,
    out: Vec<u8>,
    said_goodbye: bool,
    gone: bool,
}

/// A twin and the hosts that talk to it.
#[derive(Debug)]
pub struct Twin {
    machine: Shared<ModelBoard>,
    facts: BoardFacts,
    sdram: bool,
    clockwork: Clockwork,
    /// What comes over the wire, and when its last word is there.
    arriving: VecDeque<(u64, Letter)>,
    /// When the last one was.
    arrived: u64,
    /// What the gateware is answering by itself.
    executing: Option<Letter>,
    /// The host whose next exchange can be judged in advance, and its token.
    owner: Option<(Datagram, u32)>,
    /// When the next pass can be handed out, if that is only a matter of time.
    offer_at: u64,
    requests: VecDeque<Request>,
    replies: Vec<Reply>,
    visitors: Vec<Visitor>,
    meter: Meter,
    script: Script,
    to_board: OneWay<Letter>,
    from_board: OneWay<Reply>,
    /// The twin receives nothing before this clock: the firmware is starting.
    starting: u64,
    frames: FrameCounts,
    frozen: bool,
    housekeeping_at: u64,
    /// What executes jobs, and when it is called next.
    jobs: Option<jobs::Program>,
    jobs_at: u64,
    /// For the consoles, if the services run.
    reader: Option<Reader>,
    /// What asks DHCP servers.
    dhcp: Option<DhcpClient>,
    /// Its network is frames.
    cable: bool,
    /// What takes them.
    services: Option<Services>,
    busy: Duration,
    busy_clocks: u64,
}

fn payload(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

impl Twin {
    /// Switches a twin of this board on; its flash is new.
    pub fn start(facts: BoardFacts, plant: Plant) -> Self {
        Self::power_up(Setup::new(facts, plant))
    }

    /// Switches a board on.
    pub fn power_up(setup: Setup) -> Self {
        let (facts, sdram) = (setup.facts.clone(), setup.sdram);
        let (mut model_board, ident) = ModelBoard::power_up(setup);
        let boot = model_board.boot();
        let machine = Machine::start(model_board, ident, regmap::ABI, boot);
        let mut machine = Shared::new(machine);
        let (jobs, dhcp, reader) = programs(&mut machine, &facts, sdram);
        let clockwork = Clockwork::new(facts.clock_hz.into());
        Twin {
            housekeeping_at: machine.board.clock(),
            jobs_at: machine.board.clock(),
            jobs,
            reader,
            dhcp,
            cable: false,
            services: None,
            machine,
            facts,
            sdram,
            clockwork,
            arriving: VecDeque::new(),
            arrived: 0,
            executing: None,
            owner: None,
            offer_at: u64::MAX,
            requests: VecDeque::new(),
            replies: Vec::new(),
            visitors: Vec::new(),
            meter: Meter::default(),
            script: Script::new(clockwork.sys_hz),
            to_board: OneWay::new(Direction::ToBoard),
            from_board: OneWay::new(Direction::FromBoard),
            starting: 0,
            frames: FrameCounts::default(),
            frozen: false,
            busy: Duration::ZERO,
            busy_clocks: 0,
        }
    }

    /// The sys clock in which the watchdog was last given a token: the write is on the bus.
    pub fn fed(&self) -> u64 {
        self.machine.board.fed
    }

    /// Sets the counts of stepgen and encoder n; see [`crate::model::Board::preset`].
    pub fn preset(&mut self, n: usize, pulses: i32, count: i32) {
        self.machine.board().model.preset(n, pulses, count);
    }

    /// Pins, edges and plant.
    pub fn environment(&mut self) -> &mut PinEnvironment {
        &mut self.machine.board().environment
    }

    /// Stream every step into a file; [`Self::finish`] closes it.
    pub fn record_edges(&mut self, path: &std::path::Path) -> Result<(), Error> {
        let recorder = Recorder::create(path, self.clockwork.sys_hz)?;
        self.environment().edges.record(recorder);
        Ok(())
    }

    /// Close the edge file.
    pub fn finish(&mut self) -> Result<u64, Error> {
        self.environment().edges.finish_recording()
    }

    fn housekeeping_every(&self) -> u64 {
        match self.machine.server.flash().busy() {
            true => SLICE,
            false => self.clockwork.sys_hz / 1000,
        }
    }

    /// Sends the board's broadcasts.
    fn send_broadcasts(&mut self) {
        while self.machine.has_broadcast() {
            let mut buffer = [0; MAX_WORDS];
            let Some(broadcast) = self.machine.alone().next_broadcast(&mut buffer) else {
                return;
            };
            self.frames.from_board += 1;
            let words = &buffer[..broadcast.words];
            if self.cable {
                self.broadcast_frame(broadcast, words);
                continue;
            }
            let reply = Reply {
                service: Service::Discovery,
                port: broadcast.to_port,
                payload: payload(words),
            };
            self.send(reply);
        }
    }

    /// Puts a reply on the cable.
    fn send(&mut self, mut reply: Reply) {
        let now = self.machine.board.clock();
        let from = Direction::FromBoard;
        if reply.service != Service::Cable {
            self.script.cut(from, now, &mut reply.payload);
        }
        self.from_board.enter(&mut self.script, now, reply);
        self.heard_of(now);
    }

    /// Takes the datagrams that have arrived by now.
    fn heard_of(&mut self, now: u64) {
        while let Some(letter) = self.to_board.due(now) {
            self.take_in(letter);
        }
        while let Some(reply) = self.from_board.due(now) {
            self.replies.push(reply);
        }
        self.frames.dropped = self.script.counts.lost;
    }

    /// A datagram is on the wire; frames come one after the other.
    fn take_in(&mut self, letter: Letter) {
        self.frames.to_board += 1;
        let now = self.machine.board.clock();
        if now < self.starting {
            return;
        }
        let behind = self.arrived + self.on_wire(letter.wire_bytes());
        self.arrived = behind.max(now + RECEIVING);
        self.arriving.push_back((self.arrived, letter));
    }

    /// Its last word is there: the gateware executes it, or it waits for the CPU.
    fn arrive(&mut self, letter: Letter) {
        if self.executes(&letter) {
            self.executing = Some(letter);
            return;
        }
        if self.frozen {
            return;
        }
        let last = self.requests.back();
        let free = last.map_or(0, |last| last.due.max(last.answered));
        self.requests.push_back(Request {
            port: letter.port,
            service: letter.service,
            payload: letter.payload,
            due: self.machine.board.clock().max(free) + ANSWER[0],
            answered: 0,
            reply: None,
        });
    }

    /// Applies the due faults of the board itself.
    fn suffer(&mut self) {
        while let Some(act) = self.script.due(self.machine.board.clock()) {
            match act {
                Act::Link(up) => self.environment().link(if up { LINK_1000 } else { 0 }),
                Act::Freeze(frozen) => self.freeze_cpu(frozen),
                Act::Reboot(power) => self.reboot(power),
            }
        }
    }

    /// The whole board restarts, as its reset pin makes it; with `power` the memory of its last
    /// start is lost as well.
    pub fn reboot(&mut self, power: bool) {
        let board = self.machine.board();
        let before = board.clock();
        board.restart();
        if power {
            board.record = Record::EMPTY;
            board.flash.chip().power_up();
        }
        self.requests.clear();
        self.arriving.clear();
        self.executing = None;
        for visitor in &mut self.visitors {
            *visitor = Visitor {
                said_goodbye: true,
                ..Visitor::default()
            };
        }
        self.begin();
        self.starting = before + STARTING;
        self.housekeeping_at = self.starting;
        self.jobs_at = self.starting;
    }

    /// The firmware starts on the board as it stands.
    fn begin(&mut self) {
        (self.owner, self.offer_at) = (None, u64::MAX);
        // The restart of the board took back a pass that was out, with the firmware that remembers
        // it.
        let board = self.machine.board();
        let boot = board.record.boot(board.model.clocks() as u32);
        let (flash, trailer) = (board.flash.clone(), board.trailer);
        let (gateware, readback) = {
            let build = board.model.build();
            (build.abi, build.readback)
        };
        let spare = Setup {
            flash,
            ..Setup::new(self.facts.clone(), Plant::default())
        };
        let spare = ModelBoard::new(spare, trailer);
        let model_board = std::mem::replace(self.machine.board(), spare);
        let ident = ident(&self.facts, gateware, readback);
        let machine = Machine::start(model_board, ident, regmap::ABI, boot);
        self.machine = Shared::new(machine);
        self.start_services();
    }

    /// Starts what runs in the SDRAM.
    fn start_services(&mut self) {
        (self.jobs, self.dhcp, self.reader) = programs(&mut self.machine, &self.facts, self.sdram);
        if self.cable {
            // The services have all of them.
            let there = self.reader.is_some();
            (self.jobs, self.dhcp, self.reader) = (None, None, None);
            let start = || Services::start(self.machine.guest(), self.facts.clock_hz);
            self.services = there.then(start).flatten();
        }
    }

    fn housekeeping(&mut self) {
        if let Some((state, reason)) = self.machine.housekeeping() {
            // The image logs this for `ferrocnc log`, which needs the image's strings; here it is
            // printed.
            eprintln!("sim: {state}, reason {reason}");
        }
        self.send_broadcasts();
        let client = self.dhcp.as_mut();
        if let Some(payload) = client.and_then(|client| client.turn(self.machine.guest())) {
            self.frames.from_board += 1;
            self.send(Reply {
                service: Service::Dhcp,
                port: services::lease::SERVER_PORT,
                payload,
            });
        }
        // Nothing is told: the services and the server ask for the address.
        if self.machine.has_broadcast() {
            self.machine.alone().moved();
        }
        self.forget_owner();
        if self.machine.server.wants_restart() {
            self.machine.board().record.part(ResetReason::Requested);
            self.begin();
        }
        self.offer();
    }

    fn execute(&mut self, mut request: Request) {
        let peer = Peer {
            ip: HOST,
            port: request.port,
        };
        self.machine.board().model.arrive();
        let (mut buffer, mut owners) = ([0; MAX_WORDS], false);
        let words = || {
            let mut words = [0; MAX_WORDS];
            let count =
                wire::words_from_bytes(&request.payload, &mut words).map_or(0, <[u32]>::len);
            (words, count)
        };
        let reply = match request.service {
            Service::Etherbone => {
                let bytes = &request.payload;
                let reply = match self.machine.session().is_owner(peer) {
                    true => self.machine.alone().payload(bytes, peer, &mut buffer),
                    false => self.machine.guest().payload(bytes, peer, &mut buffer),
                };
                owners = self.machine.session().is_owner(peer);
                self.judge_ahead_for(&Self::sender(peer));
                reply.unwrap_or(&[])
            }
            Service::Discovery => {
                let (words, count) = words();
                let words = &words[..count];
                self.machine
                    .guest()
                    .discover(words, request.port, &mut buffer)
            }
            Service::Dhcp => {
                if let Some(dhcp) = &mut self.dhcp {
                    dhcp.take(&request.payload, self.machine.guest());
                }
                &[]
            }
            Service::Cable => {
                (request.reply, owners) = self.take_frame(&request.payload);
                &[]
            }
        };
        if !reply.is_empty() {
            request.reply = Some(payload(reply));
        }
        self.hold_path();
        self.send_broadcasts();
        request.answered = self.machine.board.clock() + ANSWER[1];
        if self.machine.due(self.machine.patience(owners)) {
            self.housekeeping();
        }
        self.requests.push_front(request);
    }

    /// Calls the jobs program once, or all services. True if it sent something.
    fn do_jobs(&mut self) -> bool {
        if self.cable {
            return self.turn_services();
        }
        let now = self.machine.board.clock();
        let Some(program) = self.jobs.as_mut().filter(|_| !self.frozen) else {
            self.jobs_at = u64::MAX;
            return false;
        };
        let (said, due) = program.turn(self.machine.guest());
        self.jobs_at = now + due;
        self.offer();
        let Some(said) = said else {
            return false;
        };
        let visitor = &mut self.visitors[said.visitor];
        visitor.out.extend(said.bytes);
        visitor.said_goodbye |= said.close;
        true
    }

    /// The input and output of a console. It takes no time here.
    fn converse(&mut self, client: usize, bytes: &[u8]) {
        let visitor = &mut self.visitors[client];
        let (Some(number), Some(reader)) = (visitor.number, &mut self.reader) else {
            return;
        };
        if visitor.said_goodbye {
            return;
        }
        let mut outer = jobs::Outer(self.machine.guest());
        let mut visit = Visit {
            visitor: number,
            reader,
            jobs: self.jobs.as_mut().and_then(jobs::Program::jobs),
            out: &mut outer,
        };
        let (said, close) = jobs::converse(&mut visitor.console, bytes, &mut visit);
        drop(outer);
        visitor.out.extend(said);
        visitor.said_goodbye = close;
        self.offer();
        // A line may have started a job.
        self.jobs_at = self.jobs_at.min(self.machine.board.clock() + ACCESS);
    }

    /// The CPU is done with a request.
    fn answer(&mut self, request: Request) -> bool {
        let (port, service, asked) = (request.port, request.service, request.payload);
        if let Some(payload) = request.reply {
            self.reply(port, service, &asked, payload);
        }
        self.offer();
        !self.replies.is_empty()
    }

    /// The board answers what was asked.
    fn reply(&mut self, port: u16, service: Service, asked: &[u8], payload: Vec<u8>) {
        self.frames.from_board += 1;
        if let Some(head) = sequence(asked).and_then(|s| StatusHead::parse(&payload, s)) {
            self.meter.answer(head);
        }
        self.send(Reply {
            service,
            port,
            payload,
        });
    }

    fn report_now(&mut self) -> Report {
        let own = if self.frozen {
            None
        } else {
            let peer = Peer { ip: HOST, port: 0 };
            let mut word = |address| {
                let (mut words, mut buffer) = ([0; 5], [0; MAX_WORDS]);
                let request = wire::Request::new(&mut words).read(0, &[address]).words()?;
                let mut guest = self.machine.guest();
                let reply = guest.datagram(request, peer, &mut buffer).ok()?;
                reply.get(4).copied()
            };
            Counters::gather(|base, words| (0..words).map(|n| word(base + 4 * n)).collect())
        };
        Report::of(
            &Seen {
                backend: "model",
                environment: &self.machine.board.environment,
                clockwork: self.clockwork,
                clocks: self.machine.board.clock(),
                kcycles_per_second: self.kcycles_per_second(),
                meter: &self.meter,
                frames: self.frames,
            },
            own,
        )
    }
}

impl Device for Twin {
    type Console = usize;

    fn clock(&self) -> u64 {
        self.machine.board.clock()
    }

    fn clockwork(&self) -> Clockwork {
        self.clockwork
    }

    fn post(&mut self, port: u16, service: Service, payload: &[u8]) {
        self.meter.requested += u64::from(is_request(payload));
        let mut letter = Letter {
            port,
            service,
            payload: payload.to_vec(),
        };
        let now = self.clock();
        let to = Direction::ToBoard;
        if service != Service::Cable {
            self.script.cut(to, now, &mut letter.payload);
        }
        self.to_board.enter(&mut self.script, now, letter);
        self.machine.board().spoilt = self.to_board.spoilt();
        self.heard_of(now);
    }

    fn pass(&mut self, until: u64) -> bool {
        let (started, before) = (Instant::now(), self.clock());
        let mut told = false;
        while self.clock() < until && !told {
            let next = match self.requests.front() {
                Some(request) if request.answered != 0 => request.answered,
                Some(request) => request.due,
                None => u64::MAX,
            };
            let housekeeping = if self.frozen {
                u64::MAX
            } else {
                self.housekeeping_at
            };
            let cable = self.to_board.next().min(self.from_board.next());
            let trouble = self.script.next(self.clock()).min(cable);
            let arrival = self.arriving.front().map_or(u64::MAX, |(due, _)| *due);
            let board = self.machine.board();
            let answer = match self.executing {
                Some(_) => board.clock() + 1,
                None => u64::MAX,
            };
            let stop = until
                .min(next)
                .min(housekeeping)
                .min(trouble)
                .min(self.jobs_at)
                .min(arrival)
                .min(answer)
                .min(self.offer_at);
            board.pass(stop.max(board.clock() + 1));
            if self.clock() >= trouble {
                self.suffer();
                self.heard_of(self.clock());
                told |= !self.replies.is_empty();
                continue;
            }
            if self.executing.is_some() && self.machine.board.hears() {
                told |= self.executed();
            }
            if self.clock() >= arrival
                && let Some((_, letter)) = self.arriving.pop_front()
            {
                self.arrive(letter);
            }
            if self.clock() >= self.offer_at {
                self.offer();
            }
            if self.clock() >= self.jobs_at {
                told |= self.do_jobs();
            }
            if self.clock() >= housekeeping {
                if self.machine.due(IDLE) {
                    self.housekeeping();
                }
                self.housekeeping_at = self.clock() + self.housekeeping_every();
                told |= !self.replies.is_empty();
            }
            if self.clock() >= next
                && let Some(request) = self.requests.pop_front()
            {
                if request.answered == 0 {
                    self.execute(request);
                    if self.machine.server.flash().busy() {
                        self.housekeeping_at = self.housekeeping_at.min(self.clock() + SLICE);
                    }
                } else {
                    told |= self.answer(request);
                }
            }
        }
        self.busy += started.elapsed();
        self.busy_clocks += self.clock() - before;
        told
    }

    fn take_replies(&mut self) -> Vec<Reply> {
        std::mem::take(&mut self.replies)
    }

    fn addresses(&self) -> Option<Addresses> {
        let us = &self.machine.us;
        Some(Addresses {
            mac: us.mac,
            ip: us.ip.into(),
            prefix: self.machine.net.0,
            port: us.port,
        })
    }

    fn wait_for(&self, service: Service, payload: &[u8]) -> u64 {
        if service == Service::Discovery || wants_reply(payload) {
            2000
        } else {
            RECEIVING + ANSWER[0] + 100
        }
    }

    fn open(&mut self, port: u16) -> usize {
        let mut visitor = Visitor::default();
        if port == CONSOLE_PORT {
            let taken = |number: &usize| {
                let mut all = self.visitors.iter();
                all.any(|it| it.number == Some(*number) && !it.gone && !it.said_goodbye)
            };
            visitor.number = (0..CONSOLES).find(|number| !taken(number));
            // No console is free, or nothing listens there.
            visitor.said_goodbye = visitor.number.is_none() || self.reader.is_none();
        } else {
            let number = self.visitors.len();
            let program = self.jobs.as_mut();
            match program.map(|program| program.open(number, self.machine.guest())) {
                Some(None) => self.jobs_at = self.jobs_at.min(self.clock() + ACCESS),
                Some(Some(busy)) => visitor.out.extend(busy),
                // No service listens there.
                None => visitor.said_goodbye = true,
            }
        }
        self.visitors.push(visitor);
        let last = self.visitors.len() - 1;
        self.converse(last, &[]);
        last
    }

    fn type_in(&mut self, console: usize, bytes: &[u8]) -> usize {
        if self.frozen || !self.script.link() || self.clock() < self.starting {
            return 0;
        }
        if self.visitors[console].number.is_none() {
            let program = self.jobs.as_mut();
            self.jobs_at = self.jobs_at.min(self.machine.board.clock() + ACCESS);
            return program.map_or(bytes.len(), |program| program.type_in(console, bytes));
        }
        self.converse(console, bytes);
        bytes.len()
    }

    fn heard(&mut self, console: usize) -> Vec<u8> {
        if !self.script.link() {
            return Vec::new();
        }
        std::mem::take(&mut self.visitors[console].out)
    }

    fn untold(&mut self, console: usize) -> usize {
        let program = self.jobs.as_ref();
        program.map_or(0, |program| program.untold(console))
    }

    fn hang_up(&mut self, console: usize) {
        self.visitors[console].gone = true;
        if let Some(program) = &mut self.jobs {
            program.close(console);
        }
    }

    fn hung_up(&mut self, console: usize) -> bool {
        self.visitors[console].said_goodbye
    }

    fn closed(&mut self, console: usize) -> bool {
        self.visitors[console].gone
    }

    fn forget(&mut self, console: usize) {
        // The numbers of other clients must not change; an empty entry takes a few words.
        self.visitors[console] = Visitor::default();
    }

    fn environment(&self) -> &PinEnvironment {
        &self.machine.board.environment
    }

    fn environment_mut(&mut self) -> &mut PinEnvironment {
        &mut self.machine.board().environment
    }

    fn freeze_cpu(&mut self, frozen: bool) {
        self.frozen = frozen;
        self.jobs_at = self.jobs_at.min(self.clock());
        if frozen {
            self.requests.clear();
        } else {
            self.settle();
        }
    }

    fn faults(&mut self) -> &mut Script {
        &mut self.script
    }

    fn trouble(&mut self, plan: &Plan) -> Result<(), String> {
        self.script.follow(plan, self.machine.board.clock());
        self.suffer();
        Ok(())
    }

    fn meter(&self) -> &Meter {
        &self.meter
    }

    fn frames(&self) -> FrameCounts {
        self.frames
    }

    fn ping(&mut self) -> Option<u64> {
        (!self.frozen).then_some(ANSWER[0] + ANSWER[1])
    }

    fn kcycles_per_second(&self) -> f64 {
        self.busy_clocks as f64 / self.busy.as_secs_f64().max(1e-9) / 1e3
    }

    fn report(&mut self) -> Report {
        self.report_now()
    }
}

#[cfg(test)]
mod tests;
