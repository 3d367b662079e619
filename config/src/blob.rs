//! The board info blob: what the board says about itself. Its layout's specification is
//! `wire::board`.

use crate::board::{Board, Channel, Class};
use crate::error::{Error, Report};
use wire::board::{HEADER_LEN, LIST, MAGIC, VERSION, crc32};

/// Bytes the board has for it: two block RAMs.
pub const ROM: usize = wire::regmap::BOARD_ROM_SIZE;

/// The blob of a configuration. Refused when it is longer than the board has room for.
pub fn blob(board: &Board) -> Result<Vec<u8>, Error> {
    numbered(board, |class| (0..).zip(board.of(class)).collect())
}

/// The same with the channels of a class under these numbers.
pub(crate) fn numbered<'b>(
    board: &'b Board,
    channels: impl Fn(Class) -> Vec<(u8, &'b Channel)>,
) -> Result<Vec<u8>, Error> {
    let mut body = Vec::new();
    entry(&mut body, 1, 0, board.platform.title.as_bytes());
    entry(&mut body, 2, 0, board.name.as_bytes());
    if let Some(mac) = board.mac {
        entry(&mut body, 10, 0, &mac);
    }
    entry(&mut body, 11, 0, &board.ipv4);
    entry(&mut body, 12, 0, &board.udp_port.to_be_bytes());
    entry(&mut body, 13, 0, board.platform.device.as_bytes());
    entry(&mut body, 14, 0, board.platform.name.as_bytes());
    for class in Class::ALL {
        list(&mut body, class, &channels(class));
    }
    let total = HEADER_LEN + body.len();
    if total > ROM {
        return Err(Error::from(Report {
            file: board.file.clone(),
            place: None,
            key: String::new(),
            value: String::new(),
            problem: format!("describes itself in {total} bytes and the board has {ROM}"),
            remedy: "shorten the names of the channels, or leave out some of those they had in LiteX-CNC (litexcnc_name, name in its JSON)".to_owned(),
        }));
    }
    let head = [MAGIC, VERSION, total as u32, crc32(&body)];
    let mut blob: Vec<u8> = head.iter().flat_map(|word| word.to_be_bytes()).collect();
    blob.append(&mut body);
    Ok(blob)
}

/// The channels of a class in as few entries as they go into.
fn list(body: &mut Vec<u8>, class: Class, channels: &[(u8, &Channel)]) {
    let letter = class.letter();
    let (mut first, mut next, mut said) = (0, 0, String::new());
    for (n, channel) in channels {
        let text = channel.text(class);
        let line = match text.as_str() {
            "" => channel.name.clone(),
            text => format!("{} {letter}{text}", channel.name),
        };
        // A list has no gaps.
        if *n != next || said.len() + 1 + line.len() > 255 {
            end(body, first, &said);
            said.clear();
        }
        if said.is_empty() {
            (first, said) = (*n, letter.to_string());
        } else {
            said.push('\n');
        }
        said += &line;
        next = *n + 1;
    }
    end(body, first, &said);
}

/// Ends a list, if one was begun.
fn end(body: &mut Vec<u8>, first: u8, said: &str) {
    if !said.is_empty() {
        entry(body, LIST, first, said.as_bytes());
    }
}

fn entry(body: &mut Vec<u8>, kind: u8, channel: u8, value: &[u8]) {
    // A title may be any text. Its first 255 bytes are enough to recognise a board.
    let value = &value[..value.len().min(255)];
    body.extend([kind, channel, value.len() as u8, 0]);
    body.extend_from_slice(value);
    body.resize(body.len().next_multiple_of(4), 0);
}
