//! A configuration: the use of each pin of a platform on one machine.

use crate::error::Error;
use crate::hal::{self, HalClass};
use crate::platform::{Level, Platform, Role, own_name, split};
use crate::tree::{At, Key, Kind, may, must, nearest, parse_toml};
use std::collections::BTreeMap;
use std::fmt::Write;
use wire::jobs::AXES as JOB_AXES;
use wire::regmap::{ENCODER_MAX, IN_MAX, OUT_MAX, PWM_MAX, STEPGEN_MAX};

const NAME: &str = "a name as HAL has them, lower case, as in \"x\"";
const fn name(class: HalClass) -> Key {
    let most = class.room();
    must(
        "name",
        Kind::Shaped {
            pattern: "^[a-z][a-z0-9-]*$",
            most,
        },
        NAME,
    )
}
/// A header's pins but ground, the button, or nothing.
const PIN: Kind = Kind::Shaped {
    pattern: "^(j[1-9][0-9]?:([0124-9]|1[0-4])|key|none)$",
    most: 6,
};
const LEVELS: Kind = Kind::OneOf(&["low", "high"]);

const LINE: &[Key] = &[
    must("pin", PIN, "a pin, as in \"key\" or \"j8:6\", or \"none\""),
    must("active", LEVELS, "\"low\" or \"high\": the level that acts"),
];
const NETWORK: &[Key] = &[
    may(
        "mac",
        Kind::Shaped {
            pattern: "^[0-9a-f]{2}(:[0-9a-f]{2}){5}$",
            most: 17,
        },
        "a MAC address, as in \"10:e2:d5:00:00:01\"; without it the board makes one of its flash's serial number",
    ),
    must(
        "ipv4",
        Kind::Text,
        "the address the board has until it is given another, as in \"192.168.2.50\"",
    ),
    must(
        "udp_port",
        Kind::Integer { min: 1, max: 65535 },
        "the UDP port, as in 1234",
    ),
];
const MODIFIED: &[Key] = &[
    may(
        "bus_switch",
        Kind::Texts,
        "headers with bus switches in place of their buffers, as in [\"j5\", \"j6:shared\"]: both directions",
    ),
    may(
        "inputs",
        Kind::Texts,
        "headers with their buffers turned round, as in [\"j5\"]: inputs only",
    ),
];
/// The step generators' types, hostmot2's 0, 1 and 2.
pub const STEP_TYPES: [&str; 3] = ["step_dir", "up_down", "quadrature"];
/// The encoders' types.
pub const ENCODER_TYPES: [&str; 2] = ["quadrature", "counter"];
/// The PWMs' types, hostmot2's 1, 2, 3 and 4.
pub const PWM_TYPES: [&str; 4] = ["pwm", "up_down", "pdm", "dir_pwm"];

const STEPGEN: &[Key] = &[
    name(hal::STEPGEN),
    may(
        "type",
        Kind::OneOf(&STEP_TYPES),
        "\"step_dir\" (if nothing is said), \"up_down\": step is up and dir is down, or \"quadrature\": step is A and dir is B",
    ),
    may("step", PIN, "the output pin, as in \"j1:0\""),
    may("dir", PIN, "the output pin, as in \"j1:1\""),
    may(
        "step_n",
        PIN,
        "a pin for the inverted copy of step, for a differential input",
    ),
    may(
        "dir_n",
        PIN,
        "a pin for the inverted copy of dir, for a differential input",
    ),
    may("index", PIN, "an input pin: the axis' index pulse"),
];
const ENCODER: &[Key] = &[
    name(hal::ENCODER),
    may(
        "type",
        Kind::OneOf(&ENCODER_TYPES),
        "\"quadrature\" (if nothing is said) or \"counter\": pulses on a, no b",
    ),
    may("a", PIN, "the input pin, as in \"j6:0\""),
    may("b", PIN, "the input pin, as in \"j6:1\""),
    may("index", PIN, "an input pin: the index pulse, Z"),
    may(
        "mask",
        PIN,
        "an input pin that must be high for the index to count",
    ),
];
const PWM: &[Key] = &[
    name(hal::PWM),
    may(
        "type",
        Kind::OneOf(&PWM_TYPES),
        "\"pwm\" (if nothing is said), \"up_down\": pin is up and dir is down, \"pdm\" or \"dir_pwm\": the two pins swapped",
    ),
    may("pin", PIN, "the output pin, as in \"j3:0\""),
    may("dir", PIN, "an output pin for the sign"),
];
/// Numbers of LiteX-CNC's row of inputs and outputs.
const ROW: Kind = Kind::Integer { min: 0, max: 63 };

const GPIO_IN: &[Key] = &[
    name(hal::INPUT),
    may("pin", PIN, "the input pin, as in \"j8:2\""),
    may(
        "estop",
        LEVELS,
        "the level that stops the machine, in the gateware; a normally closed contact to ground stops on \"high\"",
    ),
    may(
        "litexcnc",
        ROW,
        "the number it had in LiteX-CNC's one row of inputs and outputs, for names=litexcnc",
    ),
];
const GPIO_OUT: &[Key] = &[
    name(hal::OUTPUT),
    may("pin", PIN, "the output pin, as in \"j4:0\""),
    must(
        "safe",
        LEVELS,
        "\"low\" or \"high\": the level of the pin whenever the board is not armed",
    ),
    may(
        "invert",
        Kind::Flag,
        "true or false: whether the pin is low when HAL says true, from power-up on",
    ),
    may(
        "litexcnc",
        ROW,
        "the number it had in LiteX-CNC's one row of inputs and outputs, for names=litexcnc",
    ),
];

/// Keys of a file in `boards`.
pub const KEYS: &[Key] = &[
    must(
        "name",
        Kind::Text,
        "the configuration's name, the file's own, as in \"mill6\"",
    ),
    must(
        "platform",
        Kind::Text,
        "the name of a file in boards/platforms, without .toml",
    ),
    must(
        "sys_clk_hz",
        Kind::Integer {
            min: 10_000_000,
            max: 100_000_000,
        },
        "the clock of the cores in hertz, as in 60_000_000, which closes",
    ),
    may(
        "phy",
        Kind::Integer { min: 0, max: 1 },
        "0 (if nothing is said) or 1: which Ethernet jack is used",
    ),
    must(
        "ext_reset",
        Kind::Table(LINE),
        "a table with pin and active, as in { pin = \"key\", active = \"low\" }, or pin = \"none\"",
    ),
    may(
        "factory",
        Kind::Table(LINE),
        "a table with pin and active: held at power-up, the board forgets its stored settings for this run",
    ),
    may(
        "jobs",
        Kind::Integer {
            min: 0,
            max: JOB_AXES as i64,
        },
        "3: jobs move the first three step generators without a PC; 0 (if nothing is said): there are no jobs",
    ),
    may(
        "sdram",
        Kind::Flag,
        "true (if nothing is said) or false: without the SDRAM a PC streams the jobs",
    ),
    must(
        "network",
        Kind::Table(NETWORK),
        "a table with ipv4 and udp_port, and mac if it shall have one of its own",
    ),
    may(
        "modified",
        Kind::Table(MODIFIED),
        "a table of the headers with replaced buffers",
    ),
    may(
        "stepgen",
        Kind::Tables(STEPGEN, STEPGEN_MAX),
        "an array of tables, [[stepgen]]",
    ),
    may(
        "encoder",
        Kind::Tables(ENCODER, ENCODER_MAX),
        "an array of tables, [[encoder]]",
    ),
    may(
        "pwm",
        Kind::Tables(PWM, PWM_MAX),
        "an array of tables, [[pwm]]",
    ),
    may(
        "gpio_in",
        Kind::Tables(GPIO_IN, IN_MAX),
        "an array of tables, [[gpio_in]]",
    ),
    may(
        "gpio_out",
        Kind::Tables(GPIO_OUT, OUT_MAX),
        "an array of tables, [[gpio_out]]",
    ),
];

/// A kind of channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// `[[stepgen]]`.
    Stepgen,
    /// `[[encoder]]`.
    Encoder,
    /// `[[pwm]]`.
    Pwm,
    /// `[[gpio_in]]`.
    Input,
    /// `[[gpio_out]]`.
    Output,
}

/// A pin key of a channel: its name, whether the channel needs it, whether it drives.
type PinKey = (&'static str, bool, bool);

impl Class {
    /// All of them, in the order of the file and of the blob.
    pub const ALL: [Class; 5] = [
        Class::Stepgen,
        Class::Encoder,
        Class::Pwm,
        Class::Input,
        Class::Output,
    ];

    /// The array's name in a board file.
    pub const fn key(self) -> &'static str {
        match self {
            Class::Stepgen => "stepgen",
            Class::Encoder => "encoder",
            Class::Pwm => "pwm",
            Class::Input => "gpio_in",
            Class::Output => "gpio_out",
        }
    }

    /// First letter of the blob's pin text.
    pub const fn letter(self) -> char {
        match self {
            Class::Stepgen => 's',
            Class::Encoder => 'e',
            Class::Pwm => 'p',
            Class::Input => 'i',
            Class::Output => 'o',
        }
    }

    /// How its names become HAL's.
    pub const fn hal(self) -> HalClass {
        match self {
            Class::Stepgen => hal::STEPGEN,
            Class::Encoder => hal::ENCODER,
            Class::Pwm => hal::PWM,
            Class::Input => hal::INPUT,
            Class::Output => hal::OUTPUT,
        }
    }

    /// Its pins, in the order they are written.
    pub const fn pins(self) -> &'static [PinKey] {
        match self {
            Class::Stepgen => &[
                ("step", true, true),
                ("step_n", false, true),
                ("dir", true, true),
                ("dir_n", false, true),
                ("index", false, false),
            ],
            Class::Encoder => &[
                ("a", true, false),
                ("b", true, false),
                ("index", false, false),
                ("mask", false, false),
            ],
            Class::Pwm => &[("pin", true, true), ("dir", false, true)],
            Class::Input => &[("pin", true, false)],
            Class::Output => &[("pin", true, true)],
        }
    }

    /// Its types, the first being meant when nothing is said.
    pub const fn types(self) -> &'static [&'static str] {
        match self {
            Class::Stepgen => &STEP_TYPES,
            Class::Encoder => &ENCODER_TYPES,
            Class::Pwm => &PWM_TYPES,
            Class::Input | Class::Output => &[],
        }
    }
}

/// One channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// As HAL will call it.
    pub name: String,
    /// One of the class' types; empty where it has none.
    pub kind: String,
    /// Key and pin, in the order of [`Class::pins`]; only those it has.
    pub pins: Vec<(&'static str, String)>,
    /// Inputs: the level that stops.
    pub estop: Option<Level>,
    /// Outputs: the level of the pin while not armed.
    pub safe: Option<Level>,
    /// Outputs: the pin is the other way round.
    pub invert: bool,
    /// Inputs and outputs: the number in LiteX-CNC's row of both.
    pub litexcnc: Option<u8>,
}

impl Channel {
    /// A channel of the class' usual type on these pins. An output is safe low.
    pub fn new(class: Class, name: String, pins: Vec<(&'static str, String)>) -> Self {
        let usual = class.types().first().copied();
        Channel {
            name,
            kind: usual.unwrap_or_default().to_owned(),
            pins,
            estop: None,
            safe: (class == Class::Output).then_some(Level::Low),
            invert: false,
            litexcnc: None,
        }
    }

    /// The pin of a key.
    pub fn pin(&self, key: &str) -> Option<&str> {
        self.pins
            .iter()
            .find(|(known, _)| *known == key)
            .map(|(_, pin)| pin.as_str())
    }

    /// The pins and what else the host should know, as the blob tells it: `step=j1:0 dir=j1:1
    /// type=up_down`. A type that would be meant anyway is not written.
    pub fn text(&self, class: Class) -> String {
        let mut text = String::new();
        for (key, pin) in &self.pins {
            let _ = write!(text, "{key}={pin} ");
        }
        if !self.kind.is_empty() && class.types().first() != Some(&self.kind.as_str()) {
            let _ = write!(text, "type={} ", self.kind);
        }
        if let Some(level) = self.estop {
            let _ = write!(text, "estop={} ", level.word());
        }
        if self.safe == Some(Level::High) {
            text += "safe=high ";
        }
        if self.invert {
            text += "invert=true ";
        }
        if let Some(number) = self.litexcnc {
            let _ = write!(text, "gpio={number} ");
        }
        text.truncate(text.trim_end().len());
        text
    }
}

/// An input that is not a channel: the external reset, the factory pin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Nothing when the machine has none.
    pub pin: Option<String>,
    /// The level that acts.
    pub active: Level,
}

/// What was done to the PCB.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Modified {
    /// Both directions: `j5`, `j6:shared`.
    pub bus_switch: Vec<String>,
    /// Inputs only.
    pub inputs: Vec<String>,
}

/// A machine configuration on a platform.
#[derive(Clone, Debug)]
pub struct Board {
    /// The file as it was named to us.
    pub file: String,
    /// The file's name without its ending.
    pub name: String,
    /// The PCB.
    pub platform: Platform,
    /// The cores' clock.
    pub sys_clk_hz: u32,
    /// Which PHY.
    pub phy: usize,
    /// Closes the gate, and resets.
    pub ext_reset: Line,
    /// Held at power-up: factory settings.
    pub factory: Option<Line>,
    /// Axes of a job: step generators 0 and up; 0: there are no jobs.
    pub jobs: usize,
    /// Jobs live in the card's SDRAM. Without it a PC streams them.
    pub sdram: bool,
    /// `None`: made of the flash's serial number.
    pub mac: Option<[u8; 6]>,
    /// Until another is set.
    pub ipv4: [u8; 4],
    /// Until another is set.
    pub udp_port: u16,
    /// What was done to the PCB.
    pub modified: Modified,
    /// In the order of [`Class::ALL`].
    pub channels: [Vec<Channel>; 5],
}

/// Where platforms come from.
pub trait Platforms {
    /// The file's name and text, or nothing when there is none of this name.
    fn text(&self, name: &str) -> Option<(String, String)>;
    /// The names there are.
    fn names(&self) -> Vec<String>;
}

impl Board {
    /// Reads a board file's text. `stem` is the file's name without its ending.
    pub fn read(
        file: &str,
        stem: &str,
        text: &str,
        platforms: &dyn Platforms,
    ) -> Result<Self, Error> {
        let tree = parse_toml(file, text)?;
        let at = At::new(file, "", &tree, KEYS)?;
        let name = own_name(&at, stem)?;
        let platform = platform(&at, platforms)?;
        let phy = at.integer("phy").unwrap_or(0) as usize;
        if phy >= platform.phys.len() {
            return Err(at.error(
                "phy",
                &phy.to_string(),
                format!(
                    "is not a PHY of {}, which has {}",
                    platform.name,
                    platform.phys.len()
                ),
                "write 0",
            ));
        }
        let mut wiring = Wiring {
            platform: &platform,
            modified: Modified::default(),
            used: BTreeMap::new(),
            ways: BTreeMap::new(),
        };
        if let Some(modified) = at.table("modified")? {
            wiring.modify(&modified)?;
        }
        let mut channels: [Vec<Channel>; 5] = Default::default();
        let mut row = BTreeMap::new();
        for (class, channels) in Class::ALL.into_iter().zip(&mut channels) {
            let mut names = BTreeMap::new();
            for (n, table) in at.tables(class.key())?.into_iter().enumerate() {
                let one = channel(&table, class, n, &mut names, &mut wiring)?;
                if let Some(number) = one.litexcnc
                    && let Some(other) = row.insert(number, format!("{}[{n}]", class.key()))
                {
                    return Err(table.error(
                        "litexcnc",
                        &number.to_string(),
                        format!("is already {other}'s"),
                        "LiteX-CNC counts inputs and outputs in one row, so each number is there once",
                    ));
                }
                channels.push(one);
            }
        }
        let line = |key: &str,
                    wiring: &mut Wiring<'_>,
                    shares: Option<&Line>|
         -> Result<Option<Line>, Error> {
            let Some(table) = at.table(key)? else {
                return Ok(None);
            };
            let active = Level::of(table.text("active")).unwrap_or(Level::Low);
            let shared = shares
                .filter(|other| other.pin.is_some() && other.pin.as_deref() == table.text("pin"));
            let pin = match shared {
                Some(other) => other.pin.clone(),
                None => wiring.pin(&table, "pin", false)?,
            };
            Ok(Some(Line { pin, active }))
        };
        let ext_reset = line("ext_reset", &mut wiring, None)?.unwrap_or(Line {
            pin: None,
            active: Level::Low,
        });
        let factory = line("factory", &mut wiring, Some(&ext_reset))?;
        let jobs = at.integer("jobs").unwrap_or(0) as usize;
        let stepgens = channels[Class::Stepgen as usize].len();
        if jobs != 0 && jobs != JOB_AXES {
            return Err(at.error(
                "jobs",
                &jobs.to_string(),
                format!("is not the number of axes a job has, which is {JOB_AXES}"),
                "write 3, or leave the key out; an axis that the machine does not have needs a [[stepgen]], but no drive",
            ));
        }
        if jobs > stepgens {
            return Err(at.error(
                "jobs",
                &jobs.to_string(),
                format!("is more axes than the {stepgens} step generators there are"),
                "leave the key out, or write another [[stepgen]]",
            ));
        }
        let said = at.flag("sdram");
        if let Some(said) = said.filter(|_| jobs == 0) {
            return Err(at.error(
                "sdram",
                &said.to_string(),
                "is set for a board without jobs; only jobs use the SDRAM",
                "leave the key out, or say which axes jobs move (jobs = 3)",
            ));
        }
        let sdram = jobs > 0 && said.unwrap_or(true);
        if sdram && platform.sdram.is_none() {
            return Err(at.error(
                "jobs",
                &jobs.to_string(),
                format!("needs an SDRAM, and {} has none", platform.name),
                "write sdram = false to have a PC stream the jobs, or say in the platform file where the SDRAM is ([sdram])",
            ));
        }
        let modified = wiring.modified;
        let network = at.table("network")?;
        let network = network.as_ref().unwrap_or(&at);
        Ok(Board {
            file: file.to_owned(),
            name,
            sys_clk_hz: at.integer("sys_clk_hz").unwrap_or_default() as u32,
            phy,
            ext_reset,
            factory,
            jobs,
            sdram,
            mac: mac(network)?,
            ipv4: ipv4(network)?,
            udp_port: network.integer("udp_port").unwrap_or_default() as u16,
            modified,
            channels,
            platform,
        })
    }

    /// The channels of one kind.
    pub fn of(&self, class: Class) -> &[Channel] {
        &self.channels[class as usize]
    }

    /// One bit per output that is high while the board is not armed.
    pub fn safe_mask(&self) -> u32 {
        // `gpio.sv` turns the safe level over with the rest.
        self.mask(Class::Output, |channel| {
            (channel.safe == Some(Level::High)) != channel.invert
        })
    }

    /// One bit per output that is the other way round.
    pub fn invert_mask(&self) -> u32 {
        self.mask(Class::Output, |channel| channel.invert)
    }

    fn mask(&self, class: Class, is: impl Fn(&Channel) -> bool) -> u32 {
        let bits = self.of(class).iter().enumerate();
        bits.map(|(n, channel)| u32::from(is(channel)) << n).sum()
    }

    /// Keys of the pins a bitstream needs and the file does not give. Simulation needs none.
    pub fn missing_pins(&self) -> Vec<String> {
        let mut missing = Vec::new();
        for class in Class::ALL {
            for (n, channel) in self.of(class).iter().enumerate() {
                for (key, _, _) in class.pins().iter().filter(|key| needs(channel, key)) {
                    if channel.pin(key).is_none() {
                        missing.push(format!("{}[{n}].{key}", class.key()));
                    }
                }
            }
        }
        missing
    }
}

fn needs(channel: &Channel, (key, needed, _): &PinKey) -> bool {
    *needed && !(channel.kind == "counter" && *key == "b")
}

fn platform(at: &At<'_>, platforms: &dyn Platforms) -> Result<Platform, Error> {
    let wanted = at.text("platform").unwrap_or_default();
    let Some((file, text)) = platforms.text(wanted) else {
        let names = platforms.names();
        let near = nearest(wanted, names.iter().map(String::as_str))
            .map_or(String::new(), |near| format!(" (did you mean {near}?)"));
        return Err(at.error(
            "platform",
            &format!("{wanted:?}"),
            format!("is not a platform we know{near}"),
            format!("write one of {}", names.join(", ")),
        ));
    };
    Platform::read(&file, wanted, &text)
}

fn mac(at: &At<'_>) -> Result<Option<[u8; 6]>, Error> {
    let Some(text) = at.text("mac") else {
        return Ok(None);
    };
    let shown = format!("{text:?}");
    let bytes: Vec<u8> = text
        .split(':')
        .filter(|part| part.len() == 2)
        .filter_map(|part| u8::from_str_radix(part, 16).ok())
        .collect();
    let mac: Option<[u8; 6]> = bytes.try_into().ok().filter(|_| {
        text.len() == 17
            && text
                .bytes()
                .all(|b| b == b':' || b.is_ascii_hexdigit() && !b.is_ascii_uppercase())
    });
    let Some(mac) = mac else {
        return Err(at.error(
            "mac",
            &shown,
            "is not six bytes in lower case hexadecimal",
            "write it as in \"10:e2:d5:00:00:01\", or leave it out and the board makes one",
        ));
    };
    if mac[0] & 1 == 1 {
        return Err(at.error(
            "mac",
            &shown,
            "is a group address, which no board can have",
            "make the first byte even",
        ));
    }
    if mac == [0; 6] {
        return Err(at.error(
            "mac",
            &shown,
            "is no address at all",
            "write one, or leave it out and the board makes one",
        ));
    }
    Ok(Some(mac))
}

fn ipv4(at: &At<'_>) -> Result<[u8; 4], Error> {
    let text = at.text("ipv4").unwrap_or_default();
    let shown = format!("{text:?}");
    let Ok(address) = text.parse::<std::net::Ipv4Addr>() else {
        return Err(at.error(
            "ipv4",
            &shown,
            "is not an IPv4 address",
            "write it as in \"192.168.2.50\"",
        ));
    };
    if address.is_multicast()
        || address.is_broadcast()
        || address.is_unspecified()
        || address.is_loopback()
    {
        return Err(at.error(
            "ipv4",
            &shown,
            "is not an address one board can have",
            "write one of your network, as in \"192.168.2.50\"",
        ));
    }
    Ok(address.octets())
}

fn channel(
    at: &At<'_>,
    class: Class,
    n: usize,
    names: &mut BTreeMap<String, usize>,
    wiring: &mut Wiring<'_>,
) -> Result<Channel, Error> {
    let name = at.text("name").unwrap_or_default();
    let shown = format!("{name:?}");
    let hal = class.hal();
    if !hal::is_name(name) {
        let better = hal::nearest_name(name, hal.room());
        let hint = if better.is_empty() {
            String::new()
        } else {
            format!(", as in \"{better}\"")
        };
        return Err(at.error(
            "name",
            &shown,
            "cannot be part of a HAL name",
            format!("use a-z, 0-9 and hyphens, a letter first{hint}"),
        ));
    }
    if name.len() > hal.room() {
        let pin = hal.pin(name);
        return Err(at.error(
            "name",
            &shown,
            format!(
                "is too long: HAL has {} characters and {pin} is {}",
                hal::NAME_MAX,
                pin.len()
            ),
            format!("use up to {} characters for a {}", hal.room(), class.key()),
        ));
    }
    if let Some(other) = names.insert(name.to_owned(), n) {
        return Err(at.error(
            "name",
            &shown,
            format!("is already {}[{other}]'s", class.key()),
            "give every channel of a kind a name of its own",
        ));
    }
    let mut channel = Channel {
        name: name.to_owned(),
        kind: at
            .text_if("type")
            .or(class.types().first().copied())
            .unwrap_or_default()
            .to_owned(),
        pins: Vec::new(),
        estop: Level::of(at.text_if("estop")),
        safe: Level::of(at.text_if("safe")),
        invert: at.flag_if("invert").unwrap_or(false),
        litexcnc: at
            .integer_if("litexcnc")
            .and_then(|number| u8::try_from(number).ok()),
    };
    for (key, _, drives) in class.pins() {
        if let Some(pin) = wiring.pin(at, key, *drives)? {
            channel.pins.push((key, pin));
        }
    }
    // A channel without any pin is one for simulation; one with some but not all is a mistake.
    if !channel.pins.is_empty() {
        for key in class.pins().iter().filter(|key| needs(&channel, key)) {
            if channel.pin(key.0).is_none() {
                let other = channel.pins[0].0;
                let copy = format!("{}_n", key.0);
                let remedy = match channel.pin(&copy) {
                    Some(pin) => {
                        format!("{copy} = {pin:?} is its inverted copy; write {} too", key.0)
                    }
                    None => format!("write it, as in {} = \"j1:0\"", key.0),
                };
                return Err(at.error(
                    key.0,
                    "",
                    format!("is missing though {other} is there"),
                    remedy,
                ));
            }
        }
    }
    if channel.kind == "counter" && channel.pin("b").is_some() {
        return Err(at.error(
            "b",
            "",
            "has no meaning for type = \"counter\", which counts a alone",
            "take b or the type away",
        ));
    }
    if class == Class::Pwm
        && matches!(channel.kind.as_str(), "up_down" | "dir_pwm")
        && !channel.pins.is_empty()
        && channel.pin("dir").is_none()
    {
        return Err(at.error(
            "dir",
            "",
            format!("is missing: type = \"{}\" needs two pins", channel.kind),
            "write dir, the second one, or take the type away",
        ));
    }
    Ok(channel)
}

/// The pins, which are used, and which way they may go.
struct Wiring<'p> {
    platform: &'p Platform,
    modified: Modified,
    /// What is used, a shared line by its place among the shared: the name it has there and the key
    /// that has it.
    used: BTreeMap<String, (String, String)>,
    /// `j5` and `j5:shared` -> whether it can drive.
    ways: BTreeMap<String, bool>,
}

impl Wiring<'_> {
    fn modify(&mut self, at: &At<'_>) -> Result<(), Error> {
        for (key, drives) in [("bus_switch", true), ("inputs", false)] {
            for (n, (name, place)) in at.texts(key).into_iter().enumerate() {
                let header = name.strip_suffix(":shared").unwrap_or(name);
                let which = format!("{key}[{n}]");
                if !self
                    .platform
                    .headers
                    .iter()
                    .any(|(known, _)| known == header)
                {
                    return Err(at.error_at(place, &which, &format!("{name:?}"), format!("is not a header of {}", self.platform.name), "write a header, as in \"j5\" for the lines it has to itself or \"j5:shared\" for those it shares".to_owned()));
                }
                if self.ways.insert(name.to_owned(), drives).is_some() {
                    return Err(at.error_at(
                        place,
                        &which,
                        &format!("{name:?}"),
                        "is there twice",
                        "say it once".to_owned(),
                    ));
                }
                let list = if drives {
                    &mut self.modified.bus_switch
                } else {
                    &mut self.modified.inputs
                };
                list.push(name.to_owned());
            }
        }
        Ok(())
    }

    fn pin(&mut self, at: &At<'_>, key: &str, drives: bool) -> Result<Option<String>, Error> {
        let Some(name) = at.text(key).filter(|name| *name != "none") else {
            return Ok(None);
        };
        let shown = format!("{name:?}");
        let wrong = |problem: String, remedy: String| Err(at.error(key, &shown, problem, remedy));
        let Some((role, _)) = self.platform.pin(name) else {
            let (problem, remedy) = self.platform.no_such_pin(name);
            return wrong(problem, remedy);
        };
        let (header, index) = split(name).unwrap_or(("", 0));
        match role {
            Role::Ground => {
                return wrong(
                    "is ground".to_owned(),
                    format!(
                        "write one of {header}:0 to 2, 4 to 6 or, shared by all headers, 7 to 14"
                    ),
                );
            }
            Role::Key if drives => {
                return wrong(
                    "is the button, an input".to_owned(),
                    "write a header's pin, as in \"j1:0\"".to_owned(),
                );
            }
            Role::Key => {}
            Role::Own | Role::Shared => {
                let lines = if role == Role::Own {
                    header.to_owned()
                } else {
                    format!("{header}:shared")
                };
                match (self.ways.get(&lines), drives) {
                    (None, false) => {
                        return wrong(
                            format!(
                                "cannot be read: {header} leaves the board through 74HC245 buffers, outputs as sold"
                            ),
                            format!(
                                "replace its buffers (docs/bringup.md) and say so, [modified] bus_switch = [\"{lines}\"], or use a pin of a header that is modified"
                            ),
                        );
                    }
                    (Some(false), true) => {
                        return wrong(
                            format!(
                                "cannot be driven: [modified] inputs says that {lines} was turned round"
                            ),
                            "use another header's pin, or replace the buffers by bus switches"
                                .to_owned(),
                        );
                    }
                    _ => {}
                }
            }
        }
        let line = match role {
            Role::Shared => format!("shared:{index}"),
            _ => name.to_owned(),
        };
        let holder = at.key(key);
        match self.used.get(&line) {
            Some((same, other)) if same == name => wrong(
                format!("is already {other}"),
                "every pin has one use; choose a free one".to_owned(),
            ),
            Some((same, other)) => wrong(
                format!("is the same line as \"{same}\", which is already {other}"),
                "pins 7 to 14 are one line on all headers; choose a free one".to_owned(),
            ),
            None => {
                self.used.insert(line, (name.to_owned(), holder));
                Ok(Some(name.to_owned()))
            }
        }
    }
}
