//! What the INI file of a machine has to say.

use super::Entry;
use crate::check::HEADROOM;
use crate::model::{Axis, CncMachine, Control, End, Gui, Home, Joint, Method, Switch, Units};
use crate::units::{Length, Speed, number};

/// The files that are named in it.
pub const MAIN_HAL: &str = "ferrocnc.hal";
/// Lines of the user's own.
pub const CUSTOM_HAL: &str = "custom.hal";
/// What is connected when the user interface runs.
pub const POST_GUI_HAL: &str = "ferrocnc_postgui.hal";
/// Lines of the user's own.
pub const CUSTOM_POST_GUI_HAL: &str = "custom_postgui.hal";
/// Tools.
pub const TOOL_TABLE: &str = "tool.tbl";

struct Entries {
    section: String,
    all: Vec<Entry>,
}

impl Entries {
    fn section(&mut self, name: impl Into<String>) {
        self.section = name.into();
    }

    fn set(&mut self, key: &str, value: impl ToString) {
        self.all.push(Entry {
            section: self.section.clone(),
            key: key.to_owned(),
            value: value.to_string(),
        });
    }
}

/// All lines, in the order of a new file.
pub fn wanted(machine: &CncMachine) -> Vec<Entry> {
    let mut out = Entries {
        section: String::new(),
        all: Vec::new(),
    };
    let fastest = machine.axes.iter().filter(|axis| !axis.is_rotary());
    let fastest = { fastest }.map(|axis| axis.speed.0).fold(0.0, f64::max);
    let fastest = match fastest > 0.0 {
        true => Speed(fastest),
        false => machine.axes.first().map_or(Speed(1.0), |axis| axis.speed),
    };
    head(machine, &mut out, fastest);
    files(machine, &mut out);
    motion(machine, &mut out, fastest);
    spindle(machine, &mut out);
    for joint in &machine.joints() {
        if joint.place == 0 {
            axis(machine, joint.axis, &mut out);
        }
        self::joint(machine, joint, &mut out);
    }
    out.all
}

fn head(machine: &CncMachine, out: &mut Entries, fastest: Speed) {
    let plasma = machine.gui == Gui::QtPlasmaC;
    let mm = machine.units == Units::Mm;
    out.section("EMC");
    out.set("VERSION", "1.1");
    out.set("MACHINE", &machine.name);
    out.set("DEBUG", 0);
    out.section("DISPLAY");
    out.set("DISPLAY", machine.gui.command());
    if machine.gui == Gui::QtDragon {
        out.set("PREFERENCE_FILE_PATH", "WORKINGFOLDER/qtdragon.pref");
    }
    out.set("CYCLE_TIME", "0.100");
    out.set("POSITION_OFFSET", "RELATIVE");
    out.set("POSITION_FEEDBACK", "ACTUAL");
    out.set("MAX_FEED_OVERRIDE", "1.2");
    if !plasma {
        out.set("MIN_SPINDLE_OVERRIDE", "0.5");
        out.set("MAX_SPINDLE_OVERRIDE", "1.2");
    }
    out.set("DEFAULT_LINEAR_VELOCITY", number(fastest.0 / 4.0));
    out.set("MAX_LINEAR_VELOCITY", fastest);
    if let Some(rotary) = machine.axes.iter().find(|axis| axis.is_rotary()) {
        out.set("DEFAULT_ANGULAR_VELOCITY", number(rotary.speed.0 / 4.0));
        out.set("MAX_ANGULAR_VELOCITY", rotary.speed);
    }
    out.set("PROGRAM_PREFIX", "~/linuxcnc/nc_files");
    out.set(
        "INCREMENTS",
        match (plasma, mm) {
            (true, true) => "10mm 1mm .1mm .01mm .001mm",
            (true, false) => "1in .1in .01in .001in .0001in",
            (false, true) => "10 mm, 1 mm, .1 mm, .01 mm",
            (false, false) => "1 in, .1 in, .01 in, .001 in",
        },
    );
    if machine.lathe {
        out.set("LATHE", 1);
    }
    if let Some(plasma) = &machine.plasma {
        out.section("QTPLASMAC");
        out.set("MODE", plasma.mode);
        out.section("FILTER");
        out.set(
            "PROGRAM_EXTENSION",
            ".ngc,.nc,.tap GCode File (*.ngc, *.nc, *.tap)",
        );
        for ending in ["ngc", "nc", "tap"] {
            out.set(ending, "qtplasmac_gcode");
        }
    }
    out.section("RS274NGC");
    out.set("PARAMETER_FILE", "linuxcnc.var");
    let unit = if mm { 21 } else { 20 };
    out.set(
        "RS274NGC_STARTUP_CODE",
        match (plasma, machine.lathe) {
            (true, _) => format!("G{unit} G40 G49 G80 G90 G92.1 G94 G97 M52P1"),
            (false, true) => format!("G18 G{unit} G40 G49 G54 G80 G90 G94 G97"),
            (false, false) => format!("G17 G{unit} G40 G49 G54 G80 G90 G94"),
        },
    );
    out.section("FERROCNC");
    out.set("BOARD", &machine.board.address);
    out.set("PACKET_READ_TIMEOUT", 80);
    // Five missed servo periods, and never less than the 5 ms of hostmot2.
    let watchdog = (u64::from(machine.servo_period.0) * 5).max(5_000_000);
    out.set("WATCHDOG_NS", watchdog);
}

fn files(machine: &CncMachine, out: &mut Entries) {
    out.section("HAL");
    out.set("HALUI", "halui");
    out.set("HALFILE", MAIN_HAL);
    if machine.plasma.is_some() {
        out.set("HALFILE", "qtplasmac_comp.hal");
    }
    out.set("HALFILE", CUSTOM_HAL);
    if crate::hal::post_gui(machine).is_some() {
        out.set("POSTGUI_HALFILE", POST_GUI_HAL);
    }
    out.set("POSTGUI_HALFILE", CUSTOM_POST_GUI_HAL);
}

fn motion(machine: &CncMachine, out: &mut Entries, fastest: Speed) {
    out.section("EMCMOT");
    out.set("EMCMOT", "motmod");
    out.set("COMM_TIMEOUT", "1.0");
    out.set("SERVO_PERIOD", machine.servo_period);
    out.section("TASK");
    out.set("TASK", "milltask");
    out.set("CYCLE_TIME", "0.010");
    out.section("EMCIO");
    out.set("EMCIO", "io");
    out.set("CYCLE_TIME", "0.100");
    out.set("TOOL_TABLE", TOOL_TABLE);
    let joints = machine.joints();
    let letters: Vec<String> = joints
        .iter()
        .map(|joint| joint.axis.letter.to_uppercase().to_string())
        .collect();
    out.section("KINS");
    out.set("JOINTS", joints.len());
    let both = match machine.axes.iter().any(|axis| axis.motors.len() > 1) {
        true => " kinstype=BOTH",
        false => "",
    };
    out.set(
        "KINEMATICS",
        format!("trivkins coordinates={}{both}", letters.concat()),
    );
    out.section("TRAJ");
    if machine.plasma.is_some() {
        out.set("SPINDLES", 3);
    }
    out.set("COORDINATES", letters.join(" "));
    out.set("LINEAR_UNITS", machine.units.word());
    out.set("ANGULAR_UNITS", "degree");
    out.set("DEFAULT_LINEAR_VELOCITY", number(fastest.0 / 4.0));
    out.set("MAX_LINEAR_VELOCITY", fastest);
    let accelerations = machine.axes.iter().map(|axis| axis.acceleration.0);
    out.set(
        "MAX_LINEAR_ACCELERATION",
        number(accelerations.fold(0.0, f64::max)),
    );
}

/// What LinuxCNC asks of the spindle at least and at most. Debian 12's does not read it.
fn spindle(machine: &CncMachine, out: &mut Entries) {
    let Some(spindle) = &machine.spindle else {
        return;
    };
    match spindle.control {
        Control::OnOff => {}
        Control::Pwm { .. } => {
            out.section("SPINDLE_0");
            out.set("MIN_FORWARD_VELOCITY", spindle.min);
            out.set("MAX_FORWARD_VELOCITY", spindle.max);
        }
    }
}

fn axis(machine: &CncMachine, axis: &Axis, out: &mut Entries) {
    out.section(format!("AXIS_{}", axis.letter.to_uppercase()));
    // QtPlasmaC moves by half of it on its own.
    let (factor, plasma) = match machine.plasma {
        Some(_) => (2.0, true),
        None => (1.0, false),
    };
    out.set("MAX_VELOCITY", number(axis.speed.0 * factor));
    out.set("MAX_ACCELERATION", number(axis.acceleration.0 * factor));
    if plasma {
        out.set("OFFSET_AV_RATIO", "0.5");
    }
    let [min, max] = soft_limits(machine, axis);
    out.set("MIN_LIMIT", min);
    out.set("MAX_LIMIT", max);
}

/// The travel. LinuxCNC takes an axis that homes onto its end for beyond it, by a part of a step:
/// that end is a hundredth of a millimetre farther, as stepconf makes it, or a step.
fn soft_limits(machine: &CncMachine, axis: &Axis) -> [Length; 2] {
    let more = machine.units.of_mm(0.01).max(1.0 / axis.scale.0);
    let beyond = |end: Length, sign: f64| match axis.home.position == end {
        true => Length(end.0 + sign * more),
        false => end,
    };
    [beyond(axis.min, -1.0), beyond(axis.max, 1.0)]
}

fn joint(machine: &CncMachine, joint: &Joint<'_>, out: &mut Entries) {
    let axis = joint.axis;
    out.section(format!("JOINT_{}", joint.number));
    out.set(
        "TYPE",
        if axis.is_rotary() {
            "ANGULAR"
        } else {
            "LINEAR"
        },
    );
    out.set("MAX_VELOCITY", axis.speed);
    out.set("MAX_ACCELERATION", axis.acceleration);
    let [min, max] = soft_limits(machine, axis);
    out.set("MIN_LIMIT", min);
    out.set("MAX_LIMIT", max);
    // What the axis moves in two servo periods, and not less than a twentieth of a millimetre.
    let least = match axis.is_rotary() {
        true => 0.05,
        false => machine.units.of_mm(0.05),
    };
    let error = (axis.speed.0 * machine.servo_period.seconds() * 2.0).max(least);
    out.set("MIN_FERROR", number(error));
    out.set("FERROR", number(error * 10.0));
    out.set("SCALE", joint.scale());
    // The stepgen has to be able to catch up; with backlash it has to do twice as much.
    let extra = match axis.backlash.0 > 0.0 {
        true => 2.0,
        false => HEADROOM,
    };
    out.set("STEPGEN_MAXVEL", number(axis.speed.0 * HEADROOM));
    out.set("STEPGEN_MAXACCEL", number(axis.acceleration.0 * extra));
    if axis.backlash.0 > 0.0 {
        out.set("BACKLASH", axis.backlash);
    }
    out.set("STEPLEN", axis.timing.steplen);
    out.set("STEPSPACE", axis.timing.stepspace);
    out.set("DIRSETUP", axis.timing.dirsetup);
    out.set("DIRHOLD", axis.timing.dirhold);
    home(machine, joint, &axis.home, out);
}

/// LinuxCNC's homing, by its own table: search and latch velocity and the index say which way.
fn home(machine: &CncMachine, joint: &Joint<'_>, home: &Home, out: &mut Entries) {
    let towards = match home.end {
        End::Min => -1.0,
        End::Max => 1.0,
    };
    let back = if home.on_contact { 1.0 } else { -1.0 };
    let (search, latch) = match home.method {
        Method::Immediate | Method::Absolute => (0.0, 0.0),
        Method::Index => (0.0, towards * home.latch.0),
        Method::Switch | Method::Limit | Method::SwitchIndex | Method::LimitIndex => {
            (towards * home.search.0, towards * back * home.latch.0)
        }
    };
    out.set("HOME", home.position);
    out.set("HOME_OFFSET", number(home.offset.0 + joint.motor.square.0));
    out.set("HOME_SEARCH_VEL", number(search));
    out.set("HOME_LATCH_VEL", number(latch));
    if let Some(travel) = home.travel {
        out.set("HOME_FINAL_VEL", travel);
    }
    if home.method.uses_index() {
        out.set("HOME_USE_INDEX", "YES");
    }
    if home.method == Method::Absolute {
        out.set("HOME_ABSOLUTE_ENCODER", 2);
    }
    let is_limit = |input: &str| {
        let limits = [&joint.axis.limits.min, &joint.axis.limits.max];
        let mut limits = limits.into_iter().flatten();
        limits.any(|limit| limit.input == input)
    };
    let switch = joint.home_switch();
    if home.method.by_limit() || switch.is_some_and(|switch| is_limit(&switch.input)) {
        out.set("HOME_IGNORE_LIMITS", "YES");
    }
    let shared = |switch: &Switch| {
        let users = machine
            .axes
            .iter()
            .filter(|axis| axis.home.switches.contains(switch));
        users.count() > 1
    };
    if switch.is_some_and(shared) {
        out.set("HOME_IS_SHARED", 1);
    }
    out.set("HOME_SEQUENCE", sequence(machine, joint));
}

/// LinuxCNC's own numbers for the order: without gaps, and negative where the motors of an axis go
/// to HOME together, so that they do not pull at it. There is no negative 0, so they begin with 1
/// then.
fn sequence(machine: &CncMachine, joint: &Joint<'_>) -> String {
    let order = joint.axis.home.sequence;
    let all = machine.axes.iter().map(|axis| axis.home.sequence);
    let earlier: std::collections::BTreeSet<u32> = all.filter(|other| *other < order).collect();
    let has_pair = machine.axes.iter().any(|axis| axis.motors.len() > 1);
    let number = earlier.len() + usize::from(has_pair);
    match joint.axis.motors.len() > 1 {
        true => format!("-{number}"),
        false => number.to_string(),
    }
}
