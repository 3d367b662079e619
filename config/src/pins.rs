//! A board file as the configuration of an image's pins: the bytes that `wire::pins` describes,
//! with the file's text in them.
//!
//! An image is built for a platform and has counts of channels. What a file asks for beyond that is
//! refused here, in words, before anything is sent to a board.

use crate::blob;
use crate::board::{Board, Channel, Class, ControlInput};
use crate::error::{Error, Report};
use crate::platform::Level;
use crate::source::BUILT_IN;
use wire::board::crc32;
use wire::describe::FEATURE_JOBS;
use wire::pins::{
    BYTES_MAX, Built, DRIVES_AT, ESTOPS, GENERATION_AT, HEAD_WORDS, Head, INPUTS_AT, INVERT,
    LEVELS_AT, LINES_MAX, MAGIC, NONE, OUTPUTS_AT, VERSION, Verdict, platform_number,
};
use wire::regmap::IN_MAX;
use wire::words_from_bytes;

/// Bytes before the description.
const HEAD: usize = HEAD_WORDS * 4;

/// What a board with configurable pins says of its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image {
    /// Channels and lines.
    pub built: Built,
    /// CRC-32 of its platform's name.
    pub platform: u32,
    /// The cores' clock.
    pub clock_hz: u32,
    /// As the board's description has them.
    pub features: u32,
}

impl Image {
    /// Refuses a file for another image: another card, clock or jack, or jobs it does not have.
    pub fn fits(&self, board: &Board) -> Result<(), Error> {
        let platform = &board.platform.name;
        if platform_number(platform) != self.platform {
            let mut known = BUILT_IN.iter().map(|(name, _)| *name);
            let card = known.find(|name| platform_number(name) == self.platform);
            let card = card.unwrap_or("one that this version does not know");
            return Err(wrong(
                board,
                "platform",
                &format!("{platform:?}"),
                format!("is not the card's, which is {card}"),
                "take a file for that card, or change the platform and the pins in this one",
            ));
        }
        if board.sys_clk_hz != self.clock_hz {
            return Err(wrong(
                board,
                "sys_clk_hz",
                &board.sys_clk_hz.to_string(),
                format!("is not the clock of the card's image, {} Hz", self.clock_hz),
                format!("write {}", self.clock_hz),
            ));
        }
        if board.phy != 0 {
            return Err(wrong(
                board,
                "phy",
                &board.phy.to_string(),
                "is a jack that the card's image does not use",
                "leave the key out and use the other jack, or build this file and update the board",
            ));
        }
        if board.jobs > 0 && self.features & FEATURE_JOBS == 0 {
            return Err(wrong(
                board,
                "jobs",
                &board.jobs.to_string(),
                "needs an image with jobs, and the card's has none",
                "leave the key out, or update the board with an image that has jobs",
            ));
        }
        Ok(())
    }
}

/// The configuration for an image that was built so, with this generation. `text` is the file's.
pub fn configuration(
    board: &Board,
    text: &str,
    built: Built,
    generation: u32,
) -> Result<Vec<u8>, Error> {
    if let [first, ..] = board.missing_pins().as_slice() {
        return Err(wrong(
            board,
            first,
            "",
            "is missing: a channel without pins can only be simulated",
            "write its pins, or take the channel out",
        ));
    }
    enough(board, built)?;
    let compiled = Routes::of(board, built)?;
    let description = blob::numbered(board, |class| match class {
        Class::Input => compiled.inputs.clone(),
        Class::Output => compiled.outputs.clone(),
        Class::Stepgen | Class::Encoder | Class::Pwm => (0..).zip(board.of(class)).collect(),
    })?;
    let used = HEAD + description.len() + text.len();
    let bytes = used.next_multiple_of(4);
    if bytes > BYTES_MAX as usize {
        return Err(wrong(
            board,
            "",
            "",
            format!(
                "is too long: the board stores {BYTES_MAX} bytes, and with names and routes it has {bytes}"
            ),
            "shorten its comments",
        ));
    }
    let mut words = compiled.words;
    words[..3].copy_from_slice(&[MAGIC, VERSION, bytes as u32]);
    words[GENERATION_AT] = generation;
    words[5] = built.to_word();
    words[6] = platform_number(&board.platform.name);
    let channels = compiled_channels(board, &compiled.inputs, &compiled.outputs);
    words[7..9].copy_from_slice(&channels);
    words[9..11].copy_from_slice(&[description.len() as u32, text.len() as u32]);
    let verdict = Head(words).check(built, words[6]);
    if verdict != Verdict::InForce {
        return Err(wrong(
            board,
            "",
            "",
            format!("would be refused by the board: {}", verdict.text()),
            "report it as an error of this program, with the file",
        ));
    }
    let mut all: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
    all.extend(description);
    all.extend_from_slice(text.as_bytes());
    all.resize(bytes, 0);
    let crc = crc32(&all[GENERATION_AT * 4..]);
    all[12..16].copy_from_slice(&crc.to_be_bytes());
    Ok(all)
}

/// The two words with the channels that are used. Inputs and outputs count up to the last line.
fn compiled_channels(
    board: &Board,
    inputs: &[(u8, &Channel)],
    outputs: &[(u8, &Channel)],
) -> [u32; 2] {
    let end = |of: &[(u8, &Channel)]| of.iter().map(|(line, _)| line + 1).max().unwrap_or(0);
    let mut channels = board.channels();
    (channels.inputs, channels.outputs) = (end(inputs), end(outputs));
    channels.to_words()
}

/// A stored configuration, whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored<'b> {
    /// The words in front.
    pub head: Head,
    /// The description: a blob.
    pub description: &'b [u8],
    /// The file, as it was written.
    pub text: &'b str,
}

impl<'b> Stored<'b> {
    /// Of the bytes of a copy; more may follow. `None`: they are no whole configuration.
    pub fn new_checked(bytes: &'b [u8]) -> Option<Self> {
        let head = head(bytes)?;
        let body = bytes.get(..head.bytes()? as usize)?;
        if crc32(body.get(GENERATION_AT * 4..)?) != head.crc() {
            return None;
        }
        let (described, text) = (head.description() as usize, head.text() as usize);
        let rest = body.get(HEAD..)?;
        Some(Stored {
            head,
            description: rest.get(..described)?,
            text: std::str::from_utf8(rest.get(described..)?.get(..text)?).ok()?,
        })
    }
}

/// The words in front of these bytes.
fn head(bytes: &[u8]) -> Option<Head> {
    let mut words = [0; HEAD_WORDS];
    words_from_bytes(bytes.get(..HEAD)?, &mut words).ok()?;
    Some(Head(words))
}

fn wrong(
    board: &Board,
    key: &str,
    value: &str,
    problem: impl Into<String>,
    remedy: impl Into<String>,
) -> Error {
    Error::from(Report {
        file: board.file.clone(),
        place: None,
        key: key.to_owned(),
        value: value.to_owned(),
        problem: problem.into(),
        remedy: remedy.into(),
    })
}

/// Refuses a file with more channels than the image has, or for a card with other lines.
fn enough(board: &Board, built: Built) -> Result<(), Error> {
    let platform = &board.platform;
    let lines = platform.lines().len();
    if lines != usize::from(built.lines) || lines > usize::from(LINES_MAX) {
        return Err(wrong(
            board,
            "platform",
            &format!("{:?}", platform.name),
            format!(
                "has {lines} header lines, and the image has {}",
                built.lines
            ),
            "take a file for the card that the image is for",
        ));
    }
    let has = [built.stepgens, built.encoders, built.pwms].map(usize::from);
    let classes = [Class::Stepgen, Class::Encoder, Class::Pwm];
    let needs = classes.map(|class| board.of(class).len());
    for ((class, has), needs) in classes.into_iter().zip(has).zip(needs) {
        if needs > has {
            return Err(wrong(
                board,
                class.key(),
                "",
                format!("is there {needs} times, and the card's image has {has}"),
                format!(
                    "take some out, or build this file alone and update the board: cargo xtask bitstream boards/{}.toml",
                    board.name
                ),
            ));
        }
    }
    Ok(())
}

/// The routes of a file, and its inputs and outputs with their lines, in the file's order.
struct Routes<'b> {
    board: &'b Board,
    built: Built,
    words: [u32; HEAD_WORDS],
    inputs: Vec<(u8, &'b Channel)>,
    outputs: Vec<(u8, &'b Channel)>,
}

impl<'b> Routes<'b> {
    fn of(board: &'b Board, built: Built) -> Result<Self, Error> {
        let mut words = [0; HEAD_WORDS];
        let nothing = u32::from_le_bytes([NONE; 4]);
        words[OUTPUTS_AT..DRIVES_AT].fill(nothing);
        words[INPUTS_AT..LEVELS_AT].fill(nothing);
        let mut routes = Routes {
            board,
            built,
            words,
            inputs: Vec::new(),
            outputs: Vec::new(),
        };
        routes.channels()?;
        routes.inputs = routes.by_line(Class::Input)?;
        routes.outputs = routes.by_line(Class::Output)?;
        for (line, _) in routes.outputs.clone() {
            routes.drive(line, built.own(line));
        }
        routes.levels();
        routes.estops()?;
        routes.control(Some(&board.ext_reset), built.reset());
        routes.control(board.factory.as_ref(), built.factory());
        Ok(routes)
    }

    /// Step generators, encoders and PWMs.
    fn channels(&mut self) -> Result<(), Error> {
        let built = self.built;
        for class in [Class::Stepgen, Class::Encoder, Class::Pwm] {
            for (n, channel) in (0..).zip(self.board.of(class)) {
                for (key, pin) in &channel.pins {
                    match (class, *key) {
                        (Class::Stepgen, "step") => self.output(pin, built.step(n)),
                        (Class::Stepgen, "step_n") => self.output(pin, built.step(n) | INVERT),
                        (Class::Stepgen, "dir") => self.output(pin, built.step(n) + 1),
                        (Class::Stepgen, "dir_n") => self.output(pin, (built.step(n) + 1) | INVERT),
                        (Class::Stepgen, "index") => self.input(pin, built.index(n), false),
                        (Class::Encoder, "a") => self.input(pin, built.encoder(n), false),
                        (Class::Encoder, "b") => self.input(pin, built.encoder(n) + 1, false),
                        (Class::Encoder, "index") => self.input(pin, built.encoder(n) + 2, false),
                        (Class::Encoder, "mask") => self.input(pin, built.encoder(n) + 3, false),
                        (Class::Pwm, "pin") => self.output(pin, built.pwm(n)),
                        (Class::Pwm, "dir") => self.output(pin, built.pwm(n) + 1),
                        (_, key) => return Err(self.unknown(class, n, key)),
                    }
                }
            }
        }
        Ok(())
    }

    fn unknown(&self, class: Class, n: u8, key: &str) -> Error {
        wrong(
            self.board,
            &format!("{}[{n}].{key}", class.key()),
            "",
            "is a pin that no image has",
            "take it out, or build this file and update the board",
        )
    }

    /// A line, or the button behind the last one.
    fn at(&self, pin: &str) -> u8 {
        self.board.platform.line(pin).unwrap_or(self.built.key())
    }

    fn output(&mut self, pin: &str, source: u8) {
        self.drive(self.at(pin), source);
    }

    fn drive(&mut self, line: u8, source: u8) {
        put(&mut self.words[OUTPUTS_AT..DRIVES_AT], line, source);
        self.words[DRIVES_AT + usize::from(line / 32)] |= 1 << (line % 32);
    }

    fn input(&mut self, pin: &str, sink: u8, inverted: bool) {
        self.listen(self.at(pin), sink, inverted);
    }

    fn listen(&mut self, line: u8, sink: u8, inverted: bool) {
        let route = line | if inverted { INVERT } else { 0 };
        put(&mut self.words[INPUTS_AT..LEVELS_AT], sink, route);
    }

    /// An input of which 1 acts.
    fn control(&mut self, said: Option<&ControlInput>, sink: u8) {
        if let Some(ControlInput {
            pin: Some(pin),
            active,
        }) = said
        {
            self.input(pin, sink, *active == Level::Low);
        }
    }

    /// Inputs or outputs with the lines that are their numbers.
    fn by_line(&self, class: Class) -> Result<Vec<(u8, &'b Channel)>, Error> {
        let most = IN_MAX.min(self.built.lines.into());
        let mut found = Vec::new();
        for (n, channel) in self.board.of(class).iter().enumerate() {
            let pin = channel.pin("pin").unwrap_or_default();
            let line = self.at(pin);
            let key = format!("{}[{n}].pin", class.key());
            let refuse = |problem: String, remedy: &str| {
                Err(wrong(
                    self.board,
                    &key,
                    &format!("{pin:?}"),
                    problem,
                    remedy,
                ))
            };
            if line == self.built.key() {
                return refuse(
                    "is the button, which is no input of its own on this image".to_owned(),
                    "use it as ext_reset or factory, or write a header's pin",
                );
            }
            if usize::from(line) >= most {
                return refuse(
                    format!("is line {line}, and the first {most} lines can be inputs or outputs"),
                    "write a pin that a header with a lower number has to itself",
                );
            }
            found.push((line, channel));
        }
        Ok(found)
    }

    /// The safe levels of the outputs, and which are inverted.
    fn levels(&mut self) {
        let words = &mut self.words[LEVELS_AT..];
        for (line, channel) in &self.outputs {
            let (word, bit) = (usize::from(line / 32), line % 32);
            words[word] |= u32::from(channel.is_safe_high()) << bit;
            words[2 + word] |= u32::from(channel.invert) << bit;
        }
    }

    /// The e-stop inputs, the lowest line first.
    fn estops(&mut self) -> Result<(), Error> {
        let mut stops: Vec<(u8, Level)> = { self.inputs.iter() }
            .filter_map(|(line, channel)| Some((*line, channel.estop?)))
            .collect();
        // A client that knows the lines alone can count them.
        stops.sort_by_key(|(line, _)| *line);
        if stops.len() > usize::from(ESTOPS) {
            return Err(wrong(
                self.board,
                "gpio_in",
                "",
                format!(
                    "has {} e-stop inputs, and an image has {ESTOPS}",
                    stops.len()
                ),
                "wire contacts in series to one input, or build this file and update the board",
            ));
        }
        for (n, (line, level)) in (0..).zip(stops) {
            self.listen(line, self.built.estop(n), level == Level::Low);
        }
        Ok(())
    }
}

/// Writes a route.
fn put(words: &mut [u32], place: u8, route: u8) {
    let word = &mut words[usize::from(place / 4)];
    let mut bytes = word.to_le_bytes();
    bytes[usize::from(place % 4)] = route;
    *word = u32::from_le_bytes(bytes);
}
