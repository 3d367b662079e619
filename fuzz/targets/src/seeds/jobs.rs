//! Real conversations with the jobs port, as scripts of [`crate::jobs`].

use super::Seed;

/// The client greets the board.
const HELLO: &[u8] = &[0, 6];
/// A job of three lines, an arc and a dwell, called `a`, in blocks of 60 bytes.
const UPLOAD: &[u8] = &[
    1, 5, 16, 20, 10, 16, 0, 20, 24, 5, 5, 10, 30, 0, 16, 0, 0, 0, 0,
];
/// The machine, without switches and with them.
const FREE: &[u8] = &[2, 0];
const SWITCHED: &[u8] = &[2, 1];
/// Time goes by.
const SOME: &[u8] = &[4, 7];
const LONG: &[u8] = &[4, 10];
const REPORT: &[u8] = &[14, 0];
/// The last request once more.
const AGAIN: &[u8] = &[11];
const LIST: &[u8] = &[14, 1];
const START: &[u8] = &command(2, 128);
const ATTENDED: &[u8] = &command(2, 0);
const PAUSE: &[u8] = &command(10, 0);
const GO_ON: &[u8] = &command(1, 0);
const STOP: &[u8] = &command(0, 0);
const HOME: &[u8] = &command(11, 128);

/// With a keepalive of 100 ms.
const fn command(code: u8, flags: u8) -> [u8; 5] {
    [3, code, flags, 5, 0]
}

fn script(name: &'static str, steps: &[&[u8]]) -> Seed {
    ("jobs", name, steps.concat())
}

pub(super) fn jobs_seeds() -> Vec<Seed> {
    [to_an_end(), stopped(), odd()].concat()
}

fn to_an_end() -> Vec<Seed> {
    let talk: Vec<u8> = (0..11).flat_map(|verb| [10, verb << 1 | 1, 0]).collect();
    vec![
        script(
            "sent_started_and_drawn",
            &[
                HELLO, FREE, UPLOAD, LIST, START, AGAIN, SOME, REPORT, LONG, LONG, LONG, LONG,
                REPORT,
            ],
        ),
        script(
            "switches_are_looked_for",
            &[
                HELLO, SWITCHED, UPLOAD, START, SOME, HOME, SOME, REPORT, LONG, REPORT,
            ],
        ),
        script(
            "the_console_says_it_all",
            &[HELLO, FREE, UPLOAD, &talk, LONG, &talk],
        ),
        script(
            "fpga_gs_words",
            &[
                HELLO,
                FREE,
                &[12, 3, 0, 28],
                &[1; 28],
                &[12, 1, 0, 0],
                &[12, 2, 0, 0],
                LONG,
                REPORT,
            ],
        ),
    ]
}

fn stopped() -> Vec<Seed> {
    vec![
        script(
            "paused_gone_on_and_stopped",
            &[
                HELLO, FREE, UPLOAD, START, SOME, PAUSE, SOME, REPORT, GO_ON, SOME, STOP, AGAIN,
                LONG, LONG, LONG, LONG, REPORT,
            ],
        ),
        script(
            "an_estop_in_mid_job",
            &[HELLO, FREE, UPLOAD, START, LONG, &[8, 8], SOME, REPORT],
        ),
        script(
            "its_starter_hangs_up",
            &[
                HELLO,
                FREE,
                UPLOAD,
                ATTENDED,
                SOME,
                &[9],
                LONG,
                LONG,
                LONG,
                LONG,
                HELLO,
                REPORT,
            ],
        ),
    ]
}

/// What no client says.
fn odd() -> Vec<Seed> {
    vec![script(
        "garbled_in_pieces_and_unknown",
        &[
            REPORT,
            HELLO,
            &[15, 9],
            &[5, 99, 0, 2, 1, 2],
            &[7, 40, 128],
            &[6, 0, 4, 1, 2, 3, 4],
            HELLO,
            REPORT,
        ],
    )]
}
