//! `pwm.<nn>`: a value in, a duty cycle out; pins and arithmetic of LinuxCNC's `pwmgen`.
//!
//! | pin | | |
//! |---|---|---|
//! | `value` | float in | `value / scale + offset` is the commanded duty cycle |
//! | `enable` | bit in | false: duty 0, output inactive |
//! | `scale`, `offset` | float io | 1, 0 |
//! | `pwm-freq` | float io | Hz, 1000; takes effect at once. With PDM: bits per second |
//! | `min-dc`, `max-dc` | float io | 0, 1: the duty's magnitude is kept between them while enabled |
//! | `curr-dc` | float out | the duty given |
//! | `curr-pwm-freq` | float out | Hz: the frequency given, a whole number of clocks |
//! | `curr-period`, `curr-width` | u32 out | the same in clocks; with PDM the width is 1/65536 |
//! | `direction` | bit out | the duty is negative |
//!
//! | parameter | | |
//! |---|---|---|
//! | `output-type` | u32 | the board file's `type` until HAL sets it; hostmot2's numbers: 1 PWM and direction, 2 up/down, 3 PDM and direction, 4 direction and PWM |
//! | `dither` | bit | spread 1/256 clocks over periods; the average is exact over 256 of them |
//! | `invert-output` | bit | active low |
//!
//! Parameters are taken over while disarmed. A channel with a direction pin shows the sign of the
//! duty there. A channel without one has duty 0 for a negative value, and its types 2 and 4 act as
//! type 1.

use crate::hal::checked::{Checked, Rule};
use crate::hal::{ExportError, Exporter, In, Out, Param};
use wire::exchange::{PWM_DIRECTION, PWM_ENABLE, PWM_FRACTION, PWM_PERIOD_MAX, PWM_WIDTH_MASK};
use wire::map::{PWM_DITHER, PWM_INVERT, PWM_SWAP, PWM_TYPE_SHIFT, PwmType};

/// A PDM density of 1, in the unit of a PWM's width.
const PDM_FULL: f64 = 65_536.0 * (1u32 << PWM_FRACTION) as f64;

/// hostmot2's numbers.
const OUTPUT_TYPES: Rule = Rule::Whole(1, 4);

/// One PWM.
#[derive(Debug)]
pub struct Pwm {
    value: Checked<f64>,
    enable: In<bool>,
    scale: Checked<f64>,
    offset: Checked<f64>,
    frequency: Checked<f64>,
    min_dc: Checked<f64>,
    max_dc: Checked<f64>,
    curr_dc: Out<f64>,
    curr_frequency: Out<f64>,
    curr_period: Out<u32>,
    curr_width: Out<u32>,
    direction: Out<bool>,
    output_type: Checked<u32>,
    dither: Param<bool>,
    invert: Param<bool>,
    has_direction: bool,
    /// As the board has them: while it is armed a changed parameter waits.
    kind: (PwmType, bool),
    dithers: bool,
}

impl Pwm {
    /// Exports the pins; `kind` is what the board file says it is.
    pub fn export(
        hal: &mut Exporter<'_>,
        has_direction: bool,
        kind: PwmType,
    ) -> Result<Self, ExportError> {
        Ok(Pwm {
            value: hal.command("value")?,
            enable: hal.input("enable")?,
            scale: hal.setting_pin("scale", 1.0, Rule::Divisor)?,
            offset: hal.setting_pin("offset", 0.0, Rule::Number)?,
            frequency: hal.setting_pin("pwm-freq", 1000.0, Rule::Positive)?,
            min_dc: hal.setting_pin("min-dc", 0.0, Rule::NotNegative)?,
            max_dc: hal.setting_pin("max-dc", 1.0, Rule::NotNegative)?,
            curr_dc: hal.output("curr-dc")?,
            curr_frequency: hal.output("curr-pwm-freq")?,
            curr_period: hal.output("curr-period")?,
            curr_width: hal.output("curr-width")?,
            direction: hal.output("direction")?,
            output_type: hal.setting("output-type", number(kind), OUTPUT_TYPES)?,
            dither: hal.param("dither", false)?,
            invert: hal.param("invert-output", false)?,
            has_direction,
            kind: (PwmType::Pwm, false),
            dithers: false,
        })
    }

    /// The mode register; to be asked while the board will take it.
    pub fn configure(&mut self) -> u32 {
        self.kind = self.wanted_kind();
        self.dithers = self.dither.get();
        let (kind, swap) = self.kind;
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        bit(self.invert.get(), PWM_INVERT)
            | (kind as u32) << PWM_TYPE_SHIFT
            | bit(self.dithers, PWM_DITHER)
            | bit(swap, PWM_SWAP)
    }

    /// The period register, in clocks.
    pub fn period(&self, clock_hz: f64) -> u32 {
        // `as` saturates. Faster than the clock is 0 clocks, which is the slowest rather than the
        // fastest.
        let clocks = (clock_hz / self.frequency.get()).round() as u32;
        match (clocks, self.kind.0) {
            (0, _) => PWM_PERIOD_MAX,
            (_, PwmType::Pdm) => clocks.min(PWM_PERIOD_MAX),
            (_, PwmType::Pwm | PwmType::UpDown) => clocks.clamp(2, PWM_PERIOD_MAX),
        }
    }

    /// This channel's word of the command block. `period` is what the board has; it and
    /// `self.period` differ while a new frequency is on its way, and the shorter one decides, so
    /// that the duty is never more than asked.
    pub fn command(&self, period: u32, clock_hz: f64) -> u32 {
        let period = period.min(self.period(clock_hz));
        self.curr_period.set(period);
        self.curr_frequency.set(clock_hz / f64::from(period.max(1)));
        if !self.enable.get() {
            self.curr_dc.set(0.0);
            self.curr_width.set(0);
            self.direction.set(false);
            return 0;
        }
        let duty = self.duty();
        let full = match self.kind.0 {
            PwmType::Pdm => PDM_FULL,
            PwmType::Pwm | PwmType::UpDown => f64::from(period) * f64::from(1 << PWM_FRACTION),
        };
        let exact = duty.abs() * full;
        let width = if self.dithers {
            exact.round() as u32
        } else {
            // The gateware ignores the fraction: round it here.
            let whole = (exact / f64::from(1 << PWM_FRACTION)).round() as u32;
            whole << PWM_FRACTION
        };
        self.curr_dc.set(duty);
        self.curr_width.set(width >> PWM_FRACTION);
        self.direction.set(duty < 0.0);
        let direction = if duty < 0.0 { PWM_DIRECTION } else { 0 };
        width.min(PWM_WIDTH_MASK) | direction | PWM_ENABLE
    }

    /// What the gateware calls the output type, and whether the pins change places.
    fn wanted_kind(&self) -> (PwmType, bool) {
        match (self.output_type.get(), self.has_direction) {
            (3, _) => (PwmType::Pdm, false),
            (2, true) => (PwmType::UpDown, false),
            (4, true) => (PwmType::Pwm, true),
            _ => (PwmType::Pwm, false),
        }
    }

    fn duty(&self) -> f64 {
        // A command that is not a number means duty 0, without the offset.
        let Some(value) = self.value.now() else {
            return 0.0;
        };
        let asked = value / self.scale.get() + self.offset.get();
        let most = self.max_dc.get().min(1.0);
        let least = self.min_dc.get().min(most);
        if asked < 0.0 {
            if self.has_direction {
                -(-asked).clamp(least, most)
            } else {
                least
            }
        } else {
            asked.clamp(least, most)
        }
    }
}

/// hostmot2's number for the type.
const fn number(kind: PwmType) -> u32 {
    match kind {
        PwmType::Pwm => 1,
        PwmType::UpDown => 2,
        PwmType::Pdm => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    const CLOCK: f64 = 60e6;

    fn bench(has_direction: bool) -> (FakeHal, Pwm) {
        let mut hal = FakeHal::new();
        let pwm = Pwm::export(
            &mut Exporter::new(&mut hal, "p"),
            has_direction,
            PwmType::Pwm,
        )
        .unwrap();
        hal.set("p.enable", true);
        hal.set("p.scale", 100.0);
        (hal, pwm)
    }

    fn command(pwm: &Pwm) -> u32 {
        pwm.command(pwm.period(CLOCK), CLOCK)
    }

    /// A width of whole clocks as the command carries it.
    const fn clocks(clocks: u32) -> u32 {
        PWM_ENABLE | clocks << PWM_FRACTION
    }

    #[test]
    fn the_width_is_the_duty_of_the_period() {
        let (hal, pwm) = bench(false);
        hal.set("p.value", 25.0);
        assert_eq!(command(&pwm), clocks(15_000));
        assert_eq!(hal.get::<f64>("p.curr-dc"), 0.25);
        assert_eq!(hal.get::<u32>("p.curr-period"), 60_000);
        assert_eq!(hal.get::<u32>("p.curr-width"), 15_000);
        assert_eq!(hal.get::<f64>("p.curr-pwm-freq"), 1000.0);
    }

    #[test]
    fn full_and_no_duty_are_exactly_that() {
        for dither in [false, true] {
            let (hal, mut pwm) = bench(false);
            hal.set("p.dither", dither);
            pwm.configure();
            hal.set("p.value", 1e9);
            assert_eq!(command(&pwm), clocks(60_000));
            hal.set("p.value", -5.0);
            assert_eq!(command(&pwm), PWM_ENABLE);
            hal.set("p.value", f64::NAN);
            assert_eq!(command(&pwm), PWM_ENABLE);
            hal.set("p.enable", false);
            assert_eq!(command(&pwm), 0);
        }
    }

    #[test]
    fn dither_keeps_the_fraction_of_a_clock_and_without_it_the_width_is_rounded() {
        let (hal, mut pwm) = bench(false);
        hal.set("p.pwm-freq", 600_000.0);
        // 100 clocks; 50.5 % of them are half a clock more than 50.
        hal.set("p.value", 50.6);
        assert_eq!(command(&pwm), clocks(51));
        hal.set("p.dither", true);
        assert_eq!(command(&pwm), clocks(51), "the board has not taken it yet");
        assert_eq!(pwm.configure(), PWM_DITHER);
        assert_eq!(command(&pwm), PWM_ENABLE | (50.6f64 * 256.0).round() as u32);
    }

    #[test]
    fn a_negative_duty_needs_a_direction_pin() {
        let (hal, pwm) = bench(true);
        hal.set("p.value", -50.0);
        assert_eq!(command(&pwm), clocks(30_000) | PWM_DIRECTION);
        assert_eq!(hal.get::<f64>("p.curr-dc"), -0.5);
        assert!(hal.get::<bool>("p.direction"));
    }

    #[test]
    fn min_and_max_hold_the_duty() {
        let (hal, pwm) = bench(false);
        hal.set("p.min-dc", 0.1);
        hal.set("p.max-dc", 0.9);
        assert_eq!(command(&pwm), clocks(6_000));
        hal.set("p.value", 100.0);
        assert_eq!(command(&pwm), clocks(54_000));
    }

    #[test]
    fn output_types_are_hostmot2s_and_need_two_pins_where_they_use_two() {
        let (hal, mut pwm) = bench(true);
        for (number, mode) in [
            (1u32, 0),
            (2, 1 << PWM_TYPE_SHIFT),
            (3, 2 << PWM_TYPE_SHIFT),
            (4, PWM_SWAP),
            // There are no such types: the last good one stays.
            (0, PWM_SWAP),
            (77, PWM_SWAP),
            (1, 0),
        ] {
            hal.set("p.output-type", number);
            assert_eq!(pwm.configure(), mode, "{number}");
        }
        let (hal, mut pwm) = bench(false);
        for number in [2u32, 4] {
            hal.set("p.output-type", number);
            assert_eq!(pwm.configure(), 0, "{number} with one pin");
        }
    }

    #[test]
    fn a_pulse_density_is_sixteen_bits_and_the_frequency_its_bit_rate() {
        let (hal, mut pwm) = bench(false);
        hal.set("p.output-type", 3u32);
        pwm.configure();
        hal.set("p.pwm-freq", 20e6);
        assert_eq!(pwm.period(CLOCK), 3);
        hal.set("p.value", 25.0);
        assert_eq!(command(&pwm), clocks(16_384));
        hal.set("p.value", 100.0);
        assert_eq!(command(&pwm), clocks(65_536));
        hal.set("p.pwm-freq", 1e9);
        assert_eq!(pwm.period(CLOCK), PWM_PERIOD_MAX, "faster than the clock");
    }

    #[test]
    fn while_a_new_frequency_is_on_its_way_the_duty_is_never_more_than_asked() {
        let (hal, pwm) = bench(false);
        hal.set("p.value", 50.0);
        hal.set("p.pwm-freq", 500.0);
        // The board still has 60 000 clocks, 120 000 are wanted; then the other way round.
        assert_eq!(pwm.command(60_000, CLOCK), clocks(30_000));
        hal.set("p.pwm-freq", 2000.0);
        assert_eq!(pwm.command(60_000, CLOCK), clocks(15_000));
    }

    #[test]
    fn the_period_follows_the_frequency_into_its_register() {
        let (hal, pwm) = bench(false);
        for (frequency, clocks) in [
            (1000.0, 60_000),
            (20_000.0, 3_000),
            (1e8, 2),
            (1e12, PWM_PERIOD_MAX),
            (500.0, 120_000),
            // No frequencies: the last good one stays.
            (0.0, 120_000),
            (-1000.0, 120_000),
            (f64::NAN, 120_000),
        ] {
            hal.set("p.pwm-freq", frequency);
            assert_eq!(pwm.period(CLOCK), clocks, "{frequency} Hz");
        }
    }
}
