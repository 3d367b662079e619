//! `ferrocnc watch`: reads and shows the status window repeatedly. Reading it changes nothing on
//! the board.

use crate::describe::ways_to_json;
use anyhow::{Context, Result};
use ferrocnc::blocks::ways::WORDS;
use ferrocnc::client::{Client, Identity};
use ferrocnc::selftest::ways;
use serde_json::{Value, json};
use std::fmt::{self, Write as _};
use std::io::Write;
use std::time::{Duration, Instant};
use wire::board::Kind;
use wire::exchange::{Status, status_words};
use wire::flash::LinkWord;
use wire::units::Clocks;
use wire::{FaultReason, Refusal, map};

/// Clears the screen and moves the cursor home (VT100).
const HOME: &str = "\x1b[2J\x1b[H";
/// Frames received, sent, exchanges.
const PLAIN_COUNTERS: usize = 3;

pub(crate) fn run(client: &mut Client, once: bool, interval: u64, as_json: bool) -> Result<()> {
    let show = |look: &Look, identity: &Identity| -> Result<()> {
        let mut out = std::io::stdout().lock();
        if as_json {
            writeln!(out, "{}", look.to_json(identity))?;
        } else {
            let home = if once { "" } else { HOME };
            write!(out, "{home}{}", look.to_text(identity))?;
        }
        Ok(out.flush()?)
    };
    if once {
        let identity = client.identify()?;
        return show(&Look::take(client, &identity)?, &identity);
    }
    each(client, Duration::from_millis(interval), show)
}

/// Looks again and again; ends with the first error, of the board or of what takes the look.
pub(crate) fn each(
    client: &mut Client,
    interval: Duration,
    take: impl Fn(&Look, &Identity) -> Result<()>,
) -> Result<()> {
    let mut identity = client.identify()?;
    let mut boot = None;
    loop {
        let look = Look::take(client, &identity)?;
        // It may have other settings since it has restarted.
        let now = look.status.boot_id;
        if boot.replace(now).is_some_and(|before| before != now) {
            identity = client.identify()?;
            continue;
        }
        take(&look, &identity)?;
        std::thread::sleep(interval);
    }
}

/// The status window at one instant.
pub(crate) struct Look {
    clock_hz: f64,
    status: Status,
    counters: Vec<u32>,
    owner: Option<std::net::SocketAddrV4>,
    link: LinkWord,
    ways: ways::Facts,
    /// How long the board took to answer the question of the status window, repeats included.
    answer: Duration,
}

impl Look {
    fn take(client: &mut Client, identity: &Identity) -> Result<Look> {
        let channels = identity.describe.channels;
        let asked = Instant::now();
        let words = client.read_from(map::STATUS, status_words(channels))?;
        let answer = asked.elapsed();
        let status = Status::parse(&words, channels)
            .context("the board's status is invalid; compare versions with ferrocnc describe")?;
        let counters = client.read_from(map::COUNTERS, PLAIN_COUNTERS + Refusal::COUNT)?;
        let now = [
            map::SESSION_OWNER_IP,
            map::SESSION_OWNER_PORT,
            map::FLASH_LINK,
        ];
        let now = client.read(&[&now[..], &WORDS].concat())?;
        let owner = match now[..] {
            [ip, port, ..] if ip != 0 => Some(std::net::SocketAddrV4::new(ip.into(), port as u16)),
            _ => None,
        };
        let link = LinkWord::from_word(now[2]);
        Ok(Look {
            clock_hz: identity.describe.clock_hz.into(),
            status,
            counters,
            owner,
            link,
            ways: ways::Facts::from_words([now[3], now[4], now[5]]),
            answer,
        })
    }

    fn refusals(&self) -> impl Iterator<Item = (&'static str, u32)> {
        let counts = self.counters.iter().skip(PLAIN_COUNTERS);
        Refusal::ALL
            .iter()
            .zip(counts)
            .filter(|(_, count)| **count != 0)
            .map(|(reason, count)| (reason.key(), *count))
    }

    pub(crate) fn to_json(&self, identity: &Identity) -> Value {
        let channels = identity.describe.channels;
        let clock = self.clock_hz;
        let status = &self.status;
        let blob = identity.blob();
        let name = |kind, n: usize| blob.text(kind, n as u8).unwrap_or("").to_owned();
        let stepgens: Vec<Value> = status.stepgen[..channels.stepgens.into()]
            .iter()
            .enumerate()
            .map(|(n, (position, velocity))| {
                json!({
                    "name": name(Kind::Stepgen, n),
                    "pulses": position.pulses(),
                    "position": position.steps(),
                    "velocity": velocity.to_hz(clock),
                    "rate_limited": status.rate_limited >> n & 1 != 0,
                })
            })
            .collect();
        let encoders: Vec<Value> = status.encoder[..channels.encoders.into()]
            .iter()
            .enumerate()
            .map(|(n, encoder)| {
                json!({
                    "name": name(Kind::Encoder, n),
                    "count": encoder.count.0 as i32,
                    "errors": encoder.errors,
                    "index_latched": status.index_latched >> n & 1 != 0,
                    "probe_latched": status.probe_latched >> n & 1 != 0,
                })
            })
            .collect();
        let inputs: Vec<Value> = { identity.numbers(Kind::Input).into_iter() }
            .map(|n| {
                let level = status.gpio_in >> n & 1 != 0;
                json!({ "name": name(Kind::Input, n.into()), "level": level })
            })
            .collect();
        json!({
            "state": status.state.state.text(),
            "fault_reason": status.state.reason.text(),
            "fault_remedy": remedy(status.state.reason),
            "enabled": status.state.enabled,
            "position_trusted": status.state.position_trusted,
            "bitten": status.state.bitten,
            "external_reset": status.state.external_reset,
            "estop": status.state.estop,
            "owner": self.owner.map(|owner| owner.to_string()),
            "sequence": status.sequence,
            "sample_clock": status.sample.0,
            "sample_seconds": status.sample.to_seconds(clock),
            "boot_id": status.boot_id,
            "stepgen": stepgens,
            "encoder": encoders,
            "input": inputs,
            "link_mbit": self.link.speed.mbit(),
            "link_errors": self.link.errors,
            "frames_rx": self.counters.first(),
            "frames_tx": self.counters.get(1),
            "exchanges": self.counters.get(2),
            "ways": ways_to_json(&self.ways),
            "answer_us": self.answer.as_secs_f64() * 1e6,
            "refused": self.refusals().map(|(key, count)| (key.to_owned(), count.into())).collect::<serde_json::Map<_, _>>(),
        })
    }

    fn to_text(&self, identity: &Identity) -> String {
        // Writing to a String cannot fail.
        let mut text = String::new();
        let _ = self.write_state(&mut text);
        let _ = self.write_stepgens(&mut text, identity);
        let _ = self.write_encoders(&mut text, identity);
        let inputs = self.levels(identity).join(" ");
        let _ = writeln!(text, "\ninputs  {inputs}");
        text
    }

    /// State, session and link.
    fn write_state(&self, text: &mut String) -> fmt::Result {
        let (status, word) = (&self.status, self.status.state);
        let said = |flag: bool, words: &'static str| if flag { words } else { "" };
        writeln!(
            text,
            "{}{}{}{}{}{}",
            word.state,
            said(word.enabled, ", outputs live"),
            match word.reason {
                FaultReason::None => String::new(),
                reason => format!(", stopped last by: {reason}"),
            },
            said(word.bitten, ", watchdog bitten"),
            said(word.external_reset, ", external reset"),
            said(word.estop, ", e-stop"),
        )?;
        writeln!(
            text,
            "session {}, sequence {}, sampled at {:.3} s, positions {}",
            self.owner
                .map_or("free".to_owned(), |owner| format!("of {owner}")),
            status.sequence,
            Clocks(status.sample.0).to_seconds(self.clock_hz),
            if word.position_trusted {
                "trusted"
            } else {
                "not trusted"
            },
        )?;
        write!(
            text,
            "link {}, {} frames thrown away; frames in {}, out {}, exchanges {}",
            self.link.speed, self.link.errors, self.counters[0], self.counters[1], self.counters[2]
        )?;
        for (key, count) in self.refusals() {
            write!(text, ", refused {key} {count}")?;
        }
        writeln!(text, "\nexchanges since its start: {}", self.ways)
    }

    fn write_stepgens(&self, text: &mut String, identity: &Identity) -> fmt::Result {
        writeln!(
            text,
            "\n{:<20} {:>14} {:>16} {:>14}",
            "stepgen", "pulses", "position", "steps/s"
        )?;
        let count = usize::from(identity.describe.channels.stepgens);
        for (n, (position, velocity)) in self.status.stepgen[..count].iter().enumerate() {
            let limited = if self.status.rate_limited >> n & 1 != 0 {
                " limited"
            } else {
                ""
            };
            writeln!(
                text,
                "{:<20} {:>14} {:>16.3} {:>14.1}{limited}",
                numbered(identity, Kind::Stepgen, n),
                position.pulses(),
                position.steps(),
                velocity.to_hz(self.clock_hz)
            )?;
        }
        Ok(())
    }

    fn write_encoders(&self, text: &mut String, identity: &Identity) -> fmt::Result {
        writeln!(
            text,
            "\n{:<20} {:>14} {:>16}",
            "encoder", "count", "latched"
        )?;
        let count = usize::from(identity.describe.channels.encoders);
        for (n, encoder) in self.status.encoder[..count].iter().enumerate() {
            let latched = if self.status.index_latched >> n & 1 != 0 {
                "index"
            } else if self.status.probe_latched >> n & 1 != 0 {
                "probe"
            } else {
                "-"
            };
            writeln!(
                text,
                "{:<20} {:>14} {latched:>16}",
                numbered(identity, Kind::Encoder, n),
                encoder.count.0 as i32
            )?;
        }
        Ok(())
    }

    /// Name and level of every input.
    fn levels(&self, identity: &Identity) -> Vec<String> {
        let blob = identity.blob();
        { identity.numbers(Kind::Input).into_iter() }
            .map(|n| {
                let name = blob.text(Kind::Input, n);
                let name = name.map_or_else(|| format!("{n:02}"), str::to_owned);
                format!("{name}={}", self.status.gpio_in >> n & 1)
            })
            .collect()
    }
}

/// What to do about a fault; nothing if there was none.
fn remedy(reason: FaultReason) -> Option<&'static str> {
    (reason != FaultReason::None).then(|| reason.remedy())
}

/// A channel's number and name.
fn numbered(identity: &Identity, kind: Kind, n: usize) -> String {
    let blob = identity.blob();
    format!("{n:>2} {}", blob.text(kind, n as u8).unwrap_or(""))
}
