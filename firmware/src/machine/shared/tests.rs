//! The rule of the fast path, on a board that executes with a pass as the gateware does.

use super::*;
use crate::fake::*;
use crate::machine::ident_of_six as ident;
use wire::exchange::{Command, FLAG_APPLY_TIME};
use wire::regmap::command;
use wire::units::{Clocks, Velocity};
use wire::{LongWay, MAX_WORDS, map};

/// An armed machine.
struct Bench {
    machine: Shared<Notebook>,
    owner: Peer,
    sequence: u32,
}

impl Bench {
    /// By Alice.
    fn armed() -> Self {
        Self::armed_by(ALICE)
    }

    fn armed_by(owner: Peer) -> Self {
        let machine = Machine::start(Notebook::new(), ident(), ABI, BOOT);
        let mut bench = Bench {
            machine: Shared::new(machine),
            owner,
            sequence: 0,
        };
        bench.send(
            owner,
            &[0x4e6f_1044, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7],
        );
        for request in [false, true, true] {
            let command = bench.command(request);
            bench.long_way(&command);
        }
        assert!(!bench.machine.at_rest());
        bench
    }

    fn command(&mut self, request: bool) -> Command {
        self.sequence += 1;
        Command {
            token: self.machine.session().token_for(self.owner),
            sequence: self.sequence,
            enable: true,
            enable_request: request,
            stepgen_enable: 0x3f,
            ..Command::default()
        }
    }

    fn send(&mut self, peer: Peer, words: &[u32]) -> bool {
        let mut reply = [0; MAX_WORDS];
        if peer == Peer::INSIDE {
            return self.machine.guest().inside(words, &mut reply).is_ok();
        }
        let served = match self.machine.session().is_owner(peer) {
            true => self
                .machine
                .alone()
                .datagram(words, peer, &mut reply)
                .is_ok(),
            false => self
                .machine
                .guest()
                .datagram(words, peer, &mut reply)
                .is_ok(),
        };
        if self.machine.owes_path() {
            self.machine.alone().hold_path();
        }
        served
    }

    fn long_way(&mut self, command: &Command) -> bool {
        let mut buffer = [0; MAX_WORDS];
        let words = command.emit_request(SIX, &mut buffer).unwrap().to_vec();
        self.send(self.owner, &words)
    }

    /// The gateware first, then the firmware; true if the gateware executed it.
    fn comes(&mut self, command: &Command) -> bool {
        let fast = self.machine.machine.board.comes(command);
        if fast {
            assert!(self.machine.executed());
            self.machine.alone();
            self.machine.alone().hold_path();
        } else {
            assert!(self.long_way(command));
        }
        fast
    }

    fn why(&self) -> LongWay {
        self.machine.server.counters().long_way
    }
}

#[test]
fn with_a_pass_the_machine_does_and_counts_the_same_as_on_the_long_way() {
    let mut fast = Bench::armed();
    fast.machine.offer();
    let mut slow = Bench::armed();
    for velocity in [1000, -7, 0, i32::MIN] {
        fast.machine.offer();
        let mut command = fast.command(true);
        slow.sequence = fast.sequence;
        command.stepgen[5].0 = Velocity(velocity);
        assert!(fast.comes(&command));
        assert!(!slow.comes(&command));
        let [with, without] = [&fast, &slow].map(|bench| &bench.machine.machine);
        assert_eq!(with.board.done, without.board.done);
        assert_eq!(with.board.live, without.board.live);
        assert_eq!(with.server.session, without.server.session);
        assert_eq!(with.server.safety, without.server.safety);
        let exchanges = [with, without].map(|machine| machine.server.counters.exchanges);
        assert_eq!(exchanges[0], exchanges[1]);
    }
    assert_eq!(fast.machine.server.counters.ways[0], 4);
    assert_eq!(slow.machine.server.counters.ways[0], 0);
}

#[test]
fn a_pass_is_for_one_command() {
    let mut bench = Bench::armed();
    bench.machine.offer();
    let command = bench.command(true);
    assert!(bench.machine.machine.board.comes(&command));
    assert!(!bench.machine.machine.board.comes(&command));
    assert!(!bench.long_way(&command), "it is a duplicate");
    bench.machine.offer();
    assert!(
        !bench.machine.machine.board.comes(&command),
        "and stays one"
    );
}

#[test]
fn what_changes_the_machine_takes_the_pass_back_first() {
    let mut bench = Bench::armed();
    bench.machine.offer();
    assert!(bench.machine.machine.board.pass.is_some());
    bench.machine.alone();
    assert_eq!(bench.machine.machine.board.pass, None);
    // What was executed before that is settled first.
    bench.machine.offer();
    let command = bench.command(true);
    assert!(bench.machine.machine.board.comes(&command));
    let sequence = bench.machine.alone().session().last_sequence();
    assert_eq!(sequence, command.sequence);
}

#[test]
fn a_guest_of_a_moving_machine_leaves_the_pass_out_and_one_at_rest_does_not() {
    let read = [0x4e6f_1044, 0, 0x000f_0001, 0, map::DESCRIBE];
    let acquire = [0x4e6f_1044, 0, 0x000f_0100, map::SESSION_ACQUIRE, 9];
    let mut bench = Bench::armed();
    bench.machine.offer();
    assert!(bench.send(BOB, &read));
    assert!(!bench.send(BOB, &acquire), "it has an owner");
    assert!(bench.machine.machine.board.pass.is_some());
    let command = bench.command(true);
    assert!(bench.comes(&command));
}

#[test]
fn housekeeping_takes_the_pass_back_only_if_something_has_happened() {
    let mut bench = Bench::armed();
    bench.machine.housekeeping();
    bench.machine.offer();
    bench.machine.machine.board.now += 120_000;
    assert_eq!(bench.machine.housekeeping(), None);
    assert!(bench.machine.machine.board.pass.is_some());
    bench.machine.machine.board.bite();
    assert!(bench.machine.housekeeping().is_some(), "a fault");
    assert_eq!(bench.machine.machine.board.pass, None);
}

#[test]
fn a_job_that_owns_the_machine_gets_no_pass_and_neither_does_a_host_beside_it() {
    let mut bench = Bench::armed_by(Peer::INSIDE);
    for _ in 0..3 {
        let command = bench.command(true);
        assert!(bench.long_way(&command));
        bench.machine.offer();
        assert_eq!(bench.machine.machine.board.pass, None);
        // A frame of a host that is like the job's next command.
        let sequence = bench.sequence;
        let next = bench.command(true);
        assert!(!bench.machine.machine.board.comes(&next), "on the fast way");
        let mut buffer = [0; MAX_WORDS];
        let words = next.emit_request(SIX, &mut buffer).unwrap().to_vec();
        assert!(!bench.send(ALICE, &words), "on the long way");
        bench.machine.offer();
        assert_eq!(bench.machine.machine.board.pass, None);
        bench.sequence = sequence;
    }
    // The job's own exchanges are no exchanges of a host.
    assert_eq!(bench.machine.server.counters().ways, [0, 0]);
    assert!(!bench.machine.at_rest(), "and the job goes on");
}

#[test]
fn a_pass_that_was_out_for_a_host_is_back_when_a_job_owns_the_machine() {
    let mut bench = Bench::armed();
    bench.machine.offer();
    assert!(bench.machine.machine.board.pass.is_some());
    let old = bench.command(true);
    bench.machine.machine.board.bite();
    bench.machine.housekeeping();
    assert_eq!(bench.machine.session().owner(), None, "a bite ends it");
    let acquire = [0x4e6f_1044, 0, 0x000f_0100, map::SESSION_ACQUIRE, 9];
    assert!(bench.send(Peer::INSIDE, &acquire));
    bench.machine.offer();
    assert_eq!(bench.machine.machine.board.pass, None);
    assert!(!bench.machine.machine.board.comes(&old));
}

/// What a guest must not change, done behind the type's back.
fn guest_that(changes: impl FnOnce(&mut Machine<Notebook>)) {
    let mut bench = Bench::armed();
    bench.machine.offer();
    let mut guest = bench.machine.guest();
    changes(guest.machine);
    guest.leased(None);
}

#[test]
fn a_guest_that_changes_nothing_passes_the_check() {
    guest_that(|_| {});
    guest_that(|machine| machine.received());
}

#[test]
#[should_panic(expected = "a guest has changed")]
fn a_guest_that_changes_the_session_is_found() {
    guest_that(|machine| machine.server.session.kill());
}

#[test]
#[should_panic(expected = "a guest has changed")]
fn a_guest_that_changes_the_state_is_found() {
    guest_that(|machine| machine.server.safety.hold(true));
}

#[test]
#[should_panic(expected = "a guest has changed")]
fn a_guest_that_stages_a_word_is_found() {
    guest_that(|machine| machine.board.stage(command::WORDS - 1, 1));
}

#[test]
#[should_panic(expected = "a guest has changed")]
fn a_guest_that_writes_to_the_answers_slot_is_found() {
    guest_that(|machine| machine.board.slot[crate::pass::answer_length(machine.shape()) / 4] ^= 1);
}

/// The same, not by a guest.
fn while_a_pass_is_out(changes: impl FnOnce(&mut Machine<Notebook>)) {
    let mut bench = Bench::armed();
    bench.machine.offer();
    changes(&mut bench.machine.machine);
    bench.machine.alone();
}

#[test]
fn what_the_gateware_changes_itself_while_a_pass_is_out_passes_the_check() {
    while_a_pass_is_out(|machine| machine.board.stage(0, 1));
    let mut bench = Bench::armed();
    bench.machine.offer();
    let command = bench.command(true);
    assert!(bench.machine.machine.board.comes(&command));
    bench.machine.machine.board.slot[20] ^= 1;
    bench.machine.alone();
}

#[test]
#[should_panic(expected = "while a pass was out")]
fn a_sequence_number_accepted_while_a_pass_is_out_is_found() {
    while_a_pass_is_out(|machine| machine.server.session.accept(77));
}

#[test]
#[should_panic(expected = "while a pass was out")]
fn other_services_in_the_state_word_while_a_pass_is_out_are_found() {
    while_a_pass_is_out(|machine| machine.jobs(wire::describe::JobsState::GivenUp));
}

#[test]
#[should_panic(expected = "while a pass was out")]
fn a_write_to_the_answers_slot_while_a_pass_is_out_is_found() {
    while_a_pass_is_out(|machine| machine.board.slot[4] ^= 1);
}

#[test]
fn there_is_no_pass_without_an_owner_or_while_an_answer_leaves() {
    let start = Machine::start(Notebook::new(), ident(), ABI, BOOT);
    let mut free = Shared::new(start);
    free.offer();
    assert_eq!(free.machine.board.pass, None);
    let mut bench = Bench::armed();
    bench.machine.machine.board.sending = true;
    bench.machine.offer();
    assert_eq!(bench.machine.machine.board.pass, None);
}

#[test]
fn where_something_has_to_be_decided_there_is_no_pass() {
    let mut bench = Bench::armed();
    let mut stop = bench.command(true);
    stop.enable = false;
    assert!(!bench.comes(&stop));
    bench.machine.offer();
    assert_eq!(
        bench.machine.machine.board.pass, None,
        "the stop is still running"
    );
    let mut bench = Bench::armed();
    bench.machine.machine.board.bite();
    bench.machine.offer();
    assert_eq!(
        bench.machine.machine.board.pass, None,
        "the watchdog has bitten"
    );
}

#[test]
fn every_reason_for_the_long_way_is_told() {
    let mut bench = Bench::armed();
    assert_eq!(bench.why(), LongWay::NoPass);
    bench.machine.offer();
    bench.sequence += 1;
    let behind_a_lost_one = bench.command(true);
    assert!(!bench.comes(&behind_a_lost_one));
    assert_eq!(bench.why(), LongWay::Sequence);
    bench.machine.offer();
    let mut other = bench.command(true);
    other.stepgen_alone = 1;
    assert!(!bench.comes(&other));
    assert_eq!(bench.why(), LongWay::Flags);
    bench.machine.offer();
    bench.machine.machine.board.gate |= 0b10;
    let mut same = bench.command(true);
    same.stepgen_alone = 1;
    bench.comes(&same);
    assert_eq!(bench.why(), LongWay::Frame);
}

#[test]
fn an_exchange_before_the_next_pass_is_out_has_no_pass_whatever_came_back_before() {
    let mut bench = Bench::armed();
    bench.machine.offer();
    let read = [0x4e6f_1044, 0, 0x000f_0001, 9, map::COUNTERS];
    assert!(bench.send(ALICE, &read), "it takes the pass back");
    let command = bench.command(true);
    assert!(!bench.comes(&command));
    assert_eq!(bench.why(), LongWay::NoPass);
    // One that came back behind a read long ago, and one that was executed since.
    bench.machine.offer();
    assert!(bench.send(ALICE, &read));
    bench.machine.offer();
    let executed = bench.command(true);
    assert!(bench.comes(&executed));
    let command = bench.command(true);
    assert!(!bench.comes(&command));
    assert_eq!(bench.why(), LongWay::NoPass);
}

#[test]
fn a_timed_command_with_a_pass_waits_for_its_time_and_the_next_long_way_takes_it_back() {
    let mut bench = Bench::armed();
    let timed = |bench: &mut Bench| Command {
        apply_at: Some(Clocks(0x5_0000_0007)),
        ..bench.command(true)
    };
    let first = timed(&mut bench);
    assert!(!bench.comes(&first));
    bench.machine.offer();
    let flags = bench.machine.machine.board.pass.unwrap().flags;
    assert_ne!(flags & FLAG_APPLY_TIME, 0);
    let second = timed(&mut bench);
    assert!(bench.comes(&second));
    assert_eq!(bench.machine.machine.board.commit_at, 0x5_0000_0007);
    let now = bench.command(true);
    assert!(bench.long_way(&now));
    assert_eq!(bench.machine.machine.board.commit_at, u64::MAX);
}
