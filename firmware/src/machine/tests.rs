use super::*;
use crate::fake::*;
use wire::GateClose;
use wire::describe::JobsState;
use wire::exchange::Command;
use wire::map;

use super::ident_of_six as ident;

fn machine(board: Notebook) -> Machine<Notebook> {
    Machine::start(board, ident(), ABI, BOOT)
}

fn read(address: u32) -> Vec<u8> {
    [0x4e6f_1044u32, 0, 0x000f_0001, 0x77, address]
        .iter()
        .flat_map(|word| word.to_be_bytes())
        .collect()
}

#[test]
fn start_up_closes_the_gate_first_and_leaves_a_watchful_board() {
    let machine = machine(Notebook::new());
    assert_eq!(machine.board.done[0], Change::Order(Control::Close));
    let timeout = Setting::Board(BoardConfig::WatchdogTimeout);
    assert!(machine.board.done.contains(&Change::Set(timeout, 300_000)));
    let steplen = Setting::Stepgen(5, StepgenConfig::Steplen);
    assert!(machine.board.done.contains(&Change::Set(steplen, 300)));
    assert_eq!(machine.server.safety().state(), State::Disarmed);
}

#[test]
fn every_default_is_a_value_the_setting_may_have() {
    for clock_hz in [40_000_000, 60_000_000, 125_000_000] {
        let mut board = Notebook::new();
        let ident = Ident {
            clock_hz,
            ..ident()
        };
        defaults(&mut board, &ident);
        for change in &board.done {
            let Change::Set(setting, value) = change else {
                panic!("{change:?}");
            };
            let checked = crate::config::check(*setting, *value, SIX, clock_hz);
            assert_eq!(checked, Ok(()), "{setting:?} {value} at {clock_hz}");
        }
    }
}

#[test]
fn a_board_without_addresses_gets_the_usual_ones() {
    let us = machine(Notebook::new()).us;
    assert_eq!((us.ip, us.port), (0xc0a8_0232, 1234));
}

#[test]
fn a_payload_is_answered_counted_and_refused_like_a_frame() {
    let mut machine = machine(Notebook::new());
    let mut reply = [0; MAX_WORDS];
    let answer = machine.payload(&read(0x100), ALICE, &mut reply).unwrap();
    assert_eq!(answer[4], 0xb10b_0000);
    let ragged = machine.payload(&read(0)[..19], ALICE, &mut reply);
    assert_eq!(ragged, Err(Refusal::Ragged));
    let long = machine.payload(&[0; wire::MAX_PAYLOAD + 4], ALICE, &mut reply);
    assert_eq!(long, Err(Refusal::Oversized));
    let counters = machine.server.counters();
    assert_eq!((counters.frames_rx, counters.frames_tx), (3, 1));
    assert_eq!(counters.refused_total, 2);
}

#[test]
fn no_sender_on_the_wire_is_taken_for_the_jobs_program() {
    let mut machine = machine(Notebook::new());
    let mut reply = [0; MAX_WORDS];
    for port in [0, 724] {
        let peer = Peer {
            port,
            ..Peer::INSIDE
        };
        let refused = machine.payload(&read(0), peer, &mut reply);
        assert_eq!(refused, Err(Refusal::NotOwner));
    }
    let request = [0x4e6f_1044u32, 0, 0x000f_0001, 0x77, 0];
    let answer = machine
        .inside(&request, &mut reply, Machine::hold_path)
        .unwrap();
    assert_eq!(answer[4], wire::describe::MAGIC);
}

#[test]
fn housekeeping_is_due_every_millisecond_behind_a_frame_and_later_without() {
    let mut machine = machine(Notebook::new());
    let behind = machine.patience(true);
    assert!(!machine.due(behind));
    machine.board.now += 60_000;
    assert!(!machine.due(IDLE));
    assert!(machine.due(behind));
    assert!(!machine.due(behind), "done");
    machine.board.now += 180_000;
    assert!(machine.due(IDLE));
}

#[test]
fn while_a_host_owns_the_board_housekeeping_waits_for_the_answer_to_it_not_behind_a_guests_frame() {
    let free = machine(Notebook::new());
    assert_eq!(free.patience(false), free.patience(true), "no owner waits");
    let mut rig = Rig::armed();
    let mut owned = machine(Notebook::new());
    core::mem::swap(&mut owned.server, &mut rig.server);
    core::mem::swap(&mut owned.board, &mut rig.board);
    owned.board.now += 60_000;
    let guests = owned.patience(false);
    assert!(!owned.due(guests), "a guest's");
    let owners = owned.patience(true);
    assert!(owned.due(owners), "the owner's");
    // An owner that is silent does not keep them from being done.
    owned.board.now += 180_000;
    assert!(owned.due(guests));
}

#[test]
fn between_the_requests_of_a_host_that_does_not_exchange_yet_housekeeping_waits_for_a_pause() {
    let mut machine = machine(Notebook::new());
    let mut reply = [0; MAX_WORDS];
    let acquire = [0x4e6f_1044, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7];
    assert!(machine.datagram(&acquire, ALICE, &mut reply).is_ok());
    machine.board.now += 599_999;
    let owners = machine.patience(true);
    assert!(!machine.due(owners), "behind a request");
    machine.board.now += 1;
    assert!(machine.due(owners), "but not for ever");
    machine.board.now += 180_000;
    assert!(!machine.due(owners));
    assert!(machine.due(IDLE), "in a pause");
    let command = Command {
        token: machine.session().token_for(ALICE),
        sequence: 1,
        ..Command::default()
    };
    let mut buffer = [0; MAX_WORDS];
    let request = command.emit_request(SIX, &mut buffer).unwrap();
    assert!(machine.datagram(request, ALICE, &mut reply).is_ok());
    machine.board.now += 60_000;
    let owners = machine.patience(true);
    assert!(machine.due(owners), "behind an exchange");
}

#[test]
fn a_change_of_state_is_told_once() {
    let mut board = Notebook::new();
    board.close = GateClose::Never as u32;
    let mut machine = machine(board);
    assert_eq!(machine.housekeeping(), None);
    let mut rig = Rig::armed();
    core::mem::swap(&mut machine.server, &mut rig.server);
    core::mem::swap(&mut machine.board, &mut rig.board);
    assert_eq!(
        machine.housekeeping(),
        Some((State::Armed, FaultReason::None))
    );
    assert_eq!(machine.housekeeping(), None);
    machine.board.estop = true;
    let told = (State::Faulted, FaultReason::EStop);
    assert_eq!(machine.housekeeping(), Some(told));
}

fn ask(machine: &mut Machine<Notebook>, message: &Message) -> Option<Message> {
    let mut words = [0; wire::discovery::WORDS_MAX];
    let mut reply = [0; MAX_WORDS];
    let answer = machine.discover(message.emit(&mut words), 50_000, &mut reply);
    (!answer.is_empty()).then(|| Message::parse(answer).unwrap())
}

fn message(uid: [u32; 2], body: Body) -> Message {
    Message {
        nonce: 99,
        uid,
        body,
    }
}

const UID: [u32; 2] = [0x0102_0304, 0x0506_0708];

/// Runs housekeeping and broadcasts until nothing is left to do.
fn broadcasts(machine: &mut Machine<Notebook>) -> Vec<(Broadcast, Vec<u32>)> {
    let mut all = Vec::new();
    for _ in 0..100 {
        machine.housekeeping();
        let mut words = [0; MAX_WORDS];
        if machine.has_broadcast()
            && let Some(broadcast) = machine.next_broadcast(&mut words)
        {
            all.push((broadcast, words[..broadcast.words].to_vec()));
        }
    }
    all
}

#[test]
fn a_board_is_found_by_any_host_and_by_its_own_id() {
    let mut machine = machine(Notebook::new());
    for (uid, found) in [([0, 0], true), (UID, true), ([1, 2], false)] {
        let answer = ask(&mut machine, &message(uid, Body::Discover));
        assert_eq!(answer.is_some(), found);
        if let Some(answer) = answer {
            assert_eq!((answer.nonce, answer.uid), (99, UID));
            let Body::Here(here) = answer.body else {
                panic!("{answer:?}");
            };
            assert_eq!((here.ip, here.port, here.mac[0]), (0xc0a8_0232, 1234, 2));
            assert!(!here.armed && !here.owned && !here.dhcp);
        }
    }
    let mut reply = [0; MAX_WORDS];
    assert!(machine.discover(&[1, 2, 3], 5, &mut reply).is_empty());
    assert_eq!(machine.server.counters().refused_total, 1);
}

#[test]
fn a_board_saves_the_settings_it_gets_confirms_them_and_restarts() {
    let mut machine = machine(Notebook::new());
    let settings = Settings {
        ip: 0x0a00_0002,
        name: Name::new("mill").unwrap(),
        ..Settings::default()
    };
    let set = message(UID, Body::Set(settings));
    assert_eq!(
        ask(&mut machine, &message([0; 2], set.body)),
        None,
        "for another board"
    );
    assert_eq!(ask(&mut machine, &set), None, "not yet");
    assert_eq!(ask(&mut machine, &set), None, "repeated, still not saved");
    assert!(!machine.server.wants_restart());
    let told = broadcasts(&mut machine);
    let [(broadcast, words)] = &told[..] else {
        panic!("{told:?}");
    };
    assert_eq!((broadcast.from_port, broadcast.to_port), (51234, 50_000));
    let done = message(UID, Body::Done(OpResult::Ok));
    assert_eq!(Message::parse(words), Ok(done));
    assert!(machine.server.wants_restart());
    let mut again = Machine::start(machine.board, ident(), ABI, BOOT);
    assert_eq!(again.us.ip, 0x0a00_0002);
    assert_eq!(ask(&mut again, &set), Some(done), "saved already");
    assert!(!again.server.wants_restart());
}

#[test]
fn a_board_that_is_armed_or_owned_is_not_told_anything() {
    let mut machine = machine(Notebook::new());
    let set = message(UID, Body::Set(Settings::default()));
    let mut rig = Rig::new();
    rig.acquire();
    for armed in [false, true] {
        if armed {
            rig.arm();
        }
        core::mem::swap(&mut machine.server.session, &mut rig.server.session);
        core::mem::swap(&mut machine.server.safety, &mut rig.server.safety);
        let refused = message(UID, Body::Done(OpResult::Armed));
        assert_eq!(ask(&mut machine, &set), Some(refused));
        core::mem::swap(&mut machine.server.session, &mut rig.server.session);
        core::mem::swap(&mut machine.server.safety, &mut rig.server.safety);
    }
    assert!(machine.board.chip.writes.is_empty());
}

/// A board whose settings ask for DHCP.
fn with_dhcp() -> (Machine<Notebook>, Settings) {
    let mut board = Notebook::new();
    let settings = Settings {
        dhcp: true,
        ..Settings::default()
    };
    let mut words = [0; 128];
    wire::words_to_bytes(&settings.to_words(), &mut words);
    board.chip.put(0x1f_0000, &words);
    (machine(board), settings)
}

/// A second passes.
fn second(machine: &mut Machine<Notebook>) {
    machine.board.now += u64::from(CLOCK);
    machine.due(IDLE);
    machine.housekeeping();
}

const LEASE: Lease = Lease {
    ip: 0x0a07_0037,
    prefix: 16,
    gateway: 0x0a07_0001,
};

#[test]
fn a_board_with_dhcp_falls_back_to_its_static_address_after_ten_seconds() {
    let (mut machine, settings) = with_dhcp();
    assert_eq!(machine.us.ip, 0, "none yet");
    for passed in 1..=16 {
        second(&mut machine);
        let ip = if passed < 10 { 0 } else { settings.ip };
        assert_eq!(machine.us.ip, ip, "second {passed}");
    }
    assert!(machine.moved() && !machine.moved());
    machine.leased(Some(LEASE));
    assert_eq!(
        (machine.us.ip, machine.net),
        (LEASE.ip, (16, LEASE.gateway))
    );
    assert!(machine.moved(), "a server that comes later");
    machine.leased(None);
    assert_eq!(machine.us.ip, settings.ip, "the lease is over");
}

#[test]
fn a_lease_waits_until_no_host_owns_the_session() {
    let (mut machine, _) = with_dhcp();
    machine.leased(Some(LEASE));
    assert!(machine.moved());
    let answer = ask(&mut machine, &message(UID, Body::Discover));
    let Some(Body::Here(here)) = answer.map(|answer| answer.body) else {
        panic!("{answer:?}");
    };
    assert!(here.dhcp && here.ip == LEASE.ip);
    let mut rig = Rig::new();
    rig.acquire();
    core::mem::swap(&mut machine.server.session, &mut rig.server.session);
    let other = Lease {
        ip: LEASE.ip + 1,
        ..LEASE
    };
    machine.leased(Some(other));
    assert!(!machine.moved() && machine.us.ip == LEASE.ip);
    core::mem::swap(&mut machine.server.session, &mut rig.server.session);
    second(&mut machine);
    assert!(machine.moved() && machine.us.ip == other.ip);
}

#[test]
fn a_lease_of_an_address_that_no_host_can_have_is_none() {
    let (mut machine, _) = with_dhcp();
    for ip in [0, 0x7f00_0001, 0xe000_00fb, u32::MAX] {
        machine.leased(Some(Lease { ip, ..LEASE }));
        assert!(!machine.moved(), "{ip:08x}");
    }
    let prefix = 33;
    machine.leased(Some(Lease { prefix, ..LEASE }));
    assert!(!machine.moved());
}

#[test]
fn a_lease_that_was_not_asked_for_changes_nothing() {
    let mut machine = machine(Notebook::new());
    let before = machine.us;
    machine.leased(Some(LEASE));
    second(&mut machine);
    assert!(!machine.moved() && machine.us == before);
}

#[test]
fn a_board_without_sdram_refuses_settings_that_ask_for_dhcp() {
    let settings = Settings {
        dhcp: true,
        ..Settings::default()
    };
    for (state, taken) in [
        (JobsState::None, false),
        (JobsState::Streamed, false),
        (JobsState::Alive, true),
        (JobsState::Ended, true),
    ] {
        let mut machine = machine(Notebook::new());
        machine.jobs(state);
        let answer = ask(&mut machine, &message(UID, Body::Set(settings)));
        let refused = message(UID, Body::Done(OpResult::NoDhcp));
        assert_eq!(answer, (!taken).then_some(refused), "{state}");
    }
}

#[test]
fn a_cable_that_is_pulled_stops_the_machine_at_the_third_look() {
    let mut machine = machine(Notebook::new());
    let mut rig = Rig::armed();
    core::mem::swap(&mut machine.server, &mut rig.server);
    core::mem::swap(&mut machine.board, &mut rig.board);
    machine.housekeeping();
    machine.board.link.status = 0;
    assert_eq!(
        (machine.housekeeping(), machine.housekeeping()),
        (None, None)
    );
    let told = (State::Stopping, FaultReason::LinkDown);
    assert_eq!(machine.housekeeping(), Some(told));
    let word = machine.server.state_word(crate::cores::Gate::LIVE);
    let word = wire::exchange::StateWord::from_word(word).unwrap();
    assert!(!word.link && word.speed == wire::LinkSpeed::Down);
}

#[test]
fn speed_and_errors_are_in_every_answer() {
    let mut machine = machine(Notebook::new());
    machine.board.link.errors = 0x102;
    machine.housekeeping();
    let word = machine.server.state_word(crate::cores::Gate(0));
    let word = wire::exchange::StateWord::from_word(word).unwrap();
    assert!(word.link && word.speed == wire::LinkSpeed::M1000);
    assert_eq!(word.link_errors, 2);
}

#[test]
fn the_factory_pin_at_start_gives_the_built_in_address() {
    let mut board = Notebook::new();
    let settings = Settings {
        ip: 0x0a00_0002,
        ..Settings::default()
    };
    let mut bytes = [0; 128];
    wire::words_to_bytes(&settings.to_words(), &mut bytes);
    board.chip.put(0x1f_1000, &bytes);
    assert_eq!(machine(board.clone()).us.ip, 0x0a00_0002);
    board.factory = true;
    assert_eq!(machine(board).us.ip, 0xc0a8_0232);
}

#[test]
fn the_services_question_at_start_up_does_not_name_the_boot() {
    let boot = Boot {
        reset: wire::ResetReason::PowerUp,
        ..BOOT
    };
    let mut machine = Machine::start(Notebook::new(), ident(), ABI, boot);
    let mut reply = [0; MAX_WORDS];
    let words = [
        wire::etherbone::HEADER,
        0,
        wire::etherbone::record(0, 1),
        0,
        0,
    ];
    machine
        .inside(&words, &mut reply, Machine::hold_path)
        .unwrap();
    assert_eq!(machine.server.boot(), boot);
    machine.datagram(&words, ALICE, &mut reply).unwrap();
    assert_ne!(machine.server.boot().id, boot.id);
}
