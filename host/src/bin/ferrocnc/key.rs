//! `ferrocnc key`: makes, sets, removes and shows a board's pre-shared key. The key is never on a
//! command line and is never printed.

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use ferrocnc::client::{Client, ClientError};
use ferrocnc::keys::{self, Key, KeyError, Keys};
use ferrocnc::provision::{self, ProvisionError};
use ferrocnc::uid::uid_text;
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
    match command {
        KeyCommand::New { address } => {
            let key = Key::random().context("no random numbers")?;
            set(address, Some(key), as_json)
        }
        KeyCommand::Set { address, file } => {
            let key = keys::read(file).with_context(|| "the new key".to_owned())?;
            set(address, Some(key), as_json)
        }
        KeyCommand::Clear { address } => set(address, None, as_json),
        KeyCommand::Show { address } => show(address, as_json),
    }
}

/// Sets or clears the key. The new key is on the disk before it is sent to the board, and beside
/// the old one's file until the board is known to have it or to have refused it: after any
/// interruption or loss both files exist, and every command that needs the key tries both.
fn set(address: &str, key: Option<Key>, as_json: bool) -> Result<()> {
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
    if as_json {
        println!(
            "{:#}",
            json!({ "uid": uid_text(uid), "file": key.map(|_| home), "fingerprint": fingerprint })
        );
    } else if let Some(fingerprint) = fingerprint {
        println!(
            "board {} has the key in {} (fingerprint {fingerprint}); copy that file to every computer that is to drive the board",
            uid_text(uid),
            home.display()
        );
    } else {
        println!("board {} has no key any more", uid_text(uid));
    }
    Ok(())
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

fn show(address: &str, as_json: bool) -> Result<()> {
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
    if as_json {
        let (fingerprint, problem) = match ours {
            Ok(fingerprint) => (fingerprint, None),
            Err(problem) => (None, Some(problem)),
        };
        println!(
            "{:#}",
            json!({
                "uid": uid_text(uid), "locked": locked, "file": path,
                "fingerprint": fingerprint, "problem": problem, "fits": fits,
                "on_their_way": waiting,
            })
        );
        return Ok(());
    }
    println!(
        "board {}: {}",
        uid_text(uid),
        match locked {
            true => "has a key",
            false => "has no key; every computer on the network may command it (ferrocnc key new)",
        }
    );
    match ours {
        Ok(Some(fingerprint)) => println!("{}: fingerprint {fingerprint}", path.display()),
        Ok(None) => println!("{}: not there", path.display()),
        Err(problem) => println!("{problem}"),
    }
    for path in waiting {
        println!(
            "{}: was on its way to the board, which does not have it so far",
            path.display()
        );
    }
    match fits {
        Some(true) => println!("they fit"),
        Some(false) => println!("they do not fit: the board has another key"),
        None => {}
    }
    Ok(())
}
