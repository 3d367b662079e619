//! One thing of a board at a time, by hand: an output is switched on, an axis jogged, an encoder
//! turned, and the scale of an axis made of what was measured. Before there is a LinuxCNC machine.
//!
//! [`Tryout`] decides. Keys, times and the board's status go in; an [`Order`] for the board comes
//! out. It knows no terminal and no socket: [`board`] is the way to the board, the drawing is the
//! tool's.
//!
//! It never arms by itself. Whatever ends the armed state (the key, the board, a lost link, a
//! minute without a key) ends it until the next key for arming.
//!
//! ```text
//!  key for arming    Off --> Asked --> Armed --> Off        arming again, a stop, a lost link, a
//!                      <------ not in 200 answers           minute without a key
//! ```

pub mod board;
mod jog;
pub mod measured;

#[cfg(test)]
mod tests;

use jog::{Hold, Jog};
use measured::Measured;
use std::time::Duration;
use wire::exchange::Status;

pub use jog::Way;

/// An output is switched off after this long.
pub const ON_FOR: Duration = Duration::from_secs(3);
/// Arming takes a few exchanges; a board that has not done it after so many says why. A second, if
/// this computer is not busy.
const ASK: u32 = 200;
/// Without a key for this long everything is off.
pub const IDLE: Duration = Duration::from_secs(60);
/// Exchanges without an answer in a row until the link counts as lost. The board's own watchdog
/// waits longer ([`board::TIMEOUT_S`]) and does not depend on this computer.
pub const LOST: u32 = 3;
/// A key for arming that is held repeats itself: so soon after the last one it arms nothing.
const HELD: Duration = Duration::from_millis(800);

/// An input, an output or an encoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Labelled {
    /// Its name.
    pub name: String,
    /// The header pins it is on, as in `j1:0`.
    pub pins: String,
    /// The bit of an input or output.
    pub bit: u8,
}

/// A step generator with its motor.
#[derive(Clone, Debug, PartialEq)]
pub struct Motor {
    /// Name and header pins.
    pub line: Labelled,
    /// Steps in a unit, if a machine's file says so; negative where the motor is reversed.
    pub scale: Option<f64>,
    /// Never faster, steps/s.
    pub most: f64,
    /// Never harder, steps/s^2.
    pub accel: f64,
    /// `steplen`, `stepspace`, `dirsetup`, `dirhold`, ns.
    pub timing: [u32; 4],
}

impl Motor {
    /// Steps in what distances are counted in: a unit, or a step.
    pub fn steps(&self) -> f64 {
        self.scale.unwrap_or(1.0)
    }
}

/// What the board has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// Inputs, in the order of their bits.
    pub inputs: Vec<Labelled>,
    /// Outputs.
    pub outputs: Vec<Labelled>,
    /// Step generators.
    pub motors: Vec<Motor>,
    /// Encoders.
    pub encoders: Vec<Labelled>,
    /// The output that is on while a motor may move, if a machine's file names one.
    pub drive_enable: Option<usize>,
    /// `mm`, `inch`; `steps` without a machine's file.
    pub unit: String,
}

/// A row that the keys are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// An output.
    Output(usize),
    /// A motor.
    Motor(usize),
    /// An encoder.
    Encoder(usize),
}

/// What happened to a key that moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// It was pressed, or its repeat came. Most terminals do not tell these two apart.
    Down,
    /// It was released. Few terminals tell this.
    Up,
}

/// A key, by what it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// The row before.
    Previous,
    /// The next row.
    Next,
    /// Moves the selected motor.
    Move(Way, Edge),
    /// Switches the selected output, or takes the number that was typed.
    Enter,
    /// This row.
    Select(Row),
    /// Arms, or disarms.
    Arm,
    /// Disarms, and never arms.
    Off,
    /// Stops motion and switches the output off; still armed.
    Stop,
    /// Counts from here.
    Mark,
    /// Half the speed.
    Slower,
    /// Twice.
    Faster,
    /// The next distance of a jog.
    Distance,
    /// Begins to type what was measured.
    Measure,
    /// Writes the scale that was found.
    Write,
    /// A digit, the point, the sign.
    Digit(char),
    /// Takes the last one back.
    Backspace,
    /// Leaves what is being typed, or everything.
    Escape,
}

/// What the tool has to do beside the board.
#[derive(Clone, Debug, PartialEq)]
pub enum Act {
    /// End.
    Quit,
    /// Write this scale into the machine's file, or print it.
    Write(Measured),
}

/// What the board is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Order {
    /// It may move.
    pub enable: bool,
    /// A rising edge arms.
    pub request: bool,
    /// Outputs that are on, one bit each.
    pub on: u64,
    /// A motor and its speed, steps/s.
    pub motion: Option<(usize, f64)>,
}

/// May anything move?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arming {
    /// No.
    Off,
    /// It was asked for; the request goes out once the board has heard of `enable`.
    Asked {
        /// Answers since.
        heard: u32,
    },
    /// Yes.
    Armed,
}

/// The state of everything that is tried out.
#[derive(Clone, Debug)]
pub struct Tryout {
    /// What there is.
    pub layout: Layout,
    rows: Vec<Row>,
    selected: usize,
    arming: Arming,
    on: Option<(usize, Duration)>,
    hold: Option<Hold>,
    jog: Option<Jog>,
    /// Part of `Motor::most`, as a power of a half.
    slower: u32,
    distance: usize,
    last_key: Duration,
    last_arm: Option<Duration>,
    unanswered: u32,
    status: Option<Status>,
    /// Where each motor and each encoder is counted from.
    motor_marks: Vec<i64>,
    encoder_marks: Vec<wire::units::Count>,
    typed: Option<String>,
    found: Option<Measured>,
    /// What was said last.
    said: String,
}

/// The slowest of them: a 64th of the most.
const SLOWEST: u32 = 6;

impl Tryout {
    /// Nothing is armed.
    pub fn new(layout: Layout) -> Self {
        let rows = (0..layout.outputs.len()).map(Row::Output);
        let rows = rows.chain((0..layout.motors.len()).map(Row::Motor));
        let rows = rows.chain((0..layout.encoders.len()).map(Row::Encoder));
        Tryout {
            rows: rows.collect(),
            selected: 0,
            arming: Arming::Off,
            on: None,
            hold: None,
            jog: None,
            slower: 3,
            distance: 1,
            last_key: Duration::ZERO,
            last_arm: None,
            unanswered: 0,
            status: None,
            motor_marks: Vec::new(),
            encoder_marks: Vec::new(),
            typed: None,
            found: None,
            said: "a arms; nothing is driven before".to_owned(),
            layout,
        }
    }

    /// The row that the keys are for; nothing on a board with inputs only.
    pub fn row(&self) -> Option<Row> {
        self.rows.get(self.selected).copied()
    }

    /// In a word: may anything move, and is the board there?
    pub fn state(&self) -> &'static str {
        match (self.status(), self.arming) {
            (None, _) => "NO ANSWER",
            (Some(_), Arming::Armed) => "ARMED",
            (Some(_), Arming::Asked { .. }) => "ARMING",
            (Some(_), Arming::Off) => "OFF",
        }
    }

    /// May anything move?
    pub fn arming(&self) -> Arming {
        self.arming
    }

    /// The output that is on.
    pub fn on(&self) -> Option<usize> {
        self.on.map(|(output, _)| output)
    }

    /// What was said last.
    pub fn said(&self) -> &str {
        &self.said
    }

    /// Says something of the tool's.
    pub fn say(&mut self, text: impl Into<String>) {
        self.said = text.into();
    }

    /// What is being typed.
    pub fn typed(&self) -> Option<&str> {
        self.typed.as_deref()
    }

    /// The scale that was found last.
    pub fn found(&self) -> Option<&Measured> {
        self.found.as_ref()
    }

    /// The board's last answer.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref().filter(|_| self.unanswered < LOST)
    }

    /// Steps that a motor has gone since its mark.
    pub fn gone(&self, motor: usize) -> i64 {
        let at = self.status.as_ref().map(|it| it.stepgen[motor].0.pulses());
        let mark = self.motor_marks.get(motor).copied();
        at.zip(mark).map_or(0, |(at, mark)| at - mark)
    }

    /// Counts of an encoder since its mark.
    pub fn turned(&self, encoder: usize) -> i32 {
        let at = self.status.as_ref().map(|it| it.encoder[encoder].count);
        let mark = self.encoder_marks.get(encoder).copied();
        at.zip(mark).map_or(0, |(at, mark)| at.since(mark))
    }

    /// The speed of a jog, steps/s.
    pub fn speed(&self, motor: &Motor) -> f64 {
        motor.most / f64::from(1u32 << self.slower)
    }

    /// The distance of a jog, in units or steps.
    pub fn distance(&self, motor: &Motor) -> f64 {
        let of = match motor.scale {
            Some(_) => [0.1, 1.0, 10.0, 100.0],
            None => [10.0, 100.0, 1_000.0, 10_000.0],
        };
        of[self.distance % of.len()]
    }

    /// A key.
    pub fn key(&mut self, key: Key, now: Duration) -> Option<Act> {
        self.last_key = now;
        // Every other key is a release, too: there is one hand for the jog.
        if let Key::Move(way, edge) = key {
            if self.typed.is_none() {
                self.moved(way, edge, now);
            }
            return None;
        }
        self.release();
        if self.typed.is_some() {
            self.type_number(key);
            return None;
        }
        match key {
            Key::Previous => self.select(self.selected.saturating_sub(1)),
            Key::Next => self.select(self.selected + 1),
            Key::Select(row) => {
                if let Some(row) = self.rows.iter().position(|it| *it == row) {
                    self.select(row);
                }
            }
            Key::Enter => self.switch(now),
            Key::Off => self.off("off"),
            Key::Arm => {
                let last = self.last_arm.replace(now);
                let held = last.is_some_and(|last| now.saturating_sub(last) < HELD);
                match self.arming {
                    Arming::Off if held => {}
                    Arming::Off => self.ask(),
                    Arming::Asked { .. } | Arming::Armed => self.off("off"),
                }
            }
            Key::Stop => {
                self.on = None;
                self.said = "stopped".to_owned();
            }
            Key::Mark => self.mark(),
            Key::Slower => self.slower = (self.slower + 1).min(SLOWEST),
            Key::Faster => self.slower = self.slower.saturating_sub(1),
            Key::Distance => self.distance += 1,
            Key::Measure => match self.row() {
                Some(Row::Motor(motor)) if self.gone(motor) != 0 => {
                    self.typed = Some(String::new());
                }
                Some(Row::Motor(_)) => {
                    self.said = "jog it first: what it has gone since its mark is measured".into();
                }
                _ => self.said = "select a motor: its way is measured".to_owned(),
            },
            Key::Write => match self.found.clone() {
                Some(found) => return Some(Act::Write(found)),
                None => self.said = "nothing was measured: m, the number, Enter".to_owned(),
            },
            Key::Escape => {
                self.off("off");
                return Some(Act::Quit);
            }
            Key::Digit(_) | Key::Backspace | Key::Move(..) => {}
        }
        None
    }

    /// The board answered.
    pub fn answer(&mut self, status: &Status, now: Duration) {
        self.unanswered = 0;
        if self.status.is_none() {
            self.status = Some(*status);
            self.motor_marks = (0..self.layout.motors.len())
                .map(|n| status.stepgen[n].0.pulses())
                .collect();
            self.encoder_marks = (0..self.layout.encoders.len())
                .map(|n| status.encoder[n].count)
                .collect();
        }
        self.status = Some(*status);
        match self.arming {
            Arming::Asked { .. } if status.state.enabled => {
                self.arming = Arming::Armed;
                self.said = "armed".to_owned();
            }
            Arming::Asked { heard } if heard >= ASK => {
                let why = board::held_by(&status.state);
                self.off(&format!("the board does not arm: {why}"));
            }
            Arming::Asked { heard } => self.arming = Arming::Asked { heard: heard + 1 },
            Arming::Armed if !status.state.enabled => {
                self.off(&format!("the board stopped: {}", status.state.reason));
            }
            Arming::Armed | Arming::Off => {}
        }
        self.pass(now);
    }

    /// An exchange was not answered.
    pub fn silence(&mut self, now: Duration) {
        self.unanswered = self.unanswered.saturating_add(1);
        if self.unanswered == LOST {
            self.off("no answer from the board: all is off, and stays off until a arms it again");
        }
        self.pass(now);
    }

    /// What the board is to do now.
    pub fn order(&self) -> Order {
        let armed = self.arming == Arming::Armed;
        let bit = |output: usize| 1u64 << self.layout.outputs[output].bit;
        let on = self.on.map_or(0, |(output, _)| bit(output));
        let held = self.layout.drive_enable.map_or(0, bit);
        let heard = matches!(self.arming, Arming::Asked { heard: 1.. });
        let at = |motor: usize| self.status.as_ref().map(|it| it.stepgen[motor].0);
        let motion = self.jog.as_ref().and_then(|jog| {
            let motor = &self.layout.motors[jog.motor];
            Some((jog.motor, jog.velocity(at(jog.motor)?, motor.accel)))
        });
        Order {
            enable: self.arming != Arming::Off,
            request: heard || armed,
            on: if armed { on | held } else { 0 },
            motion: motion.filter(|_| armed),
        }
    }

    /// Time passes.
    fn pass(&mut self, now: Duration) {
        if self.arming != Arming::Off && now.saturating_sub(self.last_key) > IDLE {
            self.off("a minute without a key: all is off");
        }
        if let Some((output, since)) = self.on
            && now.saturating_sub(since) >= ON_FOR
        {
            self.on = None;
            self.said = format!("{} is off again", self.layout.outputs[output].name);
        }
        if let Some(hold) = self.hold.filter(|hold| hold.is_over(now)) {
            self.release();
            if !hold.moves() && self.arming == Arming::Armed {
                self.said = "released before it moved".to_owned();
            }
        }
        if let Some(jog) = &self.jog
            && let Some(status) = &self.status
            && jog.is_there(status.stepgen[jog.motor].0)
        {
            self.jog = None;
            self.said = "there".to_owned();
        }
    }

    fn off(&mut self, why: &str) {
        self.arming = Arming::Off;
        (self.on, self.hold, self.jog) = (None, None, None);
        self.said = why.to_owned();
    }

    fn ask(&mut self) {
        match self.status() {
            Some(status) if status.state.estop => {
                self.said = "an e-stop input is active: release it, then a".to_owned();
            }
            Some(_) => {
                self.arming = Arming::Asked { heard: 0 };
                self.said = "asks the board to arm".to_owned();
            }
            None => self.said = "the board does not answer".to_owned(),
        }
    }

    fn select(&mut self, row: usize) {
        self.selected = row.min(self.rows.len().saturating_sub(1));
        self.on = None;
    }

    /// The selected output on, or off.
    fn switch(&mut self, now: Duration) {
        let Some(Row::Output(output)) = self.row() else {
            self.said = "select an output: Enter switches it".to_owned();
            return;
        };
        if self.arming != Arming::Armed {
            self.said = "a arms first".to_owned();
            return;
        }
        self.on = match self.on {
            Some((on, _)) if on == output => None,
            _ => Some((output, now)),
        };
        let name = &self.layout.outputs[output].name;
        self.said = match self.on {
            Some(_) => format!("{name} is on for {} s", ON_FOR.as_secs()),
            None => format!("{name} is off"),
        };
    }

    fn mark(&mut self) {
        let Some(status) = &self.status else { return };
        match self.row() {
            Some(Row::Motor(n)) => self.motor_marks[n] = status.stepgen[n].0.pulses(),
            Some(Row::Encoder(n)) => self.encoder_marks[n] = status.encoder[n].count,
            Some(Row::Output(_)) | None => {}
        }
    }

    /// A key that moves.
    fn moved(&mut self, way: Way, edge: Edge, now: Duration) {
        let Some(Row::Motor(motor)) = self.row() else {
            return;
        };
        if edge == Edge::Up {
            self.release();
            return;
        }
        let held = self
            .hold
            .filter(|hold| hold.way == way && !hold.is_over(now));
        let Some(hold) = held else {
            self.release();
            self.hold = Some(Hold::new(way, now));
            self.said = match self.arming {
                Arming::Armed => "hold it: it moves while the key repeats",
                Arming::Off | Arming::Asked { .. } => "a arms first",
            }
            .to_owned();
            return;
        };
        self.hold = Some(hold.again(now));
        if hold.moves() || self.arming != Arming::Armed {
            return;
        }
        if let Some(status) = &self.status {
            let from = status.stepgen[motor].0.pulses();
            let axis = &self.layout.motors[motor];
            let way = way.sign() * axis.steps().signum();
            let length = (self.distance(axis) * axis.steps()).abs().round();
            self.jog = Some(Jog {
                motor,
                target: from + (way * length) as i64,
                speed: self.speed(axis),
            });
            self.said = format!("{} moves", axis.line.name);
        }
    }

    /// The key was released.
    fn release(&mut self) {
        self.hold = None;
        if self.jog.take().is_some() {
            self.said = "released".to_owned();
        }
    }

    fn type_number(&mut self, key: Key) {
        let Some(text) = &mut self.typed else { return };
        match key {
            Key::Digit(digit) if text.len() < 12 => text.push(digit),
            Key::Backspace => {
                text.pop();
            }
            Key::Enter => {
                let text = self.typed.take().unwrap_or_default();
                self.measure(&text);
            }
            Key::Escape => self.typed = None,
            _ => {}
        }
    }

    fn measure(&mut self, text: &str) {
        let Some(Row::Motor(motor)) = self.row() else {
            return;
        };
        let axis = &self.layout.motors[motor];
        match Measured::new(motor, self.gone(motor), text, axis.scale) {
            Ok(found) => {
                self.said = format!("{}; w writes it", found.line(&self.layout.unit));
                self.found = Some(found);
            }
            Err(why) => self.said = why,
        }
    }
}
