//! A text console for `telnet` or `nc`: it shows everything and changes almost nothing.
//!
//! Lines come in, text goes out. A command that changes something (`restart`) needs a machine at
//! rest, a session without an owner and, if the board has a key, a `login` ([`crate::auth`]). No
//! command can stop a machine that a host drives. Lines that begin with `job` are for the services,
//! which have their own rules for them ([`crate::services`]). The console ignores lines that are
//! too long, control bytes and telnet's option negotiation.

use crate::auth::{Words, by_port};
use crate::cores::{Board, Setting};
use crate::log;
use crate::net::Us;
use crate::server::{Server, last_close};
use crate::text::{Out, Sink};
use wire::Refusal;
use wire::exchange::EDGE_TIME_BITS;
use wire::map::{self, BoardConfig, StepgenConfig};
use wire::regmap::{CSR_PAGE, status};

/// Longest line. The longest command with its argument is a quarter of this.
pub const LINE_MAX: usize = 64;

/// Greets a new client, and asks for the next line.
pub const PROMPT: &str = "ferrocnc> ";

/// `login` answers this, the challenge in 32 hex digits, and the board's unique id in 16.
pub const CHALLENGE: &str = "challenge ";

/// `login ANSWER` answers this if the answer is right.
pub const WELCOME: &str = "welcome";

/// Longest answer, in bytes: sixteen encoders.
pub const ANSWER_MAX: usize = 1100;

/// The answer to `job` on a board without a jobs program.
pub const NO_JOBS: &str = "no jobs here; `ferrocnc describe` says why";

const HELP: [&str; 17] = [
    "help          this",
    "status        what the machine is doing, and why it stopped",
    "net           frames and refusals by reason",
    "regs [page]   the CSR pages, or the first words of one",
    "stepgen [n]   positions, rates, timings",
    "encoder [n]   counts, latches, errors, modes",
    "pwm [n]       periods and modes",
    "gpio          inputs, e-stop, probe",
    "watchdog      timeout, time left, what closed the gate",
    "log           where the log stands, and the last obituary",
    "link          speed, and what got lost",
    "flash         the chip, running and next image",
    "settings      name and addresses, and their source",
    "job           what jobs do; try job help",
    "login         with the key; `ferrocnc console` does it",
    "restart       start the firmware anew",
    "quit          good bye",
];

/// What a line means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// The list of commands.
    Help,
    /// State, session, memory.
    Status,
    /// Frame and refusal counters.
    Net,
    /// All pages, or one.
    Regs(Option<u8>),
    /// All stepgens, or one.
    Stepgen(Option<u8>),
    /// All encoders, or one.
    Encoder(Option<u8>),
    /// All PWMs, or one.
    Pwm(Option<u8>),
    /// Inputs.
    Gpio,
    /// The watchdog.
    Watchdog,
    /// Log and last panic.
    Log,
    /// The Ethernet link.
    Link,
    /// The flash and its images.
    Flash,
    /// The settings in force.
    Settings,
    /// A challenge, or the answer to one.
    Login(Option<Words>),
    /// Something for the part of the services that knows jobs: [`LineEditor::line`].
    Job,
    /// Restart the firmware.
    Restart,
    /// Hang up.
    Quit,
    /// An empty line.
    Nothing,
    /// Anything else.
    Unknown,
}

impl Ask {
    /// Reads a line. It never fails; a line may be [`Ask::Unknown`].
    pub fn parse(line: &str) -> Ask {
        let mut words = line.split_ascii_whitespace();
        let Some(command) = words.next() else {
            return Ask::Nothing;
        };
        if command == "job" {
            return Ask::Job;
        }
        let argument = words.next();
        if words.next().is_some() {
            return Ask::Unknown;
        }
        if command == "login" {
            return match argument.map(hex_words) {
                None => Ask::Login(None),
                Some(Some(answer)) => Ask::Login(Some(answer)),
                Some(None) => Ask::Unknown,
            };
        }
        let number = match argument.map(str::parse::<u8>) {
            None => None,
            Some(Ok(number)) => Some(number),
            Some(Err(_)) => return Ask::Unknown,
        };
        let ask = match command {
            "regs" => return Ask::Regs(number),
            "stepgen" => return Ask::Stepgen(number),
            "encoder" => return Ask::Encoder(number),
            "pwm" => return Ask::Pwm(number),
            "help" | "?" => Ask::Help,
            "status" => Ask::Status,
            "net" => Ask::Net,
            "gpio" => Ask::Gpio,
            "watchdog" => Ask::Watchdog,
            "log" => Ask::Log,
            "link" => Ask::Link,
            "flash" => Ask::Flash,
            "settings" => Ask::Settings,
            "restart" => Ask::Restart,
            "quit" | "exit" => Ask::Quit,
            _ => Ask::Unknown,
        };
        if number.is_some() { Ask::Unknown } else { ask }
    }
}

/// 32 hex digits.
#[inline(never)]
fn hex_words(text: &str) -> Option<Words> {
    let mut words = Words::default();
    let (chunks, []) = text.as_bytes().as_chunks::<8>() else {
        return None;
    };
    if chunks.len() != words.len() {
        return None;
    }
    for (word, digits) in words.iter_mut().zip(chunks) {
        for digit in digits {
            *word = *word << 4 | char::from(*digit).to_digit(16)?;
        }
    }
    Some(words)
}

/// Collects bytes into lines.
#[derive(Clone, Debug, Default)]
pub struct LineEditor {
    text: heapless::String<LINE_MAX>,
    too_long: bool,
    telnet: u8,
    /// The line is complete, and kept until the next byte comes.
    complete: bool,
}

impl LineEditor {
    /// No byte yet.
    pub const fn new() -> Self {
        LineEditor {
            text: heapless::String::new(),
            too_long: false,
            telnet: 0,
            complete: false,
        }
    }

    /// Takes one byte; returns the line's meaning when the line is complete.
    pub fn push(&mut self, byte: u8) -> Option<Ask> {
        self.collect(byte).then(|| Ask::parse(self.line()))
    }

    /// Takes one byte; true if the line is complete ([`LineEditor::line`]).
    // Inlined in two places it would cost half a KiB.
    #[inline(never)]
    pub fn collect(&mut self, byte: u8) -> bool {
        const IAC: u8 = 255;
        const WILL: u8 = 251;
        const DONT: u8 = 254;
        if self.complete {
            *self = LineEditor::new();
        }
        if self.telnet > 0 {
            // IAC WILL/WONT/DO/DONT option; any other IAC command is two bytes.
            self.telnet = u8::from(self.telnet == 1 && (WILL..=DONT).contains(&byte)) * 2;
            return false;
        }
        match byte {
            IAC => self.telnet = 1,
            b'\n' => self.complete = true,
            8 | 127 => {
                self.text.pop();
            }
            b' '..=b'~' => self.too_long |= self.text.push(byte as char).is_err(),
            _ => {}
        }
        self.complete
    }

    /// The line that is complete, until the next byte comes. One that was too long is a line that
    /// means nothing.
    pub fn line(&self) -> &str {
        if self.too_long { "!" } else { &self.text }
    }
}

/// Facts that only the transport and the linker know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Vitals {
    /// Bytes of stack ever used, and its size.
    pub stack: (u32, u32),
    /// Frames the MAC dropped: no free slot, a wrong preamble, a wrong CRC.
    pub mac_errors: [u32; 3],
}

/// Answers into `out`; what does not fit there is lost.
pub fn answer<B: Board>(
    ask: Ask,
    server: &mut Server,
    board: &mut B,
    us: &Us,
    vitals: &Vitals,
    out: &mut dyn Sink,
) {
    let mut out = Out(out);
    if ask == Ask::Restart {
        return restart(server, &mut out);
    }
    if let Ask::Login(answer) = ask {
        // A frame brought the line a short time ago.
        server.auth.stir(board.now_lo());
        return login(answer.as_ref(), server, &mut out);
    }
    match ask {
        Ask::Help => {
            for line in HELP {
                out.text(line).end();
            }
        }
        Ask::Status => status(server, board, vitals, &mut out),
        Ask::Net => net(server, us, vitals, &mut out),
        Ask::Regs(page) => regs(page, board, &mut out),
        Ask::Stepgen(only) => stepgen(only, server, board, &mut out),
        Ask::Encoder(only) => encoder(only, server, board, &mut out),
        Ask::Pwm(only) => pwm(only, server, board, &mut out),
        Ask::Gpio => gpio(board, &mut out),
        Ask::Watchdog => watchdog(server, board, &mut out),
        Ask::Log => log(server, board, &mut out),
        Ask::Link => link(server, vitals, &mut out),
        Ask::Flash => flash(server, &mut out),
        Ask::Settings => settings(server, us, &mut out),
        Ask::Job => out.text(NO_JOBS).end(),
        Ask::Quit => out.text("bye").end(),
        Ask::Nothing | Ask::Login(_) | Ask::Restart => {}
        Ask::Unknown => out.text("? try help").end(),
    }
}

/// Restarts, or says why not.
#[inline(never)]
fn restart(server: &mut Server, out: &mut Out) {
    let why = if !server.auth.trusted() {
        "refused: the board has a key; use `ferrocnc console`"
    } else if !server.safety().at_rest() {
        "refused: the machine is armed"
    } else if server.session().owner().is_some() {
        "refused: a host drives the board"
    } else if server.flash().busy() {
        "refused: a flash operation is running"
    } else {
        server.restart();
        "restarting"
    };
    out.text(why).end();
}

#[inline(never)]
fn login(answer: Option<&Words>, server: &mut Server, out: &mut Out) {
    let Some(answer) = answer else {
        let [a, b, c, d] = *server.auth.challenge(by_port(wire::CONSOLE_PORT));
        let [uid_hi, uid_lo] = server.flash().uid();
        out.text(CHALLENGE);
        for word in [a, b, c, d, uid_hi, uid_lo] {
            out.hex(word);
        }
        return out.text("").end();
    };
    let welcome = match server.auth.login(answer) {
        Ok(()) => WELCOME,
        Err(why) => {
            server.refuse(why);
            "refused: wrong answer"
        }
    };
    out.text(welcome).end();
}

fn status<B: Board>(server: &Server, board: &mut B, vitals: &Vitals, out: &mut Out) {
    let (ident, safety, gate) = (server.ident(), server.safety(), board.gate());
    out.text("state    ").text(safety.state().text());
    out.text(", reason ").text(safety.reason().text()).end();
    out.text("gate     ").either(gate.open(), "open", "closed");
    out.text(", positions ")
        .either(safety.position_trusted(), "trusted", "not trusted")
        .end();
    out.text("session  ");
    match server.session().owner() {
        Some(owner) => {
            out.address(owner.ip, owner.port)
                .text(", last sequence ")
                .number(server.session().last_sequence())
                .end();
        }
        None => out.text("free").end(),
    }
    let now = board.now();
    out.text("clock    ")
        .number(ident.clock_hz)
        .text(" Hz, now 0x");
    out.hex((now >> 32) as u32).hex(now as u32).end();
    out.text("abi      firmware ")
        .hex(server.abi())
        .text(", gateware ")
        .hex(ident.abi)
        .end();
    out.text("version  firmware ")
        .hex(crate::VERSION)
        .text(", gateware ")
        .hex(ident.version)
        .end();
    let (used, size) = vitals.stack;
    out.text("boot     ").hex(server.boot().id);
    out.text(", ").text(server.boot().reset.text()).end();
    out.text("stack    ")
        .number(used)
        .text(" of ")
        .number(size)
        .text(" bytes")
        .end();
}

fn net(server: &Server, us: &Us, vitals: &Vitals, out: &mut Out) {
    out.text("address ").address(us.ip, us.port).end();
    let counters = server.counters();
    out.text("frames in ")
        .number(counters.frames_rx)
        .text(", out ")
        .number(counters.frames_tx);
    out.text("; exchanges ").number(counters.exchanges);
    out.text("; refused ").number(counters.refused_total).end();
    mac_errors(vitals, out);
    for (why, count) in Refusal::ALL.iter().zip(counters.refused) {
        if count != 0 {
            out.text("  ").text(why.key()).text(" ").number(count).end();
        }
    }
}

fn mac_errors(vitals: &Vitals, out: &mut Out) {
    let [slots, preamble, crc] = vitals.mac_errors;
    out.text("mac: no slot ")
        .number(slots)
        .text(", preamble ")
        .number(preamble);
    out.text(", crc ").number(crc).end();
}

fn link(server: &Server, vitals: &Vitals, out: &mut Out) {
    let word = server.link().word();
    out.text("link ").text(word.speed.text());
    out.either(word.full_duplex, ", full duplex", "").end();
    mac_errors(vitals, out);
}

fn flash(server: &Server, out: &mut Out) {
    let flash = server.flash();
    let [uid_hi, uid_lo] = flash.uid();
    out.text("chip     ").hex(flash.jedec());
    out.text(", ")
        .number(flash.layout().map_or(0, |layout| layout.size >> 10))
        .text(" KiB, id ");
    out.hex(uid_hi).hex(uid_lo).end();
    out.text("runs     ").text(flash.running().text());
    out.text(", build ").hex(flash.build_id()).end();
    let selected = flash.selected().map_or("golden", |slot| slot.text());
    out.text("next     ").text(selected).end();
    out.text("golden   ")
        .either(flash.protected(), "protected", "not protected")
        .end();
    let word = flash.word();
    if let Some(op) = word.op {
        out.text("last     ").text(op.text()).text(": ");
        out.text(word.result.text()).end();
    }
}

fn settings(server: &Server, us: &Us, out: &mut Out) {
    let flash = server.flash();
    let settings = flash.settings();
    out.text("name     ").text(settings.name.text()).end();
    out.text("from     ").text(flash.origin().text()).end();
    out.text("address  ").address(us.ip, us.port);
    out.either(settings.dhcp, ", DHCP, else ", ", static ");
    out.address(settings.ip, settings.port).text(", /");
    out.number(settings.prefix.into()).end();
    out.text("gateway  ").address(settings.gateway, 0).end();
    let [hi, lo] = wire::settings::mac_to_words(us.mac);
    out.text("mac      ").hex(hi).text(" ").hex(lo).end();
    out.text("key      ")
        .either(server.auth.locked(), "set", "none")
        .end();
}

fn regs<B: Board>(page: Option<u8>, board: &mut B, out: &mut Out) {
    // 8 words identify a page, 32 fit a screen.
    let (pages, words) = match page {
        Some(page) => (u32::from(page)..u32::from(page) + 1, 32),
        None => (8..16, 8),
    };
    for page in pages {
        let base = map::SERVICE + page * CSR_PAGE as u32;
        if !crate::service::readable(base) {
            continue;
        }
        for word in 0..words {
            if word % 8 == 0 {
                out.hex(base + word * 4);
            }
            out.text(" ").hex(board.csr_read(base + word * 4));
            if word % 8 == 7 {
                out.end();
            }
        }
    }
}

fn chosen(only: Option<u8>, count: u8) -> core::ops::Range<u8> {
    match only {
        Some(n) if n < count => n..n + 1,
        Some(_) => 0..0,
        None => 0..count,
    }
}

fn stepgen<B: Board>(only: Option<u8>, server: &Server, board: &mut B, out: &mut Out) {
    for n in chosen(only, server.ident().channels.stepgens) {
        let at = status::STEPGEN0_POSITION_LO + status::STEPGEN_STRIDE * usize::from(n);
        // The upper word of a position counts pulses.
        let pulses = board.latched(at + 1) as i32;
        let velocity = board.latched(at + 2) as i32;
        // Steps/s in integers: a softcore has no `f64`.
        let hz = (i64::from(velocity) * i64::from(server.ident().clock_hz)) >> 32;
        out.number(n.into())
            .text(": ")
            .signed(pulses)
            .text(" steps, ");
        out.signed(hz as i32).text(" steps/s");
        if only.is_some() {
            let latch = board.latched(status::STEPGEN0_LATCH + usize::from(n));
            out.text(", latch ").signed(latch as i32);
            for (name, field) in [
                ("steplen", StepgenConfig::Steplen),
                ("stepspace", StepgenConfig::Stepspace),
                ("dirsetup", StepgenConfig::Dirsetup),
                ("dirhold", StepgenConfig::Dirhold),
                ("stop-accel", StepgenConfig::StopAccel),
                ("mode", StepgenConfig::Mode),
            ] {
                out.text("\r\n    ").text(name).text(" ");
                out.number(server.setting(board, Setting::Stepgen(n, field)));
            }
        }
        out.end();
    }
}

fn encoder<B: Board>(only: Option<u8>, server: &Server, board: &mut B, out: &mut Out) {
    for n in chosen(only, server.ident().channels.encoders) {
        let at = status::ENCODER0_COUNT + status::ENCODER_STRIDE * usize::from(n);
        let [count, edge] = [at, at + 1].map(|word| board.latched(word));
        let latch = board.latched(status::ENCODER0_LATCH + usize::from(n));
        out.number(n.into()).text(": ").signed(count as i32);
        out.text(", latch ").signed(latch as i32);
        out.text(", errors ").number(edge >> EDGE_TIME_BITS);
        out.text(", edge at 0x").hex(edge << 8 >> 8);
        if only.is_some() {
            out.text("\r\n    mode 0x")
                .hex(board.setting(Setting::EncoderMode(n)));
            out.text(", filter ")
                .number(board.setting(Setting::EncoderFilter(n)))
                .text(" clocks");
        }
        out.end();
    }
}

fn pwm<B: Board>(only: Option<u8>, server: &Server, board: &mut B, out: &mut Out) {
    for n in chosen(only, server.ident().channels.pwms) {
        out.number(n.into()).text(": period ");
        out.number(board.setting(Setting::PwmPeriod(n)));
        out.text(" clocks, mode 0x");
        out.hex(board.setting(Setting::PwmMode(n))).end();
    }
}

fn gpio<B: Board>(board: &mut B, out: &mut Out) {
    out.text("inputs 0x").hex(board.latched(status::GPIO_IN));
    out.text(", e-stop latched 0x")
        .hex(board.latched(status::ESTOP))
        .end();
    let probe = board.setting(Setting::Board(BoardConfig::Probe));
    out.text("probe ");
    if probe & map::PROBE_ENABLE == 0 {
        out.text("none").end();
    } else {
        out.text("input ").number(probe & map::PROBE_INPUT_MASK);
        out.either(probe & map::PROBE_INVERT != 0, ", active low", "")
            .end();
    }
}

fn watchdog<B: Board>(server: &Server, board: &mut B, out: &mut Out) {
    let gate = board.gate();
    let timeout = board.setting(Setting::Board(BoardConfig::WatchdogTimeout));
    let per_us = (server.ident().clock_hz / 1_000_000).max(1);
    out.either(gate.awake(), "awake", "asleep");
    out.either(gate.stopping(), ", stopping", "");
    out.either(gate.bitten(), ", has bitten", "").end();
    out.text("external reset ")
        .either(gate.reset_pin(), "high", "low");
    out.either(gate.reset(), ", latched", "").end();
    out.text("e-stop ")
        .either(gate.estop_pin(), "active", "idle");
    out.either(gate.estop(), ", latched", "").end();
    out.text("gate closed last: ")
        .text(last_close(board).text())
        .end();
    out.text("timeout ")
        .number(timeout / per_us)
        .text(" us, left ");
    out.number(board.watchdog_left() / per_us).text(" us").end();
}

fn log<B: Board>(server: &Server, board: &mut B, out: &mut Out) {
    let (head, size) = (board.log(log::Read::Head), board.log(log::Read::Size));
    out.number(head)
        .text(" bytes logged, the last ")
        .number(head.min(size));
    out.text(" kept; `ferrocnc log` decodes them").end();
    let length = board.panic(4).min(map::PANIC_TEXT_LEN);
    out.text("boot ").hex(server.boot().id);
    out.text(", deaths since power-up ")
        .number(board.panic(0))
        .end();
    for offset in (0..length).step_by(4) {
        let bytes = board
            .panic(map::PANIC_TEXT - map::PANIC + offset)
            .to_be_bytes();
        out.ascii(
            bytes
                .get(..(length - offset).min(4) as usize)
                .unwrap_or(&bytes),
        );
    }
    if length > 0 {
        out.end();
    }
}

#[cfg(test)]
mod tests;
