//! `watchdog.sv`: the gate, and everything that closes it.

use wire::regmap::watchdog;

/// Why the gate closed last, as the gateware numbers it.
mod close {
    use wire::regmap::watchdog;

    pub const BITE: u8 = watchdog::LAST_CLOSE_REASON_BITE as u8;
    pub const EXT_RESET: u8 = watchdog::LAST_CLOSE_REASON_EXT_RESET as u8;
    pub const STOP_KEY: u8 = watchdog::LAST_CLOSE_REASON_STOP as u8;
    pub const SOFT_STOP: u8 = watchdog::LAST_CLOSE_REASON_SOFT as u8;
    pub const E_STOP: u8 = watchdog::LAST_CLOSE_REASON_ESTOP as u8;
    pub const SYSTEM_RESET: u8 = watchdog::LAST_CLOSE_REASON_SYS_RESET as u8;
}

/// The watchdog and its gate.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Watchdog {
    open: bool,
    stop: bool,
    bitten: bool,
    reset_latched: bool,
    estop_latched: bool,
    armed: bool,
    last_close: u8,
    remaining: u32,
    last_token: u32,
    bites: u32,
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// System reset.
    pub rst: bool,
    /// The synchronised reset pin.
    pub ext_reset: bool,
    /// An e-stop input is active.
    pub estop: bool,
    /// A token is written.
    pub token: Option<u32>,
    /// The fast path has executed a command.
    pub feed: bool,
    /// The key words.
    pub arm: bool,
    /// See `arm`.
    pub soft_stop: bool,
    /// See `arm`.
    pub shut: bool,
    /// See `arm`.
    pub clear: bool,
    /// Clocks without a new token until it bites.
    pub timeout: u32,
    /// Longest soft stop.
    pub grace: u32,
    /// Every stepgen has obeyed `stop`.
    pub all_stopped: bool,
}

impl Watchdog {
    /// Outputs are live in this clock.
    pub fn gate(&self, ext_reset: bool, estop: bool) -> bool {
        self.open && !ext_reset && !estop
    }

    /// `clear` is obeyed in this clock.
    pub fn cleared(&self, input: &Input) -> bool {
        input.clear && !self.open && !input.ext_reset && !input.estop
    }

    /// A soft stop is running.
    pub fn stop(&self) -> bool {
        self.stop
    }

    /// The status register's bits.
    pub fn status(&self, ext_reset: bool, estop: bool) -> u32 {
        [
            (self.gate(ext_reset, estop), watchdog::STATUS_GATE),
            (self.stop, watchdog::STATUS_STOPPING),
            (self.bitten, watchdog::STATUS_BITTEN),
            (self.reset_latched, watchdog::STATUS_RESET_LATCHED),
            (ext_reset, watchdog::STATUS_RESET_PIN),
            (self.armed, watchdog::STATUS_ARMED),
            (self.estop_latched, watchdog::STATUS_ESTOP_LATCHED),
            (estop, watchdog::STATUS_ESTOP_NOW),
        ]
        .into_iter()
        .fold(0, |word, (on, bit)| if on { word | bit } else { word })
    }

    /// Clocks until it bites, or until a soft stop ends.
    pub fn remaining(&self) -> u32 {
        self.remaining
    }

    /// The last token.
    pub fn last_token(&self) -> u32 {
        self.last_token
    }

    /// How often it has bitten.
    pub fn bites(&self) -> u32 {
        self.bites
    }

    /// Why the gate closed last.
    pub fn last_close(&self) -> u8 {
        self.last_close
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let pins = i.ext_reset || i.estop;
        let cleared = self.cleared(i);
        let fed = i.feed || i.token.is_some_and(|token| token != self.last_token);
        let done = self.remaining == 0;
        let bite = self.armed && done && !fed;
        let latched = self.bitten || self.reset_latched || self.estop_latched;
        let opens = !self.open && i.arm && !latched && !pins && !i.shut && !i.rst;
        let shuts =
            self.open && (pins || i.rst || i.shut || (self.stop && (i.all_stopped || done)));
        let stops = self.armed && (bite || i.soft_stop);

        if shuts {
            self.last_close = if i.estop {
                close::E_STOP
            } else if i.ext_reset {
                close::EXT_RESET
            } else if self.bitten || bite {
                close::BITE
            } else if i.rst {
                close::SYSTEM_RESET
            } else if i.shut {
                close::STOP_KEY
            } else {
                close::SOFT_STOP
            };
        }
        self.remaining = if (!self.open || shuts) && !opens {
            0
        } else if opens || (fed && self.armed && !stops) {
            i.timeout
        } else if stops {
            i.grace
        } else {
            self.remaining.wrapping_sub(1)
        };
        self.last_token = i.token.unwrap_or(self.last_token);
        self.stop = !shuts && (self.stop || stops) && self.open;
        self.armed = opens || (self.armed && !shuts && !stops);
        self.bitten = ((self.bitten && !cleared) || bite) && !i.rst;
        self.reset_latched = (self.reset_latched && !cleared && !i.rst) || i.ext_reset;
        self.estop_latched = (self.estop_latched && !cleared) || i.estop;
        self.bites = self.bites.wrapping_add(bite.into());
        self.open = opens || (self.open && !shuts);
    }

    /// Clocks in which it does nothing by itself but count.
    pub fn quiet(&self) -> u64 {
        if self.open {
            u64::from(self.remaining)
        } else {
            u64::MAX
        }
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64) {
        if self.open {
            self.remaining -= clocks as u32;
        }
    }
}

#[cfg(test)]
mod tests;
