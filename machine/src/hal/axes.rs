//! The joints: step generators, drives, switches.

use super::File;
use crate::model::CncMachine;

/// All of them.
pub(super) fn axes(machine: &CncMachine, file: &mut File) {
    let joints = machine.joints();
    let with_fault = joints.iter().filter(|joint| joint.axis.fault.is_some());
    let alarms: Vec<String> = with_fault
        .map(|it| format!("fault-{}", it.number))
        .collect();
    file.component("or2", &alarms);
    let faults: Vec<String> = joints
        .iter()
        .map(|joint| match joint.axis.fault {
            Some(_) => format!("fault-{}.in0", joint.number),
            None => format!("joint.{}.amp-fault-in", joint.number),
        })
        .collect();
    file.comment(
        "A stop of the board is an amplifier fault, too: motion stops in the same period.",
    );
    file.net(
        "board-fault",
        &format!("not-enabled.out => {}", faults.join(" ")),
    );
    for joint in &joints {
        let (n, name) = (joint.number, &joint.motor.name);
        let stepgen = format!("ferrocnc.0.stepgen.{name}");
        let letter = joint.axis.letter.to_uppercase();
        file.heading(&format!("joint {n}: {letter}, stepgen {name}"));
        for (pin, key) in [
            ("position-scale", "SCALE"),
            ("maxvel", "STEPGEN_MAXVEL"),
            ("maxaccel", "STEPGEN_MAXACCEL"),
            ("steplen", "STEPLEN"),
            ("stepspace", "STEPSPACE"),
            ("dirsetup", "DIRSETUP"),
            ("dirhold", "DIRHOLD"),
        ] {
            file.setp(&format!("{stepgen}.{pin}"), format!("[JOINT_{n}]{key}"));
        }
        file.net(
            &format!("j{n}-cmd"),
            &format!("joint.{n}.motor-pos-cmd => {stepgen}.position-cmd"),
        );
        file.net(
            &format!("j{n}-fb"),
            &format!("{stepgen}.position-fb => joint.{n}.motor-pos-fb"),
        );
        let drives = match (n, &machine.drive_enable) {
            (0, Some(output)) => format!(" ferrocnc.0.gpio.{output}.out"),
            _ => String::new(),
        };
        file.net(
            &format!("j{n}-enable"),
            &format!("joint.{n}.amp-enable-out => {stepgen}.enable{drives}"),
        );
        if joint.axis.home.method.uses_index() {
            file.net(
                &format!("j{n}-index"),
                &format!("joint.{n}.index-enable <=> {stepgen}.index-enable"),
            );
        }
        if joint.axis.fault.is_some() {
            file.net(
                &format!("j{n}-fault"),
                &format!("fault-{n}.out => joint.{n}.amp-fault-in"),
            );
        }
        if let Some(switch) = joint.home_switch() {
            file.inputs.read(switch, format!("joint.{n}.home-sw-in"));
        }
        let limits = &joint.axis.limits;
        for (switch, pin) in [(&limits.min, "neg"), (&limits.max, "pos")] {
            if let Some(switch) = switch {
                file.inputs
                    .read(switch, format!("joint.{n}.{pin}-lim-sw-in"));
            }
        }
        if let Some(switch) = &joint.axis.fault {
            file.inputs.read(switch, format!("fault-{n}.in1"));
        }
    }
}
