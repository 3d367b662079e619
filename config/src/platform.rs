//! A platform: the use of each ball of the FPGA on a PCB. It holds facts of the PCB only; the board
//! file says how a machine uses them.

use crate::error::{Error, Place};
use crate::tree::{At, Key, Kind, may, must, nearest, parse_toml};
use std::collections::BTreeMap;

/// What a HUB75 header's sixteen pins are, counted from 0 as Lcnc and LiteX-CNC count them. The
/// silk screen counts from 1.
pub const HEADER: [&str; 16] = [
    "R0", "G0", "B0", "GND", "R1", "G1", "B1", "E", "A", "B", "C", "D", "CLK", "LAT", "OE", "GND",
];
/// First of the lines every header shares.
pub const FIRST_SHARED: usize = 7;
/// Lines every header shares.
pub const SHARED: usize = 8;
/// Lines a header has to itself.
pub const OWN: usize = 6;

/// The pins a header has to itself, in their order.
pub fn own_pins(header: &str) -> Vec<String> {
    let own = (0..FIRST_SHARED).filter(|n| HEADER[*n] != "GND");
    own.map(|n| format!("{header}:{n}")).collect()
}

/// The pins it shares with every other header, by this one's name.
pub fn shared_pins(header: &str) -> Vec<String> {
    let shared = FIRST_SHARED..HEADER.len() - 1;
    shared.map(|n| format!("{header}:{n}")).collect()
}

const BALL: &str = "the FPGA's ball, as in \"P6\"";

const CLOCK: &[Key] = &[
    must("ball", Kind::Text, BALL),
    must(
        "hz",
        Kind::Integer {
            min: 1_000_000,
            max: 400_000_000,
        },
        "the oscillator in hertz, as in 25_000_000",
    ),
];
const LINE: &[Key] = &[
    must("ball", Kind::Text, BALL),
    must(
        "active",
        Kind::OneOf(&["low", "high"]),
        "\"low\" or \"high\": the level at which it is lit or pressed",
    ),
];
const FLASH: &[Key] = &[
    must(
        "chip",
        Kind::Text,
        "what is printed on it, as in \"W25Q32JV\"",
    ),
    must(
        "bytes",
        Kind::Integer {
            min: 0x10_0000,
            max: 0x100_0000,
        },
        "its size in bytes, as in 4_194_304",
    ),
    must("cs", Kind::Text, BALL),
    must("mosi", Kind::Text, BALL),
    must("miso", Kind::Text, BALL),
];
const SDRAM: &[Key] = &[
    must(
        "chip",
        Kind::Text,
        "what is printed on it, as in \"M12L64322A\"",
    ),
    must("clk", Kind::Text, BALL),
    must("we", Kind::Text, BALL),
    must("ras", Kind::Text, BALL),
    must("cas", Kind::Text, BALL),
    must(
        "ba",
        Kind::Texts,
        "the balls of the bank address, bit 0 first",
    ),
    must("a", Kind::Texts, "the balls of the address, bit 0 first"),
    must("dq", Kind::Texts, "the 32 balls of the data, bit 0 first"),
];
const MANAGEMENT: &[Key] = &[
    must(
        "chip",
        Kind::Text,
        "what is printed on the PHYs, as in \"RTL8211FD\"",
    ),
    must("mdio", Kind::Text, BALL),
    must("mdc", Kind::Text, BALL),
    may(
        "reset",
        Kind::Text,
        "the ball of the reset both PHYs share; no configuration may drive it",
    ),
];
const PHY: &[Key] = &[
    must("tx_clk", Kind::Text, BALL),
    must("rx_clk", Kind::Text, BALL),
    must("tx_ctl", Kind::Text, BALL),
    must("rx_ctl", Kind::Text, BALL),
    must("tx_data", Kind::Texts, "four balls, bit 0 first"),
    must("rx_data", Kind::Texts, "four balls, bit 0 first"),
];

/// Keys of a file in `boards/platforms`.
pub const KEYS: &[Key] = &[
    must(
        "name",
        Kind::Text,
        "the platform's name, the file's own, as in \"5a-75b-8.0\"",
    ),
    must(
        "title",
        Kind::Text,
        "what is printed on the PCB, as in \"Colorlight 5A-75B V8.0\"",
    ),
    must(
        "device",
        Kind::Text,
        "the FPGA with package and speed grade, as in \"LFE5U-25F-6BG256C\"",
    ),
    must(
        "clock",
        Kind::Table(CLOCK),
        "a table with ball and hz: the clock the FPGA gets",
    ),
    must("led", Kind::Table(LINE), "a table with ball and active"),
    must(
        "key",
        Kind::Table(LINE),
        "a table with ball and active: the button, or the pads where one goes",
    ),
    must(
        "flash",
        Kind::Table(FLASH),
        "a table with chip, bytes, cs, mosi and miso; the clock has no ball, it is the FPGA's own",
    ),
    may(
        "sdram",
        Kind::Table(SDRAM),
        "a table with the balls of the SDRAM",
    ),
    must(
        "ethernet",
        Kind::Table(MANAGEMENT),
        "a table with chip, mdio, mdc and the reset, which both PHYs share",
    ),
    must(
        "phy",
        Kind::Tables(PHY, 2),
        "an array of tables, [[phy]]: the RGMII balls of each PHY",
    ),
    must(
        "shared",
        Kind::Texts,
        "the balls of the eight lines every header has, in the order E A B C D CLK LAT OE",
    ),
    must(
        "headers",
        Kind::Lists,
        "a table of headers, each with the balls of R0 G0 B0 R1 G1 B1",
    ),
];

/// A level, of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// 0 V.
    Low,
    /// 3.3 V at the FPGA, 5 V behind the board's buffers.
    High,
}

impl Level {
    /// Of the word in a file.
    pub fn of(text: Option<&str>) -> Option<Self> {
        match text {
            Some("low") => Some(Level::Low),
            Some("high") => Some(Level::High),
            _ => None,
        }
    }

    /// As a board file writes it.
    pub const fn word(self) -> &'static str {
        match self {
            Level::Low => "low",
            Level::High => "high",
        }
    }
}

/// The balls of the SDRAM: 32 bits wide. Its clock enable, chip select and data masks are wired on
/// the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sdram {
    /// What is printed on it, as in `M12L64322A` or `2x M12L16161A`.
    pub chip: String,
    /// Clock.
    pub clk: String,
    /// Write enable.
    pub we: String,
    /// Row address strobe.
    pub ras: String,
    /// Column address strobe.
    pub cas: String,
    /// Bank address, bit 0 first.
    pub ba: Vec<String>,
    /// Address, bit 0 first.
    pub a: Vec<String>,
    /// Data, bit 0 first.
    pub dq: Vec<String>,
}

/// The balls of one PHY's RGMII.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Phy {
    /// FPGA to PHY.
    pub tx_clk: String,
    /// PHY to FPGA.
    pub rx_clk: String,
    /// FPGA to PHY.
    pub tx_ctl: String,
    /// PHY to FPGA.
    pub rx_ctl: String,
    /// Bit 0 first.
    pub tx_data: Vec<String>,
    /// Bit 0 first.
    pub rx_data: Vec<String>,
}

/// What a pin of a platform is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A line this header has to itself; behind a buffer.
    Own,
    /// A line every header has; behind a buffer for every two headers or so.
    Shared,
    /// Ground.
    Ground,
    /// The button; an input.
    Key,
}

/// A PCB.
#[derive(Clone, Debug)]
pub struct Platform {
    /// The file as it was named to us.
    pub file: String,
    /// The file's name without its ending.
    pub name: String,
    /// What is printed on the PCB.
    pub title: String,
    /// The FPGA, as in `LFE5U-25F-6BG256C`.
    pub device: String,
    /// What its maker's tools call the package, as in `CABGA256`.
    pub package: &'static str,
    /// Where the clock comes in.
    pub clock_ball: String,
    /// How fast it is.
    pub clock_hz: u32,
    /// The one LED.
    pub led_ball: String,
    /// Lit when it is at this level.
    pub led_active: Level,
    /// The button.
    pub key_ball: String,
    /// Pressed when it is at this level.
    pub key_active: Level,
    /// What is printed on the flash.
    pub flash_chip: String,
    /// Size of the flash.
    pub flash_bytes: u32,
    /// Chip select, data to the flash, data from the flash.
    pub flash_balls: [String; 3],
    /// The SDRAM, if the file says where it is.
    pub sdram: Option<Sdram>,
    /// What is printed on the PHYs.
    pub phy_chip: String,
    /// Management data and clock of all PHYs.
    pub mdio: [String; 2],
    /// The reset both PHYs share. Low stops the FPGA's clock.
    pub phy_reset: Option<String>,
    /// One or two.
    pub phys: Vec<Phy>,
    /// `j1`, `j2` ... in the order of the board, each with its six balls.
    pub headers: Vec<(String, Vec<String>)>,
    /// E A B C D CLK LAT OE.
    pub shared: Vec<String>,
}

impl Platform {
    /// Reads a platform file's text. `stem` is the file's name without its ending.
    pub fn read(file: &str, stem: &str, text: &str) -> Result<Self, Error> {
        let tree = parse_toml(file, text)?;
        let at = At::new(file, "", &tree, KEYS)?;
        let mut claims = Claims::default();
        let name = own_name(&at, stem)?;
        let device = at.text("device").unwrap_or_default();
        let mut platform = Platform {
            file: file.to_owned(),
            name,
            title: at.text("title").unwrap_or_default().to_owned(),
            device: device.to_owned(),
            package: package(device).ok_or_else(|| at.error("device", &format!("{device:?}"), "names no package we know", "write one of Lattice's part numbers with BG256 or BG381 in it, as in \"LFE5U-25F-6BG256C\""))?,
            clock_ball: String::new(),
            clock_hz: 0,
            led_ball: String::new(),
            led_active: Level::Low,
            key_ball: String::new(),
            key_active: Level::Low,
            flash_chip: String::new(),
            flash_bytes: 0,
            flash_balls: Default::default(),
            sdram: None,
            phy_chip: String::new(),
            mdio: Default::default(),
            phy_reset: None,
            phys: Vec::new(),
            headers: Vec::new(),
            shared: Vec::new(),
        };
        if let Some(clock) = at.table("clock")? {
            platform.clock_ball = claims.key(&clock, "ball")?;
            platform.clock_hz = clock.integer("hz").unwrap_or_default() as u32;
        }
        if let Some(led) = at.table("led")? {
            platform.led_ball = claims.key(&led, "ball")?;
            platform.led_active = Level::of(led.text("active")).unwrap_or(Level::Low);
        }
        if let Some(key) = at.table("key")? {
            platform.key_ball = claims.key(&key, "ball")?;
            platform.key_active = Level::of(key.text("active")).unwrap_or(Level::Low);
        }
        platform.read_flash(&at, &mut claims)?;
        platform.read_sdram(&at, &mut claims)?;
        platform.read_ethernet(&at, &mut claims)?;
        platform.shared = claims.keys(&at, "shared", Some(SHARED))?;
        platform.read_headers(&at, &mut claims)?;
        Ok(platform)
    }

    fn read_flash(&mut self, at: &At<'_>, claims: &mut Claims) -> Result<(), Error> {
        if let Some(flash) = at.table("flash")? {
            self.flash_chip = flash.text("chip").unwrap_or_default().to_owned();
            self.flash_bytes = flash.integer("bytes").unwrap_or_default() as u32;
            if !self.flash_bytes.is_power_of_two() {
                return Err(flash.error(
                    "bytes",
                    &self.flash_bytes.to_string(),
                    "is not the size of any flash",
                    "write it in bytes, as in 4_194_304 for 32 Mbit",
                ));
            }
            self.flash_balls = [
                claims.key(&flash, "cs")?,
                claims.key(&flash, "mosi")?,
                claims.key(&flash, "miso")?,
            ];
        }
        Ok(())
    }

    fn read_sdram(&mut self, at: &At<'_>, claims: &mut Claims) -> Result<(), Error> {
        if let Some(sdram) = at.table("sdram")? {
            self.sdram = Some(Sdram {
                chip: sdram.text("chip").unwrap_or_default().to_owned(),
                clk: claims.key(&sdram, "clk")?,
                we: claims.key(&sdram, "we")?,
                ras: claims.key(&sdram, "ras")?,
                cas: claims.key(&sdram, "cas")?,
                ba: claims.keys(&sdram, "ba", None)?,
                a: claims.keys(&sdram, "a", None)?,
                dq: claims.keys(&sdram, "dq", Some(32))?,
            });
        }
        Ok(())
    }

    /// The PHYs, and what they share.
    fn read_ethernet(&mut self, at: &At<'_>, claims: &mut Claims) -> Result<(), Error> {
        if let Some(management) = at.table("ethernet")? {
            self.phy_chip = management.text("chip").unwrap_or_default().to_owned();
            self.mdio = [
                claims.key(&management, "mdio")?,
                claims.key(&management, "mdc")?,
            ];
            if management.text("reset").is_some() {
                self.phy_reset = Some(claims.key(&management, "reset")?);
            }
        }
        for phy in at.tables("phy")? {
            self.phys.push(Phy {
                tx_clk: claims.key(&phy, "tx_clk")?,
                rx_clk: claims.key(&phy, "rx_clk")?,
                tx_ctl: claims.key(&phy, "tx_ctl")?,
                rx_ctl: claims.key(&phy, "rx_ctl")?,
                tx_data: claims.keys(&phy, "tx_data", Some(4))?,
                rx_data: claims.keys(&phy, "rx_data", Some(4))?,
            });
        }
        if self.phys.is_empty() {
            return Err(at.error("phy", "", "is empty", "write at least one [[phy]]"));
        }
        Ok(())
    }

    /// The headers, in the order of their numbers.
    fn read_headers(&mut self, at: &At<'_>, claims: &mut Claims) -> Result<(), Error> {
        for (name, place, balls) in at.lists("headers")? {
            let number = name
                .strip_prefix('j')
                .and_then(|digits| digits.parse::<u8>().ok());
            if number.is_none_or(|number| number == 0 || name != format!("j{number}")) {
                return Err(at.error_at(
                    place,
                    &format!("headers.{name}"),
                    "",
                    "is not a header's name",
                    "write it as the silk screen does, in lower case: j1, j2 ...".to_owned(),
                ));
            }
            let key = format!("headers.{name}");
            self.headers.push((
                name.to_owned(),
                claims.list(at, &key, place, &balls, Some(OWN))?,
            ));
        }
        self.headers
            .sort_by_key(|(name, _)| name[1..].parse::<u8>().unwrap_or_default());
        if self.headers.is_empty() {
            return Err(at.error(
                "headers",
                "",
                "is empty",
                "write at least one, as in j1 = [\"C4\", \"D4\", \"E4\", \"D3\", \"F5\", \"E3\"]",
            ));
        }
        Ok(())
    }

    /// What a pin is and which ball it has; ground has none. `None`: there is no such pin.
    pub fn pin(&self, name: &str) -> Option<(Role, Option<&str>)> {
        if name == "key" {
            return Some((Role::Key, Some(&self.key_ball)));
        }
        let (header, index) = split(name)?;
        let (_, own) = self.headers.iter().find(|(known, _)| known == header)?;
        let (role, ball) = match HEADER.get(index)? {
            &"GND" => (Role::Ground, None),
            _ if index >= FIRST_SHARED => (Role::Shared, self.shared.get(index - FIRST_SHARED)),
            _ => (Role::Own, own.get(index - usize::from(index > 3))),
        };
        Some((role, ball.map(String::as_str)))
    }

    /// Every pin with a ball, by name, in the order of the headers.
    pub fn pins(&self) -> impl Iterator<Item = (String, &str)> {
        let of_header = |(header, _): &(String, Vec<String>)| {
            (0..HEADER.len())
                .map(|n| format!("{header}:{n}"))
                .collect::<Vec<_>>()
        };
        let names = self
            .headers
            .iter()
            .flat_map(of_header)
            .chain(["key".to_owned()]);
        names.filter_map(|name| {
            let ball = self.pin(&name)?.1?;
            Some((name, ball))
        })
    }

    /// The lines of the headers in the order of their numbers on a card whose pins are configured
    /// (`wire::pins`): the lines a header has to itself, header by header, then the shared ones by
    /// the first header's names.
    pub fn lines(&self) -> Vec<String> {
        let own = self.headers.iter().flat_map(|(name, _)| own_pins(name));
        let shared = self.headers.first().map(|(name, _)| shared_pins(name));
        own.chain(shared.into_iter().flatten()).collect()
    }

    /// The number of a pin's line; `None` for the key, ground, and what is no pin. All headers have
    /// the same shared lines.
    pub fn line(&self, name: &str) -> Option<u8> {
        let (role, _) = self.pin(name)?;
        let (header, index) = split(name)?;
        let place = match role {
            Role::Ground | Role::Key => return None,
            Role::Own => {
                let header = self.headers.iter().position(|(known, _)| known == header)?;
                header * OWN + index - usize::from(index > 3)
            }
            Role::Shared => self.headers.len() * OWN + index - FIRST_SHARED,
        };
        u8::try_from(place).ok()
    }

    /// Why a name is no pin, and what to write instead.
    pub fn no_such_pin(&self, name: &str) -> (String, String) {
        let headers = format!(
            "its headers are {} to {}",
            self.headers.first().map_or("", |(name, _)| name),
            self.headers.last().map_or("", |(name, _)| name)
        );
        match split(name) {
            Some((header, index)) if self.headers.iter().any(|(known, _)| known == header) => (
                format!("is not a pin: a header has sixteen, and {index} is not one of them"),
                format!(
                    "write {header}:0 to {header}:14; they count from 0, the silk screen from 1"
                ),
            ),
            Some(_) => (
                format!("is not a pin of {}", self.name),
                format!("{headers}, each with pins 0 to 14 from 0, as in \"j1:0\""),
            ),
            None => {
                let lower = name.to_lowercase();
                let near = nearest(&lower, ["key", "none"].into_iter())
                    .map_or(String::new(), |near| format!("; did you mean \"{near}\"?"));
                (
                    format!("is not a pin of {}", self.name),
                    format!(
                        "write a header and a pin, as in \"j1:0\" ({headers}), or \"key\"{near}"
                    ),
                )
            }
        }
    }
}

/// Splits `j7:3` into its parts. Another form of the number (`j7:03`) is refused.
pub fn split(name: &str) -> Option<(&str, usize)> {
    let (header, digits) = name.split_once(':')?;
    let index: usize = digits.parse().ok()?;
    (index.to_string() == digits).then_some((header, index))
}

/// Refuses a file that says another name than its own.
pub(crate) fn own_name(at: &At<'_>, stem: &str) -> Result<String, Error> {
    let name = at.text("name").unwrap_or_default();
    if name != stem {
        return Err(at.error(
            "name",
            &format!("{name:?}"),
            format!("is not the file's own name \"{stem}\""),
            "make them equal",
        ));
    }
    if name.len() > wire_name_len() || name.is_empty() || name.chars().any(char::is_control) {
        return Err(at.error(
            "name",
            &format!("{name:?}"),
            format!(
                "does not fit the {} bytes a board has for it",
                wire_name_len()
            ),
            "write a shorter one",
        ));
    }
    Ok(name.to_owned())
}

/// Discovery carries names in 32 bytes.
const fn wire_name_len() -> usize {
    32
}

fn package(device: &str) -> Option<&'static str> {
    let part = device.strip_prefix("LFE5U")?;
    [("BG256", "CABGA256"), ("BG381", "CABGA381")]
        .into_iter()
        .find(|(short, _)| part.contains(short))
        .map(|(_, long)| long)
}

/// Which ball is already what: every ball has one use.
#[derive(Default)]
struct Claims(BTreeMap<String, String>);

impl Claims {
    fn key(&mut self, at: &At<'_>, name: &str) -> Result<String, Error> {
        let ball = at.text(name).unwrap_or_default();
        self.claim(at, name, ball, at.place(name))
    }

    fn keys(
        &mut self,
        at: &At<'_>,
        name: &str,
        count: Option<usize>,
    ) -> Result<Vec<String>, Error> {
        self.list(at, name, at.place(name), &at.texts(name), count)
    }

    fn list(
        &mut self,
        at: &At<'_>,
        name: &str,
        place: Option<Place>,
        balls: &[(&str, Option<Place>)],
        count: Option<usize>,
    ) -> Result<Vec<String>, Error> {
        if let Some(count) = count.filter(|count| *count != balls.len()) {
            return Err(at.error_at(
                place,
                name,
                "",
                format!("has {} balls", balls.len()),
                format!("write {count}"),
            ));
        }
        let one = |(n, (ball, place)): (usize, &(&str, Option<Place>))| {
            self.claim(at, &format!("{name}[{n}]"), ball, *place)
        };
        balls.iter().enumerate().map(one).collect()
    }

    fn claim(
        &mut self,
        at: &At<'_>,
        name: &str,
        ball: &str,
        place: Option<Place>,
    ) -> Result<String, Error> {
        let shown = format!("{ball:?}");
        let letters = ball.trim_end_matches(|c: char| c.is_ascii_digit());
        let digits = &ball[letters.len()..];
        if !(1..=2).contains(&letters.len())
            || !letters.bytes().all(|b| b.is_ascii_uppercase())
            || !(1..=2).contains(&digits.len())
        {
            return Err(at.error_at(
                place,
                name,
                &shown,
                "is not an FPGA ball",
                "write a letter and a number, as in \"P6\"".to_owned(),
            ));
        }
        if let Some(other) = self.0.get(ball) {
            return Err(at.error_at(
                place,
                name,
                &shown,
                format!("is already {other}"),
                "every ball has one use; look at the PCB again".to_owned(),
            ));
        }
        self.0.insert(ball.to_owned(), at.key(name));
        Ok(ball.to_owned())
    }
}
