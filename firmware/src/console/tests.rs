use super::*;
use crate::fake::Rig;
use wire::describe::Channels;

const US: Us = Us {
    mac: [0; 6],
    ip: 0xc0a8_0232,
    port: 1234,
};

fn ask(line: &[u8]) -> Vec<Ask> {
    let mut collector = LineEditor::default();
    line.iter()
        .filter_map(|byte| collector.push(*byte))
        .collect()
}

fn said(line: &str) -> String {
    let mut rig = Rig::new();
    let mut out = String::new();
    answer(
        Ask::parse(line),
        &mut rig.server,
        &mut rig.board,
        &US,
        &Vitals::default(),
        &mut out,
    );
    out
}

#[test]
fn the_board_states_its_name_its_image_and_its_link_speed() {
    let text = said("flash");
    assert!(
        text.contains("volatile") && text.contains("golden"),
        "{text}"
    );
    assert!(said("settings").contains("built in"));
    assert!(said("link").contains("link down"));
}

fn say(rig: &mut Rig, line: &str) -> String {
    let mut out = String::new();
    let (server, board) = (&mut rig.server, &mut rig.board);
    answer(
        Ask::parse(line),
        server,
        board,
        &US,
        &Vitals::default(),
        &mut out,
    );
    out
}

#[test]
fn a_restart_needs_a_machine_at_rest_without_an_owner() {
    let mut rig = Rig::armed();
    assert_eq!(
        say(&mut rig, "restart"),
        "refused: the machine is armed\r\n"
    );
    let mut rig = Rig::new();
    rig.acquire();
    assert_eq!(
        say(&mut rig, "restart"),
        "refused: a host drives the board\r\n"
    );
    assert!(!rig.server.wants_restart());
    assert_eq!(say(&mut Rig::new(), "restart 1"), "? try help\r\n");
    let mut rig = Rig::new();
    assert_eq!(say(&mut rig, "restart"), "restarting\r\n");
    assert!(rig.server.wants_restart());
}

#[test]
fn a_board_with_a_key_restarts_for_a_friend_only_and_shows_itself_to_all() {
    const KEY: Words = [5, 6, 7, 8];
    let mut rig = Rig::new();
    assert!(
        say(&mut rig, "login").starts_with("challenge 00000000"),
        "none is needed"
    );
    rig.server.auth.lock(KEY);
    assert!(say(&mut rig, "status").contains("disarmed"));
    assert!(say(&mut rig, "settings").contains("key      set"));
    let refused = "refused: the board has a key; use `ferrocnc console`\r\n";
    assert_eq!(say(&mut rig, "restart"), refused);
    for (key, said) in [
        ([5, 6, 7, 9], "refused: wrong answer\r\n"),
        (KEY, "welcome\r\n"),
    ] {
        let asked = say(&mut rig, "login");
        let (digits, uid) = asked.trim().strip_prefix(CHALLENGE).unwrap().split_at(32);
        assert_eq!(uid.len(), 16);
        let head = wire::auth::Purpose::Login.head(hex_words(digits).unwrap());
        let tag = crate::auth::tag(&key, &head, &[]);
        let tag: String = tag.iter().map(|word| format!("{word:08x}")).collect();
        assert_eq!(say(&mut rig, &format!("login {tag}")), said);
    }
    assert_eq!(rig.server.counters().refused[Refusal::Key.index()], 1);
    assert_eq!(say(&mut rig, "restart"), "restarting\r\n");
    for wrong in ["login 12", "login x", &format!("login {}", "0".repeat(33))] {
        assert_eq!(say(&mut rig, wrong), "? try help\r\n", "{wrong}");
    }
}

#[test]
fn a_line_is_a_command_with_at_most_one_number() {
    assert_eq!(ask(b"status\r\n"), [Ask::Status]);
    assert_eq!(ask(b"  stepgen   3 \n"), [Ask::Stepgen(Some(3))]);
    assert_eq!(
        ask(b"stepgen\nencoder 255\nregs 14\n"),
        [
            Ask::Stepgen(None),
            Ask::Encoder(Some(255)),
            Ask::Regs(Some(14))
        ]
    );
    assert_eq!(ask(b"\r\n"), [Ask::Nothing]);
    assert_eq!(ask(b"statsu\x7f\x7fus\n"), [Ask::Status]);
}

#[test]
fn what_begins_with_job_is_kept_for_the_program_until_the_next_byte() {
    let mut line = LineEditor::default();
    for byte in *b"  job start my part 2\r" {
        assert_eq!(line.push(byte), None);
    }
    assert_eq!(line.push(b'\n'), Some(Ask::Job));
    assert_eq!(line.line(), "  job start my part 2");
    assert_eq!(line.push(b'x'), None);
    assert_eq!(line.push(b'\n'), Some(Ask::Unknown));
    assert_eq!(ask(b"job\njob list\nnet\n"), [Ask::Job, Ask::Job, Ask::Net]);
}

#[test]
fn a_board_without_a_program_for_jobs_says_so() {
    let refused = "no jobs here; `ferrocnc describe` says why\r\n";
    assert_eq!(said("job"), refused);
    assert_eq!(said("job start x"), refused);
}

#[test]
fn garbage_is_not_understood_and_the_next_line_is() {
    for garbage in [
        &b"reboot"[..],
        b"stepgen 256",
        b"stepgen -1",
        b"status 1",
        b"stepgen 1 2",
        b"jobs",
        b"set x",
        b"\xc3\xa9\x00\x01 1",
        &[b'x'; 5000],
    ] {
        let mut line = garbage.to_vec();
        line.extend(b"\nwatchdog\n");
        assert_eq!(ask(&line).last(), Some(&Ask::Watchdog), "{garbage:?}");
        assert_ne!(ask(&line).first(), Some(&Ask::Watchdog), "{garbage:?}");
    }
}

#[test]
fn a_line_longer_than_the_limit_is_dropped_whole() {
    let mut line = b"help".to_vec();
    line.extend([b' '; LINE_MAX]);
    line.extend(b"\nhelp\n");
    assert_eq!(ask(&line), [Ask::Unknown, Ask::Help]);
}

#[test]
fn telnet_may_negotiate_all_it_wants() {
    assert_eq!(ask(b"\xff\xfb\x1f\xff\xfd\x01\xff\xf1net\r\n"), [Ask::Net]);
}

#[test]
fn every_command_answers_and_none_changes_the_board() {
    for line in [
        "help",
        "status",
        "net",
        "regs",
        "regs 14",
        "regs 200",
        "stepgen",
        "stepgen 5",
        "stepgen 6",
        "encoder",
        "encoder 5",
        "pwm",
        "pwm 7",
        "gpio",
        "watchdog",
        "log",
        "job stop",
        "quit",
    ] {
        let mut rig = Rig::new();
        let before = rig.board.changes();
        let mut out = String::new();
        answer(
            Ask::parse(line),
            &mut rig.server,
            &mut rig.board,
            &US,
            &Vitals::default(),
            &mut out,
        );
        assert_eq!(rig.board.changes(), before, "{line}");
        assert!(
            out.is_ascii() && out.replace("\r\n", "").find(['\r', '\n']).is_none(),
            "{line}: {out:?}"
        );
    }
    assert!(said("status").contains("disarmed"));
    assert!(said("net").contains("refused 0"));
    assert_eq!(said("stepgen").lines().count(), 6);
    assert_eq!(said("stepgen 6"), "");
    assert!(said("stepgen 5").contains(", latch 4205"));
    assert!(said("status").contains(", reboot requested"));
    assert!(said("watchdog").contains("e-stop idle\r\ngate closed last: never opened"));
    assert!(said("gpio").contains("inputs 0x00001002, e-stop latched 0x00001006"));
    assert_eq!(said("pwm").lines().count(), 6);
    assert!(said("rm -rf").contains("try help"));
}

#[test]
fn the_probe_is_told_by_its_input() {
    let mut rig = Rig::new();
    let probe = Setting::Board(BoardConfig::Probe);
    for (value, text) in [
        (5, "probe none\r\n"),
        (map::PROBE_ENABLE | 5, "probe input 5\r\n"),
        (
            map::PROBE_ENABLE | map::PROBE_INVERT | 5,
            "probe input 5, active low\r\n",
        ),
    ] {
        rig.board.set(probe, value);
        let mut out = String::new();
        gpio(&mut rig.board, &mut Out(&mut out));
        assert!(out.ends_with(text), "{out}");
    }
}

#[test]
fn the_longest_answer_of_the_largest_board_is_not_cut_off() {
    let mut rig = Rig::new();
    let mut ident = *rig.server.ident();
    ident.channels = Channels {
        stepgens: 16,
        encoders: 16,
        pwms: 16,
        inputs: 32,
        outputs: 32,
    };
    rig.server = Server::new(ident, 0, rig.server.boot());
    rig.board.latched.fill(0x8000_0001);
    for line in [
        "help",
        "status",
        "net",
        "regs",
        "regs 14",
        "stepgen",
        "stepgen 0",
        "encoder",
        "pwm",
        "gpio",
        "watchdog",
        "log",
    ] {
        let mut out = String::new();
        let ask = Ask::parse(line);
        let vitals = Vitals::default();
        answer(ask, &mut rig.server, &mut rig.board, &US, &vitals, &mut out);
        assert!(out.len() <= ANSWER_MAX, "{line}: {} bytes", out.len());
    }
}
