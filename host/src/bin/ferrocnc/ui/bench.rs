//! One thing of a board at a time, from a page: what `ferrocnc test` does, with its rules.
//!
//! The page's stream of events is its hold on the board: it ends with the page, and the session
//! with it. Another page is refused as any other program is. Keys are taken from the page that has
//! the number of this hold, which its events tell it.

use super::answer::{Answer, Refusal};
use super::api::At;
use super::live::{Events, stream};
use crate::tryout::{EVERY, SHOWN, layout, name, ready};
use anyhow::{Context, Result};
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::routing::{get, post};
use axum::{Json, Router};
use ferrocnc::tryout::board::Bench;
use ferrocnc::tryout::measured::number;
use ferrocnc::tryout::{Edge, Key, Labelled, Motor, Row, Tryout, Way};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The pages that have a board, by the number of their hold.
type Holds = Arc<Mutex<HashMap<String, Sender<Key>>>>;

/// What all pages share.
#[derive(Clone)]
struct Shared {
    holds: Holds,
    patience: Duration,
}

/// Its answers. `patience` is how long one answer of the board is waited for.
pub(super) fn routes(patience: Duration) -> Router {
    Router::new()
        .route("/bench", get(hold))
        .route("/bench/keys", post(keys))
        .with_state(Shared {
            holds: Holds::default(),
            patience,
        })
}

/// A page that has a board.
struct Hold {
    holds: Holds,
    number: String,
    keys: Receiver<Key>,
}

impl Hold {
    fn new(holds: &Holds) -> Result<Self> {
        let mut bytes = [0; 8];
        getrandom::fill(&mut bytes).context("this computer has no random numbers")?;
        let number = format!("{:016x}", u64::from_le_bytes(bytes));
        let (sender, keys) = channel();
        let mut all = holds.lock().unwrap_or_else(PoisonError::into_inner);
        all.insert(number.clone(), sender);
        Ok(Hold {
            holds: holds.clone(),
            number,
            keys,
        })
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        let mut all = self.holds.lock().unwrap_or_else(PoisonError::into_inner);
        all.remove(&self.number);
    }
}

/// Takes the board for as long as the page listens.
async fn hold(State(shared): State<Shared>, Query(at): Query<At>) -> Events {
    stream(move |page| {
        let (client, identity) = ready(&at.board)?;
        let title = format!("{} at {}", name(&identity), client.address());
        let layout = layout(&identity, None);
        let mut bench = Bench::take(client, &identity, &layout, shared.patience)?;
        let mut tryout = Tryout::new(layout);
        let hold = Hold::new(&shared.holds)?;
        let begin = Instant::now();
        let mut shown = None;
        loop {
            let now = begin.elapsed();
            for key in hold.keys.try_iter() {
                // It neither ends the page nor has a machine's file.
                let _act = tryout.key(key, now);
            }
            bench.turn(&mut tryout, now);
            if shown.is_none_or(|last| now.saturating_sub(last) >= SHOWN) {
                page.send("line", &to_json(&tryout, &hold.number, &title))?;
                shown = Some(now);
            }
            std::thread::sleep((now + EVERY).saturating_sub(begin.elapsed()));
        }
    })
}

/// A key of the page, or what it has typed.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Pressed {
    Arm,
    Off,
    Stop,
    Output(usize),
    Motor(usize),
    Encoder(usize),
    Switch,
    Mark,
    Slower,
    Faster,
    Distance,
    Minus,
    Plus,
    Released,
    Measured(String),
}

impl Pressed {
    fn keys(self) -> Vec<Key> {
        let key = match self {
            Pressed::Measured(text) => {
                let digits = text.trim().chars().map(Key::Digit);
                return [Key::Measure]
                    .into_iter()
                    .chain(digits)
                    .chain([Key::Enter])
                    .collect();
            }
            Pressed::Arm => Key::Arm,
            Pressed::Off => Key::Off,
            Pressed::Stop => Key::Stop,
            Pressed::Output(n) => Key::Select(Row::Output(n)),
            Pressed::Motor(n) => Key::Select(Row::Motor(n)),
            Pressed::Encoder(n) => Key::Select(Row::Encoder(n)),
            Pressed::Switch => Key::Enter,
            Pressed::Mark => Key::Mark,
            Pressed::Slower => Key::Slower,
            Pressed::Faster => Key::Faster,
            Pressed::Distance => Key::Distance,
            Pressed::Minus => Key::Move(Way::Minus, Edge::Down),
            Pressed::Plus => Key::Move(Way::Plus, Edge::Down),
            Pressed::Released => Key::Move(Way::Plus, Edge::Up),
        };
        vec![key]
    }
}

/// Keys of one page, in their order.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    hold: String,
    keys: Vec<Pressed>,
}

async fn keys(State(shared): State<Shared>, Json(keys): Json<Keys>) -> Answer {
    let holds = shared.holds.lock().unwrap_or_else(PoisonError::into_inner);
    let hold = holds.get(&keys.hold);
    let taken = hold.is_some_and(|hold| {
        let mut keys = keys.keys.into_iter().flat_map(Pressed::keys);
        keys.all(|key| hold.send(key).is_ok())
    });
    match taken {
        true => Ok(Json(json!({}))),
        false => Err(Refusal::new(
            StatusCode::CONFLICT,
            "this page does not have the board; open Bench, and no other page with it",
        )),
    }
}

fn to_json(tryout: &Tryout, hold: &str, title: &str) -> Value {
    let layout = &tryout.layout;
    let levels = tryout.status().map(|status| status.gpio_in);
    let input = |(_, line): (usize, &Labelled)| {
        let level = levels.map(|levels| levels >> line.bit & 1 != 0);
        json!({ "name": line.name, "pins": line.pins, "level": level })
    };
    let output = |(n, line): (usize, &Labelled)| {
        let on = tryout.on() == Some(n);
        json!({ "name": line.name, "pins": line.pins, "on": on })
    };
    let motor = |(n, motor): (usize, &Motor)| {
        json!({
            "name": motor.line.name,
            "pins": motor.line.pins,
            "gone": tryout.gone(n),
            "distance": number(tryout.distance(motor)),
            "speed": number(tryout.speed(motor).round()),
        })
    };
    let encoder = |(n, line): (usize, &Labelled)| json!({ "name": line.name, "pins": line.pins, "turned": tryout.turned(n) });
    fn all<'a, T: 'a>(lines: &'a [T], each: impl Fn((usize, &'a T)) -> Value) -> Vec<Value> {
        lines.iter().enumerate().map(each).collect()
    }
    json!({
        "hold": hold,
        "title": title,
        "state": tryout.state(),
        "said": tryout.said(),
        "found": tryout.found().map(|found| found.line(&layout.unit)),
        "inputs": all(&layout.inputs, input),
        "outputs": all(&layout.outputs, output),
        "motors": all(&layout.motors, motor),
        "encoders": all(&layout.encoders, encoder),
    })
}
