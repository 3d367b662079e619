//! An image: a platform and how many channels of each kind its gateware has. What is on which pin
//! is no part of it; a board gets that as a configuration ([`wire::pins`]).

use crate::board::{Board, ControlInput, Modified};
use crate::error::{Error, Report};
use crate::export::export;
use crate::platform::{Level, Platform};
use serde_json::{Value, json};
use wire::jobs::AXES as JOB_AXES;
use wire::pins::Built;

/// Most header lines of an image: an input and an output for each.
pub const LINES_MAX: usize = wire::regmap::IN_MAX;
/// Most channels of each kind.
pub const CHANNELS_MAX: u8 = wire::regmap::STEPGEN_MAX as u8;

/// How many channels an image has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Step generators.
    pub stepgens: u8,
    /// Encoders.
    pub encoders: u8,
    /// PWM generators.
    pub pwms: u8,
}

impl Counts {
    /// Reads `8/8/8`: step generators, encoders, PWM generators.
    pub fn read(text: &str) -> Result<Self, String> {
        let numbers: Vec<Option<u8>> = text.split('/').map(|part| part.parse().ok()).collect();
        let [Some(stepgens), Some(encoders), Some(pwms)] = numbers[..] else {
            return Err(format!(
                "--channels {text}: is not three counts; write step generators, encoders and PWM \
                 generators, as in 8/8/8"
            ));
        };
        if [stepgens, encoders, pwms].iter().any(|n| *n > CHANNELS_MAX) {
            return Err(format!(
                "--channels {text}: are more than the gateware has; write at most {CHANNELS_MAX} of each kind"
            ));
        }
        Ok(Counts {
            stepgens,
            encoders,
            pwms,
        })
    }

    /// Those of an image that is given out.
    pub const OF_IMAGES: Counts = Counts {
        stepgens: 8,
        encoders: 8,
        pwms: 8,
    };

    /// The name of an image with them.
    fn name(self, platform: &Platform) -> String {
        match self {
            Self::OF_IMAGES => platform.name.clone(),
            Counts {
                stepgens,
                encoders,
                pwms,
            } => format!("{}-{stepgens}-{encoders}-{pwms}", platform.name),
        }
    }

    /// Axes of a job, unless said otherwise: what there are step generators for.
    pub fn jobs(self) -> usize {
        match usize::from(self.stepgens) {
            enough if enough >= JOB_AXES => JOB_AXES,
            _ => 0,
        }
    }
}

/// The header lines of a platform by number, each with the first name it has and its ball: what
/// each header has to itself, in the order of the headers, and behind those what all share.
pub fn lines(platform: &Platform) -> Vec<(String, &str)> {
    let names = platform.lines().into_iter();
    names
        .filter_map(|name| {
            let ball = platform.pin(&name)?.1?;
            Some((name, ball))
        })
        .collect()
}

/// What an image is built with.
pub fn built(platform: &Platform, counts: Counts) -> Result<Built, Error> {
    let lines = platform.lines().len();
    if lines > LINES_MAX || !lines.is_multiple_of(4) {
        return Err(Error::from(Report {
            file: platform.file.clone(),
            place: None,
            key: "headers".to_owned(),
            value: format!("{lines} lines"),
            problem: format!(
                "are not what an image can have, which is a multiple of 4 up to {LINES_MAX}"
            ),
            remedy: "build a board file for this card: `cargo xtask bitstream boards/NAME.toml` (decision 32 says why)".to_owned(),
        }));
    }
    Ok(Built {
        stepgens: counts.stepgens,
        encoders: counts.encoders,
        pwms: counts.pwms,
        lines: lines as u8,
    })
}

/// The image as JSON: a board without channels, as [`export`] writes it, and its lines and counts.
pub fn export_image(platform: &Platform, counts: Counts, jobs: usize) -> Result<Value, Error> {
    let built = built(platform, counts)?;
    let board = described(platform, jobs);
    let mut out = export(&board)?;
    out["name"] = json!(counts.name(platform));
    out["lines"] = lines(platform)
        .into_iter()
        .map(|(name, ball)| json!({ "name": name, "ball": ball }))
        .collect();
    out["key"] = json!({
        "ball": platform.key_ball,
        "active_low": platform.key_active == Level::Low,
    });
    out["built"] = json!({
        "stepgen": built.stepgens, "encoder": built.encoders, "pwm": built.pwms,
    });
    Ok(out)
}

/// What a board with this image and without a configuration says about itself.
fn described(platform: &Platform, jobs: usize) -> Board {
    Board {
        file: platform.file.clone(),
        name: format!("{} image", platform.name),
        platform: platform.clone(),
        sys_clk_hz: 60_000_000,
        phy: 0,
        ext_reset: ControlInput {
            pin: None,
            active: Level::High,
        },
        factory: None,
        jobs,
        sdram: platform.sdram.is_some(),
        mac: None,
        ipv4: [192, 168, 2, 50],
        udp_port: 1234,
        modified: Modified::default(),
        channels: Default::default(),
    }
}
