//! The pads that the board drives, with one defect: a pad that is held at a level, or joined with
//! another.
//!
//! What is wrong is wrong at the pad itself, so both the world outside and the gateware that reads
//! its own pads back see it. The Verilated board has the same in `verilator/copper.sv`.

use crate::soc::Pins;

/// A pad that the board drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pad {
    /// The first pin of a stepgen.
    Step(u8),
    /// The second pin of a stepgen.
    Dir(u8),
    /// The inverted copy of the first.
    StepN(u8),
    /// The inverted copy of the second.
    DirN(u8),
    /// The first pin of a PWM.
    Pwm(u8),
    /// The second pin of a PWM.
    PwmDir(u8),
    /// A general output.
    Output(u8),
}

impl Pad {
    /// Its number, as `copper.sv` counts them.
    pub fn number(self) -> u8 {
        match self {
            Pad::Step(n) => n & 15,
            Pad::Dir(n) => 16 + (n & 15),
            Pad::StepN(n) => 32 + (n & 15),
            Pad::DirN(n) => 48 + (n & 15),
            Pad::Pwm(n) => 64 + (n & 15),
            Pad::PwmDir(n) => 80 + (n & 15),
            Pad::Output(n) => OUTPUTS + (n & 63),
        }
    }
}

/// Number of the first output's pad.
const OUTPUTS: u8 = 96;

/// What is wrong with the pads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// This one is held low.
    Low(Pad),
    /// This one is held high.
    High(Pad),
    /// These two are joined; of two drivers that fight, the one that pulls low wins.
    Short(Pad, Pad),
}

impl Fault {
    /// Puts it on the pins, as inputs of the board.
    pub fn put(self, pins: &mut Pins) {
        (pins.pad_fault, pins.pad_at, pins.pad_to) = match self {
            Fault::None => (0, 0, 0),
            Fault::Low(pad) => (1, pad.number(), 0),
            Fault::High(pad) => (2, pad.number(), 0),
            Fault::Short(one, other) => (3, one.number(), other.number()),
        };
    }
}

/// The levels at the pads of a board that drives them like this.
#[inline]
pub fn levels(driven: &Pins) -> Pins {
    let mut pins = *driven;
    if pins.pad_fault != 0 {
        fight(&mut pins);
    }
    pins
}

#[cold]
fn fight(pins: &mut Pins) {
    let (at, to) = (pins.pad_at, pins.pad_to);
    match pins.pad_fault & 3 {
        0 => {}
        3 => {
            let level = get(pins, at) && get(pins, to);
            set(pins, at, level);
            set(pins, to, level);
        }
        held => set(pins, at, held & 2 != 0),
    }
}

fn word(pins: &mut Pins, pad: u8) -> Option<&mut u16> {
    Some(match pad >> 4 {
        0 => &mut pins.step,
        1 => &mut pins.dir,
        2 => &mut pins.step_n,
        3 => &mut pins.dir_n,
        4 => &mut pins.pwm_out,
        5 => &mut pins.pwm_dir,
        _ => return None,
    })
}

/// Which output is at this pad, which is none of the others.
fn output(pad: u8) -> u8 {
    pad.saturating_sub(OUTPUTS).min(63)
}

fn get(pins: &mut Pins, pad: u8) -> bool {
    match word(pins, pad) {
        Some(word) => *word >> (pad & 15) & 1 != 0,
        None => pins.gpio_out >> output(pad) & 1 != 0,
    }
}

fn set(pins: &mut Pins, pad: u8, level: bool) {
    match word(pins, pad) {
        Some(word) => *word = *word & !(1 << (pad & 15)) | u16::from(level) << (pad & 15),
        None => {
            let n = output(pad);
            pins.gpio_out = pins.gpio_out & !(1 << n) | u64::from(level) << n;
        }
    }
}

/// The registers of the page `pads`, of pins like these.
pub fn registers(pins: &Pins) -> [u32; 5] {
    let both = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
    [
        both(pins.step, pins.dir),
        both(pins.step_n, pins.dir_n),
        both(pins.pwm_out, pins.pwm_dir),
        pins.gpio_out as u32,
        (pins.gpio_out >> 32) as u32,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_at_its_pad_and_nowhere_else() {
        let driven = Pins {
            step: 0b10,
            gpio_out: 0b100,
            ..Pins::default()
        };
        let seen = |fault: Fault| {
            let mut pins = driven;
            fault.put(&mut pins);
            registers(&levels(&pins))
        };
        assert_eq!(seen(Fault::None), [0b10, 0, 0, 0b100, 0]);
        assert_eq!(seen(Fault::Low(Pad::Step(1))), [0, 0, 0, 0b100, 0]);
        assert_eq!(
            seen(Fault::High(Pad::DirN(15))),
            [0b10, 1 << 31, 0, 0b100, 0]
        );
        assert_eq!(
            seen(Fault::High(Pad::Output(31))),
            [0b10, 0, 0, 0b100 | 1 << 31, 0]
        );
        assert_eq!(
            seen(Fault::High(Pad::Output(63))),
            [0b10, 0, 0, 0b100, 1 << 31]
        );
        let joined = Fault::Short(Pad::Step(1), Pad::Output(2));
        assert_eq!(seen(joined), [0b10, 0, 0, 0b100, 0]);
        assert_eq!(
            seen(Fault::Short(Pad::Pwm(0), Pad::Output(2))),
            [0b10, 0, 0, 0, 0]
        );
    }
}
