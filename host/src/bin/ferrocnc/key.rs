//! `ferrocnc key`: a board's pre-shared key. The key itself is never on a command line, nor shown.

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use ferrocnc::client::{Client, ClientError};
use ferrocnc::flash::uid_text;
use ferrocnc::keys::{self, Key, KeyError, Keys};
use ferrocnc::provision;
use serde_json::json;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// A board that starts anew is back within seconds; one that asks a DHCP server later, and perhaps elsewhere.
const RESTART: Duration = Duration::from_secs(15);

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Make a key, keep it in this user's file for the board, and set it. The old one is needed if there is one.
    New {
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
    },
    /// Set the key in a file, and keep it in this user's file for the board. The old one is needed if there is one.
    Set {
        /// IP[:port] of the board.
        #[arg(value_name = "BOARD")]
        address: String,
        /// The new key: one line of 32 hex digits, mode 0600.
        #[arg(value_name = "NEW")]
        file: PathBuf,
    },
    /// Take the key away: everybody on the network may command the board again.
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

pub(crate) fn run(command: &Command, as_json: bool) -> Result<()> {
    match command {
        Command::New { address } => {
            let key = Key::random().context("no random numbers")?;
            set(address, Some(key), as_json)
        }
        Command::Set { address, file } => {
            let key = keys::read(file).with_context(|| "the new key".to_owned())?;
            set(address, Some(key), as_json)
        }
        Command::Clear { address } => set(address, None, as_json),
        Command::Show { address } => show(address, as_json),
    }
}

/// Sets or clears. The new key lies beside the old one's file until the board is known to have it: whatever is cut short,
/// both are there.
fn set(address: &str, key: Option<Key>, as_json: bool) -> Result<()> {
    let mut client = crate::open(address)?;
    let (locked, uid) = client.locked()?;
    if key.is_none() && !locked {
        bail!("{address} has no key");
    }
    let home = Keys::ByBoard.path(uid)?;
    let pending = home.with_extension("key.new");
    if let Some(key) = &key {
        keys::write(&pending, key)?;
    }
    if let Err(error) = provision::set_key(client, key) {
        // The board has heard nothing of it.
        let _ = std::fs::remove_file(&pending);
        return Err(error.into());
    }
    arrived(address, &key, &pending)?;
    match &key {
        Some(_) => std::fs::rename(&pending, &home)
            .with_context(|| format!("the board has the key in {}", pending.display()))?,
        // Gone, or never there.
        None => drop(std::fs::remove_file(&home)),
    }
    let fingerprint = key.map(|key| key.fingerprint());
    if as_json {
        println!(
            "{:#}",
            json!({ "uid": uid_text(uid), "file": key.map(|_| home), "fingerprint": fingerprint })
        );
    } else if let Some(fingerprint) = fingerprint {
        println!(
            "board {} has the key in {} (fingerprint {fingerprint}); copy that file to every computer that shall drive the board",
            uid_text(uid),
            home.display()
        );
    } else {
        println!("board {} has no key any more", uid_text(uid));
    }
    Ok(())
}

/// Waits until the board has started anew with what it was given.
fn arrived(address: &str, key: &Option<Key>, pending: &std::path::Path) -> Result<()> {
    let began = Instant::now();
    loop {
        std::thread::sleep(Duration::from_millis(100));
        let client = crate::open(address)?.with_patience(Duration::from_secs(1));
        let mut client = client.with_keys(Keys::File(pending.to_owned()));
        let settled = match (client.locked(), key) {
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
                match key {
                    Some(_) => format!("; its key will be the one in {}", pending.display()),
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
    let path = crate::keys().path(uid)?;
    let ours = match keys::read(&path) {
        Ok(key) => Ok(Some(key.fingerprint())),
        Err(KeyError::Missing(_)) => Ok(None),
        Err(error) => Err(error.to_string()),
    };
    let fits = match (&ours, locked) {
        (Ok(Some(_)), true) => match fits(&mut client) {
            Ok(()) => Some(true),
            Err(ClientError::Key(..)) => Some(false),
            // Somebody drives it, for one: that cannot be told now.
            Err(_) => None,
        },
        (Ok(_) | Err(_), _) => None,
    };
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
            })
        );
        return Ok(());
    }
    println!(
        "board {}: {}",
        uid_text(uid),
        match locked {
            true => "has a key",
            false => "has no key; everybody on the network may command it (ferrocnc key new)",
        }
    );
    match ours {
        Ok(Some(fingerprint)) => println!("{}: fingerprint {fingerprint}", path.display()),
        Ok(None) => println!("{}: not there", path.display()),
        Err(problem) => println!("{problem}"),
    }
    match fits {
        Some(true) => println!("they fit"),
        Some(false) => println!("they do not fit: the board has another key"),
        None => {}
    }
    Ok(())
}
