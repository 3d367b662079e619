//! Numbers with units. Raw integers appear only here and in registers.

/// A signed step velocity as the gateware counts it: one unit is `f_clk / 2^32` steps per second
/// (0.014 steps/s at 60 MHz). Full scale is half the clock: a step every second clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Velocity(pub i32);

/// An acceleration limit as the gateware applies it every clock: one unit is `f_clk^2 / 2^56`
/// steps/s^2 (0.05 steps/s^2 at 60 MHz). Zero means no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Accel(pub u32);

/// A stepgen's position: s32.32, pulses emitted in the upper half. It starts at half a step, so the
/// DDS crosses half way between two steps and a rounding error never costs a pulse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position(pub i64);

/// A free-running 32-bit counter. It wraps, and only [`Count::since`] may subtract.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count(pub u32);

/// A duration or instant in clocks of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Clocks(pub u64);

/// `2^32`, the units in one step per clock.
const TWO_32: f64 = 4_294_967_296.0;
/// `2^56`.
const TWO_56: f64 = 72_057_594_037_927_936.0;

impl Velocity {
    /// The largest velocity of a stepgen: just under half the clock.
    pub const MAX: Velocity = Velocity(i32::MAX);

    /// From steps per second, saturating at +-[`Velocity::MAX`]; NaN is 0.
    pub fn from_hz(steps_per_second: f64, clock_hz: f64) -> Self {
        let units = steps_per_second / clock_hz * TWO_32;
        // `as` saturates and maps NaN to 0; i32::MIN would have no positive twin.
        Velocity((units + half(units)) as i32).clamped()
    }

    /// In steps per second.
    pub fn to_hz(self, clock_hz: f64) -> f64 {
        f64::from(self.0) * clock_hz / TWO_32
    }

    fn clamped(self) -> Self {
        Velocity(self.0.max(-i32::MAX))
    }
}

impl Accel {
    /// No limit: the velocity jumps.
    pub const UNLIMITED: Accel = Accel(0);

    /// From steps/s^2. Zero or less, and NaN, mean "no limit"; anything else is at least one unit.
    pub fn from_steps(steps_per_second2: f64, clock_hz: f64) -> Self {
        if steps_per_second2.is_nan() || steps_per_second2 <= 0.0 {
            return Accel::UNLIMITED;
        }
        let units = steps_per_second2 / (clock_hz * clock_hz) * TWO_56;
        Accel(((units + 0.5) as u32).max(1))
    }

    /// In steps/s^2; `None` for no limit.
    pub fn to_steps(self, clock_hz: f64) -> Option<f64> {
        (self.0 != 0).then(|| f64::from(self.0) * clock_hz * clock_hz / TWO_56)
    }
}

impl Position {
    /// The position of every stepgen at power-up: no pulses, half a step.
    pub const ZERO: Position = Position(0x8000_0000);

    /// From the two halves a status block carries.
    pub const fn from_words(lo: u32, hi: u32) -> Self {
        Position(((hi as i64) << 32) | lo as i64)
    }

    /// Pulses emitted, signed.
    pub const fn pulses(self) -> i64 {
        self.0 >> 32
    }

    /// The DDS's position, in steps, without the half-step bias.
    pub fn steps(self) -> f64 {
        // Split, so that a position beyond 2^52 still keeps its fraction's upper bits.
        self.pulses() as f64 + (f64::from(self.0 as u32) / TWO_32 - 0.5)
    }

    /// The way from an earlier position, in steps; exact across the 2^63 wrap.
    pub fn since(self, earlier: Position) -> f64 {
        self.0.wrapping_sub(earlier.0) as f64 / TWO_32
    }
}

impl Count {
    /// How far the counter moved since `earlier`. It is right across the wrap if the counter moved
    /// by less than 2^31.
    pub const fn since(self, earlier: Count) -> i32 {
        self.0.wrapping_sub(earlier.0) as i32
    }
}

impl Clocks {
    /// From the two halves a block carries.
    pub const fn from_words(lo: u32, hi: u32) -> Self {
        Clocks(((hi as u64) << 32) | lo as u64)
    }

    /// Clocks in this many nanoseconds, rounded up: a timing is never shorter than asked.
    pub fn from_nanos_ceil(nanos: u64, clock_hz: u32) -> Self {
        let clocks = (u128::from(nanos) * u128::from(clock_hz)).div_ceil(1_000_000_000);
        Clocks(u64::try_from(clocks).unwrap_or(u64::MAX))
    }

    /// In seconds.
    pub fn to_seconds(self, clock_hz: f64) -> f64 {
        self.0 as f64 / clock_hz
    }
}

/// Half a unit with the sign of `x`: rounding without `std`.
fn half(x: f64) -> f64 {
    if x < 0.0 { -0.5 } else { 0.5 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK: f64 = 60e6;

    #[test]
    fn one_unit_of_velocity_is_finer_than_the_design_asks() {
        assert!(Velocity(1).to_hz(50e6) <= 0.012);
        assert!(Accel(1).to_steps(50e6).unwrap() <= 0.1);
    }

    #[test]
    fn the_units_are_those_of_the_clock() {
        // 2^24 of 2^32 of 60 MHz; 2^24 of 2^56 of its square.
        assert_eq!(Velocity(1 << 24).to_hz(CLOCK), 234_375.0);
        assert_eq!(Velocity::from_hz(-234_375.0, CLOCK), Velocity(-(1 << 24)));
        let steps = 60e6 * 60e6 / TWO_32;
        assert_eq!(Accel(1 << 24).to_steps(CLOCK), Some(steps));
        assert_eq!(Accel::from_steps(steps, CLOCK), Accel(1 << 24));
        assert_eq!(Clocks(90_000_000).to_seconds(CLOCK), 1.5);
    }

    #[test]
    fn velocities_and_limits_are_rounded_to_the_nearest_unit() {
        let unit = Velocity(1).to_hz(CLOCK);
        for (units, rounded) in [(2.4, 2), (2.6, 3), (-2.4, -2), (-2.6, -3), (-0.4, 0)] {
            assert_eq!(Velocity::from_hz(units * unit, CLOCK), Velocity(rounded));
        }
        let unit = Accel(1).to_steps(CLOCK).unwrap();
        for (units, rounded) in [(2.4, 2), (2.6, 3), (0.1, 1)] {
            assert_eq!(Accel::from_steps(units * unit, CLOCK), Accel(rounded));
        }
    }

    #[test]
    fn no_limit_is_what_is_not_above_zero() {
        for nothing in [0.0, -0.0, -1e6, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(Accel::from_steps(nothing, CLOCK), Accel::UNLIMITED);
        }
        assert_eq!(Accel::UNLIMITED.to_steps(CLOCK), None);
    }

    #[test]
    fn a_rate_beyond_half_the_clock_saturates_and_keeps_its_sign() {
        assert_eq!(Velocity::from_hz(1e9, CLOCK), Velocity::MAX);
        assert_eq!(Velocity::from_hz(-1e9, CLOCK), Velocity(-i32::MAX));
        assert_eq!(Velocity::from_hz(f64::NAN, CLOCK), Velocity(0));
        assert_eq!(
            Velocity::from_hz(f64::NEG_INFINITY, CLOCK),
            Velocity(-i32::MAX)
        );
    }

    #[test]
    fn velocities_survive_the_round_trip_at_the_edges() {
        for units in [0, 1, -1, i32::MAX, -i32::MAX, 71_583] {
            assert_eq!(
                Velocity::from_hz(Velocity(units).to_hz(CLOCK), CLOCK),
                Velocity(units)
            );
        }
    }

    #[test]
    fn a_limit_of_zero_is_no_limit_and_a_tiny_one_is_still_a_limit() {
        assert_eq!(Accel::from_steps(0.0, CLOCK), Accel::UNLIMITED);
        assert_eq!(Accel::from_steps(1e-9, CLOCK), Accel(1));
        assert_eq!(Accel::from_steps(f64::INFINITY, CLOCK), Accel(u32::MAX));
    }

    #[test]
    fn a_position_counts_pulses_from_the_middle_of_a_step() {
        assert_eq!(Position::ZERO.pulses(), 0);
        assert_eq!(Position::ZERO.steps(), 0.0);
        let back = Position::from_words(0x8000_0000, 0xffff_ffff);
        assert_eq!((back.pulses(), back.steps()), (-1, -1.0));
        assert_eq!(Position(i64::MIN).since(Position(i64::MAX)), 1.0 / TWO_32);
        let place = Position::from_words(0xc000_0000, 3);
        assert_eq!(place, Position(3 << 32 | 0xc000_0000));
        assert_eq!((place.pulses(), place.steps()), (3, 3.25));
        assert_eq!(place.since(Position::ZERO), 3.25);
    }

    #[test]
    fn a_count_differs_right_across_its_wrap() {
        assert_eq!(Count(2).since(Count(u32::MAX)), 3);
        assert_eq!(Count(u32::MAX).since(Count(2)), -3);
        assert_eq!(Count(0x8000_0000).since(Count(0x7fff_ffff)), 1);
    }

    #[test]
    fn a_timing_is_never_shorter_than_asked() {
        assert_eq!(Clocks::from_nanos_ceil(1, 60_000_000), Clocks(1));
        assert_eq!(Clocks::from_nanos_ceil(1_000, 60_000_000), Clocks(60));
        assert_eq!(Clocks::from_nanos_ceil(1_001, 60_000_000), Clocks(61));
        assert_eq!(Clocks::from_nanos_ceil(0, 60_000_000), Clocks(0));
        assert_eq!(
            Clocks::from_nanos_ceil(u64::MAX, u32::MAX),
            Clocks(u64::MAX)
        );
        assert_eq!(Clocks::from_words(5, 7), Clocks(7 << 32 | 5));
    }
}
