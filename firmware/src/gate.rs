//! How the gate in front of all outputs reads.

use wire::regmap::watchdog;

/// The watchdog's `status` register.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gate(pub u32);

impl Gate {
    /// What a healthy armed machine reads: gate open, watchdog awake, nothing else.
    pub const LIVE: Gate = Gate(Gate::OPEN | Gate::AWAKE);
    const OPEN: u32 = watchdog::STATUS_GATE;
    const STOPPING: u32 = watchdog::STATUS_STOPPING;
    const BITTEN: u32 = watchdog::STATUS_BITTEN;
    const RESET: u32 = watchdog::STATUS_RESET_LATCHED;
    const RESET_PIN: u32 = watchdog::STATUS_RESET_PIN;
    const AWAKE: u32 = watchdog::STATUS_ARMED;
    const ESTOP: u32 = watchdog::STATUS_ESTOP_LATCHED;
    const ESTOP_PIN: u32 = watchdog::STATUS_ESTOP_NOW;

    /// Outputs are live.
    pub const fn open(self) -> bool {
        self.0 & Self::OPEN != 0
    }
    /// A soft stop is running.
    pub const fn stopping(self) -> bool {
        self.0 & Self::STOPPING != 0
    }
    /// The latched bite.
    pub const fn bitten(self) -> bool {
        self.0 & Self::BITTEN != 0
    }
    /// The latched external reset.
    pub const fn reset(self) -> bool {
        self.0 & Self::RESET != 0
    }
    /// The external reset pin now.
    pub const fn reset_pin(self) -> bool {
        self.0 & Self::RESET_PIN != 0
    }
    /// The watchdog counts.
    pub const fn awake(self) -> bool {
        self.0 & Self::AWAKE != 0
    }
    /// The latched e-stop.
    pub const fn estop(self) -> bool {
        self.0 & Self::ESTOP != 0
    }
    /// An e-stop input is active now.
    pub const fn estop_pin(self) -> bool {
        self.0 & Self::ESTOP_PIN != 0
    }
    /// A pin stops the machine, or did: external reset or e-stop.
    pub const fn pinned(self) -> bool {
        self.0 & (Self::RESET | Self::RESET_PIN | Self::ESTOP | Self::ESTOP_PIN) != 0
    }
    /// A pin stops the machine now: nothing can be cleared.
    pub const fn pinned_now(self) -> bool {
        self.0 & (Self::RESET_PIN | Self::ESTOP_PIN) != 0
    }
    /// A latched condition that only [`Control::Clear`] resets.
    pub const fn latched(self) -> bool {
        self.0 & (Self::BITTEN | Self::RESET | Self::ESTOP) != 0
    }
}
