//! The kinds of channels: what each is called, which pins and which types it has.

use super::keys::{ENCODER_TYPES, PWM_TYPES, STEP_TYPES};
use crate::hal::{self, HalClass};

/// A kind of channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// `[[stepgen]]`.
    Stepgen,
    /// `[[encoder]]`.
    Encoder,
    /// `[[pwm]]`.
    Pwm,
    /// `[[gpio_in]]`.
    Input,
    /// `[[gpio_out]]`.
    Output,
}

/// A pin key of a channel: its name, whether the channel needs it, whether it drives.
pub(super) type PinKey = (&'static str, bool, bool);

impl Class {
    /// All of them, in the order of the file and of the blob.
    pub const ALL: [Class; 5] = [
        Class::Stepgen,
        Class::Encoder,
        Class::Pwm,
        Class::Input,
        Class::Output,
    ];

    /// The array's name in a board file.
    pub const fn key(self) -> &'static str {
        match self {
            Class::Stepgen => "stepgen",
            Class::Encoder => "encoder",
            Class::Pwm => "pwm",
            Class::Input => "gpio_in",
            Class::Output => "gpio_out",
        }
    }

    /// First letter of the blob's pin text.
    pub const fn letter(self) -> char {
        match self {
            Class::Stepgen => 's',
            Class::Encoder => 'e',
            Class::Pwm => 'p',
            Class::Input => 'i',
            Class::Output => 'o',
        }
    }

    /// How its names become HAL's.
    pub const fn hal(self) -> HalClass {
        match self {
            Class::Stepgen => hal::STEPGEN,
            Class::Encoder => hal::ENCODER,
            Class::Pwm => hal::PWM,
            Class::Input => hal::INPUT,
            Class::Output => hal::OUTPUT,
        }
    }

    /// The name that an import gives a channel without one.
    pub(crate) fn numbered(self, n: usize) -> String {
        let prefix = match self {
            Class::Stepgen => "sg",
            Class::Encoder => "enc",
            Class::Pwm => "pwm",
            Class::Input => "in",
            Class::Output => "out",
        };
        format!("{prefix}-{n:02}")
    }

    /// Its pins, in the order they are written.
    pub const fn pins(self) -> &'static [PinKey] {
        match self {
            Class::Stepgen => &[
                ("step", true, true),
                ("step_n", false, true),
                ("dir", true, true),
                ("dir_n", false, true),
                ("index", false, false),
            ],
            Class::Encoder => &[
                ("a", true, false),
                ("b", true, false),
                ("index", false, false),
                ("mask", false, false),
            ],
            Class::Pwm => &[("pin", true, true), ("dir", false, true)],
            Class::Input => &[("pin", true, false)],
            Class::Output => &[("pin", true, true)],
        }
    }

    /// Its types, the first being meant when nothing is said.
    pub const fn types(self) -> &'static [&'static str] {
        match self {
            Class::Stepgen => &STEP_TYPES,
            Class::Encoder => &ENCODER_TYPES,
            Class::Pwm => &PWM_TYPES,
            Class::Input | Class::Output => &[],
        }
    }
}
