//! The invariants of the state machine: what must hold in every step from every state, one sentence
//! each.

use super::{Effects, Event, Request, Safety};
use crate::cores::{Control, Gate};
use wire::{FaultReason, State};

/// A step of the state machine.
struct Step<'a> {
    before: &'a Safety,
    event: Event,
    after: &'a Safety,
    effects: &'a Effects,
    /// The gate as the event shows it.
    gate: Option<Gate>,
}

/// Does the step from `before` to `after` keep all invariants? If not, the error is the broken one.
pub(super) fn hold(
    before: &Safety,
    event: Event,
    after: &Safety,
    effects: &Effects,
) -> Result<(), &'static str> {
    let gate = match event {
        Event::Command { gate, .. } | Event::Gate(gate) => Some(gate),
        Event::Booted { .. }
        | Event::Acquired
        | Event::Lost
        | Event::LinkDown
        | Event::JobUnderrun => None,
    };
    let step = Step {
        before,
        event,
        after,
        effects,
        gate,
    };
    step.arming()?;
    step.armed()?;
    step.end_of_a_fault()?;
    step.faults()?;
    step.transitions()?;
    step.orders()?;
    step.session()
}

fn keep(holds: bool, promise: &'static str) -> Result<(), &'static str> {
    if holds { Ok(()) } else { Err(promise) }
}

fn faulted(machine: &Safety) -> bool {
    machine.state == State::Faulted
}

/// Faulted, or on the way there.
fn strikes(machine: &Safety) -> bool {
    faulted(machine) || machine.state == State::Stopping && machine.after_stop == State::Faulted
}

impl Step<'_> {
    fn arms(&self) -> bool {
        self.effects.order == Some(Control::Arm)
    }

    /// Into Armed.
    fn arming(&self) -> Result<(), &'static str> {
        let Self {
            before,
            event,
            after,
            ..
        } = *self;
        let arms = self.arms();
        keep(
            arms == (before.state != State::Armed && after.state == State::Armed),
            "the gate opens if and only if the machine becomes armed",
        )?;
        if arms {
            let Event::Command {
                enable,
                request,
                gate,
            } = event
            else {
                return Err("only a fresh command arms");
            };
            keep(
                before.state == State::Disarmed,
                "only Disarmed becomes Armed",
            )?;
            keep(before.session, "arming needs a session")?;
            keep(before.abi_fits, "arming needs an ABI that fits")?;
            keep(!before.held, "a held machine is not armed")?;
            keep(
                enable && request,
                "arming needs enable and the request still high",
            )?;
            keep(
                before.request == Request::Edge,
                "a rising edge of the request comes a command before arming",
            )?;
            keep(
                !gate.open() && !gate.latched() && !gate.pinned(),
                "no arming with a latch set, an active pin or an open gate",
            )?;
        }
        Ok(())
    }

    /// While Armed.
    fn armed(&self) -> Result<(), &'static str> {
        let Self {
            event,
            after,
            effects,
            gate,
            ..
        } = *self;
        let arms = self.arms();
        if after.state == State::Armed {
            keep(
                after.session && after.abi_fits,
                "Armed needs a session and an ABI that fits",
            )?;
            keep(
                after.reason == FaultReason::None,
                "Armed has no fault reason",
            )?;
            if let Some(gate) = gate.filter(|_| !arms) {
                keep(
                    gate.open() && !gate.pinned() && !gate.bitten(),
                    "Armed ends when the gate is not live",
                )?;
            }
        }
        keep(
            !effects.execute
                || after.state == State::Armed && matches!(event, Event::Command { .. }),
            "only an armed machine executes, and only commands",
        )?;
        Ok(())
    }

    /// Out of Faulted.
    fn end_of_a_fault(&self) -> Result<(), &'static str> {
        let Self {
            before,
            event,
            after,
            effects,
            ..
        } = *self;
        if faulted(before) && !faulted(after) {
            let Event::Command { request, gate, .. } = event else {
                return Err("only a command ends a fault");
            };
            keep(after.state == State::Disarmed, "a fault ends in Disarmed")?;
            keep(
                request && before.request == Request::Low,
                "only a rising edge ends a fault",
            )?;
            keep(
                before.session && before.resynced,
                "a fault ends only after a full resync",
            )?;
            keep(
                before.abi_fits && !gate.open() && !gate.pinned_now(),
                "a fault ends only when its cause is gone",
            )?;
            keep(
                effects.order == Some(Control::Clear),
                "the end of a fault clears the latches",
            )?;
        }
        Ok(())
    }

    /// Fault and resync.
    fn faults(&self) -> Result<(), &'static str> {
        let Self {
            before,
            event,
            after,
            ..
        } = *self;
        keep(
            !faulted(after) || after.reason != FaultReason::None,
            "a fault has a reason",
        )?;
        keep(
            !faulted(before) || !faulted(after) || before.reason == after.reason,
            "a fault keeps its reason",
        )?;
        keep(
            before.resynced || !after.resynced || event == Event::Acquired,
            "only acquiring resynchronises",
        )?;
        keep(
            !after.resynced || after.session,
            "a resync ends with its session",
        )?;
        keep(
            !strikes(after) || strikes(before) || !after.resynced || event == Event::Acquired,
            "a fault invalidates earlier knowledge",
        )?;
        Ok(())
    }

    /// Ways between states.
    fn transitions(&self) -> Result<(), &'static str> {
        let Self {
            before,
            event,
            after,
            ..
        } = *self;
        let may = match before.state {
            State::Boot => [State::Boot, State::Disarmed, State::Faulted].contains(&after.state),
            State::Disarmed => [State::Disarmed, State::Armed].contains(&after.state),
            State::Armed => [State::Armed, State::Stopping, State::Faulted].contains(&after.state),
            State::Stopping => {
                [State::Stopping, State::Disarmed, State::Faulted].contains(&after.state)
            }
            State::Faulted => [State::Faulted, State::Disarmed].contains(&after.state),
        };
        keep(may, "this transition does not exist")?;
        keep(
            before.state != State::Boot
                || after.state == State::Boot
                || matches!(event, Event::Booted { .. }),
            "Boot ends with start-up",
        )?;
        keep(
            before.state != State::Stopping
                || after.state != State::Disarmed
                || before.reason == FaultReason::HostDisable,
            "only a stop that the host asked for ends in Disarmed",
        )?;
        Ok(())
    }

    /// The gate's orders.
    fn orders(&self) -> Result<(), &'static str> {
        let Self {
            before,
            after,
            effects,
            gate,
            ..
        } = *self;
        let order = effects.order;
        keep(
            (order == Some(Control::SoftStop))
                == (before.state == State::Armed && after.state == State::Stopping)
                || order.is_none() && effects.end_session,
            "a soft stop is ordered when Armed becomes Stopping, unless a bite has begun it",
        )?;
        if let Some(gate) = gate {
            keep(
                order != Some(Control::Clear) || !gate.open(),
                "nothing is cleared while the gate is open",
            )?;
            keep(
                !before.at_rest() || !gate.open() || order == Some(Control::Close),
                "an open gate at rest is closed",
            )?;
        }
        keep(
            order != Some(Control::Close) || after.state != State::Armed,
            "Armed does not close its gate",
        )?;
        Ok(())
    }

    /// Session, hold, ABI, trust.
    fn session(&self) -> Result<(), &'static str> {
        let Self {
            before,
            event,
            after,
            effects,
            ..
        } = *self;
        let arms = self.arms();
        keep(
            !effects.end_session || !after.session,
            "an ended session is gone",
        )?;
        keep(
            !before.session || after.session || effects.end_session || event == Event::Lost,
            "a session that ends here is ended for its owner too",
        )?;
        keep(
            before.session || !after.session || event == Event::Acquired,
            "only acquiring makes a session",
        )?;
        keep(before.held == after.held, "no event changes the hold")?;
        keep(
            before.abi_fits == after.abi_fits || matches!(event, Event::Booted { .. }),
            "the ABI is compared once",
        )?;
        keep(
            before.position_trusted || !after.position_trusted || arms,
            "trust comes back with arming, never by itself",
        )?;
        if before.position_trusted && !after.position_trusted {
            let moving = matches!(before.state, State::Armed | State::Stopping);
            keep(
                moving || before.state == State::Boot,
                "a machine at rest cannot lose steps",
            )?;
        }
        Ok(())
    }
}
