//! The HAL names of a channel, and the limits of their length.

use wire::board::{HAL_NAME_LEN, HAL_NAME_MAX};

/// What the pins of a channel class are called: `ferrocnc.<board>.<class>.<name>.<pin>`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HalClass {
    /// Third part of the name.
    pub class: &'static str,
    /// The longest last part.
    pub longest: &'static str,
    /// The longest last part in LiteX-CNC, whose third and last parts are behind the board's name.
    pub litexcnc: &'static str,
}

/// `[[stepgen]]`.
pub const STEPGEN: HalClass = HalClass {
    class: "stepgen",
    longest: "position-scale",
    litexcnc: "position-prediction",
};
/// `[[encoder]]`.
pub const ENCODER: HalClass = HalClass {
    class: "encoder",
    longest: "velocity-rpm",
    litexcnc: "overflow-occurred",
};
/// `[[pwm]]`.
pub const PWM: HalClass = HalClass {
    class: "pwm",
    longest: "invert-output",
    litexcnc: "curr-pwm-freq",
};
/// `[[gpio_in]]`.
pub const INPUT: HalClass = HalClass {
    class: "gpio",
    longest: "in-not",
    litexcnc: "in-not",
};
/// `[[gpio_out]]`.
pub const OUTPUT: HalClass = HalClass {
    class: "gpio",
    longest: "invert",
    litexcnc: "invert-output",
};

impl HalClass {
    /// The longest pin a channel of this name gets, on the first board.
    pub fn pin(self, name: &str) -> String {
        self.pin_called(name, self.longest)
    }

    /// The pin with this last part, on the first board.
    pub fn pin_called(self, name: &str, last: &str) -> String {
        format!("ferrocnc.0.{}.{name}.{last}", self.class)
    }

    /// The longest pin that LiteX-CNC makes of this name on a board of that name.
    pub fn litexcnc_pin(self, board: &str, name: &str) -> String {
        format!("{board}.{}.{name}.{}", self.class, self.litexcnc)
    }

    /// How long a name of LiteX-CNC's may be, with the shortest name of the board.
    pub const fn litexcnc_room(self) -> usize {
        HAL_NAME_LEN - "b...".len() - self.class.len() - self.litexcnc.len()
    }

    /// How long a name may be.
    pub const fn room(self) -> usize {
        HAL_NAME_MAX - "ferrocnc.0...".len() - self.class.len() - self.longest.len()
    }
}

/// Whether HAL can have it: lower case, digits and hyphens, a letter first.
pub fn is_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name
            .bytes()
            .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-')
}

/// The nearest name HAL can have, of at most `room` characters; empty when nothing is left.
pub fn nearest_name(text: &str, room: usize) -> String {
    let mut name = String::new();
    for c in text.chars().flat_map(char::to_lowercase) {
        match c {
            'a'..='z' => name.push(c),
            '0'..='9' if !name.is_empty() => name.push(c),
            _ if !name.is_empty() && !name.ends_with('-') => name.push('-'),
            _ => {}
        }
    }
    name.truncate(room);
    name.trim_end_matches('-').to_owned()
}
