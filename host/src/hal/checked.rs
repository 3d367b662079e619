//! Numbers that come from HAL, checked.
//!
//! `setp` takes every text that `strtod` takes, and a signal carries every value that a component
//! computes: `nan`, `inf`, a minus sign too many. A limit that is not a number limits nothing, so
//! every number the driver reads has a [`Rule`]. A value that breaks its rule is not used: the last
//! good value stays in force. [`Watch`] says so, once per change. Only switches, which are bits,
//! have no rule.

use super::{Exported, Handle, Value};
use core::fmt;
use core::marker::PhantomData;
use std::ffi::CString;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// The largest number and, 0 apart, the smallest. No machine comes near them, and a product of
/// three numbers in between neither overflows nor becomes 0, which to a limit would mean "none".
const MOST: f64 = 1e20;
const LEAST: f64 = 1e-20;

/// 1 s: a name is reported at most this often.
const QUIET_NS: i64 = 1_000_000_000;

/// What a number may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Every value of its type: an integer for which all values are valid.
    Any,
    /// A whole number, these two included.
    Whole(i32, i32),
    /// Any number.
    Number,
    /// 0 or more.
    NotNegative,
    /// 0, which is no limit, or more.
    Limit,
    /// More than 0.
    Positive,
    /// Anything but 0: something is divided by it.
    Divisor,
    /// Any number. If it is not a number the output rests, because an old command must not stay in
    /// force.
    Command,
}

impl Rule {
    /// Whether a value obeys it.
    pub fn allows(self, value: f64) -> bool {
        let (zero, size) = (value == 0.0, value.abs());
        // A comparison with NaN is false.
        let number = size <= MOST;
        match self {
            Rule::Any => true,
            Rule::Whole(least, most) => (f64::from(least)..=f64::from(most)).contains(&value),
            Rule::Number | Rule::Command => number,
            Rule::NotNegative | Rule::Limit => zero || (value >= LEAST && number),
            Rule::Positive => value >= LEAST && number,
            Rule::Divisor => size >= LEAST && number,
        }
    }

    /// What to set instead.
    fn remedy(self) -> &'static str {
        match self {
            Rule::Any | Rule::Whole(..) => "a valid number",
            Rule::Number => "a number of at most 1e20",
            Rule::NotNegative => "0 or more, from 1e-20 to 1e20",
            Rule::Limit => "0 for no limit or more, from 1e-20 to 1e20",
            Rule::Positive => "more than 0, from 1e-20 to 1e20",
            Rule::Divisor => "any number but 0, from 1e-20 to 1e20 either way",
            Rule::Command => "a number of at most 1e20",
        }
    }
}

/// A number as an operator would write it: `{}` would print 309 digits of 1e308.
struct Plain(f64);

impl fmt::Display for Plain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.abs() < 1e15 && self.0 == self.0.trunc() {
            // -0 is 0.
            write!(f, "{:.0}", self.0 + 0.0)
        } else {
            write!(f, "{:?}", self.0)
        }
    }
}

/// Where a number is read, what it may be, and what it was when it last was that. A clone shares
/// the last good value.
#[derive(Clone, Debug)]
pub struct Source {
    handle: Handle,
    rule: Rule,
    good: Arc<AtomicU64>,
}

impl Source {
    /// Of a value that is good already.
    pub(super) fn new(handle: Handle, rule: Rule) -> Self {
        let good = handle.get();
        Source {
            handle,
            rule,
            good: Arc::new(AtomicU64::new(good.to_bits())),
        }
    }

    /// What HAL says; the error is a number that breaks the rule.
    pub fn look(&self) -> Result<f64, f64> {
        let value = self.handle.get();
        if !self.rule.allows(value) {
            return Err(value);
        }
        // -0 is 0.
        let value = value + 0.0;
        self.good.store(value.to_bits(), Relaxed);
        Ok(value)
    }

    /// What is in force: what HAL says, or what it said when that last was good.
    pub fn get(&self) -> f64 {
        self.look()
            .unwrap_or_else(|_| f64::from_bits(self.good.load(Relaxed)))
    }

    /// What it may be.
    pub fn rule(&self) -> Rule {
        self.rule
    }
}

/// A value of HAL that is a number.
pub trait Number: Value {
    /// From one that its type holds.
    fn of(number: f64) -> Self;
    /// To one.
    fn number(self) -> f64;
}

macro_rules! number {
    ($($ty:ty),+) => {$(
        impl Number for $ty {
            fn of(number: f64) -> Self {
                number as $ty
            }
            fn number(self) -> f64 {
                self.into()
            }
        }
    )+};
}
number!(f64, i32, u32);

/// A parameter or pin that is a number, checked each time it is read.
#[derive(Debug)]
pub struct Checked<T: Number> {
    source: Source,
    ty: PhantomData<T>,
}

impl<T: Number> Checked<T> {
    pub(super) fn new(source: Source) -> Self {
        Checked {
            source,
            ty: PhantomData,
        }
    }

    /// What is in force.
    pub fn get(&self) -> T {
        T::of(self.source.get())
    }

    /// What HAL says, if it is good: for what must not go on as it was.
    pub fn now(&self) -> Option<T> {
        self.source.look().ok().map(T::of)
    }

    /// Sets it.
    pub fn set(&self, value: T) {
        self.source.handle.set(value.number());
    }
}

/// Tells the operator of a number that is not used.
#[derive(Debug)]
pub struct Watch {
    name: CString,
    source: Source,
    /// What was told last, as bits, for NaN is not equal to itself.
    told: Option<u64>,
    /// For how long nothing more is told, ns of servo periods.
    quiet: i64,
}

impl Watch {
    /// Of something exported, if it is checked.
    pub fn of(exported: &Exported) -> Option<Self> {
        Some(Watch {
            name: exported.name.clone(),
            source: exported.source.clone()?,
            told: None,
            quiet: 0,
        })
    }

    /// Looks once a period; calls `tell` when there is something to be said.
    pub fn look(&mut self, period_ns: i64, tell: impl FnOnce(fmt::Arguments<'_>)) {
        self.quiet = self.quiet.saturating_sub(period_ns).max(0);
        let Err(bad) = self.source.look() else {
            self.told = None;
            return;
        };
        let bits = Some(bad.to_bits());
        if self.told == bits || self.quiet > 0 {
            return;
        }
        (self.told, self.quiet) = (bits, QUIET_NS);
        let name = self.name.to_str().unwrap_or_default();
        let (bad, rule) = (Plain(bad), self.source.rule);
        let good = Plain(f64::from_bits(self.source.good.load(Relaxed)));
        match rule {
            Rule::Command => tell(format_args!(
                "{name} is {bad}: its output comes to rest; find what computes it, it has to be {}",
                rule.remedy()
            )),
            Rule::Whole(least, most) => tell(format_args!(
                "{name} is {bad}, which is refused: {good} stays in force; set {least} to {most}"
            )),
            _ => tell(format_args!(
                "{name} is {bad}, which is refused: {good} stays in force; set {}",
                rule.remedy()
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The edges of every number.
    const EDGES: [f64; 14] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        1e308,
        -1e308,
        5e-324,
        -5e-324,
        1e-20,
        1e20,
        -1e20,
    ];

    #[test]
    fn every_rule_says_of_every_edge_whether_it_is_one() {
        // In the order of EDGES.
        for (rule, allowed) in [
            (Rule::Any, "yyyyyyyyyyyyyy"),
            (Rule::Whole(0, 5), "yyynnnnnnynynn"),
            (Rule::Whole(-1, 31), "yyyynnnnnyyynn"),
            (Rule::Number, "yyyynnnnnyyyyy"),
            (Rule::Command, "yyyynnnnnyyyyy"),
            (Rule::NotNegative, "yyynnnnnnnnyyn"),
            (Rule::Limit, "yyynnnnnnnnyyn"),
            (Rule::Positive, "nnynnnnnnnnyyn"),
            (Rule::Divisor, "nnyynnnnnnnyyy"),
        ] {
            for (edge, allowed) in EDGES.into_iter().zip(allowed.chars()) {
                assert_eq!(rule.allows(edge), allowed == 'y', "{rule:?} of {edge:?}");
            }
        }
    }

    #[test]
    fn numbers_are_told_as_one_would_write_them() {
        for (number, text) in [
            (-500.0, "-500"),
            (-0.0, "0"),
            (0.25, "0.25"),
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "-inf"),
            (1e308, "1e308"),
            (5e-324, "5e-324"),
        ] {
            assert_eq!(Plain(number).to_string(), text);
        }
    }
}
