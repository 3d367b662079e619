//! Step timings of drives, so that a drive needs no data sheet if it is a known one.

use crate::units::Nanoseconds;

/// What a drive wants of its STEP and DIR signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// How long STEP is active.
    pub steplen: Nanoseconds,
    /// How long it is inactive at least.
    pub stepspace: Nanoseconds,
    /// From a change of DIR to the next STEP.
    pub dirsetup: Nanoseconds,
    /// From the end of a STEP to a change of DIR.
    pub dirhold: Nanoseconds,
}

impl Timing {
    const fn new([steplen, stepspace, dirsetup, dirhold]: [u32; 4]) -> Self {
        Timing {
            steplen: Nanoseconds(steplen),
            stepspace: Nanoseconds(stepspace),
            dirsetup: Nanoseconds(dirsetup),
            dirhold: Nanoseconds(dirhold),
        }
    }

    /// A step and the pause behind it.
    pub fn period(self) -> Nanoseconds {
        Nanoseconds(self.steplen.0.saturating_add(self.stepspace.0))
    }

    /// The timing of a preset.
    pub fn of(preset: &str) -> Option<Self> {
        let found = PRESETS.iter().find(|(name, _)| *name == preset);
        found.map(|(_, timing)| *timing)
    }
}

/// The drives of LinuxCNC's stepconf, with its numbers: step time, step space, direction setup and
/// direction hold, in nanoseconds. `generic` is slow enough for any of them but sherline's and
/// oem750's.
pub const PRESETS: [(&str, Timing); 16] = [
    ("generic", Timing::new([5_000, 5_000, 20_000, 20_000])),
    ("gecko201", Timing::new([500, 4_000, 20_000, 1_000])),
    ("gecko202", Timing::new([500, 4_500, 20_000, 1_000])),
    ("gecko203v", Timing::new([1_000, 2_000, 200, 200])),
    ("gecko210", Timing::new([500, 4_000, 20_000, 1_000])),
    ("gecko212", Timing::new([500, 4_000, 20_000, 1_000])),
    ("gecko320", Timing::new([3_500, 500, 200, 200])),
    ("gecko540", Timing::new([5_000, 5_000, 10_000, 10_000])),
    ("l297", Timing::new([500, 4_000, 4_000, 1_000])),
    ("pmdx150", Timing::new([1_000, 2_000, 1_000, 1_000])),
    ("sherline", Timing::new([22_000, 22_000, 100_000, 100_000])),
    ("xylotex", Timing::new([2_000, 1_000, 200, 200])),
    ("oem750", Timing::new([1_000, 1_000, 1_000, 200_000])),
    ("jvlsmd41", Timing::new([500, 500, 2_500, 2_500])),
    ("hobbycnc", Timing::new([2_000, 2_000, 2_000, 2_000])),
    ("keling", Timing::new([5_000, 5_000, 20_000, 20_000])),
];

/// Their names.
pub const NAMES: [&str; 16] = {
    let mut names = [""; 16];
    let mut n = 0;
    while n < names.len() {
        names[n] = PRESETS[n].0;
        n += 1;
    }
    names
};
