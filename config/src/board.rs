//! A configuration: the use of each pin of a platform on one machine.

mod channel;
mod class;
mod keys;
mod network;
mod wiring;

use crate::error::Error;
use crate::platform::{Level, Platform, own_name};
use crate::tree::{At, nearest, parse_toml};
use std::collections::BTreeMap;
use wire::describe::Channels;
use wire::jobs::AXES as JOB_AXES;
use wiring::Wiring;

pub use channel::Channel;
pub use class::Class;
pub use keys::{ENCODER_TYPES, KEYS, PWM_TYPES, STEP_TYPES};

/// An input that is not a channel: the external reset, the factory pin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ControlInput {
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
    pub ext_reset: ControlInput,
    /// Held at power-up: factory settings.
    pub factory: Option<ControlInput>,
    /// Axes of a job: step generators 0 and up; 0: there are no jobs.
    pub jobs: usize,
    /// The services run in the card's SDRAM: consoles, jobs. Without it a PC streams the jobs.
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
        let phy = phy(&at, &platform)?;
        let mut wiring = Wiring::new(&platform);
        if let Some(modified) = at.table("modified")? {
            wiring.modify(&modified)?;
        }
        let channels = channels(&at, &mut wiring)?;
        let ext_reset = line(&at, "ext_reset", &mut wiring, None)?.unwrap_or(ControlInput {
            pin: None,
            active: Level::Low,
        });
        let factory = line(&at, "factory", &mut wiring, Some(&ext_reset))?;
        let jobs = jobs(&at, channels[Class::Stepgen as usize].len())?;
        let sdram = sdram(&at, jobs, &platform)?;
        let modified = wiring.into_modified();
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
            mac: network::mac(network)?,
            ipv4: network::ipv4(network)?,
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

    /// How many channels there are of each kind.
    pub fn channels(&self) -> Channels {
        // No kind has more than 64.
        let count = |class| self.of(class).len() as u8;
        Channels {
            stepgens: count(Class::Stepgen),
            encoders: count(Class::Encoder),
            pwms: count(Class::Pwm),
            inputs: count(Class::Input),
            outputs: count(Class::Output),
        }
    }

    /// One bit per output that is high while the board is not armed.
    pub fn safe_mask(&self) -> u64 {
        self.mask(Class::Output, Channel::is_safe_high)
    }

    /// One bit per output that is the other way round.
    pub fn invert_mask(&self) -> u64 {
        self.mask(Class::Output, |channel| channel.invert)
    }

    fn mask(&self, class: Class, is: impl Fn(&Channel) -> bool) -> u64 {
        let bits = self.of(class).iter().enumerate();
        bits.map(|(n, channel)| u64::from(is(channel)) << n).sum()
    }

    /// Keys of the pins a bitstream needs and the file does not give. Simulation needs none.
    pub fn missing_pins(&self) -> Vec<String> {
        let mut missing = Vec::new();
        for class in Class::ALL {
            for (n, channel) in self.of(class).iter().enumerate() {
                for (key, _, _) in class.pins().iter().filter(|key| channel.needs(key)) {
                    if channel.pin(key).is_none() {
                        missing.push(format!("{}[{n}].{key}", class.key()));
                    }
                }
            }
        }
        missing
    }
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

/// Which PHY of the platform.
fn phy(at: &At<'_>, platform: &Platform) -> Result<usize, Error> {
    let phy = at.integer("phy").unwrap_or(0) as usize;
    if phy < platform.phys.len() {
        return Ok(phy);
    }
    Err(at.error(
        "phy",
        &phy.to_string(),
        format!(
            "is not a PHY of {}, which has {}",
            platform.name,
            platform.phys.len()
        ),
        "write 0",
    ))
}

/// The channels of all kinds, in the order of [`Class::ALL`].
fn channels(at: &At<'_>, wiring: &mut Wiring<'_>) -> Result<[Vec<Channel>; 5], Error> {
    let mut channels: [Vec<Channel>; 5] = Default::default();
    let mut row = BTreeMap::new();
    for (class, channels) in Class::ALL.into_iter().zip(&mut channels) {
        let (mut names, mut theirs) = (BTreeMap::new(), BTreeMap::new());
        for (n, table) in at.tables(class.key())?.into_iter().enumerate() {
            let one = Channel::read(&table, class, n, &mut names, wiring)?;
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
            if let Some(name) = &one.litexcnc_name
                && let Some(other) = theirs.insert(name.clone(), n)
            {
                return Err(table.error(
                    "litexcnc_name",
                    &format!("{name:?}"),
                    format!("is already {}[{other}]'s", class.key()),
                    "give every channel of a kind a name of its own, here and in the HAL file",
                ));
            }
            channels.push(one);
        }
    }
    Ok(channels)
}

/// An input that is not a channel; its pin may be that of `shares`.
fn line(
    at: &At<'_>,
    key: &str,
    wiring: &mut Wiring<'_>,
    shares: Option<&ControlInput>,
) -> Result<Option<ControlInput>, Error> {
    let Some(table) = at.table(key)? else {
        return Ok(None);
    };
    let active = Level::of(table.text("active")).unwrap_or(Level::Low);
    let shared =
        shares.filter(|other| other.pin.is_some() && other.pin.as_deref() == table.text("pin"));
    let pin = match shared {
        Some(other) => other.pin.clone(),
        None => wiring.pin(&table, "pin", false)?,
    };
    Ok(Some(ControlInput { pin, active }))
}

/// The axes of a job.
fn jobs(at: &At<'_>, stepgens: usize) -> Result<usize, Error> {
    let jobs = at.integer("jobs").unwrap_or(0) as usize;
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
    Ok(jobs)
}

/// Whether the SDRAM is used: wherever there is one, unless the file says otherwise.
fn sdram(at: &At<'_>, jobs: usize, platform: &Platform) -> Result<bool, Error> {
    let said = at.flag("sdram");
    if platform.sdram.is_some() || said == Some(false) {
        return Ok(said.unwrap_or(true));
    }
    let (key, value) = match said {
        Some(said) => ("sdram", said.to_string()),
        None if jobs == 0 => return Ok(false),
        None => ("jobs", jobs.to_string()),
    };
    Err(at.error(
        key,
        &value,
        format!("needs an SDRAM, and {} has none", platform.name),
        "write sdram = false (a PC streams the jobs, if there are any), or say in the platform file where the SDRAM is ([sdram])",
    ))
}
