//! The release image on the Verilated board, with the behavioural flash soldered to its four wires:
//! identity, settings, discovery, an update, the factory pin, the link.
//!
//! `provision/` tests all of this on the twin, thousands of times. These tests show that gateware
//! and image do it with real clocks on real wires. A power cycle is another board of the same
//! gateware with the same chip.

use std::net::Ipv4Addr;

use ferrocnc_tests::bench::packed;
use ferrocnc_tests::flash::{self, Boots, FIRST, SECOND, UID, boots, factory};
use ferrocnc_tests::{parts, to_bytes, to_words};
use sim::lan_segment::{BOARD_IP, HOST_IP, LanSegment};
use sim::nor::spi::Shared;
use sim::nor::{Cut, Order, Part, Times};
use sim::rig::Rig;
use wire::discovery::{Body, Message, WORDS_MAX};
use wire::flash::{LinkWord, Op, OpResult, OpWord, Origin, PAGE, Running, Slot};
use wire::map;
use wire::settings::{self, Settings};
use wire::{LinkSpeed, Name};

/// The host's port for discovery.
const PORT: u16 = 51_000;

/// A new board's flash.
fn new_flash() -> Shared {
    Shared::new(factory(Part::W25Q32JV.with(Times::QUICK), UID))
}

/// Power comes to a board with this flash that is expected at this address.
fn power_up(flash: &Shared, ip: Ipv4Addr, factory_pin: bool) -> Rig {
    // What a datagram writes while an image is summed up waits for a slice of that: a fifth of a
    // millisecond.
    let mut rig = flash::power_up(flash, ip, factory_pin);
    rig.patience *= 4;
    rig
}

fn read(rig: &mut Rig, address: u32) -> u32 {
    rig.read_word(address)
        .unwrap_or_else(|| panic!("no answer to a read of {address:#x}"))
}

/// An operation to its end; `None` when the power failed.
fn op(rig: &mut Rig, flash: &Shared, op: Op, address: u32, buffer: &[u32]) -> Option<OpResult> {
    op_of(rig, flash, op, address, 4 * buffer.len() as u32, buffer)
}

fn op_of(
    rig: &mut Rig,
    flash: &Shared,
    op: Op,
    address: u32,
    length: u32,
    buffer: &[u32],
) -> Option<OpResult> {
    rig.write_words(map::FLASH_ADDRESS, &[address, length]);
    if !buffer.is_empty() {
        rig.write_words(map::FLASH_BUFFER, buffer);
    }
    rig.write_words(map::FLASH_OP, &[op.code()]);
    for _ in 0..2_000 {
        if flash.chip().dead() {
            return None;
        }
        let word = OpWord::from_word(read(rig, map::FLASH_OP)).expect("an operation word");
        assert_eq!(word.op, Some(op));
        if !word.busy {
            return Some(word.result);
        }
        rig.run(10_000);
    }
    panic!("{op} is stuck");
}

fn settings_at(last_octet: u8, name: &str) -> Settings {
    Settings {
        ip: u32::from_be_bytes([192, 168, 2, last_octet]),
        name: Name::new(name).expect("a name"),
        ..Settings::default()
    }
}

/// A broadcast message; returns the answers within some milliseconds.
fn discover(rig: &mut Rig, message: &Message, milliseconds: u64) -> Vec<Message> {
    let mut buffer = [0; WORDS_MAX];
    let bytes = to_bytes(message.emit(&mut buffer));
    rig.take_datagrams();
    rig.broadcast((HOST_IP, PORT), wire::DISCOVERY_PORT, &bytes);
    rig.run_ms(milliseconds);
    let came = rig.take_datagrams().into_iter();
    came.filter(|(datagram, _)| datagram.to == (Ipv4Addr::BROADCAST, PORT))
        .map(|(datagram, _)| {
            assert_eq!(datagram.from.1, wire::DISCOVERY_PORT);
            let words = to_words(&datagram.payload);
            Message::parse(&words).unwrap_or_else(|why| panic!("{words:x?}: {why}"))
        })
        .collect()
}

fn present(rig: &mut Rig) -> Message {
    let ask = Message {
        nonce: 42,
        uid: [0, 0],
        body: Body::Discover,
    };
    let mut answers = discover(rig, &ask, 5);
    assert_eq!(answers.len(), 1, "{answers:?}");
    answers.remove(0)
}

#[test]
fn the_flash_is_identified_through_its_wires() {
    let flash = new_flash();
    let mut rig = power_up(&flash, BOARD_IP, false);
    println!("answers after {} clocks", rig.clock());
    assert_eq!(read(&mut rig, map::FLASH_JEDEC), 0xef_4016);
    let uid = [map::FLASH_UID_HI, map::FLASH_UID_LO].map(|at| read(&mut rig, at));
    assert_eq!(uid, [(UID >> 32) as u32, UID as u32]);
    assert_eq!(read(&mut rig, map::FLASH_SIZE), 4 << 20);
    assert_eq!(read(&mut rig, map::FLASH_RUNNING), Running::A.code());
    assert_eq!(read(&mut rig, map::FLASH_SELECTED), Slot::A.code());
    assert_eq!(read(&mut rig, map::FLASH_BUILD_ID), FIRST);
    assert_eq!(read(&mut rig, map::FLASH_PROTECTED), 1);
    assert_eq!(
        flash.chip().misuse(),
        [],
        "every edge on the wires was in its place"
    );
}

#[test]
fn a_board_without_a_flash_runs_and_says_that_there_is_none() {
    let (soc, firmware) = parts();
    let mut rig = Rig::start(&soc, &firmware).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(read(&mut rig, map::FLASH_JEDEC), 0);
    assert_eq!(read(&mut rig, map::FLASH_ORIGIN), Origin::BuiltIn.code());
}

#[test]
fn settings_are_saved_survive_a_power_cycle_and_a_cut_and_the_factory_pin_sets_them_aside() {
    let flash = new_flash();
    let mut rig = power_up(&flash, BOARD_IP, false);
    let new = settings_at(77, "lathe");
    let saved = op(&mut rig, &flash, Op::SaveSettings, 0, &new.to_words());
    assert_eq!(saved, Some(OpResult::Ok));
    drop(rig);

    let mut rig = power_up(&flash, Ipv4Addr::new(192, 168, 2, 77), false);
    assert!(rig.ping().is_some());
    assert_ne!(read(&mut rig, map::FLASH_ORIGIN), Origin::BuiltIn.code());
    let words = rig.read_block(map::FLASH_SETTINGS, settings::WORDS as u32);
    let words = words.expect("the settings in force");
    let now = Settings::parse(words.first_chunk().expect("32 words")).expect("settings");
    assert_eq!((now.ip, now.name), (new.ip, new.name));

    // The power fails while others are saved: the old ones are in force.
    let step = flash.chip().steps() + 20;
    flash.chip().cut_at(Cut {
        step,
        seed: 5,
        order: Order::InOrder,
    });
    let other = settings_at(78, "torn").to_words();
    assert_eq!(op(&mut rig, &flash, Op::SaveSettings, 0, &other), None);
    drop(rig);
    let mut rig = power_up(&flash, Ipv4Addr::new(192, 168, 2, 77), false);
    assert!(rig.ping().is_some());
    drop(rig);

    let mut rig = power_up(&flash, BOARD_IP, true);
    assert_eq!(read(&mut rig, map::FLASH_ORIGIN), Origin::FactoryPin.code());
    drop(rig);
    let mut rig = power_up(&flash, Ipv4Addr::new(192, 168, 2, 77), false);
    assert!(rig.ping().is_some(), "the pin has erased nothing");
    assert_eq!(flash.chip().misuse(), []);
}

#[test]
fn discovery_is_answered_by_broadcast_and_a_set_moves_the_board() {
    let flash = new_flash();
    let mut rig = power_up(&flash, BOARD_IP, false);
    let uid = [(UID >> 32) as u32, UID as u32];
    let here = present(&mut rig);
    assert_eq!((here.nonce, here.uid), (42, uid));
    let Body::Here(before) = here.body else {
        panic!("{here:?}");
    };
    assert_eq!(before.ip, u32::from(BOARD_IP));
    assert_eq!((before.running, before.build_id), (Running::A, FIRST));
    assert_eq!(before.configuration.text(), "mill6");

    // What is for another board, and what is nonsense, is not answered.
    let set = Message {
        nonce: 43,
        uid,
        body: Body::Set(settings_at(99, "moved")),
    };
    let foreign = Message {
        uid: [uid[0], uid[1] ^ 1],
        ..set
    };
    assert_eq!(discover(&mut rig, &foreign, 5), []);

    let done = discover(&mut rig, &set, 40);
    let expected = Message {
        body: Body::Done(OpResult::Ok),
        ..set
    };
    assert!(done.contains(&expected), "{done:?}");
    // It restarts by itself, at its new address.
    rig.segment = LanSegment::new(Ipv4Addr::new(192, 168, 2, 99));
    rig.wait_ready(6_000_000)
        .unwrap_or_else(|error| panic!("{error}"));
    let Body::Here(after) = present(&mut rig).body else {
        panic!("no answer");
    };
    assert_eq!(after.ip, u32::from_be_bytes([192, 168, 2, 99]));
    assert_eq!(after.name.text(), "moved");
    assert_eq!(flash.chip().misuse(), []);
}

#[test]
fn a_small_image_is_brought_into_the_other_slot_and_selected() {
    let flash = new_flash();
    let mut rig = power_up(&flash, BOARD_IP, false);
    let image = flash::image(SECOND, 14);
    let area = flash::layout(&flash.chip()).slot_b;
    let begun = rig.clock();
    let ok = Some(OpResult::Ok);
    assert_eq!(op(&mut rig, &flash, Op::EraseSector, area.meta(), &[]), ok);
    assert_eq!(op(&mut rig, &flash, Op::EraseBlock, area.start, &[]), ok);
    for (n, page) in (0..).zip(image.chunks(PAGE as usize)) {
        let (at, words) = (area.start + n * PAGE, packed(page));
        let done = op_of(&mut rig, &flash, Op::Program, at, page.len() as u32, &words);
        assert_eq!(done, ok, "page {n}");
    }
    let length = image.len() as u32;
    let summed = op_of(&mut rig, &flash, Op::Crc, area.start, length, &[]);
    assert_eq!(summed, ok);
    assert_eq!(read(&mut rig, map::FLASH_CRC), wire::crc::crc32(&image));
    let slot = Slot::B.code();
    let early = op(&mut rig, &flash, Op::Select, slot, &[]);
    assert_eq!(early, Some(OpResult::Image), "no meta page yet");
    let meta = packed(&flash::meta(&image, SECOND).to_page());
    assert_eq!(op(&mut rig, &flash, Op::Program, area.meta(), &meta), ok);
    assert_eq!(boots(&flash.chip()), Boots::Slot(Slot::A, FIRST));
    assert_eq!(op(&mut rig, &flash, Op::Select, slot, &[]), ok);
    assert_eq!(boots(&flash.chip()), Boots::Slot(Slot::B, SECOND));
    assert_eq!(read(&mut rig, map::FLASH_SELECTED), slot);
    assert_eq!(read(&mut rig, map::FLASH_RUNNING), Running::A.code());
    let clocks = rig.clock() - begun;
    println!("{length} bytes and a selection in {clocks} clocks, the chip's own times aside");
    // Golden is out of reach.
    let golden = flash::layout(&flash.chip()).golden.start;
    for what in [Op::EraseSector, Op::EraseBlock] {
        let went = op(&mut rig, &flash, what, golden, &[]);
        assert_eq!(went, Some(OpResult::Address));
    }
    assert_eq!(flash.chip().misuse(), []);
}

#[test]
fn the_link_and_its_speed_are_told() {
    let flash = new_flash();
    let mut rig = power_up(&flash, BOARD_IP, false);
    // RGMII's in-band status: up, speed, duplex.
    for (status, speed, full_duplex) in [
        (0b1101, LinkSpeed::M1000, true),
        (0b1011, LinkSpeed::M100, true),
        (0b0001, LinkSpeed::M10, false),
        (0b1100, LinkSpeed::Down, true),
        (0b1101, LinkSpeed::M1000, true),
    ] {
        rig.board.link(status);
        rig.run_ms(8);
        let word = LinkWord::from_word(read(&mut rig, map::FLASH_LINK));
        assert_eq!(word.speed, speed, "status {status:#06b}");
        if speed != LinkSpeed::Down {
            assert_eq!(word.full_duplex, full_duplex);
        }
    }
}
