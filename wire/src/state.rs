//! The states of the machine and why it stopped: words for host, firmware and operator.

use crate::codes::codes;

codes! {
    /// The safety state machine's states (`Boot -> Disarmed -> Armed -> Stopping -> Faulted ->
    /// Disarmed`).
    State: u8 {
        /// Firmware has not finished starting.
        Boot = 0, "boot";
        /// Outputs safe; waiting for a session, `enable` and a rising edge of `enable-request`.
        Disarmed = 1, "disarmed";
        /// Outputs live, commands executed.
        Armed = 2, "armed";
        /// A soft stop is running; then Disarmed or Faulted.
        Stopping = 3, "stopping";
        /// Outputs safe, reason latched; only a full resync and a new rising edge end it.
        Faulted = 4, "faulted";
    }
}

codes! {
    /// Why the machine stopped.
    FaultReason: u8 {
        /// It did not stop.
        None = 0, "none";
        /// No accepted command within the watchdog's timeout.
        Watchdog = 1, "watchdog: no accepted command within the timeout";
        /// The external reset pin was high.
        ExternalReset = 2, "external reset pin";
        /// The host cleared `enable`.
        HostDisable = 3, "host disabled";
        /// The session was released or taken over.
        SessionLost = 4, "session lost";
        /// The Ethernet link went down.
        LinkDown = 5, "link down";
        /// The firmware panicked or trapped; the text is in the panic window.
        FirmwareFault = 6, "firmware fault";
        /// A job ran out of segments.
        JobUnderrun = 7, "job underrun";
        /// Gateware and firmware were built from different register maps.
        AbiMismatch = 8, "ABI mismatch between gateware and firmware";
        /// An e-stop input tripped.
        EStop = 9, "e-stop input";
    }
}

impl FaultReason {
    /// What the operator can do about it, in one sentence.
    pub const fn remedy(self) -> &'static str {
        match self {
            FaultReason::None => "Nothing is wrong; enable the machine to move it.",
            FaultReason::Watchdog => {
                "No command came in time: check cable, switch and the computer's latency, then enable again."
            }
            FaultReason::ExternalReset => {
                "Release the external reset or emergency stop, then enable again."
            }
            FaultReason::HostDisable => "LinuxCNC switched the machine off; enable it there.",
            FaultReason::SessionLost => {
                "LinuxCNC ended or another host took the board: start LinuxCNC again, then enable."
            }
            FaultReason::LinkDown => {
                "Check the cable and the other end's power, wait for the link, then enable again."
            }
            FaultReason::FirmwareFault => {
                "The firmware failed and started again: read the log, home again, and report it."
            }
            FaultReason::JobUnderrun => {
                "The job's source was too slow: start the job again, from the board's own store."
            }
            FaultReason::AbiMismatch => {
                "Firmware and gateware are of different builds: flash an image that has both."
            }
            FaultReason::EStop => "Release the emergency stop, then enable again.",
        }
    }
}

codes! {
    /// Why the firmware started.
    ResetReason: u8 {
        /// The board was switched on, or its bitstream loaded.
        PowerUp = 0, "power-up";
        /// A client asked for it.
        Requested = 1, "reboot requested";
        /// The firmware panicked; the text is in the panic window.
        Panic = 2, "firmware panic";
        /// The processor trapped; the text is in the panic window.
        Trap = 3, "processor trap";
        /// It restarted without recording a reason.
        Unknown = 4, "unknown";
    }
}

codes! {
    /// Why the gate closed last; the gateware remembers it through every restart of the firmware.
    GateClose: u8 {
        /// It has not been open since power-up.
        Never = 0, "never opened";
        /// The watchdog bit and the soft stop is over.
        Bite = 1, "watchdog bite";
        /// The external reset pin.
        ExternalReset = 2, "external reset pin";
        /// The firmware closed it.
        Order = 3, "closed by order";
        /// A soft stop that the firmware commanded is over.
        SoftStop = 4, "soft stop";
        /// An e-stop input.
        EStop = 5, "e-stop input";
        /// The whole system was reset.
        SystemReset = 6, "system reset";
    }
}

codes! {
    /// The speed of the Ethernet link, reported by the PHY in band.
    LinkSpeed: u8 {
        /// Down, or not known yet.
        Down = 0, "down";
        /// 10 Mbit/s.
        M10 = 1, "10 Mbit/s";
        /// 100 Mbit/s.
        M100 = 2, "100 Mbit/s";
        /// 1000 Mbit/s.
        M1000 = 3, "1000 Mbit/s";
    }
}

impl LinkSpeed {
    /// In Mbit/s; 0 when down.
    pub const fn mbit(self) -> u32 {
        match self {
            LinkSpeed::Down => 0,
            LinkSpeed::M10 => 10,
            LinkSpeed::M100 => 100,
            LinkSpeed::M1000 => 1000,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_is_as_fast_as_it_is_called() {
        for (speed, mbit) in LinkSpeed::ALL.iter().zip([0, 10, 100, 1000]) {
            assert_eq!(speed.mbit(), mbit, "{speed}");
        }
    }
}
