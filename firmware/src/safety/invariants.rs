//! What must hold of every step of the state machine from anywhere, one sentence each.

use super::{Effects, Event, Request, Safety};
use crate::cores::Control;
use wire::{FaultReason, State};

/// Does the step from `before` to `after` keep every promise? If not, which one is broken.
pub(super) fn hold(
    before: &Safety,
    event: Event,
    after: &Safety,
    effects: &Effects,
) -> Result<(), &'static str> {
    let keep = |holds: bool, promise: &'static str| if holds { Ok(()) } else { Err(promise) };
    let gate = match event {
        Event::Command { gate, .. } | Event::Gate(gate) => Some(gate),
        Event::Booted { .. }
        | Event::Acquired
        | Event::Lost
        | Event::LinkDown
        | Event::JobUnderrun => None,
    };
    let arms = effects.order == Some(Control::Arm);
    let faulted = |machine: &Safety| machine.state == State::Faulted;

    // Into Armed.
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
        keep(!before.held, "what is held is not armed")?;
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
            "nothing arms over what is latched, a pin, or an open gate",
        )?;
    }

    // While Armed.
    if after.state == State::Armed {
        keep(
            after.session && after.abi_fits,
            "Armed is with a session and an ABI that fits",
        )?;
        keep(
            after.reason == FaultReason::None,
            "Armed has no reason to have stopped",
        )?;
        if let Some(gate) = gate.filter(|_| !arms) {
            keep(
                gate.open() && !gate.pinned() && !gate.bitten(),
                "Armed does not outlive what the gate says",
            )?;
        }
    }
    keep(
        !effects.execute || after.state == State::Armed && matches!(event, Event::Command { .. }),
        "only an armed machine executes, and only commands",
    )?;

    // Out of Faulted.
    if faulted(before) && !faulted(after) {
        let Event::Command { request, gate, .. } = event else {
            return Err("a fault is left by a command");
        };
        keep(
            after.state == State::Disarmed,
            "a fault is left for Disarmed",
        )?;
        keep(
            request && before.request == Request::Low,
            "a fault is left by a rising edge",
        )?;
        keep(
            before.session && before.resynced,
            "a fault is left after a full resync",
        )?;
        keep(
            before.abi_fits && !gate.open() && !gate.pinned_now(),
            "a fault is left when its cause is gone",
        )?;
        keep(
            effects.order == Some(Control::Clear),
            "leaving a fault clears what is latched",
        )?;
    }
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
    let strikes = |machine: &Safety| {
        faulted(machine) || machine.state == State::Stopping && machine.after_stop == State::Faulted
    };
    keep(
        !strikes(after) || strikes(before) || !after.resynced || event == Event::Acquired,
        "what was known before a fault counts no more",
    )?;

    // Ways between states.
    let may = match before.state {
        State::Boot => [State::Boot, State::Disarmed, State::Faulted].contains(&after.state),
        State::Disarmed => [State::Disarmed, State::Armed].contains(&after.state),
        State::Armed => [State::Armed, State::Stopping, State::Faulted].contains(&after.state),
        State::Stopping => {
            [State::Stopping, State::Disarmed, State::Faulted].contains(&after.state)
        }
        State::Faulted => [State::Faulted, State::Disarmed].contains(&after.state),
    };
    keep(may, "there is no such way between states")?;
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
        "a stop that ends in Disarmed was the host's wish",
    )?;

    // The gate's orders.
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
            "nothing is cleared behind an open gate",
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

    // Session, hold, ABI, trust.
    keep(
        !effects.end_session || !after.session,
        "an ended session is gone",
    )?;
    keep(
        before.session || !after.session || event == Event::Acquired,
        "only acquiring makes a session",
    )?;
    keep(before.held == after.held, "no event holds or lets go")?;
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
            "what stands cannot lose steps",
        )?;
    }
    Ok(())
}
