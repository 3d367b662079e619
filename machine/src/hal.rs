//! The generated HAL files: `ferrocnc.hal`, and `ferrocnc_postgui.hal` for user interfaces whose
//! pins are there only when they run.
//!
//! Each input of the board is one signal, read wherever it is needed: a switch may be limit and
//! home of several joints. What the servo thread does in which order is written here only.

mod axes;
mod nets;
mod tools;

use crate::model::{CncMachine, Estop, Gui};
use nets::Nets;
use std::fmt::Write as _;

/// A HAL file in the making.
#[derive(Default)]
struct File {
    /// `loadrt` and `loadusr`.
    loads: Vec<String>,
    /// Functions between the motion controller and the board's `write`.
    functions: Vec<String>,
    /// Everything else.
    text: String,
    /// Signals of the board's inputs.
    inputs: Nets,
}

impl File {
    fn heading(&mut self, title: &str) {
        let dashes = 92_usize.saturating_sub(title.len());
        let _ = writeln!(self.text, "\n# ---- {title} {}", "-".repeat(dashes));
    }

    fn setp(&mut self, pin: &str, value: impl std::fmt::Display) {
        let _ = writeln!(self.text, "setp {pin} {value}");
    }

    fn net(&mut self, signal: &str, rest: &str) {
        let _ = writeln!(self.text, "net {signal} {rest}");
    }

    fn comment(&mut self, text: &str) {
        let _ = writeln!(self.text, "# {text}");
    }

    /// A realtime component with one function.
    fn component(&mut self, kind: &str, names: &[String]) {
        if !names.is_empty() {
            self.loads
                .push(format!("loadrt {kind} names={}", names.join(",")));
            self.functions.extend(names.iter().cloned());
        }
    }
}

/// What `ferrocnc.hal` does, without its head.
pub fn main(machine: &CncMachine) -> String {
    let mut file = File::default();
    board(machine, &mut file);
    axes::axes(machine, &mut file);
    tools::spindle(machine, &mut file);
    tools::coolant(machine, &mut file);
    tools::probe(machine, &mut file);
    tools::plasma(machine, &mut file);
    tools::tool_change(machine, &mut file);
    if !file.inputs.is_empty() {
        file.heading("inputs of the board, each with what reads it");
        for (input, ns) in debounced(machine) {
            file.setp(&format!("ferrocnc.0.gpio.{input}.debounce-ns"), ns);
        }
        file.text += &file.inputs.to_text();
    }
    let mut text = String::from("loadrt [KINS]KINEMATICS\n");
    let spindles = match machine.plasma {
        Some(_) => " num_spindles=[TRAJ]SPINDLES",
        None => "",
    };
    let _ = writeln!(
        text,
        "loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS{spindles}"
    );
    text += "loadrt ferrocnc boards=[FERROCNC]BOARD\nloadrt not names=not-enabled\n";
    for load in &file.loads {
        let _ = writeln!(text, "{load}");
    }
    text += "\n# Feedback first, commands last.\n";
    let first = [
        "ferrocnc.0.read",
        "not-enabled",
        "motion-command-handler",
        "motion-controller",
    ];
    let rest = file.functions.iter().map(String::as_str);
    for function in first.into_iter().chain(rest).chain(["ferrocnc.0.write"]) {
        let _ = writeln!(text, "addf {function} servo-thread");
    }
    text + &file.text
}

/// What is connected when the user interface runs; nothing where it needs nothing.
pub fn post_gui(machine: &CncMachine) -> Option<String> {
    if !machine.manual_tool_change {
        return None;
    }
    let dialog = match machine.gui {
        Gui::QtDragon => "hal_manualtoolchange",
        Gui::ProbeBasic => "qtpyvcp_manualtoolchange",
        Gui::Axis | Gui::Gmoccapy | Gui::QtPlasmaC => return None,
    };
    Some(format!(
        "net tool-change => {dialog}.change\nnet tool-changed <= {dialog}.changed\nnet tool-number => {dialog}.number\n"
    ))
}

/// The board itself, and the way out of E-stop.
fn board(machine: &CncMachine, file: &mut File) {
    file.text += "\n";
    file.setp(
        "ferrocnc.0.packet-read-timeout",
        "[FERROCNC]PACKET_READ_TIMEOUT",
    );
    file.setp("ferrocnc.0.watchdog.timeout-ns", "[FERROCNC]WATCHDOG_NS");
    file.heading("emergency stop");
    file.comment("The machine is out of it exactly while the board is armed: F1 asks the board, which answers");
    file.comment("with `enabled`. Every stop of the board puts LinuxCNC in E-stop.");
    file.comment(match &machine.estop {
        Estop::Input(_) => "The e-stop input stops the board in its gateware, and stays until it is released and F1.",
        Estop::External(_) => "The chain is on the card's KEY terminal, which stops the board in its gateware.",
        Estop::Software => "There is no chain: what stops the machine if this computer does not?",
    });
    file.net(
        "estop-enable",
        "iocontrol.0.user-enable-out => ferrocnc.0.enable",
    );
    file.net(
        "estop-request",
        "iocontrol.0.user-request-enable => ferrocnc.0.enable-request",
    );
    file.net(
        "estop-enabled",
        "ferrocnc.0.enabled => iocontrol.0.emc-enable-in not-enabled.in",
    );
}

/// The switches that are waited for until they are at rest, and how long.
fn debounced(machine: &CncMachine) -> Vec<(String, u32)> {
    let ns = machine.board.debounce.0;
    let mut names: Vec<&String> = Vec::new();
    if ns > 0 {
        for axis in &machine.axes {
            let limits = [&axis.limits.min, &axis.limits.max, &axis.fault];
            let limits = limits.into_iter().flatten();
            for switch in axis.home.switches.iter().chain(limits) {
                if !names.contains(&&switch.input) {
                    names.push(&switch.input);
                }
            }
        }
    }
    names.into_iter().map(|name| (name.clone(), ns)).collect()
}
