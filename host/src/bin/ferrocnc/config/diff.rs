//! `ferrocnc config diff`: what a board's image has other than a board file.

use super::check::described;
use crate::describe::{classes, classes_of};
use crate::text::{Told, tell};
use anyhow::{Result, anyhow};
use ferrocnc_config::source::read_text;
use serde_json::{Value, json};
use std::path::Path;
use wire::board::{Blob, Kind};

pub(super) fn diff(file: &Path, address: &str, as_json: bool) -> Result<()> {
    tell(&differ(file, &read_text(file)?, address)?, as_json)
}

/// The same of a board file that is only on a page.
pub(crate) fn differences(name: &str, toml: &str, address: &str) -> Result<Value> {
    let file = super::unsaved(name);
    Ok(differ(&file, toml, address)?.json)
}

fn differ(file: &Path, toml: &str, address: &str) -> Result<Told> {
    let board = described(file, toml)?;
    let bytes = ferrocnc_config::blob::blob(&board)?;
    let ours = Blob::new_checked(&bytes).map_err(|error| anyhow!("{error:?}"))?;
    let identity = crate::open(address)?.identify()?;
    let theirs = identity.blob();
    let text = |blob: &Blob<'_>, kind| blob.text(kind, 0).unwrap_or("").to_owned();
    let mut found = Vec::new();
    for (what, kind) in [
        ("platform", Kind::Platform),
        ("configuration", Kind::Configuration),
    ] {
        let [of_board, of_file] = [text(&theirs, kind), text(&ours, kind)];
        if of_board != of_file {
            found.push(json!({ "what": what, "board": of_board, "file": of_file }));
        }
    }
    let of_file = classes_of(&ours, board.channels());
    for ((class, of_board), (_, of_file)) in classes(&identity).into_iter().zip(of_file) {
        for n in 0..of_board.len().max(of_file.len()) {
            let [of_board, of_file] = [of_board.get(n), of_file.get(n)];
            if of_board != of_file {
                let shown = |channel: Option<&(String, String)>| {
                    channel.map(|(name, pins)| format!("{name} {pins}"))
                };
                found.push(json!({
                    "what": format!("{class} {n}"),
                    "board": shown(of_board), "file": shown(of_file),
                }));
            }
        }
    }
    let lines: Vec<String> = found.iter().map(line).collect();
    let text = match lines.is_empty() {
        true => format!("{address} has what {} says", file.display()),
        false => lines.join("\n"),
    };
    let json = json!({ "board": address, "differences": found });
    Ok(Told { json, text })
}

fn line(difference: &Value) -> String {
    let said = |side: &str| difference[side].as_str().unwrap_or("-").to_owned();
    format!(
        "{:<14} board: {:<36} file: {}",
        said("what"),
        said("board"),
        said("file")
    )
}
