//! `ferrocnc log`: prints the firmware's defmt frames from the board's ring buffer as text.
//!
//! The firmware stores numbers; the texts are in its ELF, which has to be that of the running build
//! ([`elf`]). After the ring has wrapped, its first
//! bytes are the rest of a frame. Frames end with a zero byte, so the decoder finds the next one by
//! itself.

mod elf;

use anyhow::{Context, Result, bail, ensure};
use defmt_decoder::{DecodeError, Frame, Table};
use ferrocnc::client::Client;
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;
use wire::map;

/// More than any board's ring: a larger value is not a valid size.
const RING_MOST: u32 = 4096;

/// Where the texts are.
#[derive(clap::Args, Default)]
pub(crate) struct Texts {
    /// The firmware's ELF file, which holds the texts. If not given, it is found by the build id of
    /// the board.
    #[arg(long, value_name = "FILE", conflicts_with = "elf_dir")]
    elf: Option<PathBuf>,
    /// A folder to look for it, beside target/bitstream, target/firmware and
    /// /usr/share/ferrocnc/images; may be repeated.
    #[arg(long, value_name = "DIR")]
    elf_dir: Vec<PathBuf>,
}

impl Texts {
    /// The ELF of the build that the board runs.
    fn choose(&self, client: &mut Client) -> Result<elf::Chosen> {
        let build = client.read(&[map::FLASH_BUILD_ID])?[0];
        match &self.elf {
            Some(file) => elf::named(file, build),
            None => {
                let known = elf::FOLDERS.iter().map(PathBuf::from);
                let folders: Vec<PathBuf> = self.elf_dir.iter().cloned().chain(known).collect();
                elf::found(&folders, build)
            }
        }
    }
}

pub(crate) fn run(client: &mut Client, texts: &Texts, follow: bool, as_json: bool) -> Result<()> {
    each(client, texts, follow, |said| {
        match said {
            Said::Note(note) => eprintln!("ferrocnc: {note}"),
            Said::Line(frame) if as_json => writeln!(std::io::stdout(), "{}", to_json(frame))?,
            Said::Line(frame) => writeln!(std::io::stdout(), "{}", frame.display(false))?,
            Said::Looked => std::io::stdout().flush()?,
        }
        Ok(())
    })
}

/// What comes of looking at a log.
pub(crate) enum Said<'a> {
    /// A line of it.
    Line(&'a Frame<'a>),
    /// What is to be known of it.
    Note(String),
    /// There is no more for now.
    Looked,
}

pub(crate) fn to_json(frame: &Frame<'_>) -> Value {
    json!({
        "level": frame.level().map(|level| level.as_str()),
        "timestamp": frame.display_timestamp().map(|t| t.to_string()),
        "text": frame.display_message().to_string(),
    })
}

/// Reads the log, and if it is to be followed reads on until an error, of the board or of what
/// takes the lines.
pub(crate) fn each(
    client: &mut Client,
    texts: &Texts,
    follow: bool,
    take: impl Fn(Said<'_>) -> Result<()>,
) -> Result<()> {
    let elf::Chosen { file, bytes, note } = texts.choose(client)?;
    if let Some(note) = note {
        take(Said::Note(note))?;
    }
    let table = Table::parse(&bytes)
        .with_context(|| format!("{} holds no usable log texts", file.display()))?;
    let Some(table) = table else {
        bail!(
            "{} has no .defmt section; is it the firmware?",
            file.display()
        );
    };
    let mut decoder = table.new_stream_decoder();
    let mut reader = Reader::default();
    loop {
        let (fresh, lost) = reader.fetch(client)?;
        if fresh.is_empty() && !follow {
            take(Said::Note("the board's log is empty".to_owned()))?;
        }
        if lost > 0 && follow {
            let lost = format!("{lost} bytes of log were overwritten before they could be read");
            take(Said::Note(lost))?;
        }
        decoder.received(&fresh);
        loop {
            match decoder.decode() {
                Ok(frame) => take(Said::Line(&frame))?,
                Err(DecodeError::UnexpectedEof) => break,
                // Half a frame where the ring was cut.
                Err(DecodeError::Malformed) => {}
            }
        }
        take(Said::Looked)?;
        if !follow {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

/// Where the last look ended.
#[derive(Default)]
struct Reader {
    seen: Option<u32>,
}

impl Reader {
    /// What is new since the last call, and how many bytes were lost in between.
    fn fetch(&mut self, client: &mut Client) -> Result<(Vec<u8>, u32)> {
        let head = client.read(&[map::LOG, map::LOG + 4])?;
        let [head, size] = head[..] else {
            bail!("the board's log window is invalid; update the tool or the board");
        };
        ensure!(
            size.is_power_of_two() && (4..=RING_MOST).contains(&size),
            "the board keeps no log (its ring is {size} bytes)"
        );
        let words = client.read_from(map::LOG_RING, size as usize / 4)?;
        let after = client.read(&[map::LOG])?[0];
        let mut ring = vec![0; size as usize];
        wire::words_to_bytes(&words, &mut ring);
        Ok(self.take(&ring, head, after))
    }

    /// The valid part of the ring, which was read while the head went from `head` to `after`.
    fn take(&mut self, ring: &[u8], head: u32, after: u32) -> (Vec<u8>, u32) {
        let size = ring.len() as u32;
        let written = after.wrapping_sub(head).min(size);
        // Everything older than this was, or may have been, overwritten meanwhile. A head below the
        // size after start-up cannot be told from a wrapped one; zeros decode to nothing.
        let believable = size - written;
        let available = believable.min(if self.seen.is_none() && head < size {
            head
        } else {
            size
        });
        let wanted = self.seen.map_or(available, |seen| head.wrapping_sub(seen));
        let taken = wanted.min(available);
        self.seen = Some(head);
        let bytes = (0..taken)
            .map(|n| ring[(head.wrapping_sub(taken).wrapping_add(n) % size) as usize])
            .collect();
        (bytes, wanted - taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_young_ring_is_read_from_its_start() {
        let mut reader = Reader::default();
        assert_eq!(reader.take(b"abc.....", 3, 3), (b"abc".to_vec(), 0));
        assert_eq!(reader.take(b"abcde...", 5, 5), (b"de".to_vec(), 0));
    }

    #[test]
    fn a_ring_that_went_round_is_unrolled() {
        let mut reader = Reader::default();
        assert_eq!(reader.take(b"ijcdefgh", 10, 10), (b"cdefghij".to_vec(), 0));
    }

    #[test]
    fn what_was_overwritten_while_reading_is_not_believed() {
        let mut reader = Reader::default();
        assert_eq!(reader.take(b"ijklefgh", 10, 12), (b"efghij".to_vec(), 0));
    }

    #[test]
    fn what_was_missed_is_counted() {
        let mut reader = Reader { seen: Some(0) };
        assert_eq!(reader.take(b"ijklmnop", 16, 16), (b"ijklmnop".to_vec(), 8));
    }
}
