//! Parameters on their way to the board's config window, and the proof that they arrived.
//!
//! All settings that the board refuses to change while armed go in one datagram, which the board
//! executes whole or not at all. Its last record reads a word back; that answer is the receipt. PWM
//! periods may change while armed and have a datagram of their own.

use wire::describe::Channels;
use wire::exchange::MAX_CHANNELS;
use wire::{Request, map};

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
