//! Numbers with a unit. Lengths are in the machine's unit, millimetre or inch, and in degrees on a
//! rotary axis.

use std::fmt;

/// The number as a configuration file has it: at most six digits behind the point.
pub fn number(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    // No "-0".
    format!("{}", rounded + 0.0)
}

macro_rules! quantity {
    ($($(#[$about:meta])* $name:ident),*) => {$(
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
        pub struct $name(pub f64);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&number(self.0))
            }
        }
    )*};
}

quantity! {
    /// A place or a distance, in units.
    Length,
    /// Units in a second.
    Speed,
    /// Units in a second, in a second.
    Acceleration,
    /// Steps in a unit. Negative where the motor turns the other way.
    Scale,
    /// Turns of the spindle in a minute.
    Rpm,
    /// Periods in a second.
    Hertz
}

impl Scale {
    /// Steps in a second at this speed.
    pub fn rate(self, speed: Speed) -> Hertz {
        Hertz(self.0.abs() * speed.0)
    }
}

/// Nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Nanoseconds(pub u32);

impl fmt::Display for Nanoseconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl Nanoseconds {
    /// In seconds.
    pub fn seconds(self) -> f64 {
        f64::from(self.0) * 1e-9
    }
}
