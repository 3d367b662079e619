//! The executor as a client of its own board: it sends the same words as a host, and reads the
//! answers.

use crate::Outside;
use motion::segment::AXES;
use wire::describe::{self, Channels, Describe};
use wire::etherbone::{OVERHEAD, Request};
use wire::exchange::{
    COMMAND_MAX, Command, REQUEST_OVERHEAD, STATUS_HEAD, STATUS_MAX, STATUS_STEPGEN, StateWord,
    Status, status_word,
};
use wire::jobs::MachineConfig;
use wire::refusal::COUNTERS_CUTS;
use wire::units::{Accel, Velocity};
use wire::{Refusal, map};

/// 100 ms: the executor exchanges every 5 ms, and a loop that takes longer hangs.
const WATCHDOG_PER_SECOND: u32 = 10;
/// Largest number of settings in one write.
const SETTINGS: usize = 6;
/// Step generators of a job.
const STEPGENS: u16 = (1 << AXES) - 1;

/// Gives a request to the board's own server: the words that it reads. `None`: it was refused, or
/// does not fit.
pub fn ask<const N: usize>(
    request: Request<'_>,
    reply: &mut [u32],
    out: &mut impl Outside,
) -> Option<[u32; N]> {
    let length = out.ask(request.words()?, reply);
    reply.get(..length)?.get(OVERHEAD..)?.first_chunk().copied()
}

/// The client.
#[derive(Debug)]
pub struct Inside {
    channels: Channels,
    clock_hz: u32,
    token: u32,
    sequence: u32,
}

/// How the board is.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Its state.
    pub state: StateWord,
    /// How often pulses may have been cut off since the board's start, in any session.
    pub cuts: u32,
    /// Where the integrators were at its last sample.
    pub positions: [i64; AXES],
}

/// Velocity and acceleration of each axis, for motion without segments.
pub type Velocities = [(Velocity, Accel); AXES];

/// No velocities.
pub const REST: Velocities = [(Velocity(0), Accel(0)); AXES];

impl Inside {
    /// Asks the board for its description.
    pub fn new(out: &mut impl Outside) -> Option<(Inside, Describe)> {
        const WORDS: usize = describe::WORDS;
        let (mut request, mut reply) = ([0; OVERHEAD + WORDS], [0; OVERHEAD + WORDS]);
        let addresses: [u32; WORDS] = core::array::from_fn(describe::address);
        let request = Request::new(&mut request).read(0, &addresses);
        let board = Describe::parse(&ask(request, &mut reply, out)?).ok()?;
        let inside = Inside {
            channels: board.channels,
            clock_hz: board.clock_hz,
            token: 0,
            sequence: 0,
        };
        Some((inside, board))
    }

    /// Reads one word; `None` if it was refused.
    fn read(&self, address: u32, out: &mut impl Outside) -> Option<u32> {
        let (mut request, mut reply) = ([0; OVERHEAD + 1], [0; OVERHEAD + 1]);
        let request = Request::new(&mut request).read(0, &[address]);
        let [word] = ask(request, &mut reply, out)?;
        Some(word)
    }

    /// The board's state; it needs no session.
    pub fn state(&self, out: &mut impl Outside) -> Option<StateWord> {
        let word = self.read(map::STATUS, out)?;
        StateWord::from_word(word).ok()
    }

    /// How often pulses may have been cut off since the board's start, in any session.
    pub fn cuts(&self, out: &mut impl Outside) -> Option<u32> {
        self.read(COUNTERS_CUTS, out)
    }

    /// What a client sees that owns nothing, in one datagram.
    pub fn look(&self, out: &mut impl Outside) -> Option<Look> {
        const WORDS: usize = 2 + 2 * AXES;
        let (mut request, mut reply) = ([0; OVERHEAD + WORDS], [0; OVERHEAD + WORDS]);
        let word = |word: usize| map::STATUS + 4 * word as u32;
        let addresses: [u32; WORDS] = core::array::from_fn(|n| match n.checked_sub(2) {
            None if n == 0 => word(status_word::STATE),
            None => COUNTERS_CUTS,
            Some(n) => word(STATUS_HEAD + n / 2 * STATUS_STEPGEN + n % 2),
        });
        let request = Request::new(&mut request).read(0, &addresses);
        let words: [u32; WORDS] = ask(request, &mut reply, out)?;
        let [state, cuts, positions @ ..] = &words;
        let mut places = [0; AXES];
        for (place, [low, high]) in places.iter_mut().zip(positions.as_chunks().0) {
            *place = (u64::from(*high) << 32 | u64::from(*low)) as i64;
        }
        Some(Look {
            state: StateWord::from_word(*state).ok()?,
            cuts: *cuts,
            positions: places,
        })
    }

    /// Takes the session. False: another client has it.
    #[must_use]
    pub fn acquire(&mut self, out: &mut impl Outside) -> bool {
        let nonce = (out.now() as u32) | 1;
        self.sequence = 0;
        self.token = token(Request::new(&mut [0; OVERHEAD + 3]), nonce, out);
        self.token != 0
    }

    /// Checks another client's proof of the key: takes the session with that answer, and releases
    /// it.
    #[must_use]
    pub fn prove(&mut self, nonce: u32, answer: [u32; 4], out: &mut impl Outside) -> bool {
        let mut words = [0; OVERHEAD + 4 + 5];
        let request = Request::new(&mut words).write(map::SESSION_RESPONSE, &answer);
        self.token = token(request, nonce, out);
        let proven = self.token != 0;
        self.release(out);
        proven
    }

    /// The challenge to be answered for [`Inside::prove`].
    pub fn challenge(&self, out: &mut impl Outside) -> [u32; 4] {
        core::array::from_fn(|n| {
            self.read(map::SESSION_CHALLENGE + 4 * n as u32, out)
                .unwrap_or(0)
        })
    }

    /// Does another client have the session?
    pub fn owned(&self, out: &mut impl Outside) -> bool {
        self.token == 0
            && (self.read(map::SESSION_OWNER_IP, out) != Some(0)
                || self.read(map::SESSION_OWNER_PORT, out) != Some(0))
    }

    /// Gives the session back.
    pub fn release(&mut self, out: &mut impl Outside) {
        let token = core::mem::take(&mut self.token);
        if token != 0 {
            let mut words = [0; OVERHEAD + 1];
            let request = Request::new(&mut words).write(map::SESSION_RELEASE, &[token]);
            // It has no answer.
            let _: Option<[u32; 0]> = ask(request, &mut [], out);
        }
    }

    /// Configures the board for this machine, whatever the last session left. The board has to be
    /// disarmed, and the session ours. False: the board is not configured, and must not be armed.
    ///
    /// All settings that an axis of a job depends on are written: timings, deceleration, kind and
    /// polarity, the switches' inputs, the watchdog's timeout and grace, the outputs. Everything
    /// else ended with the last session: the firmware commits zeros and discards a timed command
    /// before it takes the first word. Nothing is restored after a job, because the next session
    /// configures the board, too.
    #[must_use]
    pub fn configure(
        &self,
        machine: &MachineConfig,
        stop: &[u32; AXES],
        out: &mut impl Outside,
    ) -> bool {
        let mut taken = true;
        for ((n, axis), stop) in (0..).zip(&machine.axes).zip(stop) {
            let [steplen, stepspace, dirsetup, dirhold] = axis.timings(self.clock_hz);
            let invert = |set: bool, bit: u32| if set { bit } else { 0 };
            let mode = invert(axis.step_invert, map::STEPGEN_STEP_INVERT)
                | invert(axis.dir_invert, map::STEPGEN_DIR_INVERT);
            let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
            let words = [steplen, stepspace, dirsetup, dirhold, *stop, mode];
            taken &= set(base, words, out);
            if let Some(home) = axis.home {
                let looks = u64::from(home.debounce) * u64::from(self.clock_hz)
                    / (1_000_000 * u64::from(map::DEBOUNCE_CLOCKS));
                let looks = looks.min(map::DEBOUNCE_MAX.into()) as u32;
                let at = map::CONFIG_DEBOUNCE + 4 * u32::from(home.input);
                taken &= set(at, [looks], out);
            }
        }
        let timeout = self.clock_hz / WATCHDOG_PER_SECOND;
        let grace = machine.grace(self.clock_hz);
        let board = [timeout, grace, machine.safe, machine.invert];
        taken && set(map::CONFIG_BOARD, board, out)
    }

    /// The exchange. `None`: it was refused, so the session has another owner or none.
    pub fn exchange(
        &mut self,
        enable: bool,
        request: bool,
        velocities: &Velocities,
        out: &mut impl Outside,
    ) -> Option<Status> {
        self.sequence = self.sequence.wrapping_add(1);
        let mut command = Command {
            token: self.token,
            sequence: self.sequence,
            enable,
            enable_request: request,
            stepgen_enable: if enable { STEPGENS } else { 0 },
            ..Command::default()
        };
        for (place, velocity) in command.stepgen.iter_mut().zip(velocities) {
            *place = *velocity;
        }
        let mut words = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let request = command.emit_request(self.channels, &mut words)?;
        let mut reply = [0; REQUEST_OVERHEAD + STATUS_MAX];
        let length = out.ask(request, &mut reply);
        let answer: Result<Status, Refusal> =
            Status::parse_reply(reply.get(..length)?, self.channels);
        answer.ok()
    }
}

/// Acquires the session with what is in the request already: its token, 0 if another client has it.
fn token(request: Request<'_>, nonce: u32, out: &mut impl Outside) -> u32 {
    let reads = [map::SESSION_TOKEN];
    let request = request.write_then_read(map::SESSION_ACQUIRE, &[nonce], 0, &reads);
    let token = ask(request, &mut [0; OVERHEAD + 1], out);
    token.map_or(0, |[token]| token)
}

/// Writes adjacent settings, and reads them back. False: the board does not have them.
fn set<const N: usize>(base: u32, words: [u32; N], out: &mut impl Outside) -> bool {
    // The record's words, the answer's base, and the addresses.
    let mut request = [0; OVERHEAD + SETTINGS + 1 + SETTINGS];
    let addresses: [u32; N] = core::array::from_fn(|n| base + 4 * n as u32);
    let request = Request::new(&mut request).write_then_read(base, &words, 0, &addresses);
    ask(request, &mut [0; OVERHEAD + SETTINGS], out) == Some(words)
}
