//! Spindle, coolant, probe, torch and the change of tools.

use super::File;
use crate::model::{CncMachine, Control, Gui, PlasmaInput, Relay, Spindle, SpindleEncoder};
use crate::units::number;

/// The spindle, and how its speed is known.
pub(super) fn spindle(machine: &CncMachine, file: &mut File) {
    let Some(spindle) = &machine.spindle else {
        return;
    };
    let on = [
        spindle
            .on
            .as_ref()
            .map(|it| format!("ferrocnc.0.gpio.{it}.out")),
        match &spindle.control {
            Control::OnOff => None,
            Control::Pwm { name, .. } => Some(format!("ferrocnc.0.pwm.{name}.enable")),
        },
        relay(machine, Relay::Air).map(|it| format!("ferrocnc.0.gpio.{it}.out")),
    ];
    let on: Vec<String> = on.into_iter().flatten().collect();
    file.heading("spindle");
    file.net("spindle-on", &format!("spindle.0.on => {}", on.join(" ")));
    if let Some(reverse) = &spindle.reverse {
        file.net(
            "spindle-reverse",
            &format!("spindle.0.reverse => ferrocnc.0.gpio.{reverse}.out"),
        );
    }
    if let Control::Pwm {
        name,
        frequency,
        full,
        volts,
    } = &spindle.control
    {
        let pwm = format!("ferrocnc.0.pwm.{name}");
        file.comment(&match volts {
            true => format!("0 to 10 V behind the converter are 0 to {full} turns a minute."),
            false => format!("A duty of 0 to 1 is 0 to {full} turns a minute."),
        });
        file.setp(&format!("{pwm}.pwm-freq"), frequency);
        file.setp(&format!("{pwm}.scale"), full);
        file.net(
            "spindle-speed",
            &format!("spindle.0.speed-out-abs => {pwm}.value"),
        );
    }
    if let Some(encoder) = &spindle.encoder {
        measured(spindle, encoder, file);
    }
}

fn measured(spindle: &Spindle, encoder: &SpindleEncoder, file: &mut File) {
    let channel = format!("ferrocnc.0.encoder.{}", encoder.name);
    file.setp(&format!("{channel}.scale"), encoder.counts);
    file.net(
        "spindle-revs",
        &format!("{channel}.position => spindle.0.revs"),
    );
    let near = match (&spindle.control, encoder.near > 0.0) {
        // Without a speed to be set there is none to be reached.
        (Control::Pwm { full, .. }, true) => {
            file.component("near", &["spindle-near".to_owned()]);
            file.setp("spindle-near.scale", number(1.0 + encoder.near));
            file.setp(
                "spindle-near.difference",
                number(full.0 / 60.0 * encoder.near / 10.0),
            );
            file.net(
                "spindle-wanted-rps",
                "spindle.0.speed-out-rps => spindle-near.in1",
            );
            file.net("spindle-at-speed", "spindle-near.out => spindle.0.at-speed");
            " spindle-near.in2"
        }
        _ => "",
    };
    file.net(
        "spindle-rps",
        &format!("{channel}.velocity => spindle.0.speed-in{near}"),
    );
    file.net(
        "spindle-index",
        &format!("{channel}.index-enable <=> spindle.0.index-enable"),
    );
}

fn relay(machine: &CncMachine, wanted: Relay) -> Option<&String> {
    let found = machine.coolant.iter().find(|(relay, _)| *relay == wanted);
    found.map(|(_, output)| output)
}

/// Relays. `air` goes with the spindle, if there is one.
pub(super) fn coolant(machine: &CncMachine, file: &mut File) {
    let relays = machine.coolant.iter();
    let mut relays = relays.filter(|(relay, _)| *relay != Relay::Air || machine.spindle.is_none());
    let Some(first) = relays.next() else {
        return;
    };
    file.heading("coolant, air, lubrication");
    for (relay, output) in std::iter::once(first).chain(relays) {
        let (signal, source) = match relay {
            Relay::Flood => ("coolant-flood", "iocontrol.0.coolant-flood"),
            Relay::Mist => ("coolant-mist", "iocontrol.0.coolant-mist"),
            Relay::Air => ("spindle-on", "spindle.0.on"),
            Relay::Lube => ("lube", "motion.motion-enabled"),
        };
        file.net(signal, &format!("{source} => ferrocnc.0.gpio.{output}.out"));
    }
}

/// Probe and tool setter: either trips.
pub(super) fn probe(machine: &CncMachine, file: &mut File) {
    let input = "motion.probe-input".to_owned();
    match (&machine.probe, &machine.tool_setter) {
        (Some(probe), Some(setter)) => {
            file.component("or2", &["probes".to_owned()]);
            file.heading("probe and tool setter");
            file.net("probe", "probes.out => motion.probe-input");
            file.inputs.read(probe, "probes.in0".to_owned());
            file.inputs.read(setter, "probes.in1".to_owned());
        }
        (Some(one), None) | (None, Some(one)) => file.inputs.read(one, input),
        (None, None) => {}
    }
}

/// QtPlasmaC, as LinuxCNC's stepconf connects it; qtplasmac_comp.hal does the rest.
pub(super) fn plasma(machine: &CncMachine, file: &mut File) {
    let Some(plasma) = &machine.plasma else {
        return;
    };
    let names = ["db_float", "db_ohmic", "db_breakaway", "db_arc-ok"].map(str::to_owned);
    file.component("dbounce", &names);
    file.loads.push("loadrt plasmac".to_owned());
    file.functions.push("plasmac".to_owned());
    file.heading("plasma torch");
    for name in &names {
        file.setp(&format!("{name}.delay"), 5);
    }
    let joints = machine.joints();
    if let Some(z) = joints.iter().find(|joint| joint.axis.letter == 'z') {
        let source = format!("joint.{}.pos-fb => plasmac.axis-z-position", z.number);
        file.net("plasmac:axis-position", &source);
    }
    file.net(
        "plasmac:torch-on",
        &format!("=> ferrocnc.0.gpio.{}.out", plasma.torch),
    );
    let ohmic = plasma.ohmic_enable.as_ref();
    let ohmic = ohmic.map_or(String::new(), |it| format!(" => ferrocnc.0.gpio.{it}.out"));
    file.net(
        "plasmac:ohmic-enable",
        &format!("plasmac.ohmic-enable{ohmic}"),
    );
    if let Some(name) = &plasma.arc_voltage {
        file.comment("Pulses of the THCAD in a second; QtPlasmaC has their scale and offset.");
        file.setp(&format!("ferrocnc.0.encoder.{name}.counter-mode"), 1);
        file.setp(&format!("ferrocnc.0.encoder.{name}.scale"), 1);
        file.net(
            "plasmac:arc-voltage-in",
            &format!("ferrocnc.0.encoder.{name}.velocity => plasmac.arc-voltage-in"),
        );
    }
    for (input, switch) in &plasma.inputs {
        let pin = PlasmaInput::ALL.into_iter().find(|(_, it, _)| it == input);
        if let Some((_, _, pin)) = pin {
            file.inputs.read(switch, pin.to_owned());
        }
    }
}

/// A person changes the tool, or M6 is over at once.
pub(super) fn tool_change(machine: &CncMachine, file: &mut File) {
    file.heading("tool change");
    file.net(
        "tool-prepare",
        "iocontrol.0.tool-prepare => iocontrol.0.tool-prepared",
    );
    if !machine.manual_tool_change || machine.gui == Gui::QtPlasmaC {
        file.net(
            "tool-change",
            "iocontrol.0.tool-change => iocontrol.0.tool-changed",
        );
        return;
    }
    let (change, changed, number) = match machine.gui {
        Gui::Axis | Gui::Gmoccapy => {
            file.loads
                .push("loadusr -W hal_manualtoolchange".to_owned());
            (
                " => hal_manualtoolchange.change",
                "hal_manualtoolchange.changed => ",
                " => hal_manualtoolchange.number",
            )
        }
        // Its dialog has no pins before it runs: ferrocnc_postgui.hal.
        Gui::QtDragon | Gui::ProbeBasic | Gui::QtPlasmaC => ("", "=> ", ""),
    };
    file.net("tool-change", &format!("iocontrol.0.tool-change{change}"));
    file.net(
        "tool-changed",
        &format!("{changed}iocontrol.0.tool-changed"),
    );
    file.net(
        "tool-number",
        &format!("iocontrol.0.tool-prep-number{number}"),
    );
}
