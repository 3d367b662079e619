//! The console.

use super::Seed;

pub(super) fn console_seeds() -> Vec<Seed> {
    let all = "help\nstatus\nnet\nregs\nregs 8\nstepgen\nstepgen 5\nencoder\nencoder 16\npwm\npwm 0\ngpio\nwatchdog\nlog\nlink\nflash\nsettings\nquit\n";
    let telnet = [255, 253, 3, 255, 251, 24, 255, 244];
    vec![
        ("console", "every_command", all.into()),
        (
            "console",
            "telnet_negotiates",
            [&telnet[..], b"status\r\n"].concat(),
        ),
        (
            "console",
            "keys_are_echoed",
            [
                &[255, 253, 1][..],
                b"pwn\x7fm 0\r\0\x1b[A\x1b[D\x1b[3~1\r\0\x0c\x03\x04",
            ]
            .concat(),
        ),
        (
            "console",
            "corrected",
            b"statsu\x08\x08us\r\n\x7f\x7f\n? \nstepgen 256\n".to_vec(),
        ),
        (
            "console",
            "too_long",
            [vec![b'x'; 80], b"\nnet\n".to_vec()].concat(),
        ),
    ]
}
