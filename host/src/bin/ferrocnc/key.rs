//! `ferrocnc key`: makes, sets, removes and shows a board's pre-shared key. The key is never on a
//! command line and is never printed.

use crate::text::{Told, tell};
use anyhow::{Context, Result, anyhow, bail};
use clap::Subcommand;
use ferrocnc::client::{Client, ClientError};
use ferrocnc::keys::{self, Key, KeyError, Keys};
use ferrocnc::provision::{self, ProvisionError};
use ferrocnc::uid::uid_text;
use serde::Deserialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A board that restarts is back within seconds; one that asks a DHCP server later, and perhaps
/// elsewhere.
const RESTART: Duration = Duration::from_secs(15);

#[derive(Subcommand)]
pub(crate) enum KeyCommand {
    /// Make a key, keep it in this user's file for the board, and set it. The old one is needed if
    /// there is one.
    New {
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
    },
    /// Set the key in a file, and keep it in this user's file for the board. The old one is needed
    /// if there is one.
    Set {
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
        /// The new key: one line of 32 hex digits, mode 0600.
        #[arg(value_name = "NEW")]
        file: PathBuf,
    },
    /// Remove the key: every computer on the network may command the board again.
    Clear {
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
    },
    /// Has the board a key, has this computer one for it, and do they fit?
    Show {
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
    },
}

pub(crate) fn run(command: &KeyCommand, as_json: bool) -> Result<()> {
    let told = match command {
        KeyCommand::New { address } => set(address, Some(random()?))?,
        KeyCommand::Set { address, file } => {
            let key = keys::read(file).with_context(|| "the new key".to_owned())?;
            set(address, Some(key))?
        }
        KeyCommand::Clear { address } => set(address, None)?,
        KeyCommand::Show { address } => show(address)?,
    };
    tell(&told, as_json)
}

fn random() -> Result<Key> {
    Key::random().context("no random numbers")
}

/// What a page wants of a board's key.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wanted {
    board: String,
    order: Order,
    /// What is in the file of the key that is to be set, and its name.
    #[serde(default)]
    text: String,
    #[serde(default)]
    file: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Order {
    New,
    Set,
    Clear,
}

impl Wanted {
    /// `ferrocnc key new`, `set` and `clear`.
    pub(crate) fn take(&self) -> Result<Told> {
        let key = match self.order {
            Order::New => Some(random()?),
            Order::Set => Some(Key::parse(&self.text).ok_or_else(|| {
                anyhow!(
                    "the new key: {}",
                    KeyError::Malformed(PathBuf::from(&self.file))
                )
            })?),
            Order::Clear => None,
        };
        set(&self.board, key)
    }
}

/// Sets or clears the key. The new key is on the disk before it is sent to the board, and beside
/// the old one's file until the board is known to have it or to have refused it: after any
/// interruption or loss both files exist, and every command that needs the key tries both.
fn set(address: &str, key: Option<Key>) -> Result<Told> {
    let mut client = crate::open(address)?;
    let (locked, uid) = client.locked()?;
    if key.is_none() && !locked {
        bail!("{address} has no key");
    }
    let home = Keys::ByBoard.path(uid)?;
    let pending = key.as_ref().map(|key| Keys::on_its_way(uid, key));
    let pending = pending.transpose()?;
    // It was on its way before, with an answer that is not known: that this try is refused says
    // nothing of that one.
    let before = pending.as_ref().is_some_and(|path| path.exists());
    let keep = |key: &Key| match &pending {
        Some(pending) => keys::write(pending, key),
        None => Ok(()),
    };
    if let Err(error) = provision::set_key(client, key, keep) {
        let ours = pending.as_deref().map(|path| (path, before));
        return Err(untaken(error, address, ours));
    }
    arrived(address, pending.as_deref())?;
    match &pending {
        Some(pending) => std::fs::rename(pending, &home)
            .with_context(|| format!("the board has the key in {}", pending.display()))?,
        // Gone, or never there.
        None => drop(std::fs::remove_file(&home)),
    }
    // Keys that were on their way before are obsolete now.
    for path in Keys::ByBoard.pending(uid)? {
        let _ = std::fs::remove_file(path);
    }
    let fingerprint = key.map(|key| key.fingerprint());
    let board = uid_text(uid);
    let text = match &fingerprint {
        Some(fingerprint) => format!(
            "board {board} has the key in {} (fingerprint {fingerprint}); copy that file to every computer that is to drive the board",
            home.display()
        ),
        None => format!("board {board} has no key any more"),
    };
    let json = json!({ "uid": board, "file": key.map(|_| home), "fingerprint": fingerprint });
    Ok(Told { json, text })
}

/// The board has not confirmed the key. Only where it cannot have it the file goes.
fn untaken(error: ProvisionError, address: &str, pending: Option<(&Path, bool)>) -> anyhow::Error {
    let unsure = matches!(error, ProvisionError::Unsure(_));
    match pending {
        Some((pending, _)) if unsure => anyhow::Error::new(error).context(format!(
            "it is not known whether {address} has the new key. It is kept in {}; everything that needs the key tries that file, too, and ferrocnc key show {address} tells what the board has",
            pending.display()
        )),
        Some((pending, before)) => {
            if !before {
                let _ = std::fs::remove_file(pending);
            }
            error.into()
        }
        None if unsure => anyhow::Error::new(error).context(format!(
            "it is not known whether {address} still has its key. Its file is kept; ferrocnc key show {address} tells"
        )),
        None => error.into(),
    }
}

/// Waits until the board has restarted with the key in this file, or without any.
fn arrived(address: &str, pending: Option<&Path>) -> Result<()> {
    let began = Instant::now();
    loop {
        std::thread::sleep(Duration::from_millis(100));
        let client = crate::open(address)?.with_patience(Duration::from_secs(1));
        let keys = pending.map_or(Keys::ByBoard, |path| Keys::File(path.to_owned()));
        let mut client = client.with_keys(keys);
        let settled = match (client.locked(), pending) {
            (Ok((false, _)), None) => true,
            (Ok((true, _)), Some(_)) => fits(&mut client).is_ok(),
            (Ok(_) | Err(_), _) => false,
        };
        if settled {
            return Ok(());
        }
        if began.elapsed() > RESTART {
            bail!(
                "saved, but {address} has not come back with it yet{}",
                match pending {
                    Some(pending) => format!(
                        "; its key will be the one in {}; every command that needs the key tries that file, too",
                        pending.display()
                    ),
                    None => String::new(),
                }
            );
        }
    }
}

/// Does the board take this key? Asks for the session and gives it back.
fn fits(client: &mut Client) -> Result<(), ClientError> {
    let session = client.acquire()?;
    client.release(&session);
    Ok(())
}

/// `ferrocnc key show`.
pub(crate) fn show(address: &str) -> Result<Told> {
    let mut client = crate::open(address)?;
    let (locked, uid) = client.locked()?;
    let all = crate::keys();
    let path = all.path(uid)?;
    // This comes first: if the board takes a key that was on its way, that key is in the board's
    // file afterwards.
    let fits = match locked && all.find(uid).is_ok() {
        true => match fits(&mut client) {
            Ok(()) => Some(true),
            Err(ClientError::Key(..)) => Some(false),
            // For example, another host drives the board: then the keys cannot be compared now.
            Err(_) => None,
        },
        false => None,
    };
    let ours = match keys::read(&path) {
        Ok(key) => Ok(Some(key.fingerprint())),
        Err(KeyError::Missing(_)) => Ok(None),
        Err(error) => Err(error.to_string()),
    };
    let waiting = all.pending(uid)?;
    let text = said(uid, locked, &path, &ours, &waiting, fits);
    let (fingerprint, problem) = match ours {
        Ok(fingerprint) => (fingerprint, None),
        Err(problem) => (None, Some(problem)),
    };
    let json = json!({
        "uid": uid_text(uid), "locked": locked, "file": path,
        "fingerprint": fingerprint, "problem": problem, "fits": fits,
        "on_their_way": waiting,
    });
    Ok(Told { json, text })
}

/// The same as sentences.
fn said(
    uid: [u32; 2],
    locked: bool,
    path: &Path,
    ours: &Result<Option<String>, String>,
    waiting: &[PathBuf],
    fits: Option<bool>,
) -> String {
    let has = match locked {
        true => "has a key",
        false => "has no key; every computer on the network may command it (ferrocnc key new)",
    };
    let mut lines = vec![format!("board {}: {has}", uid_text(uid))];
    lines.push(match ours {
        Ok(Some(fingerprint)) => format!("{}: fingerprint {fingerprint}", path.display()),
        Ok(None) => format!("{}: not there", path.display()),
        Err(problem) => problem.clone(),
    });
    lines.extend(waiting.iter().map(|path| {
        format!(
            "{}: was on its way to the board, which does not have it so far",
            path.display()
        )
    }));
    match fits {
        Some(true) => lines.push("they fit".to_owned()),
        Some(false) => lines.push("they do not fit: the board has another key".to_owned()),
        None => {}
    }
    lines.join("\n")
}
