//! The reaction to missing answers, a late thread, a stop of another board of the group, and a
//! change of `io-error` by hand.

use super::{Driver, Phase};
use crate::blocks::Period;
use crate::fault::Fault;
use crate::hal::Level;
use wire::exchange::Status;
use wire::{FaultReason, State};

/// `fault-reason` from here on: stopped because board n of the group has stopped.
pub const GROUP_REASON: u32 = 100;

impl Driver {
    /// The last command was not answered in time.
    pub(super) fn unanswered(&mut self, period: Period) {
        self.exchange.missing = self.exchange.missing.saturating_add(1);
        self.notifier.missed();
        if self.exchange.missing == 1 && self.condition.live {
            for stepgen in &mut self.blocks.stepgens {
                stepgen.bridge(period);
            }
        }
        if self.blocks.packets.missing() {
            self.give_up();
        }
    }

    /// The bucket is full. After so many missing answers the driver must assume that the machine is
    /// no longer driven.
    pub(super) fn give_up(&mut self) {
        self.blocks.ethernet.lost();
        self.pins.position_trusted.set(false);
        self.raise_io_error();
        let was_live = self.condition.live;
        self.no_longer_live();
        let timeout = self.blocks.watchdog.timeout_ns();
        // A simulated board in lockstep knows nothing of this computer's time.
        let held_up = self.times.held_up > timeout && self.times.clock.known();
        let reason = if held_up {
            FaultReason::Watchdog
        } else {
            FaultReason::LinkDown
        };
        if was_live {
            self.condition.reason = reason;
            self.pins.fault_reason.set(u32::from(reason.code()));
        }
        self.tell_group();
        if self.grouped() {
            self.group.shared.raise(self.index);
        }
        let others = self.stops_others();
        if held_up && was_live {
            self.notifier.once(
                Fault::HeldUp,
                format_args!(
                    "the servo thread came {:.1} ms late, the watchdog waits {:.1} ms: the board stops the machine{others}; {}",
                    self.times.held_up as f64 * 1e-6,
                    timeout as f64 * 1e-6,
                    Fault::HeldUp.remedy(),
                ),
            );
        } else if was_live {
            self.notifier.once(
                Fault::Silent,
                format_args!(
                    "too many answers missing, {} in a row: the board's watchdog stops the machine{others}; {}, then enable again",
                    self.exchange.missing,
                    Fault::Silent.remedy()
                ),
            );
        } else {
            self.notifier.once(
                Fault::Silent,
                format_args!(
                    "too many answers missing, {} in a row; {}",
                    self.exchange.missing,
                    Fault::Silent.remedy()
                ),
            );
        }
        self.session.phase = Phase::Acquiring { wait: 0, tag: 0 };
    }

    /// It counts as stopped, even if the board reports otherwise.
    fn no_longer_live(&mut self) {
        self.condition.live = false;
        self.pins.enabled.set(false);
    }

    /// Only `enable` false is sent until an answer to such a command says that the board is not
    /// armed.
    fn stop(&mut self) {
        self.condition.halting = Some(self.exchange.sequence);
        self.session.arm.forget();
        self.no_longer_live();
    }

    /// Whether this board stops with the others of its group.
    pub(super) fn grouped(&self) -> bool {
        self.group.several && self.pins.stop_group.get()
    }

    /// For a message about this board.
    pub(super) fn stops_others(&self) -> &'static str {
        if self.grouped() {
            " and the other boards with it"
        } else {
            ""
        }
    }

    /// Tells the group whether this board answers, if it is in the group.
    pub(super) fn tell_group(&self) {
        let lost = self.grouped() && self.blocks.packets.exceeded();
        self.group.shared.answers(self.index, !lost);
    }

    /// Another board has raised the alarm: this one stops by its next command.
    pub(super) fn follow_group(&mut self) {
        let Some(cause) = self.group.shared.alarm(&mut self.group.alarm_heard) else {
            return;
        };
        if cause == self.index || !self.grouped() {
            return;
        }
        if self.condition.live {
            self.group.stopped_by = Some(cause);
            self.notifier
                .tell(Level::Info, format_args!("stops because of board {cause}"));
        }
        self.stop();
        self.publish_reason();
    }

    /// `io-error` belongs to the operator as well: cleared, a silent board is asked at once, and if
    /// it answers the bucket is empty; set, the machine stops as if the bucket were full.
    pub(super) fn follow_io_error(&mut self) {
        let now = self.pins.io_error.get();
        if core::mem::replace(&mut self.condition.io_error, now) == now {
            return;
        }
        if now {
            if self.grouped() {
                self.group.shared.raise(self.index);
            }
            self.stop();
        } else if let Phase::Acquiring { wait, tag } = &mut self.session.phase {
            (*wait, *tag) = (0, 0);
        } else {
            self.blocks.packets.recovered();
        }
    }

    pub(super) fn raise_io_error(&mut self) {
        self.condition.io_error = true;
        self.pins.io_error.set(true);
    }

    pub(super) fn clear_io_error(&mut self) {
        self.condition.io_error = false;
        self.pins.io_error.set(false);
    }

    /// Another board of the group does not answer: an edge of `enable-request` is used up and says
    /// so.
    pub(super) fn refuse_alone(&mut self, pin: bool) -> bool {
        let lost = match self.group.shared.lost_beside(self.index) {
            Some(lost) if self.grouped() => lost,
            Some(_) | None => return false,
        };
        if self.session.arm.refuse(pin) {
            self.notifier.tell(
                Level::Error,
                format_args!("not enabled: board {lost} of the group does not answer"),
            );
        }
        true
    }

    /// How late `write` is called, without the time that `read` waited.
    pub(super) fn mind_the_time(&mut self) {
        let now = self.times.now();
        let before = self.times.wrote.replace(now);
        let waited = core::mem::take(&mut self.times.waited);
        // Once commands stay without answers, later ones prove nothing.
        if let Some(before) = before
            && self.exchange.missing == 0
        {
            self.times.held_up = now - before - waited;
        }
    }

    /// What the board says of itself.
    pub(super) fn follow_state(&mut self, status: &Status, clock_hz: f64) {
        let word = status.state;
        let armed_there = word.state == State::Armed && word.enabled;
        if let Some(since) = self.condition.halting
            && !armed_there
            && status.sequence.wrapping_sub(since) as i32 > 0
        {
            self.condition.halting = None;
        }
        let armed = armed_there && self.condition.halting.is_none();
        if armed && !self.condition.live {
            self.blocks.watchdog.armed();
            self.clear_io_error();
            self.notifier.armed();
            self.group.stopped_by = None;
            self.condition.restarted = false;
        }
        // The watchdog was still asleep when the command that armed arrived: its margin is valid
        // from the next command on.
        let awake = armed && self.condition.live;
        self.blocks
            .watchdog
            .sampled(word.bitten, status.watchdog_left, awake, clock_hz);
        let fell = self.condition.live && !armed && self.condition.halting.is_none();
        self.condition.live = armed;
        if word.state == State::Faulted && self.condition.state != State::Faulted {
            // The board stays in its fault until the driver acquires the session again; it reports
            // the reason until then.
            self.session.phase = Phase::Acquiring { wait: 0, tag: 0 };
        }
        self.condition.state = word.state;
        self.pins.enabled.set(armed);
        self.pins.state.set(u32::from(word.state.code()));
        self.pins
            .position_trusted
            .set(word.position_trusted && !self.condition.restarted);
        self.pins.refused_total.set(status.refused.0);
        self.pins.estop.set(word.estop);
        self.pins.services.set(word.services.code());
        self.blocks.ethernet.sampled(&word);
        if fell && word.reason != FaultReason::HostDisable && self.grouped() {
            self.group.shared.raise(self.index);
        }
        let news = core::mem::replace(&mut self.condition.reason, word.reason) != word.reason;
        self.publish_reason();
        if news {
            self.tell_reason();
        }
    }

    fn publish_reason(&self) {
        let code = match (self.group.stopped_by, self.condition.reason) {
            (Some(cause), FaultReason::None | FaultReason::HostDisable) => {
                GROUP_REASON + cause as u32
            }
            (_, reason) => u32::from(reason.code()),
        };
        self.pins.fault_reason.set(code);
    }

    /// What the operator was told last; if nothing, why the machine stopped.
    pub(super) fn publish_fault(&self) {
        let reason = self.condition.reason;
        let fault = match (self.notifier.latest(), self.group.stopped_by, reason) {
            (Some(told), _, _) => told,
            (None, _, _) if self.condition.live => Fault::Board(FaultReason::None),
            (None, Some(_), FaultReason::None | FaultReason::HostDisable) => Fault::Group,
            (None, _, reason) => Fault::Board(reason),
        };
        self.pins.fault_code.set(fault.code());
    }

    fn tell_reason(&mut self) {
        let reason = self.condition.reason;
        let known = match reason {
            FaultReason::None => return,
            FaultReason::HostDisable => true,
            // The board's view of the silence.
            FaultReason::Watchdog | FaultReason::SessionLost | FaultReason::LinkDown => {
                self.notifier.has_told(Fault::Silent) || self.notifier.has_told(Fault::HeldUp)
            }
            // The reason of the restart has just been told.
            FaultReason::FirmwareFault => self.notifier.has_told(Fault::Restarted),
            FaultReason::ExternalReset
            | FaultReason::JobUnderrun
            | FaultReason::AbiMismatch
            | FaultReason::EStop => false,
        };
        if known {
            return self.notifier.tell(Level::Info, format_args!("{reason}"));
        }
        let others = self.stops_others();
        self.notifier.once(
            Fault::Board(reason),
            format_args!("the board stopped the machine{others}: {reason}; remove the cause, then enable again"),
        );
    }
}
