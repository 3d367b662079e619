//! The keys of `machine.toml`: the check, the remedies and the guide's table are about this list.

use ferrocnc_config::tree::{Key, Kind, may, must};

const LEVELS: Kind = Kind::OneOf(&["low", "high"]);
const INPUT: &str = "the name of an input, as in \"home-x\"";
const OUTPUT: &str = "the name of an output, as in \"flood\"";
const SPEED: &str = "a speed in units a second, as in 20";
const PRESSED: &str = "\"high\" (if nothing is said) or \"low\": its level when pressed; a closed contact to ground that opens is \"high\"";

/// A switch.
pub const SWITCH: &[Key] = &[
    must("input", Kind::Text, INPUT),
    may("active", LEVELS, PRESSED),
];

const BOARD: &[Key] = &[
    must(
        "address",
        Kind::Text,
        "the board's address or name, as in \"192.168.2.50\"",
    ),
    may(
        "platform",
        Kind::Text,
        "the PCB, as in \"5a-75b-8.0\": a board file is written for it",
    ),
    may(
        "modified",
        Kind::Texts,
        "headers with bus switches, as in [\"j7\", \"j8\"]: inputs go there; without it some are proposed",
    ),
    may(
        "file",
        Kind::Text,
        "a board file, as in \"mill6.toml\": the card has its image, and it stays as it is",
    ),
    may(
        "debounce",
        Kind::Integer {
            min: 0,
            max: 35_000_000,
        },
        "how long a switch must be at rest, in ns, as in 2_000_000",
    ),
    may(
        "active_low",
        Kind::Texts,
        "outputs that are low when HAL says true, as in [\"drive-enable\"]",
    ),
];

const LIMITS: &[Key] = &[
    may("min", Kind::Text, INPUT),
    may("max", Kind::Text, INPUT),
    may("active", LEVELS, PRESSED),
];

const HOME: &[Key] = &[
    must(
        "method",
        Kind::OneOf(&[
            "immediate",
            "absolute",
            "switch",
            "limit",
            "index",
            "switch_index",
            "limit_index",
        ]),
        "\"switch\", \"limit\", \"index\", \"switch_index\", \"limit_index\", \"absolute\", or \"immediate\": where it stands",
    ),
    may(
        "inputs",
        Kind::Texts,
        "the home switch, as in [\"home-x\"], or one for each motor",
    ),
    may("active", LEVELS, PRESSED),
    may(
        "end",
        Kind::OneOf(&["min", "max"]),
        "\"min\" or \"max\": where the switch is",
    ),
    may("search", Kind::Number, SPEED),
    may("latch", Kind::Number, SPEED),
    may("travel", Kind::Number, SPEED),
    may(
        "latch_on",
        Kind::OneOf(&["release", "contact"]),
        "\"release\" (if nothing is said) or \"contact\": which edge of the switch is the place",
    ),
    may(
        "offset",
        Kind::Number,
        "the coordinate of the switch or index, as in -1.5",
    ),
    may(
        "position",
        Kind::Number,
        "where the axis goes then, as in 0",
    ),
    may(
        "square",
        Kind::Any,
        "for each motor what is added to offset, as in [0, 0.25]",
    ),
    may(
        "sequence",
        Kind::Integer { min: 0, max: 15 },
        "the order of the axes, least first; each motor of an axis with two moves with the other",
    ),
];

const AXIS: &[Key] = &[
    must(
        "letter",
        Kind::OneOf(&["x", "y", "z", "a", "b", "c", "u", "v", "w"]),
        "the axis, as in \"x\"",
    ),
    may(
        "motors",
        Kind::Texts,
        "its step generators, as in [\"y\", \"y2\"]; the letter if nothing is said",
    ),
    may(
        "reversed",
        Kind::Texts,
        "those of them that turn the other way, as in [\"y2\"]",
    ),
    must(
        "motor_steps",
        Kind::Integer {
            min: 1,
            max: 100_000,
        },
        "full steps of the motor in a turn, as in 200",
    ),
    must(
        "microsteps",
        Kind::Integer {
            min: 1,
            max: 100_000,
        },
        "steps of the drive in a full step, as in 8",
    ),
    may(
        "gear",
        Kind::Number,
        "turns of the motor in a turn of the screw, as in 2.5; 1 if nothing is said",
    ),
    must(
        "pitch",
        Kind::Number,
        "units in a turn of the screw, as in 5; 360 for a rotary table",
    ),
    may("backlash", Kind::Number, "of the screw, as in 0.02"),
    must("min", Kind::Number, "where the axis begins, as in 0"),
    must("max", Kind::Number, "where the axis ends, as in 400"),
    must("speed", Kind::Number, SPEED),
    must(
        "acceleration",
        Kind::Number,
        "in units a second, a second, as in 500",
    ),
    must(
        "drive",
        Kind::Any,
        "a preset, as in \"generic\", or { steplen, stepspace, dirsetup, dirhold } in ns",
    ),
    may(
        "limits",
        Kind::Table(LIMITS),
        "a table, as in { min = \"limit-x\", max = \"limit-x\" }",
    ),
    must(
        "home",
        Kind::Table(HOME),
        "a table with method, as in { method = \"immediate\" }",
    ),
    may(
        "fault",
        Kind::Table(SWITCH),
        "the drive's alarm, as in { input = \"alarm-x\" }",
    ),
];

/// The timings of a drive that is no preset.
pub const DRIVE: &[Key] = &[
    must("steplen", TIME, "nanoseconds, as in 2500"),
    must("stepspace", TIME, "nanoseconds, as in 2500"),
    must("dirsetup", TIME, "nanoseconds, as in 5000"),
    must("dirhold", TIME, "nanoseconds, as in 5000"),
];
const TIME: Kind = Kind::Integer {
    min: 1,
    max: 10_000_000,
};

const DRIVES: &[Key] = &[may("enable", Kind::Text, OUTPUT)];

const ESTOP: &[Key] = &[
    must(
        "source",
        Kind::OneOf(&["software", "input", "external"]),
        "\"input\": a contact on an input of the board, \"external\": on its KEY terminal, or \"software\": the button on the screen only",
    ),
    may("input", Kind::Text, INPUT),
    may(
        "active",
        LEVELS,
        "\"high\" (if nothing is said) or \"low\": the level that stops; a closed contact to ground that opens is \"high\"",
    ),
];

const SPINDLE: &[Key] = &[
    must(
        "control",
        Kind::OneOf(&["on_off", "pwm", "analog"]),
        "\"on_off\", \"pwm\", or \"analog\": 0 to 10 V by a converter behind a PWM",
    ),
    may("on", Kind::Text, OUTPUT),
    may("reverse", Kind::Text, OUTPUT),
    may(
        "pwm",
        Kind::Text,
        "the name of a PWM; \"spindle\" if nothing is said",
    ),
    may("frequency", Kind::Number, "of the PWM in hertz, as in 5000"),
    may("min_rpm", Kind::Number, "turns in a minute, as in 3000"),
    may("max_rpm", Kind::Number, "turns in a minute, as in 24000"),
    may(
        "full_rpm",
        Kind::Number,
        "turns in a minute at a duty of 1, or at 10 V; max_rpm if nothing is said",
    ),
    may(
        "encoder",
        Kind::Text,
        "the name of an encoder, as in \"spindle\"",
    ),
    may(
        "counts_per_turn",
        Kind::Integer {
            min: 1,
            max: 1_000_000,
        },
        "four times the lines of the encoder, as in 4096",
    ),
    may(
        "at_speed",
        Kind::Number,
        "how near is at speed, as a part of the speed, as in 0.05; 0: it is not waited for",
    ),
];

const COOLANT: &[Key] = &[
    may("flood", Kind::Text, OUTPUT),
    may("mist", Kind::Text, OUTPUT),
    may("air", Kind::Text, OUTPUT),
    may("lube", Kind::Text, OUTPUT),
];

const PLASMA: &[Key] = &[
    must(
        "mode",
        Kind::Integer { min: 0, max: 2 },
        "QtPlasmaC's mode: 0 arc voltage, 1 arc voltage and arc OK, 2 up and down signals",
    ),
    must("torch", Kind::Text, OUTPUT),
    may(
        "arc_voltage",
        Kind::Text,
        "the encoder that counts the pulses of a THCAD, as in \"arc-volts\"",
    ),
    may("ohmic_enable", Kind::Text, OUTPUT),
    may("arc_ok", Kind::Table(SWITCH), "{ input = \"arc-ok\" }"),
    may("float", Kind::Table(SWITCH), "{ input = \"float\" }"),
    may("ohmic", Kind::Table(SWITCH), "{ input = \"ohmic\" }"),
    may(
        "breakaway",
        Kind::Table(SWITCH),
        "{ input = \"breakaway\" }",
    ),
    may("move_up", Kind::Table(SWITCH), "{ input = \"move-up\" }"),
    may(
        "move_down",
        Kind::Table(SWITCH),
        "{ input = \"move-down\" }",
    ),
];

/// Keys of the file.
pub const KEYS: &[Key] = &[
    must(
        "name",
        Kind::Text,
        "the machine's name, as in \"mill\": of its board file and INI file, too",
    ),
    must("units", Kind::OneOf(&["mm", "inch"]), "\"mm\" or \"inch\""),
    must(
        "gui",
        Kind::OneOf(&["axis", "gmoccapy", "qtdragon", "probe_basic", "qtplasmac"]),
        "\"axis\", \"gmoccapy\", \"qtdragon\", \"probe_basic\" or \"qtplasmac\"",
    ),
    may("lathe", Kind::Flag, "true or false"),
    may(
        "tool_change",
        Kind::OneOf(&["manual", "none"]),
        "\"manual\" (if nothing is said): a window asks for the tool, or \"none\": M6 does nothing",
    ),
    may(
        "servo_period",
        Kind::Integer {
            min: 200_000,
            max: 10_000_000,
        },
        "the servo thread's period in ns, as in 1_000_000",
    ),
    must(
        "board",
        Kind::Table(BOARD),
        "a table with address, and platform or file",
    ),
    must(
        "axis",
        Kind::Tables(AXIS, 9),
        "an array of tables, [[axis]]",
    ),
    may(
        "drives",
        Kind::Table(DRIVES),
        "a table, as in { enable = \"drive-enable\" }",
    ),
    must(
        "estop",
        Kind::Table(ESTOP),
        "a table with source, as in { source = \"input\", input = \"estop\" }",
    ),
    may("spindle", Kind::Table(SPINDLE), "a table with control"),
    may("probe", Kind::Table(SWITCH), "{ input = \"probe\" }"),
    may(
        "tool_setter",
        Kind::Table(SWITCH),
        "{ input = \"tool-setter\" }",
    ),
    may(
        "coolant",
        Kind::Table(COOLANT),
        "a table, as in { flood = \"flood\" }",
    ),
    may("plasma", Kind::Table(PLASMA), "a table with mode and torch"),
];

#[cfg(test)]
mod tests {
    use super::KEYS;
    use ferrocnc_config::tree::{Key, Kind};

    /// A key and those of its tables.
    fn all(keys: &'static [Key]) -> Vec<&'static str> {
        let mut names = Vec::new();
        for key in keys {
            names.push(key.name);
            if let Kind::Table(inner) | Kind::Tables(inner, _) = &key.kind {
                names.extend(all(inner));
            }
        }
        names
    }

    #[test]
    fn the_guide_has_every_key() {
        let page = include_str!("../../docs/guide/machine.md");
        let code: Vec<&str> = page.split('`').skip(1).step_by(2).collect();
        let words = |code: &&str| -> Vec<String> {
            let parts = code.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            parts.map(str::to_owned).collect()
        };
        let known: Vec<String> = code.iter().flat_map(words).collect();
        for name in all(KEYS) {
            assert!(
                known.iter().any(|word| word == name),
                "docs/guide/machine.md: {name}"
            );
        }
    }
}
