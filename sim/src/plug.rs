//! What is wired to the headers of a card whose pins are configured.
//!
//! ```text
//! plant, tests  ---- step 3, input 5 (Pins) ---->  Plug  ---- line 17 ---->  the gateware's headers
//! ```
//!
//! A board file says which function is on which pin. The world outside is wired as one such file
//! says; which file the board has been given is another matter, and a test may well wire one and
//! apply another. Without a plug nothing is wired: every line is pulled up.

use ferrocnc_config::board::{Board, Class, ControlInput};
use ferrocnc_config::platform::Level;

use crate::soc::{Pins, Wiring};

/// One wire between a line of the headers and a function's pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Wire {
    line: u8,
    to: End,
    bit: u8,
}

/// The other end of a wire: a field of [`Pins`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Step,
    Dir,
    StepN,
    DirN,
    Pwm,
    PwmDir,
    Output,
    StepIndex,
    EncoderA,
    EncoderB,
    EncoderIndex,
    EncoderMask,
    Input,
    /// High or low while [`Pins::ext_reset`] is active.
    Reset(Level),
    /// High or low while [`Pins::factory`] is active.
    Factory(Level),
}

impl End {
    /// The field behind a pin's key in a board file.
    const fn of(class: Class, key: &str) -> Option<Self> {
        Some(match (class, key.as_bytes()) {
            (Class::Stepgen, b"step") => End::Step,
            (Class::Stepgen, b"dir") => End::Dir,
            (Class::Stepgen, b"step_n") => End::StepN,
            (Class::Stepgen, b"dir_n") => End::DirN,
            (Class::Stepgen, b"index") => End::StepIndex,
            (Class::Encoder, b"a") => End::EncoderA,
            (Class::Encoder, b"b") => End::EncoderB,
            (Class::Encoder, b"index") => End::EncoderIndex,
            (Class::Encoder, b"mask") => End::EncoderMask,
            (Class::Pwm, b"pin") => End::Pwm,
            (Class::Pwm, b"dir") => End::PwmDir,
            (Class::Input, b"pin") => End::Input,
            (Class::Output, b"pin") => End::Output,
            _ => return None,
        })
    }

    /// The level the world puts on a wire that ends here; `None` if the board drives it.
    fn level(self, pins: &Pins, bit: u8) -> Option<bool> {
        let word = match self {
            End::StepIndex => pins.step_index.into(),
            End::EncoderA => pins.enc_a.into(),
            End::EncoderB => pins.enc_b.into(),
            End::EncoderIndex => pins.enc_i.into(),
            End::EncoderMask => pins.enc_mask.into(),
            End::Input => pins.gpio_in,
            End::Reset(active) => return Some((pins.ext_reset != 0) == (active == Level::High)),
            End::Factory(active) => return Some((pins.factory != 0) == (active == Level::High)),
            _ => return None,
        };
        Some(word >> bit & 1 != 0)
    }

    /// Shows the level of a line that the board drives.
    fn show(self, pins: &mut Pins, bit: u8, level: bool) {
        let word = match self {
            End::Step => &mut pins.step,
            End::Dir => &mut pins.dir,
            End::StepN => &mut pins.step_n,
            End::DirN => &mut pins.dir_n,
            End::Pwm => &mut pins.pwm_out,
            End::PwmDir => &mut pins.pwm_dir,
            End::Output => {
                pins.gpio_out |= u64::from(level) << bit;
                return;
            }
            _ => return,
        };
        *word |= u16::from(level) << bit;
    }
}

/// The levels of the world outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct World {
    input: u64,
    encoders: [u16; 4],
    step_index: u16,
    stops: [u8; 2],
}

/// The wires of one machine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plug {
    wires: Vec<Wire>,
    /// The external reset is the card's button.
    key_resets: bool,
    /// What was worked out last, and from what.
    inputs: Option<(World, u64, u8)>,
    outputs: Option<(u64, u64, Pins)>,
}

impl Plug {
    /// The wires of the machine that this file describes.
    pub fn of(board: &Board) -> Self {
        let mut wires = Vec::new();
        for class in Class::ALL {
            for (bit, channel) in (0..).zip(board.of(class)) {
                for (key, pin) in &channel.pins {
                    // No image has more lines than `Pins` has bits.
                    let line = board.platform.line(pin).filter(|line| *line < 64);
                    let ends = End::of(class, key).zip(line);
                    wires.extend(ends.map(|(to, line)| Wire { line, to, bit }));
                }
            }
        }
        let mut control = |input: &ControlInput, to: fn(Level) -> End| {
            let line = input
                .pin
                .as_deref()
                .and_then(|pin| board.platform.line(pin));
            wires.extend(line.map(|line| Wire {
                line,
                to: to(input.active),
                bit: 0,
            }));
        };
        control(&board.ext_reset, End::Reset);
        let own = board.factory.iter();
        own.filter(|factory| factory.pin != board.ext_reset.pin)
            .for_each(|factory| control(factory, End::Factory));
        Plug {
            wires,
            key_resets: board.ext_reset.pin.as_deref() == Some("key"),
            inputs: None,
            outputs: None,
        }
    }
}

impl Wiring for Plug {
    fn inside(&mut self, pins: &Pins) -> (u64, u8) {
        let world = World {
            input: pins.gpio_in,
            encoders: [pins.enc_a, pins.enc_b, pins.enc_i, pins.enc_mask],
            step_index: pins.step_index,
            stops: [pins.ext_reset, pins.factory],
        };
        if let Some((before, lines, key)) = self.inputs
            && before == world
        {
            return (lines, key);
        }
        let mut lines = u64::MAX;
        for wire in &self.wires {
            if wire.to.level(pins, wire.bit) == Some(false) {
                lines &= !(1 << wire.line);
            }
        }
        let key = u8::from(pins.factory != 0 || self.key_resets && pins.ext_reset != 0);
        self.inputs = Some((world, lines, key));
        (lines, key)
    }

    fn outside(&mut self, pins: &mut Pins) {
        let (levels, drives) = (pins.header_out, pins.header_drives);
        let shown = match self.outputs {
            Some((before, drove, shown)) if (before, drove) == (levels, drives) => shown,
            _ => {
                let mut shown = Pins::default();
                for wire in &self.wires {
                    let level = levels & drives & 1 << wire.line != 0;
                    wire.to.show(&mut shown, wire.bit, level);
                }
                self.outputs = Some((levels, drives, shown));
                shown
            }
        };
        pins.gpio_out = shown.gpio_out;
        pins.step = shown.step;
        pins.dir = shown.dir;
        pins.step_n = shown.step_n;
        pins.dir_n = shown.dir_n;
        pins.pwm_out = shown.pwm_out;
        pins.pwm_dir = shown.pwm_dir;
    }
}
