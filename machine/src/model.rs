//! A machine, as its `machine.toml` describes it. Every default has been filled in here.

use crate::drive::Timing;
use crate::units::{Acceleration, Hertz, Length, Nanoseconds, Rpm, Scale, Speed};
use ferrocnc_config::platform::Level;
use ferrocnc_config::{Error, Place, Report};
use std::collections::BTreeMap;

/// A machine.
#[derive(Clone, Debug)]
pub struct CncMachine {
    /// The file as it was named to us.
    pub file: String,
    /// Where each key of it stands.
    pub places: BTreeMap<String, Place>,
    /// Its name: of its board file and of its INI file.
    pub name: String,
    /// Millimetre or inch.
    pub units: Units,
    /// The user interface.
    pub gui: Gui,
    /// X is a diameter, and the tool comes from the other side.
    pub lathe: bool,
    /// A person changes tools, and says so.
    pub manual_tool_change: bool,
    /// The servo thread's.
    pub servo_period: Nanoseconds,
    /// The card.
    pub board: BoardWanted,
    /// In the order of the file. Each motor is a joint.
    pub axes: Vec<Axis>,
    /// What switches the drives on; nothing where they are always on.
    pub drive_enable: Option<String>,
    /// What stops it.
    pub estop: Estop,
    /// The first spindle.
    pub spindle: Option<Spindle>,
    /// For G38.
    pub probe: Option<Switch>,
    /// A second one, in series.
    pub tool_setter: Option<Switch>,
    /// Relays: what each is for, and its output.
    pub coolant: Vec<(Relay, String)>,
    /// The torch.
    pub plasma: Option<Plasma>,
}

/// The machine's unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Units {
    /// Millimetre.
    Mm,
    /// Inch.
    Inch,
}

impl Units {
    /// As LinuxCNC writes it.
    pub const fn word(self) -> &'static str {
        match self {
            Units::Mm => "mm",
            Units::Inch => "inch",
        }
    }

    /// This many millimetres.
    pub fn of_mm(self, mm: f64) -> f64 {
        match self {
            Units::Mm => mm,
            Units::Inch => mm / 25.4,
        }
    }
}

/// The user interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gui {
    /// AXIS.
    Axis,
    /// Gmoccapy.
    Gmoccapy,
    /// QtDragon, of QtVCP.
    QtDragon,
    /// Probe Basic, of QtPyVCP.
    ProbeBasic,
    /// QtPlasmaC.
    QtPlasmaC,
}

impl Gui {
    /// All of them, as the file names them.
    pub const ALL: [(&'static str, Gui); 5] = [
        ("axis", Gui::Axis),
        ("gmoccapy", Gui::Gmoccapy),
        ("qtdragon", Gui::QtDragon),
        ("probe_basic", Gui::ProbeBasic),
        ("qtplasmac", Gui::QtPlasmaC),
    ];

    /// What `[DISPLAY]DISPLAY` says.
    pub const fn command(self) -> &'static str {
        match self {
            Gui::Axis => "axis",
            Gui::Gmoccapy => "gmoccapy",
            Gui::QtDragon => "qtvcp qtdragon",
            Gui::ProbeBasic => "probe_basic",
            Gui::QtPlasmaC => "qtvcp qtplasmac",
        }
    }
}

/// The card.
#[derive(Clone, Debug)]
pub struct BoardWanted {
    /// Where its board file comes from.
    pub source: BoardSource,
    /// What `loadrt` is told: an address, a name, or either with a port.
    pub address: String,
    /// How long a switch must be at rest. The probe and the e-stop are not waited for.
    pub debounce: Nanoseconds,
    /// Outputs that are low when HAL says true.
    pub active_low: Vec<String>,
}

/// Where the board file comes from.
#[derive(Clone, Debug)]
pub enum BoardSource {
    /// It is written here, for this PCB, and these headers can read; nothing: a proposal is made.
    Platform(String, Option<Vec<String>>),
    /// It is there, and stays as it is: the card has its image.
    File(String),
}

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// `axis[0]`, for errors.
    pub key: String,
    /// `x`.
    pub letter: char,
    /// Names of stepgens.
    pub motors: Vec<Motor>,
    /// Steps in a unit, of a motor that is not reversed.
    pub scale: Scale,
    /// Of its screw.
    pub backlash: Length,
    /// From here.
    pub min: Length,
    /// To here.
    pub max: Length,
    /// At most.
    pub speed: Speed,
    /// At most.
    pub acceleration: Acceleration,
    /// Of its drive.
    pub timing: Timing,
    /// The switches at its ends.
    pub limits: Limits,
    /// How it finds its place.
    pub home: Home,
    /// The drive says that something is wrong.
    pub fault: Option<Switch>,
}

impl Axis {
    /// It turns, and its unit is the degree.
    pub fn is_rotary(&self) -> bool {
        matches!(self.letter, 'a' | 'b' | 'c')
    }
}

/// A motor of an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Motor {
    /// The stepgen.
    pub name: String,
    /// It turns the other way.
    pub reversed: bool,
    /// How far its switch is off, which squares a gantry.
    pub square: Length,
}

/// A switch, on an input of the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Switch {
    /// The input's name.
    pub input: String,
    /// The level that means pressed.
    pub active: Level,
}

impl Switch {
    /// The pin of HAL that is true when it is pressed.
    pub fn pin(&self) -> String {
        let not = match self.active {
            Level::High => "",
            Level::Low => "-not",
        };
        format!("ferrocnc.0.gpio.{}.in{not}", self.input)
    }

    /// A signal for that pin.
    pub fn signal(&self) -> String {
        match self.active {
            Level::High => self.input.clone(),
            Level::Low => format!("{}-not", self.input),
        }
    }
}

/// The switches at the ends of an axis; one at both ends is there twice.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// At its minimum.
    pub min: Option<Switch>,
    /// At its maximum.
    pub max: Option<Switch>,
}

/// An end of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Where the coordinate is least.
    Min,
    /// Where it is greatest.
    Max,
}

/// How an axis finds its place: LinuxCNC's ways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// It is where it stands.
    Immediate,
    /// It knows by itself.
    Absolute,
    /// A home switch.
    Switch,
    /// A limit switch, which is no limit meanwhile.
    Limit,
    /// The next index pulse.
    Index,
    /// The first index pulse behind the home switch.
    SwitchIndex,
    /// The first index pulse behind the limit switch.
    LimitIndex,
}

impl Method {
    /// All of them, as the file names them.
    pub const ALL: [(&'static str, Method); 7] = [
        ("immediate", Method::Immediate),
        ("absolute", Method::Absolute),
        ("switch", Method::Switch),
        ("limit", Method::Limit),
        ("index", Method::Index),
        ("switch_index", Method::SwitchIndex),
        ("limit_index", Method::LimitIndex),
    ];

    /// A switch is searched for.
    pub const fn searches(self) -> bool {
        match self {
            Method::Immediate | Method::Absolute | Method::Index => false,
            Method::Switch | Method::Limit | Method::SwitchIndex | Method::LimitIndex => true,
        }
    }

    /// It is a limit switch.
    pub const fn by_limit(self) -> bool {
        match self {
            Method::Limit | Method::LimitIndex => true,
            Method::Immediate | Method::Absolute | Method::Index => false,
            Method::Switch | Method::SwitchIndex => false,
        }
    }

    /// An index pulse is waited for.
    pub const fn uses_index(self) -> bool {
        match self {
            Method::Index | Method::SwitchIndex | Method::LimitIndex => true,
            Method::Immediate | Method::Absolute | Method::Switch | Method::Limit => false,
        }
    }
}

/// How an axis finds its place.
#[derive(Clone, Debug)]
pub struct Home {
    /// The way.
    pub method: Method,
    /// One for each motor, or one for all.
    pub switches: Vec<Switch>,
    /// Where they are.
    pub end: End,
    /// Towards the switch.
    pub search: Speed,
    /// Slowly, to the edge or the index.
    pub latch: Speed,
    /// To `position`; nothing: as fast as it can.
    pub travel: Option<Speed>,
    /// The place is taken while the switch is being pressed, not when it is released.
    pub on_contact: bool,
    /// What the coordinate is at the switch or index.
    pub offset: Length,
    /// Where it goes then.
    pub position: Length,
    /// The least is first.
    pub sequence: u32,
}

/// The e-stop chain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Estop {
    /// There is only the button on the screen.
    Software,
    /// An input, on which the gateware acts by itself.
    Input(Switch),
    /// The card's KEY terminal; this level stops.
    External(Level),
}

/// The spindle.
#[derive(Clone, Debug)]
pub struct Spindle {
    /// Speed is set, or it only runs.
    pub control: Control,
    /// Output: it runs.
    pub on: Option<String>,
    /// Output: it runs backwards.
    pub reverse: Option<String>,
    /// Slower is not asked for.
    pub min: Rpm,
    /// Faster is not asked for.
    pub max: Rpm,
    /// What it does, told by an encoder.
    pub encoder: Option<SpindleEncoder>,
}

/// How a spindle is told its speed.
#[derive(Clone, Debug)]
pub enum Control {
    /// Not at all.
    OnOff,
    /// By a PWM, or by 0 to 10 V that a converter makes of one.
    Pwm {
        /// The channel.
        name: String,
        /// Its.
        frequency: Hertz,
        /// At a duty of 1, or at 10 V.
        full: Rpm,
        /// A converter makes volts of it.
        volts: bool,
    },
}

/// An encoder on the spindle.
#[derive(Clone, Debug)]
pub struct SpindleEncoder {
    /// The channel.
    pub name: String,
    /// Four times its lines.
    pub counts: u32,
    /// So near, as a part of the speed asked for, is at speed; 0: it is not waited for.
    pub near: f64,
}

/// What a relay is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relay {
    /// M8.
    Flood,
    /// M7.
    Mist,
    /// While the spindle runs.
    Air,
    /// While the machine is on.
    Lube,
}

impl Relay {
    /// All of them, as the file names them.
    pub const ALL: [(&'static str, Relay); 4] = [
        ("flood", Relay::Flood),
        ("mist", Relay::Mist),
        ("air", Relay::Air),
        ("lube", Relay::Lube),
    ];
}

/// A plasma torch under QtPlasmaC.
#[derive(Clone, Debug)]
pub struct Plasma {
    /// QtPlasmaC's: 0 arc voltage, 1 arc voltage and arc OK, 2 up and down signals.
    pub mode: u8,
    /// Output.
    pub torch: String,
    /// Encoder that counts a THCAD's pulses.
    pub arc_voltage: Option<String>,
    /// What QtPlasmaC is told, and by which switch: `arc-ok-in`, `float-switch` ...
    pub inputs: Vec<(PlasmaInput, Switch)>,
    /// Output: ohmic sensing is wanted.
    pub ohmic_enable: Option<String>,
}

/// An input of QtPlasmaC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlasmaInput {
    /// The arc has transferred.
    ArcOk,
    /// The torch touches.
    Float,
    /// The shield touches.
    Ohmic,
    /// The torch has broken away.
    Breakaway,
    /// Of an external THC.
    MoveUp,
    /// Of an external THC.
    MoveDown,
}

impl PlasmaInput {
    /// All of them, as the file names them, and what they are connected to.
    pub const ALL: [(&'static str, PlasmaInput, &'static str); 6] = [
        ("arc_ok", PlasmaInput::ArcOk, "db_arc-ok.in"),
        ("float", PlasmaInput::Float, "db_float.in"),
        ("ohmic", PlasmaInput::Ohmic, "db_ohmic.in"),
        ("breakaway", PlasmaInput::Breakaway, "db_breakaway.in"),
        ("move_up", PlasmaInput::MoveUp, "plasmac.move-up"),
        ("move_down", PlasmaInput::MoveDown, "plasmac.move-down"),
    ];
}

/// A joint: a motor, with its number.
pub struct Joint<'m> {
    /// From 0.
    pub number: usize,
    /// Which axis moves it.
    pub axis: &'m Axis,
    /// Which motor of the axis.
    pub motor: &'m Motor,
    /// Which of the axis' motors, from 0.
    pub place: usize,
}

impl Joint<'_> {
    /// Its home switch.
    pub fn home_switch(&self) -> Option<&Switch> {
        let switches = &self.axis.home.switches;
        switches.get(self.place).or(switches.first())
    }

    /// Steps in a unit, with the sign of its direction.
    pub fn scale(&self) -> Scale {
        match self.motor.reversed {
            true => Scale(-self.axis.scale.0),
            false => self.axis.scale,
        }
    }
}

impl CncMachine {
    /// Its joints, in the order of their numbers.
    pub fn joints(&self) -> Vec<Joint<'_>> {
        let motors = self.axes.iter().flat_map(|axis| {
            let motors = axis.motors.iter().enumerate();
            motors.map(move |(place, motor)| (axis, place, motor))
        });
        let numbered = motors.enumerate();
        let joint = |(number, (axis, place, motor))| Joint {
            number,
            axis,
            motor,
            place,
        };
        numbered.map(joint).collect()
    }

    /// Something about a key of the file.
    pub fn error(
        &self,
        key: &str,
        value: impl ToString,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Error {
        let mut known = key;
        // A key that is not there is missed in its table.
        let place = loop {
            if let Some(place) = self.places.get(known) {
                break Some(*place);
            }
            match known.rfind(['.', '[']) {
                Some(end) => known = &known[..end],
                None => break None,
            }
        };
        Error::from(Report {
            file: self.file.clone(),
            place,
            key: key.to_owned(),
            value: value.to_string(),
            problem: problem.into(),
            remedy: remedy.into(),
        })
    }
}
