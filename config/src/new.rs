//! A first configuration: so many channels of each kind, on the first free pins.

use crate::board::{Board, Channel, Class, ControlInput, Modified};
use crate::platform::{Platform, own_pins, shared_pins};

/// What is wanted.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// How many of each, in the order of [`Class::ALL`].
    pub counts: [usize; 5],
    /// Headers with replaced buffers: inputs go there.
    pub modified: Vec<String>,
}

/// Why it cannot be had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NoRoom(pub String);

impl core::fmt::Display for NoRoom {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NoRoom {}

/// Lays it out: what drives on headers as they are sold, what reads on modified ones. The shared
/// lines come last, as outputs.
pub fn layout(name: &str, platform: Platform, wanted: &Wanted) -> Result<Board, NoRoom> {
    let unknown = wanted
        .modified
        .iter()
        .find(|name| !platform.headers.iter().any(|(header, _)| header == *name));
    if let Some(header) = unknown {
        let headers: Vec<&str> = platform
            .headers
            .iter()
            .map(|(header, _)| header.as_str())
            .collect();
        return Err(NoRoom(format!(
            "\"{header}\" is not a header of {}; there is {}",
            platform.name,
            headers.join(", ")
        )));
    }
    let own = |modified: bool| {
        let headers = platform
            .headers
            .iter()
            .filter(|(header, _)| wanted.modified.contains(header) == modified);
        let pins = headers.flat_map(|(header, _)| own_pins(header));
        pins.collect::<Vec<String>>()
    };
    let first = platform
        .headers
        .iter()
        .find(|(header, _)| !wanted.modified.contains(header))
        .or(platform.headers.first());
    let shared = first.map_or(Vec::new(), |(header, _)| shared_pins(header));
    let mut outputs = own(false).into_iter().chain(shared);
    let mut inputs = own(true).into_iter();
    let mut channels: [Vec<Channel>; 5] = Default::default();
    for (class, (count, channels)) in Class::ALL
        .into_iter()
        .zip(wanted.counts.into_iter().zip(&mut channels))
    {
        for n in 0..count {
            let mut pins = Vec::new();
            for (key, needed, drives) in class.pins() {
                if *needed {
                    let pin = if *drives {
                        outputs.next()
                    } else {
                        inputs.next()
                    };
                    pins.push((
                        *key,
                        pin.ok_or_else(|| no_room(&platform, class, n, *drives, &wanted.modified))?,
                    ));
                }
            }
            channels.push(Channel::new(class, default_name(class, n), pins));
        }
    }
    let mut board = blank(name, platform);
    board.modified.bus_switch.clone_from(&wanted.modified);
    board.channels = channels;
    Ok(board)
}

/// A board without channels, with its buffers as it is sold; the key is external reset and factory
/// pin.
pub fn blank(name: &str, platform: Platform) -> Board {
    let key = ControlInput {
        pin: Some("key".to_owned()),
        active: platform.key_active,
    };
    Board {
        file: String::new(),
        name: name.to_owned(),
        sys_clk_hz: 60_000_000,
        phy: 0,
        ext_reset: key.clone(),
        factory: Some(key),
        jobs: 0,
        sdram: platform.sdram.is_some(),
        mac: None,
        ipv4: [192, 168, 2, 50],
        udp_port: wire::DEFAULT_PORT,
        modified: Modified::default(),
        channels: Default::default(),
        platform,
    }
}

fn no_room(
    platform: &Platform,
    class: Class,
    n: usize,
    drives: bool,
    modified: &[String],
) -> NoRoom {
    NoRoom(match (drives, modified) {
        (true, _) => format!(
            "{} has no pin left for {}[{n}]; take some away, or leave more headers as they are sold",
            platform.name,
            class.key()
        ),
        (false, []) => format!(
            "{}[{n}] needs an input pin and the headers are outputs as sold; say which buffers you replaced, as in --modified j5,j6",
            class.key()
        ),
        (false, _) => format!(
            "the modified headers have no pin left for {}[{n}]; modify more, or take some away",
            class.key()
        ),
    })
}

fn default_name(class: Class, n: usize) -> String {
    match class {
        Class::Stepgen => match ["x", "y", "z", "a", "b", "c"].get(n) {
            Some(axis) => (*axis).to_owned(),
            None => format!("sg-{n:02}"),
        },
        Class::Encoder => format!("enc-{n:02}"),
        Class::Pwm => format!("pwm-{n:02}"),
        Class::Input => format!("in-{n:02}"),
        Class::Output => format!("out-{n:02}"),
    }
}
