//! The keys of a board file: their names, the values they take, and the sentences that ask for a
//! missing one.

use crate::hal::{self, HalClass};
use crate::tree::{Key, Kind, may, must};
use wire::jobs::AXES as JOB_AXES;
use wire::regmap::{ENCODER_MAX, IN_MAX, OUT_MAX, PWM_MAX, STEPGEN_MAX};

const NAME: &str = "a name as HAL has them, lower case, as in \"x\"";
const fn name(class: HalClass) -> Key {
    let most = class.room();
    must(
        "name",
        Kind::Shaped {
            pattern: "^[a-z][a-z0-9-]*$",
            most,
        },
        NAME,
    )
}
/// What LiteX-CNC's JSON calls the channel; the reader asks `wire::board::is_foreign_name`.
const fn litexcnc_name(class: HalClass) -> Key {
    may(
        "litexcnc_name",
        Kind::Shaped {
            pattern: "^[A-Za-z0-9_:.+/-]*[A-Za-z_:.+/-][A-Za-z0-9_:.+/-]*$",
            most: class.litexcnc_room(),
        },
        "the name it had in LiteX-CNC's JSON, for names=litexcnc-named, as in \"j1:10\"",
    )
}
/// A header's pins but ground, the button, or nothing.
const PIN: Kind = Kind::Shaped {
    pattern: "^(j[1-9][0-9]?:([0124-9]|1[0-4])|key|none)$",
    most: 6,
};
const LEVELS: Kind = Kind::OneOf(&["low", "high"]);

const LINE: &[Key] = &[
    must("pin", PIN, "a pin, as in \"key\" or \"j8:6\", or \"none\""),
    must("active", LEVELS, "\"low\" or \"high\": the level that acts"),
];
const NETWORK: &[Key] = &[
    may(
        "mac",
        Kind::Shaped {
            pattern: "^[0-9a-f]{2}(:[0-9a-f]{2}){5}$",
            most: 17,
        },
        "a MAC address, as in \"10:e2:d5:00:00:01\"; without it the board makes one of its flash's serial number",
    ),
    must(
        "ipv4",
        Kind::Text,
        "the address the board has until it is given another, as in \"192.168.2.50\"",
    ),
    must(
        "udp_port",
        Kind::Integer { min: 1, max: 65535 },
        "the UDP port, as in 1234",
    ),
];
const MODIFIED: &[Key] = &[
    may(
        "bus_switch",
        Kind::Texts,
        "headers with bus switches in place of their buffers, as in [\"j5\", \"j6:shared\"]: both directions",
    ),
    may(
        "inputs",
        Kind::Texts,
        "headers with their buffers turned round, as in [\"j5\"]: inputs only",
    ),
];
/// The step generators' types, hostmot2's 0, 1 and 2.
pub const STEP_TYPES: [&str; 3] = ["step_dir", "up_down", "quadrature"];
/// The encoders' types.
pub const ENCODER_TYPES: [&str; 2] = ["quadrature", "counter"];
/// The PWMs' types, hostmot2's 1, 2, 3 and 4.
pub const PWM_TYPES: [&str; 4] = ["pwm", "up_down", "pdm", "dir_pwm"];

const STEPGEN: &[Key] = &[
    name(hal::STEPGEN),
    may(
        "type",
        Kind::OneOf(&STEP_TYPES),
        "\"step_dir\" (if nothing is said), \"up_down\": step is up and dir is down, or \"quadrature\": step is A and dir is B",
    ),
    may("step", PIN, "the output pin, as in \"j1:0\""),
    may("dir", PIN, "the output pin, as in \"j1:1\""),
    may(
        "step_n",
        PIN,
        "a pin for the inverted copy of step, for a differential input",
    ),
    may(
        "dir_n",
        PIN,
        "a pin for the inverted copy of dir, for a differential input",
    ),
    may("index", PIN, "an input pin: the axis' index pulse"),
    litexcnc_name(hal::STEPGEN),
];
const ENCODER: &[Key] = &[
    name(hal::ENCODER),
    may(
        "type",
        Kind::OneOf(&ENCODER_TYPES),
        "\"quadrature\" (if nothing is said) or \"counter\": pulses on a, no b",
    ),
    may("a", PIN, "the input pin, as in \"j6:0\""),
    may("b", PIN, "the input pin, as in \"j6:1\""),
    may("index", PIN, "an input pin: the index pulse, Z"),
    may(
        "mask",
        PIN,
        "an input pin that must be high for the index to count",
    ),
    litexcnc_name(hal::ENCODER),
];
const PWM: &[Key] = &[
    name(hal::PWM),
    may(
        "type",
        Kind::OneOf(&PWM_TYPES),
        "\"pwm\" (if nothing is said), \"up_down\": pin is up and dir is down, \"pdm\" or \"dir_pwm\": the two pins swapped",
    ),
    may("pin", PIN, "the output pin, as in \"j3:0\""),
    may("dir", PIN, "an output pin for the sign"),
    litexcnc_name(hal::PWM),
];
/// Numbers of LiteX-CNC's row of inputs and outputs.
const ROW: Kind = Kind::Integer { min: 0, max: 127 };

const GPIO_IN: &[Key] = &[
    name(hal::INPUT),
    may("pin", PIN, "the input pin, as in \"j8:2\""),
    may(
        "estop",
        LEVELS,
        "the level that stops the machine, in the gateware; a normally closed contact to ground stops on \"high\"",
    ),
    may(
        "litexcnc",
        ROW,
        "the number it had in LiteX-CNC's one row of inputs and outputs, for names=litexcnc",
    ),
    litexcnc_name(hal::INPUT),
];
const GPIO_OUT: &[Key] = &[
    name(hal::OUTPUT),
    may("pin", PIN, "the output pin, as in \"j4:0\""),
    must(
        "safe",
        LEVELS,
        "\"low\" or \"high\": the level of the pin whenever the board is not armed",
    ),
    may(
        "invert",
        Kind::Flag,
        "true or false: whether the pin is low when HAL says true, from power-up on",
    ),
    may(
        "litexcnc",
        ROW,
        "the number it had in LiteX-CNC's one row of inputs and outputs, for names=litexcnc",
    ),
    litexcnc_name(hal::OUTPUT),
];

/// Keys of a file in `boards`.
pub const KEYS: &[Key] = &[
    must(
        "name",
        Kind::Text,
        "the configuration's name, the file's own, as in \"mill6\"",
    ),
    must(
        "platform",
        Kind::Text,
        "the name of a file in boards/platforms, without .toml",
    ),
    must(
        "sys_clk_hz",
        Kind::Integer {
            min: 10_000_000,
            max: 100_000_000,
        },
        "the clock of the cores in hertz, as in 60_000_000, which closes",
    ),
    may(
        "phy",
        Kind::Integer { min: 0, max: 1 },
        "0 (if nothing is said) or 1: which Ethernet jack is used",
    ),
    must(
        "ext_reset",
        Kind::Table(LINE),
        "a table with pin and active, as in { pin = \"key\", active = \"low\" }, or pin = \"none\"",
    ),
    may(
        "factory",
        Kind::Table(LINE),
        "a table with pin and active: held at power-up, the board forgets its stored settings for this run",
    ),
    may(
        "jobs",
        Kind::Integer {
            min: 0,
            max: JOB_AXES as i64,
        },
        "3: jobs move the first three step generators without a PC; 0 (if nothing is said): there are no jobs",
    ),
    may(
        "sdram",
        Kind::Flag,
        "true (if nothing is said) or false: without the SDRAM there are no services, and a PC streams the jobs",
    ),
    must(
        "network",
        Kind::Table(NETWORK),
        "a table with ipv4 and udp_port, and mac where the board is not to make one",
    ),
    may(
        "modified",
        Kind::Table(MODIFIED),
        "a table of the headers with replaced buffers",
    ),
    may(
        "stepgen",
        Kind::Tables(STEPGEN, STEPGEN_MAX),
        "an array of tables, [[stepgen]]",
    ),
    may(
        "encoder",
        Kind::Tables(ENCODER, ENCODER_MAX),
        "an array of tables, [[encoder]]",
    ),
    may(
        "pwm",
        Kind::Tables(PWM, PWM_MAX),
        "an array of tables, [[pwm]]",
    ),
    may(
        "gpio_in",
        Kind::Tables(GPIO_IN, IN_MAX),
        "an array of tables, [[gpio_in]]",
    ),
    may(
        "gpio_out",
        Kind::Tables(GPIO_OUT, OUT_MAX),
        "an array of tables, [[gpio_out]]",
    ),
];
