use super::*;
use crate::auth::tag;
use crate::fake::{ABI, ALICE, BOOT, Notebook, Rig};
use crate::machine::Machine;
use wire::Refusal;
use wire::auth::Purpose;

const KEY: [u32; 4] = [5, 6, 7, 8];

/// A board with this rig's server and this key.
fn machine(rig: Rig, key: [u32; 4]) -> Machine<Notebook> {
    let ident = *rig.server.ident();
    let mut machine = Machine::start(Notebook::new(), ident, ABI, BOOT);
    (machine.server, machine.board) = (rig.server, rig.board);
    machine.server.auth.lock(key);
    machine
}

fn ask(machine: &mut Machine<Notebook>, visitor: usize, verb: Verb) -> Verdict {
    machine.visit(visitor, verb, &mut [0; WORDS])
}

fn login(machine: &mut Machine<Notebook>, visitor: usize, key: [u32; 4]) -> Verdict {
    let mut words = [0; WORDS];
    assert_eq!(
        machine.visit(visitor, Verb::Challenge, &mut words),
        Verdict::Yes
    );
    let [a, b, c, d, uid @ ..] = words;
    assert_eq!(uid, machine.server.flash().uid());
    let [a, b, c, d] = tag(&key, &Purpose::Login.head([a, b, c, d]), &[]);
    machine.visit(visitor, Verb::Answer, &mut [a, b, c, d, 0, 0])
}

#[test]
fn a_code_is_its_own_verb_or_verdict() {
    for (code, verb) in (0..).zip(Verb::ALL) {
        assert_eq!((verb as u32, Verb::from_code(code)), (code, Some(verb)));
    }
    assert_eq!(Verb::from_code(Verb::ALL.len() as u32), None);
    for (code, verdict) in (0..).zip(Verdict::ALL) {
        assert_eq!((verdict as u32, Verdict::from_code(code)), (code, verdict));
    }
    assert_eq!(Verdict::from_code(77), Verdict::NotNow, "no yes");
}

#[test]
fn each_client_logs_in_for_itself_and_a_new_one_is_a_stranger() {
    let mut machine = machine(Rig::new(), KEY);
    assert_eq!(login(&mut machine, 1, [5, 6, 7, 9]), Verdict::Wrong);
    assert_eq!(machine.server.counters().refused[Refusal::Key.index()], 1);
    assert_eq!(login(&mut machine, 1, KEY), Verdict::Yes);
    for (visitor, verdict) in [(0, Verdict::Key), (1, Verdict::Yes), (2, Verdict::Key)] {
        assert_eq!(
            ask(&mut machine, visitor, Verb::Change),
            verdict,
            "{visitor}"
        );
    }
    assert_eq!(ask(&mut machine, 0, Verb::Restart), Verdict::Key);
    assert!(!machine.server.wants_restart());
    assert_eq!(ask(&mut machine, 1, Verb::Connect), Verdict::Yes);
    assert_eq!(ask(&mut machine, 1, Verb::Change), Verdict::Key);
    assert_eq!(login(&mut machine, 2, KEY), Verdict::Yes);
    assert_eq!(ask(&mut machine, 2, Verb::Restart), Verdict::Yes);
    assert!(machine.server.wants_restart());
}

#[test]
fn a_wrong_answer_ends_what_a_right_one_began() {
    let mut machine = machine(Rig::new(), KEY);
    assert_eq!(login(&mut machine, 0, KEY), Verdict::Yes);
    assert_eq!(login(&mut machine, 0, [1, 2, 3, 4]), Verdict::Wrong);
    assert_eq!(ask(&mut machine, 0, Verb::Change), Verdict::Key);
}

#[test]
fn while_a_host_moves_the_machine_nothing_is_hashed_changed_or_restarted() {
    let mut machine = machine(Rig::armed(), [0; 4]);
    assert!(machine.server.session().is_owner(ALICE));
    for (verb, verdict) in [
        (Verb::Challenge, Verdict::NotNow),
        (Verb::Answer, Verdict::NotNow),
        (Verb::Change, Verdict::NotNow),
        (Verb::Restart, Verdict::Armed),
        (Verb::Stack, Verdict::Yes),
        (Verb::Connect, Verdict::Yes),
    ] {
        assert_eq!(ask(&mut machine, 0, verb), verdict, "{verb:?}");
    }
    assert!(!machine.server.wants_restart());
}

#[test]
fn a_board_that_a_host_owns_at_rest_does_not_restart() {
    let mut rig = Rig::new();
    rig.acquire();
    let mut machine = machine(rig, [0; 4]);
    assert_eq!(ask(&mut machine, 0, Verb::Restart), Verdict::Owned);
    assert_eq!(ask(&mut machine, 0, Verb::Change), Verdict::Yes);
}
