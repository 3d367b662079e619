//! The answers: one for each command, with what it prints with `--json`.

use super::answer::{Answer, Refusal, answered};
use crate::config::{self, New};
use crate::describe::Description;
use crate::text::Told;
use crate::{discover, doctor, job, key, machine, set};
use anyhow::Result;
use axum::Json;
use axum::extract::Query;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use ferrocnc::discovery::WAIT;
use serde::Deserialize;
use serde_json::json;
use std::path::Path;
use std::time::Duration;

/// A minute: longer looks are a mistake, and would keep a thread.
const LONGEST_WAIT_MS: u64 = 60_000;

/// Where `discover` looks.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wherever {
    interface: Option<String>,
    at: Option<String>,
    wait: Option<u64>,
}

/// `ferrocnc discover`.
pub(super) async fn discover(Query(wherever): Query<Wherever>) -> Answer {
    let wait = wherever.wait.map_or(WAIT, |millis| {
        Duration::from_millis(millis.min(LONGEST_WAIT_MS))
    });
    let place = discover::Where::named(wherever.interface, wherever.at);
    let found = answered(move || discover::find(&place, wait)).await?;
    Ok(Json(discover::all_to_json(&found)))
}

/// A board by its address.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct At {
    pub(super) board: String,
}

/// `ferrocnc describe`.
pub(super) async fn describe(Query(at): Query<At>) -> Answer {
    let described = answered(move || Description::read(&mut crate::open(&at.board)?)).await?;
    Ok(Json(described.to_json()))
}

/// What a command prints, both ways.
async fn told(work: impl FnOnce() -> Result<Told> + Send + 'static) -> Answer {
    let told = answered(work).await?;
    Ok(Json(json!({ "text": told.text, "done": told.json })))
}

/// `ferrocnc set`.
pub(super) async fn board_set(Json(wanted): Json<set::Wanted>) -> Answer {
    told(move || wanted.take()).await
}

/// `ferrocnc key show`.
pub(super) async fn key_show(Query(at): Query<At>) -> Answer {
    told(move || key::show(&at.board)).await
}

/// `ferrocnc key new`, `set` and `clear`.
pub(super) async fn key_order(Json(wanted): Json<key::Wanted>) -> Answer {
    told(move || wanted.take()).await
}

/// What `doctor` looks at.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Patient {
    board: Option<String>,
    interface: Option<String>,
}

/// `ferrocnc doctor`.
pub(super) async fn doctor(Query(patient): Query<Patient>) -> Answer {
    let report = answered(move || {
        doctor::report(&doctor::Questions {
            address: patient.board.as_deref(),
            interface: patient.interface,
            ..doctor::Questions::default()
        })
    })
    .await?;
    Ok(Json(report.to_json()))
}

/// What `ferrocnc doctor --fix` and `--undo` would do.
pub(super) async fn doctor_repairs() -> Answer {
    Ok(Json(answered(|| Ok(doctor::repairs())).await?))
}

/// One of these.
pub(super) async fn doctor_repair(Json(shown): Json<doctor::Shown>) -> Answer {
    answered(move || shown.take()).await?;
    Ok(Json(json!({})))
}

/// What `config new --platform` takes.
pub(super) async fn platforms() -> Answer {
    Ok(Json(answered(config::platforms_to_json).await?))
}

/// `ferrocnc config new`.
pub(super) async fn config_new(Json(new): Json<New>) -> Answer {
    let (name, toml) = answered(move || {
        let file = config::target(&new.name, None, true)?;
        Ok((config::stem(&file), new.toml(&file)?))
    })
    .await?;
    Ok(Json(json!({ "name": name, "toml": toml })))
}

/// A board file that is only on the page.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Text {
    name: String,
    toml: String,
}

/// `ferrocnc config check`.
pub(super) async fn config_check(Json(text): Json<Text>) -> Answer {
    let verdict = answered(move || Ok(config::check_text(&text.name, &text.toml))).await?;
    Ok(Json(verdict))
}

/// A board file that is only on the page, and a board.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TextAndBoard {
    name: String,
    toml: String,
    board: String,
}

/// `ferrocnc config diff`.
pub(super) async fn config_diff(Json(both): Json<TextAndBoard>) -> Answer {
    let found = answered(move || config::differences(&both.name, &both.toml, &both.board));
    Ok(Json(found.await?))
}

/// `ferrocnc config read`.
pub(super) async fn config_read(Query(at): Query<At>) -> Answer {
    Ok(Json(answered(move || config::kept(&at.board)).await?))
}

/// `ferrocnc config pinout`.
pub(super) async fn config_pinout(Json(text): Json<Text>) -> Answer {
    let drawing = answered(move || config::pinout_of(&text.name, &text.toml)).await?;
    Ok(Json(config::pinout_to_json(&drawing)))
}

/// `ferrocnc config pinout -o NAME.svg`.
pub(super) async fn config_svg(Json(text): Json<Text>) -> Result<impl IntoResponse, Refusal> {
    let drawing = answered(move || config::pinout_of(&text.name, &text.toml)).await?;
    let svg = ferrocnc_config::pinout::svg(&drawing);
    Ok(([(CONTENT_TYPE, "image/svg+xml")], svg))
}

/// A file of another project.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Foreign {
    from: config::From,
    file: String,
    text: String,
}

/// `ferrocnc config import`.
pub(super) async fn config_import(Json(foreign): Json<Foreign>) -> Answer {
    let (name, imported) = answered(move || {
        let Foreign { from, file, text } = foreign;
        let name = config::stem(Path::new(&file));
        let imported = config::imported(from, &file, &text, &name, Path::new(""))?;
        Ok((name, imported))
    })
    .await?;
    Ok(Json(
        json!({ "name": name, "toml": imported.toml, "notes": imported.notes }),
    ))
}

/// The samples of `ferrocnc machine new`.
pub(super) async fn machine_samples() -> Answer {
    Ok(Json(machine::samples()))
}

/// `ferrocnc machine new --from`.
pub(super) async fn machine_new(Json(sample): Json<machine::Sample>) -> Answer {
    let toml = answered(move || sample.text()).await?;
    Ok(Json(json!({ "toml": toml })))
}

/// A machine's file that is only on the page.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MachineText {
    toml: String,
}

/// The questions of `ferrocnc machine new`, `ferrocnc machine check`, and what `ferrocnc machine
/// write` would write.
pub(super) async fn machine_check(Json(text): Json<MachineText>) -> Answer {
    let judged = answered(move || {
        let mut judged = machine::judged(&text.toml);
        judged["questions"] = machine::questions(&text.toml).into();
        Ok(judged)
    });
    Ok(Json(judged.await?))
}

/// An answer to one of them.
pub(super) async fn machine_put(Json(answer): Json<machine::Answer>) -> Answer {
    let toml = answered(move || machine::put(&answer)).await?;
    Ok(Json(json!({ "toml": toml })))
}

/// `ferrocnc job preview` and `check`, of a drawing or a program that is only on the page.
pub(super) async fn job_drawn(Json(sheet): Json<job::Sheet>) -> Answer {
    Ok(Json(answered(move || sheet.drawn()).await?))
}

/// `ferrocnc job send`.
pub(super) async fn job_send(Json(parcel): Json<job::Parcel>) -> Answer {
    Ok(Json(answered(move || parcel.send()).await?))
}

/// `ferrocnc job start`, `pause`, `continue`, `stop` and `home`.
pub(super) async fn job_order(Json(told): Json<job::Told>) -> Answer {
    Ok(Json(answered(move || told.take()).await?))
}
