//! Parameters on their way to the board's config window, and the proof that they arrived.
//!
//! All settings that the board refuses to change while armed go in one datagram, which the board
//! executes whole or not at all. Its last record reads a word back; that answer is the receipt. PWM
//! periods may change while armed and have a datagram of their own. So does a [`Change`] of the few
//! others that may: a shorter timeout of the watchdog, and the times of an axis that rests.

use wire::describe::Channels;
use wire::exchange::MAX_CHANNELS;
use wire::{Request, map};

/// Up to 1280 periods between two tries of a change that the board refuses.
const MOST_DOUBLINGS: u32 = 6;

/// The four times come first among the words of a step generator.
const TIMES: usize = map::StepgenConfig::Dirhold as usize + 1;

/// Periods between two tries. A receipt takes one; a refused datagram is never answered.
const RETRY_PERIODS: u32 = 20;

/// Values that go to the config window together.
pub trait Group: Copy + PartialEq {
    /// Appends the records that write them.
    fn emit<'w>(&self, channels: Channels, request: Request<'w>) -> Request<'w>;
}

/// What may only change while the machine is disarmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disarmed {
    /// Per stepgen, in register order.
    pub stepgen: [[u32; map::STEPGEN_CONFIG_WORDS as usize]; MAX_CHANNELS],
    /// Per encoder.
    pub encoder: [[u32; map::ENCODER_CONFIG_WORDS as usize]; MAX_CHANNELS],
    /// Per PWM: its mode.
    pub pwm_mode: [u32; MAX_CHANNELS],
    /// Watchdog timeout and grace.
    pub watchdog: [u32; 2],
    /// Which outputs are high while the gate is closed, before inversion.
    pub gpio_safe: u64,
    /// Which outputs are inverted.
    pub gpio_invert: u64,
    /// As [`map::BoardConfig::Probe`] takes it.
    pub probe: u32,
    /// Per input.
    pub debounce: [u32; INPUTS],
}

/// Most inputs a board can have.
pub const INPUTS: usize = wire::regmap::IN_MAX;

impl Default for Disarmed {
    fn default() -> Self {
        Disarmed {
            stepgen: [[0; map::STEPGEN_CONFIG_WORDS as usize]; MAX_CHANNELS],
            encoder: [[0; map::ENCODER_CONFIG_WORDS as usize]; MAX_CHANNELS],
            pwm_mode: [0; MAX_CHANNELS],
            watchdog: [0; 2],
            gpio_safe: 0,
            gpio_invert: 0,
            probe: 0,
            debounce: [0; INPUTS],
        }
    }
}

impl Group for Disarmed {
    fn emit<'w>(&self, channels: Channels, request: Request<'w>) -> Request<'w> {
        let at = |window: u32, channel: usize| window + channel as u32 * map::CONFIG_STRIDE;
        let mut request = request;
        for (n, words) in self.stepgen[..channels.stepgens.into()].iter().enumerate() {
            request = request.write(at(map::CONFIG_STEPGEN, n), words);
        }
        for (n, words) in self.encoder[..channels.encoders.into()].iter().enumerate() {
            request = request.write(at(map::CONFIG_ENCODER, n), words);
        }
        for (n, word) in self.pwm_mode[..channels.pwms.into()].iter().enumerate() {
            request = request.write(at(map::CONFIG_PWM, n) + 4, &[*word]);
        }
        let high = [self.gpio_safe, self.gpio_invert].map(|mask| (mask >> u32::BITS) as u32);
        request
            .write(map::CONFIG_BOARD, &self.watchdog)
            .write(
                map::CONFIG_BOARD + 4 * map::BoardConfig::GpioSafe as u32,
                &[self.gpio_safe as u32, self.gpio_invert as u32, self.probe],
            )
            .write(
                map::CONFIG_BOARD + 4 * map::BoardConfig::GpioSafeHigh as u32,
                &high[..high.len() * channels.outputs_high()],
            )
            .write(
                map::CONFIG_DEBOUNCE,
                &self.debounce[..channels.inputs.into()],
            )
    }
}

/// PWM periods.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Periods(pub [u32; MAX_CHANNELS]);

impl Group for Periods {
    fn emit<'w>(&self, channels: Channels, request: Request<'w>) -> Request<'w> {
        let words = self.0[..channels.pwms.into()].iter().enumerate();
        words.fold(request, |request, (n, word)| {
            request.write(map::CONFIG_PWM + n as u32 * map::CONFIG_STRIDE, &[*word])
        })
    }
}

/// What may change while the machine is armed, under a condition that the board checks, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The watchdog's timeout, to less than it is.
    Timeout(u32),
    /// The times of a step generator that rests, in register order.
    Times(u8, [u32; TIMES]),
}

impl Change {
    /// The next one after `last` that leads from what the board `has` to what is `wanted`. `rests`
    /// has a bit for each step generator that has rested for long enough.
    fn next(last: u8, has: &Disarmed, wanted: &Disarmed, rests: u16) -> Option<Change> {
        let timeout = wanted.watchdog[0];
        if timeout < has.watchdog[0] {
            return Some(Change::Timeout(timeout));
        }
        // One that is refused again and again does not keep the others waiting.
        let after = (1..=MAX_CHANNELS).map(|n| (usize::from(last) + n) % MAX_CHANNELS);
        let mut times = after.filter_map(|n| {
            let [has, wanted] = [has, wanted].map(|all| all.stepgen[n].first_chunk());
            let differ = has != wanted && rests >> n & 1 != 0;
            wanted.filter(|_| differ).map(|times| (n as u8, *times))
        });
        times.next().map(|(n, times)| Change::Times(n, times))
    }

    /// The board has it.
    fn apply(self, has: &mut Disarmed) {
        match self {
            Change::Timeout(timeout) => has.watchdog[0] = timeout,
            Change::Times(n, times) => {
                has.stepgen[usize::from(n)][..TIMES].copy_from_slice(&times);
            }
        }
    }

    fn emit<'w>(&self, request: Request<'w>) -> Request<'w> {
        match self {
            Change::Timeout(timeout) => request.write(map::CONFIG_BOARD, &[*timeout]),
            Change::Times(n, times) => {
                let at = map::CONFIG_STEPGEN + u32::from(*n) * map::CONFIG_STRIDE;
                request.write(at, times)
            }
        }
    }
}

/// The changes of an armed machine, one on its way at a time. The board refuses one whose axis has
/// begun to move meanwhile; it is tried again later, and less and less often: a board of an earlier
/// release refuses all of them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Changes {
    in_flight: Option<(u32, Change)>,
    age: u32,
    /// Tries in a row without a receipt.
    tries: u32,
    /// The step generator that was tried last.
    last: u8,
}

impl Changes {
    /// Whether a datagram is due, and if so puts it into `words`.
    pub fn due<'w>(
        &mut self,
        has: &Disarmed,
        wanted: &Disarmed,
        rests: u16,
        tag: u32,
        words: &'w mut [u32],
    ) -> Option<&'w [u32]> {
        if self.in_flight.is_some() {
            self.age += 1;
            if self.age < RETRY_PERIODS << self.tries.min(MOST_DOUBLINGS) {
                return None;
            }
            self.tries = self.tries.saturating_add(1);
        }
        self.in_flight = None;
        let change = Change::next(self.last, has, wanted, rests)?;
        if let Change::Times(n, _) = change {
            self.last = n;
        }
        self.in_flight = Some((tag, change));
        self.age = 0;
        let request = change.emit(Request::new(words));
        request.read(tag, &[map::SESSION_LAST_SEQ]).words()
    }

    /// A receipt came: the change that it was for, if it was for one.
    pub fn receipt(&mut self, tag: u32) -> Option<Change> {
        let (_, change) = self.in_flight.take_if(|(expected, _)| *expected == tag)?;
        self.tries = 0;
        Some(change)
    }

    /// A new session.
    pub fn forget(&mut self) {
        *self = Changes::default();
    }
}

impl Sync<Disarmed> {
    /// The board has executed this change, too.
    pub fn changed(&mut self, change: Change) {
        if let Some(has) = &mut self.arrived {
            change.apply(has);
        }
    }
}

/// One group on its way.
#[derive(Clone, Copy, Debug)]
pub struct Sync<G> {
    arrived: Option<G>,
    in_flight: Option<(u32, G)>,
    age: u32,
    tries: u32,
}

impl<G> Default for Sync<G> {
    fn default() -> Self {
        Sync {
            arrived: None,
            in_flight: None,
            age: 0,
            tries: 0,
        }
    }
}

impl<G: Group> Sync<G> {
    /// The board has exactly this.
    pub fn settled(&self, wanted: &G) -> bool {
        self.arrived.as_ref() == Some(wanted)
    }

    /// What the board is known to have.
    pub fn arrived(&self) -> Option<&G> {
        self.arrived.as_ref()
    }

    /// Whether this period's datagram is due, and if so puts it into `words`.
    pub fn due<'w>(
        &mut self,
        wanted: &G,
        channels: Channels,
        tag: u32,
        words: &'w mut [u32],
    ) -> Option<&'w [u32]> {
        if self.settled(wanted) {
            return None;
        }
        if self.in_flight.is_some() {
            self.age += 1;
            if self.age < RETRY_PERIODS {
                return None;
            }
        }
        let request = wanted.emit(channels, Request::new(words));
        let request = request.read(tag, &[map::SESSION_LAST_SEQ]).words();
        debug_assert!(request.is_some(), "settings beyond one frame");
        self.in_flight = Some((tag, *wanted));
        self.age = 0;
        self.tries = self.tries.saturating_add(1);
        request
    }

    /// A receipt came; `true` if it was for this group.
    pub fn receipt(&mut self, tag: u32) -> bool {
        match self.in_flight {
            Some((expected, group)) if expected == tag => {
                self.arrived = Some(group);
                self.in_flight = None;
                self.tries = 0;
                true
            }
            Some(_) | None => false,
        }
    }

    /// How often this was tried without a receipt.
    pub fn tries(&self) -> u32 {
        self.tries
    }

    /// A new session: what the board has, is not known.
    pub fn forget(&mut self) {
        *self = Sync::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::{MAX_WORDS, Packet};

    const MOST: Channels = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        inputs: 64,
        outputs: 64,
    };

    #[test]
    fn the_largest_board_is_configured_in_one_datagram() {
        let mut words = [0; MAX_WORDS];
        let request = Sync::default()
            .due(&Disarmed::default(), MOST, 7, &mut words)
            .unwrap();
        let packet = Packet::new_checked(request).unwrap();
        let written: usize = packet.records().map(|record| record.writes.len()).sum();
        assert_eq!(written, 16 * 6 + 16 * 2 + 16 + 7 + 64);
        assert_eq!(packet.records().last().unwrap().return_base, 7);
    }

    #[test]
    fn what_got_no_receipt_is_sent_again_and_what_got_one_is_not() {
        let mut words = [0; MAX_WORDS];
        let (mut sync, wanted) = (Sync::default(), Periods([1; MAX_CHANNELS]));
        assert!(sync.due(&wanted, MOST, 1, &mut words).is_some());
        for _ in 1..RETRY_PERIODS {
            assert!(sync.due(&wanted, MOST, 2, &mut words).is_none());
        }
        assert!(sync.due(&wanted, MOST, 3, &mut words).is_some());
        assert!(!sync.receipt(1));
        assert!(sync.receipt(3) && sync.settled(&wanted));
        assert!(sync.due(&wanted, MOST, 4, &mut words).is_none());
    }

    fn sent(words: &[u32]) -> Vec<(u32, Vec<u32>)> {
        let packet = Packet::new_checked(words).unwrap();
        let writes = packet.records().filter(|record| !record.writes.is_empty());
        writes
            .map(|record| (record.write_base, record.writes.to_vec()))
            .collect()
    }

    #[test]
    fn of_an_armed_machine_the_timeout_shrinks_and_an_axis_at_rest_gets_its_times() {
        let mut words = [0; MAX_WORDS];
        let has = Disarmed {
            watchdog: [100, 500],
            ..Disarmed::default()
        };
        let mut wanted = has;
        wanted.watchdog = [101, 7];
        wanted.stepgen[2] = [1, 2, 3, 4, 5, 6];
        let mut changes = Changes::default();
        // No longer timeout, no other grace, and nothing of an axis that moves.
        assert!(changes.due(&has, &wanted, 0b1011, 1, &mut words).is_none());
        let due = changes.due(&has, &wanted, 0b100, 2, &mut words).unwrap();
        let at = map::CONFIG_STEPGEN + 2 * map::CONFIG_STRIDE;
        assert_eq!(sent(due), [(at, vec![1, 2, 3, 4])]);
        // The timeout waits for no axis, but for what is under way.
        wanted.watchdog[0] = 99;
        assert!(changes.due(&has, &wanted, 0, 3, &mut words).is_none());
        assert_eq!(changes.receipt(3), None);
        let change = changes.receipt(2).unwrap();
        let mut sync = Sync {
            arrived: Some(has),
            ..Sync::default()
        };
        sync.changed(change);
        let has = *sync.arrived().unwrap();
        assert_eq!(has.stepgen[2], [1, 2, 3, 4, 0, 0]);
        let due = changes.due(&has, &wanted, 0, 4, &mut words).unwrap();
        assert_eq!(sent(due), [(map::CONFIG_BOARD, vec![99])]);
    }

    #[test]
    fn an_axis_that_is_refused_its_times_is_asked_again_after_the_others() {
        let mut words = [0; MAX_WORDS];
        let has = Disarmed::default();
        let mut wanted = has;
        for n in [1, 15] {
            wanted.stepgen[n][0] = 9;
        }
        let mut changes = Changes::default();
        let mut asked = Vec::new();
        for tag in 0..4 * RETRY_PERIODS {
            if let Some(due) = changes.due(&has, &wanted, u16::MAX, tag, &mut words) {
                asked.push((sent(due)[0].0 - map::CONFIG_STEPGEN) / map::CONFIG_STRIDE);
            }
        }
        assert_eq!(asked, [1, 15, 1]);
    }

    #[test]
    fn a_change_under_way_is_sent_after_the_receipt_for_what_was_before() {
        let mut words = [0; MAX_WORDS];
        let mut sync = Sync::default();
        let _ = sync.due(&Periods([1; MAX_CHANNELS]), MOST, 1, &mut words);
        sync.receipt(1);
        let changed = Periods([2; MAX_CHANNELS]);
        assert!(sync.due(&changed, MOST, 2, &mut words).is_some());
        assert!(!sync.settled(&changed));
    }
}
