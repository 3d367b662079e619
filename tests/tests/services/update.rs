//! Without the services the ROM does all that an update needs, and the update brings them back.

use ferrocnc_tests::BenchMachine;
use ferrocnc_tests::bench::packed;
use ferrocnc_tests::flash::{self, Boots, SECOND, boots};
use ferrocnc_tests::services::small;
use ferrocnc_tests::wired::{on_flash, program, setup};
use sim::lan_segment::CONSOLE_PORT;
use sim::nor::spi::Shared;
use wire::describe::JobsState;
use wire::flash::{Op, OpResult, OpWord, PAGE, Slot};
use wire::images::{Role, Trailer};
use wire::map;

use crate::{EBREAK, FAST, becomes, moving, state};

/// Exchanges of a moving machine whose services do not run.
const EXCHANGES: usize = 10;
/// `li a0, 0; ret`: each frame is taken, and nothing is done.
const IDLE: [u32; 2] = [0x0000_0513, 0x0000_8067];

/// ARP, ping and exchanges are answered, and no port of the services is.
pub fn answers_without_services(machine: &mut BenchMachine, what: &str) {
    machine.capture();
    let question = machine.owners_arp();
    machine.inject(question);
    machine.run_millis(1);
    assert!(machine.told_the_owner_its_address(), "{what}: ARP");
    assert!(machine.ping().is_some(), "{what}: ping");
    let refused = machine.rig().tcp_connect(CONSOLE_PORT).is_err();
    assert!(refused, "{what}: there is a console");
    let mut command = moving(machine);
    for _ in 0..EXCHANGES {
        assert!(machine.exchange_and_wait(&mut command).state.enabled);
    }
    let spread = machine.turnaround_spread(EXCHANGES);
    assert!(spread.max <= FAST, "{what}: {spread:?}");
    machine.comes_to_rest(&mut command, what);
    machine.release();
}

/// An operation of the flash, to its end.
fn operation(
    machine: &mut BenchMachine,
    op: Op,
    address: u32,
    length: u32,
    buffer: &[u32],
) -> OpResult {
    let rig = machine.rig();
    rig.write_words(map::FLASH_ADDRESS, &[address, length]);
    if !buffer.is_empty() {
        rig.write_words(map::FLASH_BUFFER, buffer);
    }
    rig.write_words(map::FLASH_OP, &[op.code()]);
    for _ in 0..1000 {
        let word = OpWord::from_word(machine.read(map::FLASH_OP)).expect("an operation word");
        assert_eq!(word.op, Some(op));
        if !word.busy {
            return word.result;
        }
        machine.run_clocks(10_000);
    }
    panic!("{op} is stuck");
}

/// An image with services that do nothing is written to slot B and selected, as `ferrocnc update`
/// does. At the next power-up it runs.
pub fn is_brought_an_image(machine: &mut BenchMachine, nor: &Shared, what: &str) {
    // A write waits for a slice of the sum of an image.
    machine.rig().patience *= 4;
    let image = flash::with_program(&flash::image(SECOND, 3), &small(&program(), &IDLE));
    let area = flash::layout(&nor.chip()).slot_b;
    let mut steps = vec![
        (Op::EraseSector, area.meta(), 0, vec![]),
        (Op::EraseBlock, area.start, 0, vec![]),
    ];
    for (n, page) in (0..).zip(image.chunks(PAGE as usize)) {
        let at = area.start + n * PAGE;
        steps.push((Op::Program, at, page.len() as u32, packed(page)));
    }
    let meta = packed(&flash::meta(&image, SECOND).to_page());
    steps.push((Op::Program, area.meta(), PAGE, meta));
    steps.push((Op::Select, Slot::B.code(), 0, vec![]));
    for (op, address, length, buffer) in steps {
        let went = operation(machine, op, address, length, &buffer);
        assert_eq!(went, OpResult::Ok, "{what}: {op} at {address:#x}");
    }
    let nor = nor.chip();
    assert_eq!(boots(&nor), Boots::Slot(Slot::B, SECOND), "{what}");
    assert_eq!(nor.misuse(), [], "{what}");
}

#[test]
fn a_board_whose_services_have_failed_for_good_takes_an_update_that_brings_them_back() {
    let setup = setup(&small(&program(), &[EBREAK]));
    let nor = setup.flash.clone().expect("a flash");
    let mut machine = BenchMachine::boot(setup);
    for life in 0..4 {
        assert!(becomes(&mut machine, JobsState::Alive, 100), "life {life}");
        assert!(machine.ping().is_none(), "life {life}");
    }
    assert_eq!(state(&mut machine), JobsState::GivenUp);
    answers_without_services(&mut machine, "dead services");
    is_brought_an_image(&mut machine, &nor, "dead services");
    drop(machine);
    // A power cycle is another board with the same chip.
    let trailer = Trailer {
        build_id: SECOND,
        role: Role::Image,
    };
    let chip = nor.chip().copy();
    let mut machine = BenchMachine::boot(on_flash(trailer, chip));
    assert_eq!(state(&mut machine), JobsState::Alive);
}
