//! Each broken file is refused with its place, key, value and a remedy. A mangled file never causes
//! a panic and is never accepted silently.

use ferrocnc_config::board::Platforms;
use ferrocnc_config::import::{lcnc, litexcnc};
use ferrocnc_config::source::{BUILT_IN, Folder};
use ferrocnc_config::{Board, Error, Platform, write};
use proptest::prelude::*;
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
        "an SDRAM without jobs",
        "sys_clk_hz",
        "sdram = false\nsys_clk_hz",
        "sdram",
        &["false", "without jobs", "jobs = 3"],
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
        ("gpio_in", 32, ""),
        ("gpio_out", 32, "safe = \"low\"\n"),
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

// Mangled files
// ------------------------------------------------------------------------------------------------------

#[derive(Clone, Debug)]
enum Mangle {
    Delete(prop::sample::Index),
    Repeat(prop::sample::Index),
    Swap(prop::sample::Index, prop::sample::Index),
    Put(prop::sample::Index, char),
    Lose(prop::sample::Index),
    Cut(prop::sample::Index),
    Say(prop::sample::Index, &'static str),
}

fn mangles() -> impl Strategy<Value = Vec<Mangle>> {
    let index = any::<prop::sample::Index>;
    let words = prop::sample::select(
        &[
            "\"", "[", "]", "{", "}", "=", "\n", "0", "-1", "1e9", "null", "true", "j1:0",
            "\"j1:3\"", "[[pwm]]", "\u{0}", "\\u0000", ":", "#", ";", "é",
        ][..],
    );
    let one = prop_oneof![
        index().prop_map(Mangle::Delete),
        index().prop_map(Mangle::Repeat),
        (index(), index()).prop_map(|(a, b)| Mangle::Swap(a, b)),
        (index(), any::<char>()).prop_map(|(at, c)| Mangle::Put(at, c)),
        (index(), prop::char::range(' ', '~')).prop_map(|(at, c)| Mangle::Put(at, c)),
        index().prop_map(Mangle::Lose),
        index().prop_map(Mangle::Cut),
        (index(), words).prop_map(|(at, word)| Mangle::Say(at, word)),
    ];
    prop::collection::vec(one, 1..4)
}

fn mangled(text: &str, mangles: &[Mangle]) -> String {
    let mut text = text.to_owned();
    for mangle in mangles {
        let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
        let mut chars: Vec<char> = text.chars().collect();
        if chars.is_empty() {
            return text;
        }
        text = match mangle {
            Mangle::Delete(at) => {
                lines.remove(at.index(lines.len()));
                lines.concat()
            }
            Mangle::Repeat(at) => {
                let at = at.index(lines.len());
                lines.insert(at, lines[at]);
                lines.concat()
            }
            Mangle::Swap(a, b) => {
                let (a, b) = (a.index(lines.len()), b.index(lines.len()));
                lines.swap(a, b);
                lines.concat()
            }
            Mangle::Put(at, c) => {
                let at = at.index(chars.len());
                chars[at] = *c;
                chars.into_iter().collect()
            }
            Mangle::Lose(at) => {
                chars.remove(at.index(chars.len()));
                chars.into_iter().collect()
            }
            Mangle::Cut(at) => {
                chars.truncate(at.index(chars.len()));
                chars.into_iter().collect()
            }
            Mangle::Say(at, word) => {
                let at = at.index(chars.len());
                chars.splice(at..at, word.chars());
                chars.into_iter().collect()
            }
        };
    }
    text
}

/// INI without what does not count: comments, empty lines, spaces around keys and values.
fn ini_lines(text: &str) -> Vec<String> {
    let bare = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with(['#', ';']));
    bare.map(|line| {
        let parts: Vec<&str> = line.splitn(2, ['=', ':']).map(str::trim).collect();
        if parts.len() == 2 {
            format!("{}={}", parts[0].to_lowercase(), parts[1])
        } else {
            line.to_owned()
        }
    })
    .collect()
}

/// The same lines in their sections, in any order of the sections.
fn ini_sections(text: &str) -> BTreeSet<(String, Vec<String>)> {
    let mut sections = vec![(String::new(), Vec::new())];
    for line in ini_lines(text) {
        if line.starts_with('[') {
            sections.push((line, Vec::new()));
        } else if let Some(last) = sections.last_mut() {
            last.1.push(line);
        }
    }
    // Within a section only the channels' order counts, and that order is checked.
    sections
        .into_iter()
        .map(|(name, mut lines)| {
            lines.sort();
            (name, lines)
        })
        .collect()
}

/// Numbers by value, as a reader of numbers sees them.
fn same_but_for_writing(a: &str, b: &str) -> bool {
    let clock = |text: &str| {
        let lines = ini_sections(text);
        lines
            .into_iter()
            .map(|(name, lines)| {
                (
                    name,
                    lines
                        .into_iter()
                        .map(|line| match line.split_once('=') {
                            Some((key @ ("clock" | "port" | "num"), value)) => {
                                format!("{key}={:?}", value.parse::<f64>().ok())
                            }
                            Some(("mac", value)) => format!(
                                "mac={:?}",
                                u64::from_str_radix(
                                    value.trim_start_matches("0x").trim_start_matches("0X"),
                                    16
                                )
                                .ok()
                            ),
                            _ => line,
                        })
                        .collect::<Vec<_>>(),
                )
            })
            .collect::<BTreeSet<_>>()
    };
    clock(a) == clock(b)
}

/// Every value of a JSON file counts: if it is changed or removed, the import changes, gives a
/// note, or refuses the file. The test tries every value of every sample, changed and removed,
/// because a random draw of a few hundred would miss most single values.
#[test]
fn no_value_of_a_json_file_is_dropped_silently() {
    let samples = [
        include_str!("samples/six_axis.json"),
        include_str!("samples/lathe.json"),
        include_str!("samples/plasma.json"),
    ];
    let import = |text: &str| litexcnc("mill.json", text, "mill", &Folder::default());
    let mut silent = Vec::new();
    for good in samples {
        let before = import(good).unwrap().toml;
        let sample: serde_json::Value = serde_json::from_str(good).unwrap();
        for path in paths(&sample, "") {
            for gone in [false, true] {
                if says_nothing(&sample, &path, gone) {
                    continue;
                }
                let tree = if gone {
                    without(&sample, &path)
                } else {
                    changed(&sample, &path)
                };
                if import(&tree.to_string()).is_ok_and(|after| after.toml == before) {
                    silent.push(format!("{path} {}", if gone { "gone" } else { "changed" }));
                }
            }
        }
    }
    assert!(silent.is_empty(), "no effect: {silent:#?}");
}

/// Values that repeat a default, and the shape of a waveform that is not generated.
fn says_nothing(tree: &serde_json::Value, path: &str, gone: bool) -> bool {
    let meant_anyway = [
        "/connection_type",
        "/ethphy",
        "/tx_delay",
        "/io_standard",
        "/output_type",
    ];
    let ends = |keys: &[&str]| keys.iter().any(|key| path.ends_with(key));
    path.contains("/waveform")
        || ends(&["/speed", "/max_frequency"])
        || gone && ends(&meant_anyway)
        || gone && path.ends_with("/soft_stop") && tree.pointer(path) == Some(&false.into())
}

fn without(tree: &serde_json::Value, path: &str) -> serde_json::Value {
    let mut tree = tree.clone();
    let (parent, key) = path.rsplit_once('/').unwrap();
    match tree.pointer_mut(parent).unwrap() {
        serde_json::Value::Object(map) => {
            map.remove(key);
        }
        serde_json::Value::Array(list) => {
            list.remove(key.parse().unwrap());
        }
        _ => unreachable!(),
    }
    tree
}

fn changed(tree: &serde_json::Value, path: &str) -> serde_json::Value {
    let mut tree = tree.clone();
    let value = tree.pointer_mut(path).unwrap();
    *value = match value {
        serde_json::Value::Bool(flag) => (!*flag).into(),
        serde_json::Value::Number(_) => 77.into(),
        serde_json::Value::String(text) => format!("{text}7").into(),
        _ => "something else".into(),
    };
    tree
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mangled_toml_is_refused_or_means_what_it_says(mangles in mangles()) {
        let text = mangled(GOOD, &mangles);
        if let Ok(board) = read(&text) {
            let toml = write::to_toml(&board, &[]);
            let same = write::to_toml(&read(GOOD).unwrap(), &[]) == toml;
            let tree = |text: &str| text.parse::<toml::Table>().unwrap();
            prop_assert_eq!(same, tree(&text) == tree(GOOD), "accepted silently:\n{}", text);
            let again = Board::read("again.toml", "mill6", &toml, &Folder::default()).unwrap();
            prop_assert_eq!(write::to_toml(&again, &[]), toml);
        }
    }

    #[test]
    fn mangled_platforms_are_refused_or_read(which in 0..BUILT_IN.len(), mangles in mangles()) {
        let (name, good) = BUILT_IN[which];
        let text = mangled(good, &mangles);
        if Platform::read("p.toml", name, &text).is_ok() {
            prop_assert!(text.parse::<toml::Table>().is_ok());
        }
    }

    #[test]
    fn mangled_ini_is_refused_or_means_what_it_says(mangles in mangles()) {
        let good = include_str!("samples/router.ini");
        let text = mangled(good, &mangles);
        let import = |text: &str| lcnc("router.ini", text, "router", &Folder::default());
        if let Ok(imported) = import(&text) {
            let same = imported.toml == import(good).unwrap().toml;
            prop_assert!(!same || same_but_for_writing(&text, good), "accepted silently:\n{}", text);
        }
    }

    #[test]
    fn mangled_json_is_refused_or_means_what_it_says(which in 0..3usize, mangles in mangles()) {
        let good = [include_str!("samples/six_axis.json"), include_str!("samples/lathe.json"), include_str!("samples/plasma.json")][which];
        let text = mangled(good, &mangles);
        let import = |text: &str| litexcnc("mill.json", text, "mill", &Folder::default());
        if let Ok(imported) = import(&text) {
            prop_assert!(serde_json::from_str::<serde_json::Value>(&text).is_ok());
            prop_assert!(Board::read("again.toml", "mill", &imported.toml, &Folder::default()).is_ok());
        }
    }

    #[test]
    fn noise_is_refused(text in "\\PC*") {
        prop_assert!(read(&text).is_err());
        prop_assert!(lcnc("x.ini", &text, "x", &Folder::default()).is_err());
        prop_assert!(litexcnc("x.json", &text, "x", &Folder::default()).is_err());
        prop_assert!(Folder::default().text(&text).is_none() || BUILT_IN.iter().any(|(name, _)| *name == text));
    }
}

/// JSON pointers of everything below the root.
fn paths(tree: &serde_json::Value, path: &str) -> Vec<String> {
    let children: Vec<(String, &serde_json::Value)> = match tree {
        serde_json::Value::Object(map) => map
            .iter()
            .map(|(key, value)| (format!("{path}/{key}"), value))
            .collect(),
        serde_json::Value::Array(list) => list
            .iter()
            .enumerate()
            .map(|(n, value)| (format!("{path}/{n}"), value))
            .collect(),
        _ => Vec::new(),
    };
    children
        .into_iter()
        .flat_map(|(path, value)| [vec![path.clone()], paths(value, &path)].concat())
        .collect()
}
