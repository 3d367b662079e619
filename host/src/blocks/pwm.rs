//! `pwm.<nn>`: a value in, a duty cycle out; pins and arithmetic of LinuxCNC's `pwmgen`.
//!
//! | name | | |
//! |---|---|---|
//! | `value` | float in | `value / scale + offset` is the duty cycle asked for |
//! | `enable` | bit in | false: duty 0, output inactive |
//! | `scale`, `offset` | float io | 1, 0 |
//! | `pwm-freq` | float io | Hz, 1000; takes effect at once |
//! | `min-dc`, `max-dc` | float io | 0, 1: the duty's magnitude is kept between them while enabled |
//! | `curr-dc` | float out | the duty given |
//! | `invert-output` | bit param | taken over while disarmed |
//!
//! A channel with a direction pin takes the sign of the duty from it; one without stands still for a
//! negative one.

use crate::hal::{ExportError, Exporter, In, Io, Out, Param};
use wire::exchange::{PWM_DIRECTION, PWM_ENABLE, PWM_WIDTH_MASK};

/// One PWM.
#[derive(Debug)]
pub struct Pwm {
    value: In<f64>,
    enable: In<bool>,
    scale: Io<f64>,
    offset: Io<f64>,
    frequency: Io<f64>,
    min_dc: Io<f64>,
    max_dc: Io<f64>,
    curr_dc: Out<f64>,
    invert: Param<bool>,
    has_direction: bool,
}

impl Pwm {
    /// Exports the pins.
    pub fn export(hal: &mut Exporter<'_>, has_direction: bool) -> Result<Self, ExportError> {
        Ok(Pwm {
            value: hal.input("value")?,
            enable: hal.input("enable")?,
            scale: hal.both("scale", 1.0)?,
            offset: hal.both("offset", 0.0)?,
            frequency: hal.both("pwm-freq", 1000.0)?,
            min_dc: hal.both("min-dc", 0.0)?,
            max_dc: hal.both("max-dc", 1.0)?,
            curr_dc: hal.output("curr-dc")?,
            invert: hal.param("invert-output", false)?,
            has_direction,
        })
    }

    /// The mode register.
    pub fn mode(&self) -> u32 {
        u32::from(self.invert.get())
    }

    /// The period register, in clocks.
    pub fn period(&self, clock_hz: f64) -> u32 {
        // `as` saturates, and makes a NaN frequency the slowest rather than the fastest.
        let clocks = (clock_hz / self.frequency.get()).round() as u32;
        if clocks == 0 {
            PWM_WIDTH_MASK
        } else {
            clocks.clamp(2, PWM_WIDTH_MASK)
        }
    }

    /// This channel's word of the command block.
    pub fn command(&self, clock_hz: f64) -> u32 {
        if !self.enable.get() {
            self.curr_dc.set(0.0);
            return 0;
        }
        let duty = self.duty();
        self.curr_dc.set(duty);
        let width = (duty.abs() * f64::from(self.period(clock_hz))).round() as u32;
        let direction = if duty < 0.0 { PWM_DIRECTION } else { 0 };
        width.min(PWM_WIDTH_MASK) | direction | PWM_ENABLE
    }

    fn duty(&self) -> f64 {
        let scale = super::scale_or_one(self.scale.get());
        let asked = self.value.get() / scale + self.offset.get();
        let most = clean(self.max_dc.get(), 1.0).clamp(0.0, 1.0);
        let least = clean(self.min_dc.get(), 0.0).clamp(0.0, most);
        let asked = clean(asked, 0.0);
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

fn clean(value: f64, otherwise: f64) -> f64 {
    if value.is_nan() { otherwise } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::fake::FakeHal;

    const CLOCK: f64 = 60e6;

    fn bench(has_direction: bool) -> (FakeHal, Pwm) {
        let mut hal = FakeHal::new();
        let pwm = Pwm::export(&mut Exporter::new(&mut hal, "p"), has_direction).unwrap();
        hal.set("p.enable", true);
        hal.set("p.scale", 100.0);
        (hal, pwm)
    }

    #[test]
    fn the_width_is_the_duty_of_the_period() {
        let (hal, pwm) = bench(false);
        hal.set("p.value", 25.0);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE | 15_000);
        assert_eq!(hal.get::<f64>("p.curr-dc"), 0.25);
    }

    #[test]
    fn full_and_no_duty_are_exactly_that() {
        let (hal, pwm) = bench(false);
        hal.set("p.value", 1e9);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE | 60_000);
        hal.set("p.value", -5.0);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE);
        hal.set("p.value", f64::NAN);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE);
        hal.set("p.enable", false);
        assert_eq!(pwm.command(CLOCK), 0);
    }

    #[test]
    fn a_negative_duty_needs_a_direction_pin() {
        let (hal, pwm) = bench(true);
        hal.set("p.value", -50.0);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE | PWM_DIRECTION | 30_000);
        assert_eq!(hal.get::<f64>("p.curr-dc"), -0.5);
    }

    #[test]
    fn min_and_max_hold_the_duty() {
        let (hal, pwm) = bench(false);
        hal.set("p.min-dc", 0.1);
        hal.set("p.max-dc", 0.9);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE | 6_000);
        hal.set("p.value", 100.0);
        assert_eq!(pwm.command(CLOCK), PWM_ENABLE | 54_000);
    }

    #[test]
    fn the_period_follows_the_frequency_into_its_register() {
        let (hal, pwm) = bench(false);
        for (frequency, clocks) in [
            (1000.0, 60_000),
            (20_000.0, 3_000),
            (1e12, PWM_WIDTH_MASK),
            (0.0, PWM_WIDTH_MASK),
            (f64::NAN, PWM_WIDTH_MASK),
        ] {
            hal.set("p.pwm-freq", frequency);
            assert_eq!(pwm.period(CLOCK), clocks, "{frequency} Hz");
        }
    }
}
