//! Pre-shared keys on this computer: one file per board, named by the board's unique id, for this
//! user alone.
//!
//! ```text
//! ~/.config/ferrocnc/keys/d162-0c8a-1b2c-3d4e.key     mode 0600: one line, 32 hex digits
//! ```
//!
//! ($XDG_CONFIG_HOME in place of ~/.config.) A key on its way to a board lies beside that file, as
//! `UID.key.new-FINGERPRINT`. The file exists before the board gets the key, and until it is known
//! which key the board has. So every key of a board is in a file, even if an answer or the power of
//! this computer is lost. Every command that needs the key tries those files, too. The key that the
//! board takes becomes the board's file.
//!
//! Every command that changes a board looks there by itself; a file may be named instead. A file
//! that other users can read is refused, as by ssh. [`wire::auth`] defines the words that a key
//! signs.

use crate::replace::{replace, sync_folder};
use crate::uid::uid_text;
use hmac::{Hmac, Mac};
use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use wire::auth::{Purpose, WORDS};

/// A key; it does not show itself in debug output.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key([u32; WORDS]);

impl core::fmt::Debug for Key {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Key({})", self.fingerprint())
    }
}

impl Key {
    /// A new one, from the system's random numbers.
    pub fn random() -> io::Result<Self> {
        let mut bytes = [0; WORDS * 4];
        getrandom::fill(&mut bytes).map_err(io::Error::other)?;
        let mut words = [0; WORDS];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_be_bytes(*bytes);
        }
        // All zeros means no key; this happens once in 2^128 tries.
        Ok(Key::new(words).unwrap_or(Key([1; WORDS])))
    }

    /// These words, unless they are zeros.
    pub fn new(words: [u32; WORDS]) -> Option<Self> {
        (words != wire::auth::NONE).then_some(Key(words))
    }

    /// 32 hex digits, white space around them.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        if text.len() != WORDS * 8 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return None;
        }
        let mut words = [0; WORDS];
        for (n, word) in words.iter_mut().enumerate() {
            *word = u32::from_str_radix(&text[8 * n..][..8], 16).ok()?;
        }
        Key::new(words)
    }

    /// As settings have it.
    pub fn words(&self) -> [u32; WORDS] {
        self.0
    }

    /// As a file has it.
    fn text(&self) -> String {
        let words = self.0.map(|word| format!("{word:08x}"));
        words.concat()
    }

    /// Tells keys apart without showing them.
    pub fn fingerprint(&self) -> String {
        // Purpose 0 is not used, so no board accepts this tag as an answer.
        let [first, ..] = self.tag(&[0], &[]);
        format!("{first:08x}")
    }

    /// HMAC-SHA256 of the words, its first four.
    pub fn tag(&self, head: &[u32], rest: &[u32]) -> [u32; WORDS] {
        let mut bytes = [0; WORDS * 4];
        wire::words_to_bytes(&self.0, &mut bytes);
        let mut hmac =
            Hmac::<sha2::Sha256>::new_from_slice(&bytes).expect("HMAC takes keys of any length");
        for word in head.iter().chain(rest) {
            hmac.update(&word.to_be_bytes());
        }
        let bytes = hmac.finalize().into_bytes();
        let mut words = [0; WORDS];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_be_bytes(*bytes);
        }
        words
    }

    /// The answer that takes the session with this nonce.
    pub fn acquire(&self, challenge: [u32; WORDS], nonce: u32) -> [u32; WORDS] {
        self.tag(&Purpose::Acquire.head(challenge), &[nonce])
    }

    /// The answer that lets into the console.
    pub fn login(&self, challenge: [u32; WORDS]) -> [u32; WORDS] {
        self.tag(&Purpose::Login.head(challenge), &[])
    }

    /// The answer at the end of a Proven, for the words before it.
    pub fn set(&self, challenge: [u32; WORDS], words: &[u32]) -> [u32; WORDS] {
        self.tag(&Purpose::Set.head(challenge), words)
    }
}

/// Why there is no key.
#[derive(Debug)]
pub enum KeyError {
    /// No such file.
    Missing(PathBuf),
    /// Others may read it.
    Open(PathBuf, u32),
    /// Something else is in it.
    Malformed(PathBuf),
    /// It cannot be read or written.
    Io(PathBuf, io::Error),
    /// Neither $XDG_CONFIG_HOME nor $HOME is set.
    NoHome,
    /// The board takes none of these.
    Wrong(Vec<PathBuf>),
}

impl core::fmt::Display for KeyError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            KeyError::Missing(path) => write!(
                f,
                "the board requires a key, and there is none at {}; copy that file from the computer where the key was made (ferrocnc key new), or name another: --key FILE, with loadrt key=FILE. If the key is lost: start the board with its factory pin held, then: ferrocnc key clear",
                path.display()
            ),
            KeyError::Open(path, mode) => write!(
                f,
                "{} can be read by others (mode {mode:04o}), so it is not secret; if it was not copied: chmod 600 {}, else make a new one (ferrocnc key new)",
                path.display(),
                path.display()
            ),
            KeyError::Malformed(path) => write!(
                f,
                "{} holds no key: one line of 32 hex digits, not all zeros",
                path.display()
            ),
            KeyError::Io(path, error) => write!(f, "{}: {error}", path.display()),
            KeyError::NoHome => f.write_str(
                "neither $XDG_CONFIG_HOME nor $HOME says where keys are; name the file: --key FILE, with loadrt key=FILE",
            ),
            KeyError::Wrong(paths) => write!(
                f,
                "the board has a key, but not the one in {}; take the file from the computer where the key was made last (ferrocnc key show tells them apart)",
                paths
                    .iter()
                    .map(|path| path.display().to_string())
                    .collect::<Vec<_>>()
                    .join(", nor in ")
            ),
        }
    }
}

impl std::error::Error for KeyError {}

/// Where to look for a board's key.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Keys {
    /// In this user's files, by the board's unique id.
    #[default]
    ByBoard,
    /// In this file.
    File(PathBuf),
}

impl Keys {
    /// This file, or if none is named the user's.
    pub fn named(file: Option<&Path>) -> Self {
        file.map_or(Keys::ByBoard, |file| Keys::File(file.to_owned()))
    }

    /// The file for this board.
    pub fn path(&self, uid: [u32; 2]) -> Result<PathBuf, KeyError> {
        match self {
            Keys::File(path) => Ok(path.clone()),
            Keys::ByBoard => user_file(uid),
        }
    }

    /// The keys this board may have, at least one, and where they are: the board's file, then what
    /// was on its way to it, the last first.
    pub fn find(&self, uid: [u32; 2]) -> Result<Vec<(Key, PathBuf)>, KeyError> {
        let home = self.path(uid)?;
        let mut found = Vec::new();
        let first = match read(&home) {
            Ok(key) => {
                found.push((key, home.clone()));
                None
            }
            // Something on its way may be the one.
            Err(error @ KeyError::Missing(_)) => Some(error),
            Err(error) => return Err(error),
        };
        for path in self.pending(uid)? {
            // A file that others can read, or that a full disk cut short, is skipped.
            found.extend(read(&path).map(|key| (key, path)));
        }
        match first {
            Some(error) if found.is_empty() => Err(error),
            Some(_) | None => Ok(found),
        }
    }

    /// Where a key waits that is on its way to this board.
    pub fn on_its_way(uid: [u32; 2], key: &Key) -> Result<PathBuf, KeyError> {
        let home = user_file(uid)?;
        Ok(home.with_extension(format!("{PENDING}{}", key.fingerprint())))
    }

    /// The files of keys that were on their way to this board, the last first. None where a file is
    /// named.
    pub fn pending(&self, uid: [u32; 2]) -> Result<Vec<PathBuf>, KeyError> {
        let home = match self {
            Keys::File(_) => return Ok(Vec::new()),
            Keys::ByBoard => user_file(uid)?,
        };
        let prefix = home.with_extension(PENDING);
        let (Some(folder), Some(prefix)) = (prefix.parent(), prefix.file_name()) else {
            return Ok(Vec::new());
        };
        // No folder, no files.
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let mut found: Vec<_> = entries
            .filter(|entry| {
                let name = entry.file_name();
                name.as_encoded_bytes()
                    .starts_with(prefix.as_encoded_bytes())
            })
            .map(|entry| {
                let written = entry.metadata().and_then(|data| data.modified()).ok();
                (std::cmp::Reverse(written), entry.path())
            })
            .collect();
        found.sort();
        Ok(found.into_iter().map(|(_, path)| path).collect())
    }

    /// The board has taken the key in this file: if it was on its way, it is the board's from now
    /// on.
    pub fn accepted(&self, uid: [u32; 2], path: &Path) {
        if let (Keys::ByBoard, Ok(home)) = (self, user_file(uid))
            && path != home
        {
            // If the rename fails, the file is found under its old name the next time.
            let _ = fs::rename(path, &home).and_then(|()| sync_folder(&home));
        }
    }
}

/// What a key's file ends in while the board may not have it yet; its fingerprint follows.
const PENDING: &str = "key.new-";

/// This user's file for the board with this unique id.
pub fn user_file(uid: [u32; 2]) -> Result<PathBuf, KeyError> {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    let config = set("XDG_CONFIG_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(set("HOME")?).join(".config")))
        .ok_or(KeyError::NoHome)?;
    let name = format!("{}.key", uid_text(uid));
    Ok(config.join("ferrocnc").join("keys").join(name))
}

/// Reads a key from a file that only this user can read.
pub fn read(path: &Path) -> Result<Key, KeyError> {
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => KeyError::Missing(path.to_owned()),
        _ => KeyError::Io(path.to_owned(), error),
    };
    let file = fs::File::open(path).map_err(failed)?;
    let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(KeyError::Open(path.to_owned(), mode));
    }
    let text = io::read_to_string(file).map_err(failed)?;
    Key::parse(&text).ok_or_else(|| KeyError::Malformed(path.to_owned()))
}

/// Writes a key where only this user can read it. When this comes back it survives a loss of power,
/// as [`replace`] says, and so do folders made for it.
pub fn write(path: &Path, key: &Key) -> Result<(), KeyError> {
    let failed = |error| KeyError::Io(path.to_owned(), error);
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    if let Some(folder) = folder {
        let missing: Vec<_> = folder.ancestors().take_while(|one| !one.exists()).collect();
        let mut builder = DirBuilder::new();
        let made = builder.recursive(true).mode(0o700).create(folder);
        made.map_err(failed)?;
        for folder in missing {
            sync_folder(folder).map_err(failed)?;
        }
    }
    replace(path, format!("{}\n", key.text()).as_bytes(), 0o600).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::auth::{EXAMPLE_CHALLENGE, EXAMPLE_KEY, EXAMPLE_TAG};

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("ferrocnc-keys-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder.join(name)
    }

    #[test]
    fn the_example_of_the_specification_comes_out() {
        let key = Key::new(EXAMPLE_KEY).unwrap();
        assert_eq!(key.acquire(EXAMPLE_CHALLENGE, 7), EXAMPLE_TAG);
    }

    #[test]
    fn a_key_is_written_for_its_user_alone_and_read_back() {
        let path = scratch("deep").join("er").join("written.key");
        let (one, other) = (Key::random().unwrap(), Key::random().unwrap());
        assert_ne!(one, other);
        for key in [one, other] {
            write(&path, &key).unwrap();
            assert_eq!(
                fs::metadata(&path).unwrap().permissions().mode() & 0o777,
                0o600
            );
            assert_eq!(read(&path).unwrap(), key);
        }
        let folder = fs::metadata(path.parent().unwrap()).unwrap();
        assert_eq!(folder.permissions().mode() & 0o777, 0o700);
    }

    #[test]
    fn a_key_others_can_read_is_refused_with_the_remedy() {
        let path = scratch("open.key");
        write(&path, &Key::random().unwrap()).unwrap();
        for mode in [0o640, 0o604, 0o620, 0o777] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            let said = read(&path).unwrap_err().to_string();
            assert!(
                said.contains("chmod 600") && said.contains(&format!("{mode:04o}")),
                "{said}"
            );
        }
        fs::set_permissions(&path, fs::Permissions::from_mode(0o400)).unwrap();
        assert!(read(&path).is_ok());
    }

    #[test]
    fn what_is_no_key_is_told() {
        let path = scratch("wrong.key");
        for text in [
            "",
            "xyz",
            &"0".repeat(32),
            &"1".repeat(31),
            &"1".repeat(33),
            &"+1111111".repeat(4),
        ] {
            replace(&path, text.as_bytes(), 0o600).unwrap();
            assert!(matches!(read(&path), Err(KeyError::Malformed(_))), "{text}");
        }
        let said = read(&scratch("none.key")).unwrap_err().to_string();
        assert!(
            said.contains("requires a key") && said.contains("--key FILE"),
            "{said}"
        );
    }

    #[test]
    fn debug_output_does_not_show_the_key() {
        let key = Key::parse("feedfacefeedfacefeedfacefeedface\n").unwrap();
        assert!(!format!("{key:?}").contains("feed"));
    }
}
