//! The executor as a client of its own board: the words a host would send, and what comes back.

use super::Outside;
use motion::segment::AXES;
use wire::describe::{self, Channels, Describe};
use wire::exchange::{
    COMMAND_MAX, Command, REQUEST_OVERHEAD, STATUS_HEAD, STATUS_STEPGEN, StateWord, Status,
};
use wire::jobs::Machine;
use wire::units::{Accel, StepRate};
use wire::{MAX_WORDS, Refusal, etherbone, map};

/// 100 ms: the executor exchanges every 5 ms, and a loop that hangs is no program.
const WATCHDOG_PER_SECOND: u32 = 10;
/// Step generators of a job.
const STEPGENS: u16 = (1 << AXES) - 1;

/// The client.
#[derive(Debug)]
pub struct Inside {
    channels: Channels,
    clock_hz: u32,
    token: u32,
    sequence: u32,
}

/// Rate and acceleration of each axis, where no segments are played.
pub type Rates = [(StepRate, Accel); AXES];

/// No rates.
pub const REST: Rates = [(StepRate(0), Accel(0)); AXES];

impl Inside {
    /// Asks the board who it is.
    pub fn new(out: &mut impl Outside) -> Option<(Inside, Describe)> {
        let mut reply = [0; MAX_WORDS];
        let mut request = [0; 4 + describe::WORDS];
        let (head, addresses) = request.split_at_mut(4);
        head.copy_from_slice(&[etherbone::HEADER, 0, record(0, describe::WORDS), 0]);
        for (word, address) in addresses.iter_mut().zip((map::DESCRIBE..).step_by(4)) {
            *word = address;
        }
        let length = out.datagram(&request, &mut reply);
        let words = reply.get(4..length)?.first_chunk()?;
        let board = Describe::parse(words).ok()?;
        let inside = Inside {
            channels: board.channels,
            clock_hz: board.clock_hz,
            token: 0,
            sequence: 0,
        };
        Some((inside, board))
    }

    /// One word; `None` when it was refused.
    fn read(&self, address: u32, out: &mut impl Outside) -> Option<u32> {
        let mut reply = [0; MAX_WORDS];
        let request = [etherbone::HEADER, 0, record(0, 1), 0, address];
        let length = out.datagram(&request, &mut reply);
        reply.get(..length)?.get(4).copied()
    }

    /// The board's state, to whoever looks.
    pub fn state(&self, out: &mut impl Outside) -> Option<StateWord> {
        let word = self.read(map::STATUS, out)?;
        StateWord::from_word(word).ok()
    }

    /// How the board is, and where the integrators were at its last sample: for whoever owns nothing.
    pub fn look(&self, out: &mut impl Outside) -> Option<(StateWord, [i64; AXES])> {
        const WORDS: usize = 1 + 2 * AXES;
        let mut reply = [0; MAX_WORDS];
        let mut request = [0; 4 + WORDS];
        let (head, addresses) = request.split_at_mut(4);
        head.copy_from_slice(&[etherbone::HEADER, 0, record(0, WORDS), 0]);
        for (n, address) in addresses.iter_mut().enumerate() {
            let word = match n.checked_sub(1) {
                None => 0,
                Some(n) => STATUS_HEAD + n / 2 * STATUS_STEPGEN + n % 2,
            };
            *address = map::STATUS + 4 * word as u32;
        }
        let length = out.datagram(&request, &mut reply);
        let words: &[u32; WORDS] = reply.get(4..length)?.first_chunk()?;
        let [state, positions @ ..] = words;
        let mut places = [0; AXES];
        for (place, [low, high]) in places.iter_mut().zip(positions.as_chunks().0) {
            *place = (u64::from(*high) << 32 | u64::from(*low)) as i64;
        }
        Some((StateWord::from_word(*state).ok()?, places))
    }

    /// Takes the session. False: somebody else has it.
    #[must_use]
    pub fn acquire(&mut self, out: &mut impl Outside) -> bool {
        let nonce = (out.now() as u32) | 1;
        let mut reply = [0; MAX_WORDS];
        let request = [
            etherbone::HEADER,
            0,
            record(1, 1),
            map::SESSION_ACQUIRE,
            nonce,
            0,
            map::SESSION_TOKEN,
        ];
        let length = out.datagram(&request, &mut reply);
        self.sequence = 0;
        self.token = reply
            .get(..length)
            .and_then(|reply| reply.get(4))
            .copied()
            .unwrap_or(0);
        self.token != 0
    }

    /// Proves somebody else's key: takes the session with the answer he gave, and gives it back.
    #[must_use]
    pub fn prove(&mut self, nonce: u32, answer: [u32; 4], out: &mut impl Outside) -> bool {
        let mut reply = [0; MAX_WORDS];
        let [a, b, c, d] = answer;
        let request = [
            etherbone::HEADER,
            0,
            record(4, 0),
            map::SESSION_RESPONSE,
            a,
            b,
            c,
            d,
            record(1, 1),
            map::SESSION_ACQUIRE,
            nonce,
            0,
            map::SESSION_TOKEN,
        ];
        let length = out.datagram(&request, &mut reply);
        self.token = reply
            .get(..length)
            .and_then(|reply| reply.get(4))
            .copied()
            .unwrap_or(0);
        let proven = self.token != 0;
        self.release(out);
        proven
    }

    /// What has to be answered for [`Inside::prove`].
    pub fn challenge(&self, out: &mut impl Outside) -> [u32; 4] {
        ::core::array::from_fn(|n| {
            self.read(map::SESSION_CHALLENGE + 4 * n as u32, out)
                .unwrap_or(0)
        })
    }

    /// Somebody else has the session.
    pub fn owned(&self, out: &mut impl Outside) -> bool {
        self.token == 0
            && (self.read(map::SESSION_OWNER_IP, out) != Some(0)
                || self.read(map::SESSION_OWNER_PORT, out) != Some(0))
    }

    /// Gives the session back.
    pub fn release(&mut self, out: &mut impl Outside) {
        let mut reply = [0; MAX_WORDS];
        let token = ::core::mem::take(&mut self.token);
        if token != 0 {
            let request = [
                etherbone::HEADER,
                0,
                record(1, 0),
                map::SESSION_RELEASE,
                token,
            ];
            out.datagram(&request, &mut reply);
        }
    }

    /// Makes the board this machine. It has to be disarmed, and the session ours.
    pub fn configure(&self, machine: &Machine, stop: &[u32; AXES], out: &mut impl Outside) {
        let mut reply = [0; MAX_WORDS];
        for ((n, axis), stop) in (0..).zip(&machine.axes).zip(stop) {
            let [steplen, stepspace, dirsetup, dirhold] = axis.timings(self.clock_hz);
            let invert = |set: bool, bit: u32| if set { bit } else { 0 };
            let mode = invert(axis.step_invert, map::STEPGEN_STEP_INVERT)
                | invert(axis.dir_invert, map::STEPGEN_DIR_INVERT);
            let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
            let request = [
                etherbone::HEADER,
                0,
                record(6, 0),
                base,
                steplen,
                stepspace,
                dirsetup,
                dirhold,
                *stop,
                mode,
            ];
            out.datagram(&request, &mut reply);
            if let Some(home) = axis.home {
                let looks = u64::from(home.debounce) * u64::from(self.clock_hz)
                    / (1_000_000 * u64::from(map::DEBOUNCE_CLOCKS));
                let looks = looks.min(map::DEBOUNCE_MAX.into()) as u32;
                let at = map::CONFIG_DEBOUNCE + 4 * u32::from(home.input);
                out.datagram(&[etherbone::HEADER, 0, record(1, 0), at, looks], &mut reply);
            }
        }
        let request = [
            etherbone::HEADER,
            0,
            record(1, 0),
            map::CONFIG_BOARD,
            self.clock_hz / WATCHDOG_PER_SECOND,
            record(2, 0),
            map::CONFIG_BOARD + 8,
            machine.safe,
            machine.invert,
        ];
        out.datagram(&request, &mut reply);
    }

    /// The exchange. `None`: refused, so the session is somebody else's or nobody's.
    pub fn exchange(
        &mut self,
        enable: bool,
        request: bool,
        rates: &Rates,
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
        for (place, rate) in command.stepgen.iter_mut().zip(rates) {
            *place = *rate;
        }
        let mut words = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let request = command.emit_request(self.channels, &mut words)?;
        let mut reply = [0; MAX_WORDS];
        let length = out.datagram(request, &mut reply);
        let answer: Result<Status, Refusal> =
            Status::parse_reply(reply.get(..length)?, self.channels);
        answer.ok()
    }
}

/// A record's header: so many words to write, so many to read.
const fn record(writes: u32, reads: usize) -> u32 {
    etherbone::BYTE_ENABLE | writes << 8 | reads as u32
}
