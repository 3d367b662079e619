//! What became of the services, in the description's features and in the state word.

use crate::codes::codes;

codes! {
    /// How the services are, and with them the jobs of a board with
    /// [`crate::describe::FEATURE_JOBS`]: the feature bits from [`JobsState::AT`] on.
    JobsState: u32 {
        /// The board uses no SDRAM, and has no segments either.
        None = 0, "none: no SDRAM is used";
        /// The services run.
        Alive = 1, "ready";
        /// The SDRAM does not keep what is written into it.
        Sdram = 2, "the SDRAM failed its test";
        /// The image that runs has no services: it was loaded by JTAG, or built without one.
        Missing = 3, "no program in flash";
        /// The program's CRC or length is wrong.
        Damaged = 4, "the program is damaged";
        /// The program was built for another register map or another ROM.
        Foreign = 5, "the program is of another build";
        /// The board has no SDRAM and executes no job by itself; its owner may write the segments'
        /// registers.
        Streamed = 6, "a PC streams them (ferrocnc job serve)";
        /// The services failed while the board ran; the machine is as it was. The board loads them
        /// again as soon as no host owns it.
        Ended = 7, "the services failed";
        /// The board copies the services from its flash. It goes on with that whenever no host owns
        /// it.
        Loading = 8, "the services are being loaded";
        /// The services failed as often as the board loads them again; the machine is as it was.
        GivenUp = 9, "the services failed four times";
    }
}

impl JobsState {
    /// Lowest of its bits in the features.
    pub const AT: u32 = 16;
    /// The four of them, moved down.
    pub const MASK: u32 = 15;

    /// May the owner write [`crate::map::SEGMENTS`]?
    pub const fn streamed(features: u32) -> bool {
        features >> Self::AT & Self::MASK == Self::Streamed as u32
    }

    /// From the features; an unknown code counts as damaged.
    pub fn of(features: u32) -> Self {
        Self::from_code(features >> Self::AT & Self::MASK).unwrap_or(Self::Damaged)
    }
}
