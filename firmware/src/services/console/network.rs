//! Frames, the link, and the addresses.

use super::board::status_at;
use super::{More, Piece, Reader};
use crate::services::Network;
use crate::text::Out;
use wire::describe::{self, FEATURE_KEY, address};
use wire::exchange::status_word;
use wire::flash::{LinkWord, Origin};
use wire::regmap::{self, ethmac};
use wire::settings::{FLAG_DHCP, mac_to_words};
use wire::{Name, Refusal, map};

/// Counters of refusals in a piece.
const REFUSALS: usize = 4;
/// Words of the settings.
const FLAGS: u32 = map::FLASH_SETTINGS + 4 * 3;
const IP: u32 = map::FLASH_SETTINGS + 4 * 4;
const PREFIX: u32 = map::FLASH_SETTINGS + 4 * 5;
const GATEWAY: u32 = map::FLASH_SETTINGS + 4 * 6;
const PORT: u32 = map::FLASH_SETTINGS + 4 * 9;
const NAME: u32 = map::FLASH_SETTINGS + 4 * 10;

pub(super) fn net(step: u16, reader: &mut Reader, from: &mut impl Network, out: &mut Out) -> Piece {
    match step {
        0 => {
            let us = from.us();
            out.text("address ").address(us.ip, us.port).end();
            let [received, sent, exchanges, refused] = reader.words(
                [
                    map::COUNTERS,
                    map::COUNTERS + 4,
                    map::COUNTERS + 8,
                    status_at(status_word::REFUSED),
                ],
                from,
            )?;
            out.text("frames in ").number(received);
            out.text(", out ").number(sent);
            out.text("; exchanges ").number(exchanges);
            out.text("; refused ").number(refused).end();
            Some(More::Yes)
        }
        1 => mac_errors(reader, from, out).map(|()| More::Yes),
        _ => {
            let first = usize::from(step - 2) * REFUSALS;
            let base = map::COUNTERS_REFUSED + 4 * first as u32;
            let counts: [u32; REFUSALS] = reader.block(base, from)?;
            for (why, count) in Refusal::ALL.iter().skip(first).zip(counts) {
                if count != 0 {
                    out.text("  ").text(why.key()).text(" ").number(count).end();
                }
            }
            Some(More::when(first + REFUSALS < Refusal::COUNT))
        }
    }
}

fn mac_errors(reader: &mut Reader, from: &mut impl Network, out: &mut Out) -> Option<()> {
    let [slots, preamble, crc] = reader.words(
        [
            ethmac::SRAM_WRITER_ERRORS,
            ethmac::RX_DATAPATH_PREAMBLE_ERRORS,
            ethmac::RX_DATAPATH_CRC_ERRORS,
        ]
        .map(|word| regmap::address(ethmac::BASE, word)),
        from,
    )?;
    out.text("mac: no slot ").number(slots);
    out.text(", preamble ").number(preamble);
    out.text(", crc ").number(crc).end();
    Some(())
}

pub(super) fn link(
    step: u16,
    reader: &mut Reader,
    from: &mut impl Network,
    out: &mut Out,
) -> Piece {
    if step > 0 {
        return mac_errors(reader, from, out).map(|()| More::No);
    }
    let [word] = reader.words([map::FLASH_LINK], from)?;
    let word = LinkWord::from_word(word);
    out.text("link ").text(word.speed.text());
    out.either(word.full_duplex, ", full duplex", "").end();
    Some(More::Yes)
}

pub(super) fn settings(
    step: u16,
    reader: &mut Reader,
    from: &mut impl Network,
    out: &mut Out,
) -> Piece {
    match step {
        0 => {
            let words: [u32; Name::WORDS] = reader.block(NAME, from)?;
            let name = Name::from_words(&words).ok()?;
            out.text("name     ").text(name.text()).end();
        }
        1 => {
            let [origin] = reader.words([map::FLASH_ORIGIN], from)?;
            out.text("from     ")
                .text(Origin::from_code(origin)?.text());
            out.end();
        }
        2 => {
            let [flags, ip, prefix, port] = reader.words([FLAGS, IP, PREFIX, PORT], from)?;
            let us = from.us();
            out.text("address  ").address(us.ip, us.port);
            out.either(flags & FLAG_DHCP != 0, ", DHCP, else ", ", static ");
            out.address(ip, port as u16).text(", /");
            out.number(prefix).end();
        }
        3 => {
            let [gateway] = reader.words([GATEWAY], from)?;
            out.text("gateway  ").address(gateway, 0).end();
        }
        _ => {
            let [features] = reader.words([address(describe::FEATURES_AT)], from)?;
            let [hi, lo] = mac_to_words(from.us().mac);
            out.text("mac      ").hex(hi).text(" ").hex(lo).end();
            out.text("key      ")
                .either(features & FEATURE_KEY != 0, "set", "none")
                .end();
            return Some(More::No);
        }
    }
    Some(More::Yes)
}
