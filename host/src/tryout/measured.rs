//! "I measured 9.8 mm": the scale of an axis, of the steps it has gone and of what they were on a
//! ruler.

/// A measured ratio so near to a power of two is a wrong number of microsteps: switches of a drive
/// know nothing else. 2 %: a ruler over 50 mm is better.
const NEAR: f64 = 0.02;

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Which motor.
    pub motor: usize,
    /// Steps in a unit, with the sign that makes it go the way of the key.
    pub scale: f64,
    /// That of before, if there was one.
    pub before: Option<f64>,
}

/// What a machine's file is to say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// The drive makes so many times as many microsteps.
    Microsteps(f64),
    /// The screw or pulley moves so many times as far in a turn.
    Pitch(f64),
}

impl Measured {
    /// Of so many steps, and what was typed.
    pub fn new(motor: usize, steps: i64, typed: &str, before: Option<f64>) -> Result<Self, String> {
        let length: f64 = typed
            .parse()
            .map_err(|_| format!("{typed:?} is no number: type what you measured, as in 9.8"))?;
        if length == 0.0 || !length.is_finite() {
            return Err(
                "it did not move: look at ENA, the current and the wires of the drive".to_owned(),
            );
        }
        if steps == 0 {
            return Err("no step since the mark: jog first".to_owned());
        }
        // A ruler has no sign: a minus says that it went the other way than the key.
        let sign = before.map_or(1.0, f64::signum);
        Ok(Measured {
            motor,
            scale: sign * steps.unsigned_abs() as f64 / length,
            before,
        })
    }

    /// It went the other way than the key.
    pub fn is_reversed(&self) -> bool {
        self.before.unwrap_or(1.0) * self.scale < 0.0
    }

    /// What to change, if there is a file.
    pub fn change(&self) -> Option<Change> {
        // More steps in a unit than was thought: more microsteps, or less pitch.
        let ratio = (self.scale / self.before?).abs();
        let power = ratio.log2().round();
        let is_near = (ratio / power.exp2() - 1.0).abs() <= NEAR;
        match power != 0.0 && is_near {
            true => Some(Change::Microsteps(power.exp2())),
            false => Some(Change::Pitch(1.0 / ratio)),
        }
    }

    /// What it is, for an INI file.
    pub fn line(&self, unit: &str) -> String {
        let unit = match (self.before, unit) {
            (Some(_), unit) => unit,
            (None, _) => "unit",
        };
        format!("SCALE = {} (steps in a {unit})", number(self.scale))
    }
}

/// At most six digits behind the point.
pub fn number(value: f64) -> String {
    format!("{}", (value * 1e6).round() / 1e6)
}
