//! Each broken file is refused with its place, key, value and a remedy.

use ferrocnc_config::source::{BUILT_IN, Folder};
use ferrocnc_config::{Board, Error, Platform};
use std::collections::BTreeSet;

const GOOD: &str = include_str!("../../boards/mill6.toml");

fn read(text: &str) -> Result<Board, Error> {
    Board::read("boards/mill6.toml", "mill6", text, &Folder::default())
}

/// What is wrong, this text of mill6.toml, becomes this, the key, what else the message holds.
type Case = (
    &'static str,
    &'static str,
    &'static str,
    &'static str,
    &'static [&'static str],
);

const CASES: &[Case] = &[
    (
        "a pin used twice",
        "step = \"j1:2\"",
        "step = \"j1:0\"",
        "stepgen[1].step",
        &["\"j1:0\"", "already stepgen[0].step", "free one"],
    ),
    (
        "a shared line used twice by two names",
        "pin = \"j4:0\"",
        "pin = \"j4:7\"",
        "gpio_out[0].pin",
        &[
            "\"j4:7\"",
            "same line as \"j8:7\"",
            "gpio_in[4].pin",
            "7 to 14",
        ],
    ),
    (
        "an output-only pin read",
        "a = \"j6:0\"",
        "a = \"j5:6\"",
        "encoder[0].a",
        &[
            "\"j5:6\"",
            "74HC245",
            "[modified] bus_switch = [\"j5\"]",
            "docs/bringup.md",
        ],
    ),
    (
        "a shared line read where only the header was modified",
        "pin = \"j8:7\"",
        "pin = \"j6:7\"",
        "gpio_in[4].pin",
        &["\"j6:7\"", "bus_switch = [\"j6:shared\"]"],
    ),
    (
        "an output on a header turned round",
        "bus_switch = [\"j6\", \"j7\", \"j8\", \"j8:shared\"]",
        "bus_switch = [\"j6\", \"j7\", \"j8\", \"j8:shared\"]\ninputs = [\"j1\"]",
        "stepgen[0].step",
        &["\"j1:0\"", "turned round"],
    ),
    (
        "a header that does not exist",
        "\"j8:shared\"]",
        "\"j9\"]",
        "modified.bus_switch[3]",
        &["\"j9\"", "5a-75b-8.0"],
    ),
    (
        "a header modified twice",
        "\"j8:shared\"]",
        "\"j8\"]",
        "modified.bus_switch[3]",
        &["\"j8\"", "twice"],
    ),
    (
        "an unknown header",
        "step = \"j1:0\"",
        "step = \"j9:0\"",
        "stepgen[0].step",
        &["\"j9:0\"", "j1 to j8"],
    ),
    (
        "a pin past the end",
        "step = \"j1:0\"",
        "step = \"j1:16\"",
        "stepgen[0].step",
        &["\"j1:16\"", "j1:0 to j1:14", "silk screen"],
    ),
    (
        "ground",
        "step = \"j1:0\"",
        "step = \"j1:3\"",
        "stepgen[0].step",
        &["\"j1:3\"", "ground"],
    ),
    (
        "a pin in capitals",
        "step = \"j1:0\"",
        "step = \"J1:0\"",
        "stepgen[0].step",
        &["\"J1:0\"", "j1 to j8"],
    ),
    (
        "a pin that is no pin",
        "step = \"j1:0\"",
        "step = \"j1\"",
        "stepgen[0].step",
        &["\"j1\"", "as in \"j1:0\""],
    ),
    (
        "the button driven",
        "pin = \"j4:0\"",
        "pin = \"key\"",
        "gpio_out[0].pin",
        &["\"key\"", "an input"],
    ),
    (
        "the button used twice",
        "pin = \"j8:2\"",
        "pin = \"key\"",
        "ext_reset.pin",
        &["\"key\"", "already gpio_in[0].pin"],
    ),
    (
        "an unknown key",
        "name = \"x\"\nstep",
        "nmae = \"x\"\nname = \"x\"\nstep",
        "stepgen[0].nmae",
        &["not a known key", "did you mean name?", "step_n"],
    ),
    (
        "an unknown table",
        "[network]",
        "[netwrok]",
        "netwrok",
        &["not a known key", "did you mean network?"],
    ),
    (
        "a missing key",
        "udp_port = 1234",
        "",
        "network.udp_port",
        &["missing", "1234"],
    ),
    (
        "no network",
        "[network]\nmac = \"10:e2:d5:00:00:01\"\nipv4 = \"192.168.2.50\"\nudp_port = 1234",
        "",
        "network",
        &["missing", "ipv4"],
    ),
    (
        "no external reset",
        "ext_reset = { pin = \"key\", active = \"low\" }",
        "",
        "ext_reset",
        &["missing", "\"none\""],
    ),
    (
        "a port out of range",
        "udp_port = 1234",
        "udp_port = 70000",
        "network.udp_port",
        &["70000", "1 to 65535"],
    ),
    (
        "a port that is a text",
        "udp_port = 1234",
        "udp_port = \"1234\"",
        "network.udp_port",
        &["\"1234\"", "not a whole number"],
    ),
    (
        "a wrong address",
        "\"192.168.2.50\"",
        "\"192.168.2.500\"",
        "network.ipv4",
        &["192.168.2.500"],
    ),
    (
        "the broadcast address",
        "\"192.168.2.50\"",
        "\"255.255.255.255\"",
        "network.ipv4",
        &["one board can have"],
    ),
    (
        "a group MAC",
        "\"10:e2",
        "\"11:e2",
        "network.mac",
        &["group", "even"],
    ),
    (
        "a short MAC",
        "\"10:e2:d5:00:00:01\"",
        "\"10:e2:d5:00:00\"",
        "network.mac",
        &["10:e2:d5:00:00", "leave it out"],
    ),
    (
        "a MAC in capitals",
        "\"10:e2:d5:00:00:01\"",
        "\"10:E2:D5:00:00:01\"",
        "network.mac",
        &["lower case"],
    ),
    (
        "a clock out of reach",
        "60_000_000",
        "600_000_000",
        "sys_clk_hz",
        &["600000000", "100000000"],
    ),
    (
        "a PHY that does not exist",
        "sys_clk_hz",
        "phy = 2\nsys_clk_hz",
        "phy",
        &["2", "0 to 1"],
    ),
    (
        "an SDRAM that is neither there nor not",
        "sys_clk_hz",
        "jobs = 3\nsdram = 8\nsys_clk_hz",
        "sdram",
        &["8", "neither true nor false"],
    ),
    (
        "a number for a name",
        "name = \"x\"\nstep",
        "name = 7\nstep",
        "stepgen[0].name",
        &["7", "in quotes"],
    ),
    (
        "a name HAL cannot have",
        "name = \"x\"\nstep",
        "name = \"X axis\"\nstep",
        "stepgen[0].name",
        &["\"X axis\"", "HAL", "\"x-axis\""],
    ),
    (
        "a name too long for HAL",
        "name = \"limit-x\"",
        "name = \"limit-switch-of-the-x-axis\"",
        "gpio_in[0].name",
        &[
            "ferrocnc.0.gpio.limit-switch-of-the-x-axis.in-not",
            "41",
            "up to 18",
        ],
    ),
    (
        "a step generator's name too long for HAL",
        "name = \"x\"\nstep",
        "name = \"x-axis-left\"\nstep",
        "stepgen[0].name",
        &["ferrocnc.0.stepgen.x-axis-left.position-scale", "up to 7"],
    ),
    (
        "two of one name",
        "name = \"y\"\nstep",
        "name = \"x\"\nstep",
        "stepgen[1].name",
        &["already stepgen[0]'s"],
    ),
    (
        "a name of LiteX-CNC's that no HAL file contains",
        "name = \"y\"\nstep",
        "name = \"y\"\nlitexcnc_name = \"y axis\"\nstep",
        "stepgen[1].litexcnc_name",
        &["\"y axis\"", "HAL file", "\"j1:10\""],
    ),
    (
        "a name of LiteX-CNC's too long for HAL",
        "name = \"y\"\nstep",
        "name = \"y\"\nlitexcnc_name = \"the-y-axis-on-the-left\"\nstep",
        "stepgen[1].litexcnc_name",
        &[
            "b.stepgen.the-y-axis-on-the-left.position-prediction",
            "47",
            "shorten",
        ],
    ),
    (
        "a name of LiteX-CNC's twice",
        "name = \"x\"\nstep = \"j1:0\"\ndir = \"j1:1\"\n\n[[stepgen]]\nname = \"y\"\n",
        "name = \"x\"\nlitexcnc_name = \"Y\"\nstep = \"j1:0\"\ndir = \"j1:1\"\n\n[[stepgen]]\nname = \"y\"\nlitexcnc_name = \"Y\"\n",
        "stepgen[1].litexcnc_name",
        &["already stepgen[0]'s", "HAL file"],
    ),
    (
        "a number of LiteX-CNC's row twice",
        "[[gpio_in]]\nname = \"limit-x\"\npin = \"j8:2\"\n\n[[gpio_in]]\nname = \"limit-y\"\n",
        "[[gpio_in]]\nname = \"limit-x\"\npin = \"j8:2\"\nlitexcnc = 7\n[[gpio_in]]\nname = \"limit-y\"\nlitexcnc = 7\n",
        "gpio_in[1].litexcnc",
        &["7", "already gpio_in[0]'s", "one row"],
    ),
    (
        "an unknown platform",
        "\"5a-75b-8.0\"",
        "\"5a-75b-8.1\"",
        "platform",
        &["5a-75b-8.1", "did you mean 5a-75b-", "5a-75e-6.0"],
    ),
    (
        "a platform that is a path",
        "\"5a-75b-8.0\"",
        "\"../platforms/5a-75b-8.0\"",
        "platform",
        &["not a platform"],
    ),
    (
        "another file's name",
        "name = \"mill6\"",
        "name = \"mill7\"",
        "name",
        &["\"mill7\"", "\"mill6\"", "equal"],
    ),
    (
        "an invalid polarity",
        "ext_reset = { pin = \"key\", active = \"low\" }",
        "ext_reset = { pin = \"key\", active = \"maybe\" }",
        "ext_reset.active",
        &["\"maybe\"", "\"low\", \"high\""],
    ),
    (
        "an invalid e-stop level",
        "estop = \"high\"",
        "estop = \"yes\"",
        "gpio_in[11].estop",
        &["\"yes\"", "normally closed"],
    ),
    (
        "an e-stop output",
        "pin = \"j5:6\"",
        "pin = \"j5:6\"\nestop = \"high\"",
        "gpio_out[11].estop",
        &["not a known key", "safe"],
    ),
    (
        "an invalid safe level",
        "pin = \"j5:6\"\nsafe = \"low\"",
        "pin = \"j5:6\"\nsafe = 0",
        "gpio_out[11].safe",
        &["0", "not armed"],
    ),
    (
        "an invalid inversion",
        "pin = \"j5:6\"",
        "pin = \"j5:6\"\ninvert = \"yes\"",
        "gpio_out[11].invert",
        &["neither true nor false"],
    ),
    (
        "an unknown step type",
        "name = \"x\"\nstep",
        "name = \"x\"\ntype = \"sinus\"\nstep",
        "stepgen[0].type",
        &["\"sinus\"", "up_down", "quadrature"],
    ),
    (
        "a copy of no pin",
        "dir = \"j1:1\"",
        "dir_n = \"j1:1\"",
        "stepgen[0].dir",
        &["missing", "inverted copy"],
    ),
    (
        "half an encoder",
        "b = \"j6:1\"\n",
        "",
        "encoder[0].b",
        &["missing though a is there"],
    ),
    (
        "a counter with two inputs",
        "a = \"j6:0\"",
        "type = \"counter\"\na = \"j6:0\"",
        "encoder[0].b",
        &["counter"],
    ),
    (
        "up and down on one pin",
        "name = \"spindle\"\npin",
        "name = \"spindle\"\ntype = \"up_down\"\npin",
        "pwm[0].dir",
        &["needs two pins"],
    ),
    (
        "a list for a text",
        "step = \"j1:0\"",
        "step = [\"j1:0\"]",
        "stepgen[0].step",
        &["[\"j1:0\"]", "not a text"],
    ),
    (
        "a date for a text",
        "step = \"j1:0\"",
        "step = 2024-01-01",
        "stepgen[0].step",
        &["2024-01-01"],
    ),
    (
        "a key given twice",
        "udp_port = 1234",
        "udp_port = 1234\nudp_port = 1235",
        "",
        &["is not TOML", "duplicate"],
    ),
    (
        "not TOML",
        "[network]",
        "[network",
        "",
        &["is not TOML", "config new"],
    ),
];

#[test]
fn every_broken_configuration_has_its_own_error() {
    assert!(read(GOOD).is_ok(), "{:?}", read(GOOD).err());
    let (mut seen, mut count) = (BTreeSet::new(), 0);
    for (what, old, new, key, wanted) in CASES {
        assert!(GOOD.contains(old), "{what}: mill6.toml has no {old:?}");
        let text = GOOD.replacen(old, new, 1);
        let error = read(&text).expect_err(what);
        let said = error.to_string();
        assert_eq!(error.key, *key, "{what}: {said}");
        for part in *wanted {
            assert!(said.contains(part), "{what}: {part:?} is not in {said:?}");
        }
        assert!(said.starts_with("boards/mill6.toml:"), "{what}: {said}");
        assert!(
            !error.problem.is_empty() && !error.remedy.is_empty(),
            "{what}: {said}"
        );
        // Where something stands that should not, the place is its line.
        if !error.value.is_empty() {
            let line = error
                .place
                .unwrap_or_else(|| panic!("{what} has no place: {said}"))
                .line;
            let text = text.lines().nth(line - 1).unwrap_or_default();
            let name = error
                .key
                .rsplit('.')
                .next()
                .unwrap_or_default()
                .split('[')
                .next()
                .unwrap_or_default();
            assert!(text.contains(name), "{what}: line {line} is {text:?}");
        }
        assert!(
            seen.insert(said.clone()),
            "{what} says what another says: {said}"
        );
        count += 1;
    }
    assert!(count >= 25, "{count}");
}

#[test]
fn an_output_without_a_safe_level_is_refused() {
    let error = read(&GOOD.replacen("safe = \"low\"\n", "", 1)).unwrap_err();
    assert_eq!(error.key, "gpio_out[0].safe");
    assert!(
        error
            .to_string()
            .contains("is missing; write \"low\" or \"high\""),
        "{error}"
    );
}

#[test]
fn jobs_have_as_many_axes_as_the_program_that_executes_them() {
    let with = |jobs: &str| GOOD.replacen("[modified]", &format!("jobs = {jobs}\n[modified]"), 1);
    for jobs in ["3", "0"] {
        assert!(read(&with(jobs)).is_ok(), "{jobs}");
    }
    for (jobs, said) in [
        (
            "1",
            "is not the number of axes a job has, which is 3; write 3",
        ),
        (
            "2",
            "is not the number of axes a job has, which is 3; write 3",
        ),
        ("4", "is outside 0 to 3; write 3: jobs move"),
        ("-1", "is outside 0 to 3; write 3: jobs move"),
    ] {
        let error = read(&with(jobs)).unwrap_err();
        assert_eq!(error.key, "jobs");
        let text = error.to_string();
        assert!(text.contains(said) && text.contains(jobs), "{text}");
    }
    // One for each axis of a job.
    let head = &GOOD[..GOOD.find("[[stepgen]]").unwrap()];
    let head = head.replacen("[modified]", "jobs = 3\n[modified]", 1);
    let stepgens = |count: usize| {
        (0..count)
            .map(|n| format!("[[stepgen]]\nname = \"n{n}\"\n"))
            .collect::<String>()
    };
    assert!(read(&format!("{head}{}", stepgens(3))).is_ok());
    let error = read(&format!("{head}{}", stepgens(2))).unwrap_err();
    assert_eq!(error.key, "jobs");
    assert!(
        error
            .to_string()
            .contains("more axes than the 2 step generators there are; leave the key out"),
        "{error}"
    );
}

#[test]
fn too_many_channels_are_refused_with_the_limit() {
    for (class, most, line) in [
        ("stepgen", 16, ""),
        ("encoder", 16, ""),
        ("pwm", 16, ""),
        ("gpio_in", 64, ""),
        ("gpio_out", 64, "safe = \"low\"\n"),
    ] {
        let head = &GOOD[..GOOD.find("[[stepgen]]").unwrap()];
        let channels = |count: usize| {
            (0..count)
                .map(|n| format!("[[{class}]]\nname = \"n{n}\"\n{line}"))
                .collect::<String>()
        };
        assert!(read(&format!("{head}{}", channels(most))).is_ok());
        let error = read(&format!("{head}{}", channels(most + 1))).unwrap_err();
        assert_eq!(error.key, class);
        assert!(
            error.to_string().contains(&format!(
                "{} of them are more than the gateware has: {most}",
                most + 1
            )),
            "{error}"
        );
    }
}

#[test]
fn an_estop_behind_the_first_32_inputs_is_refused_with_the_way_out() {
    let head = &GOOD[..GOOD.find("[[stepgen]]").unwrap()];
    let board = |stop: usize| {
        let inputs: String = (0..40)
            .map(|n| {
                let estop = if n == stop { "estop = \"high\"\n" } else { "" };
                format!("[[gpio_in]]\nname = \"n{n}\"\n{estop}")
            })
            .collect();
        read(&format!("{head}{inputs}"))
    };
    assert!(board(31).is_ok());
    let error = board(32).unwrap_err();
    assert_eq!(error.key, "gpio_in[32].estop");
    assert!(error.to_string().contains("further up"), "{error}");
}

#[test]
fn a_table_where_tables_belong_is_refused() {
    let error = read(&GOOD.replace("[[pwm]]\nname = \"spindle\"", "[pwm]\nname = \"spindle\""))
        .unwrap_err();
    assert!(
        error.to_string().contains("is not TOML") || error.key == "pwm",
        "{error}"
    );
    let head = &GOOD[..GOOD.find("[[stepgen]]").unwrap()];
    let error = read(&format!("{head}[pwm]\nname = \"spindle\"\n")).unwrap_err();
    assert!(
        error.key == "pwm" && error.to_string().contains("not an array of tables"),
        "{error}"
    );
}

#[test]
fn broken_platforms_are_refused_too() {
    let good = BUILT_IN[2].1;
    let read = |text: &str| Platform::read("p.toml", "5a-75b-8.0", text);
    assert!(read(good).is_ok());
    let cases: [(&str, &str, &str, &[&str]); 9] = [
        (
            "\"C4\"",
            "\"D4\"",
            "headers.j1[1]",
            &["\"D4\"", "already headers.j1[0]", "one use"],
        ),
        ("\"C4\", ", "", "headers.j1", &["has 5 balls", "write 6"]),
        (
            "\"C4\"",
            "\"4C\"",
            "headers.j1[0]",
            &["\"4C\"", "letter and a number"],
        ),
        ("j1 = ", "J1 = ", "headers.J1", &["lower case"]),
        ("6BG256C", "6QN128C", "device", &["no package", "BG256"]),
        ("4_194_304", "4_000_000", "flash.bytes", &["4000000"]),
        (
            "reset = \"R6\"",
            "reset = \"C4\"",
            "headers.j1[0]",
            &["already ethernet.reset"],
        ),
        ("hz = 25_000_000", "hz = 25", "clock.hz", &["25 "]),
        (
            "rx_data = [\"K2\", ",
            "rx_data = [",
            "phy[0].rx_data",
            &["has 3 balls"],
        ),
    ];
    for (old, new, key, wanted) in cases {
        assert!(good.contains(old), "{old}");
        let error = read(&good.replacen(old, new, 1)).expect_err(new);
        let said = error.to_string();
        // A ball with two uses may be told at either.
        assert!(
            error.key == key || wanted.iter().any(|part| part.contains("already")),
            "{key}: {said}"
        );
        for part in wanted
            .iter()
            .filter(|part| !part.starts_with("already") && !part.starts_with('"'))
        {
            assert!(said.contains(part), "{part:?} is not in {said:?}");
        }
    }
}
