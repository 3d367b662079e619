use super::*;
use crate::fake::{ALICE, SIX};
use wire::describe::Channels;

fn shape(channels: Channels) -> Shape {
    Shape::new(channels)
}

/// Page, first word, count, flags of a run.
fn parts(run: u32) -> (u32, u32, u32, u32) {
    let register = run & fast_path::RUN0_REGISTER;
    (
        (register >> PAGE_BITS) + FIRST_PAGE,
        register & 0x7f,
        ((run & fast_path::RUN0_COUNT) >> fast_path::RUN0_COUNT_SHIFT) + 1,
        run >> 16,
    )
}

#[test]
fn the_runs_of_six_axes_are_those_of_the_frame_and_of_the_answer() {
    let runs = runs(&shape(SIX)).map(parts);
    let at = |word: usize| word as u32;
    assert_eq!(
        runs[..3],
        [
            (timebase::PAGE, at(timebase::COMMIT_AT_LO), 2, 0),
            (command::PAGE, at(command::ENABLES), 16, 0),
            (command::PAGE, at(command::PWM0_WIDTH), 6, 4),
        ]
    );
    assert_eq!(runs[4], (FIRST_PAGE, 17, 8, 1));
    assert_eq!(runs[5], (status::PAGE, at(status::SAMPLE_LO), 2, 0));
    assert_eq!(runs[8], (FIRST_PAGE, 24, 1, 1));
    assert_eq!(runs[11], (status::PAGE, at(status::ENCODER0_LATCH), 1, 2));
    assert_eq!(runs[13], (status::PAGE, at(status::ENCODER0_COUNT), 12, 4));
}

#[test]
fn with_any_number_of_channels_the_runs_have_every_word_of_both_blocks() {
    for stepgens in 0..=16 {
        for pwms in [0, 1, 16] {
            for (encoders, inputs, outputs) in [
                (0, 12, 12),
                (1, 64, 12),
                (1, 12, 64),
                (16, 64, 64),
                (0, 33, 33),
            ] {
                let channels = Channels {
                    stepgens,
                    pwms,
                    encoders,
                    inputs,
                    outputs,
                };
                let shape = shape(channels);
                let runs = runs(&shape).map(parts);
                let until_end = |runs: &[(u32, u32, u32, u32)]| {
                    let end = runs.iter().position(|run| run.3 & 4 != 0).unwrap();
                    runs[..=end].to_vec()
                };
                let words = |runs: &[(u32, u32, u32, u32)]| -> u32 {
                    let words = runs.iter().filter(|run| run.3 & 1 == 0);
                    words.map(|run| run.2).sum()
                };
                let frame = until_end(&runs[..FRAME_RUNS]);
                // All but token, sequence number and flags.
                assert_eq!(words(&frame) as usize, shape.command - 3, "{channels:?}");
                let answer = until_end(&runs[FRAME_RUNS..]);
                // All but state, sequence number, refusals and boot id.
                assert_eq!(words(&answer) as usize, shape.status - 4, "{channels:?}");
            }
        }
    }
}

#[test]
fn what_is_expected_is_what_a_frame_of_the_owner_is() {
    let us = Us {
        mac: [0x10, 0xe2, 0xd5, 0, 0, 1],
        ip: 0xc0a8_0232,
        port: 1234,
    };
    let datagram = Datagram {
        peer: ALICE,
        mac: (0x0200, 0x0000_0001),
        length: 0,
        options: 0,
        service: 0xb8,
        ttl: 63,
    };
    let expected = Expected::new(&us, &datagram, 27, 0x1234_5678);
    let [
        w0,
        w1,
        w2,
        w3,
        w4,
        w6,
        w7,
        w8,
        w9,
        w10,
        w11,
        w13,
        w14,
        w15,
        ..,
    ] = expected.words;
    assert_eq!([w0, w1], [0x10e2, 0xd500_0001]);
    assert_eq!([w2, w3], [0x0200_0000, 0x0001_0800]);
    assert_eq!([w4, w6], [0x45b8_0098, 0x3f11_0000]);
    assert_eq!([w7, w8, w9], [ALICE.ip, us.ip, 0x9c40_04d2]);
    assert_eq!([w10, w11, w13], [0x0084_0000, 0x4e6f_1044, 0x000f_1b00]);
    assert_eq!([w14, w15], [wire::map::COMMAND, 0x1234_5678]);
}
