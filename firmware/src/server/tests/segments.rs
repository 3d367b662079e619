//! Segments that a host streams.

use super::*;

/// A board with jobs streamed by a PC, armed by Alice, and the number of her next datagram.
fn streamed() -> (Rig, u32) {
    let mut rig = Rig::new();
    rig.server.jobs(JobsState::Streamed);
    rig.arm();
    let last = rig.read(map::SESSION_SEGMENTS).unwrap();
    (rig, last.wrapping_add(1))
}

/// A whole session, with an exchange in motion, until the machine is at rest; whether the segments
/// core was read, and written.
fn meets_segments(mut rig: Rig) -> (bool, bool) {
    let page = |address: u32| (map::SEGMENTS..map::SEGMENTS + 0x800).contains(&address);
    rig.arm();
    rig.exchange(true, true).unwrap();
    rig.server.hold_path(&mut rig.board);
    let owner = rig.server.session().token_for(ALICE);
    rig.write(map::SESSION_RELEASE, owner).unwrap();
    rig.board.gate = 0;
    rig.server.poll(&mut rig.board);
    assert!(rig.server.safety().at_rest());
    let written = |change: &Change| matches!(change, Change::Csr(address, _) if page(*address));
    let (asked, done) = (&rig.board.asked, &rig.board.done);
    (
        asked.iter().any(|address| page(*address)),
        done.iter().any(written),
    )
}

#[test]
fn a_board_without_the_segments_core_is_neither_asked_for_it_nor_told_anything() {
    assert_eq!(meets_segments(Rig::new()), (false, false));
    assert_eq!(meets_segments(Rig::with_segments()), (true, true));
}

/// The words of two segments with a push after each, and the reads of the receipt.
fn two_segments(number: u32) -> Vec<u32> {
    let mut words = vec![HEADER, 0, 0x000f_0100, map::SESSION_SEGMENTS, number];
    for n in 0..2 {
        words.extend([0x000f_0800, map::SEGMENTS, 6000 + n, 1, 2, 3, 4, 5, 6, 7]);
        words.extend([0x000f_0100, map::SEGMENTS + 64, 0]);
    }
    words.extend([0x000f_0001, 0x99, map::SEGMENTS + 88]);
    words
}

fn written(rig: &mut Rig) -> Vec<(u32, u32)> {
    let done = core::mem::take(&mut rig.board.done);
    let csr = done.into_iter().filter_map(|change| match change {
        Change::Csr(address, value) => Some((address - map::SEGMENTS, value)),
        Change::Strobe(_) | Change::Feed(_) | Change::Order(_) | Change::Set(..) => None,
    });
    csr.collect()
}

#[test]
fn the_owner_of_a_streamed_board_writes_segments_while_it_is_armed_each_datagram_once_and_in_order()
{
    let (mut rig, number) = streamed();
    written(&mut rig);
    let status = (map::SEGMENTS + 88) ^ 0x5555_0000;
    let answer = Ok(vec![HEADER, 0, 0x000f_0100, 0x99, status]);
    assert_eq!(rig.send(&two_segments(number)), answer);
    let pushed: Vec<u32> = written(&mut rig).iter().map(|(at, _)| *at).collect();
    let one = [0, 4, 8, 12, 16, 20, 24, 28, 64];
    assert_eq!(pushed, [one, one].concat());
    assert_eq!(rig.read(map::SESSION_SEGMENTS), Ok(number));
    for (again, why) in [
        (number, Refusal::Stale),
        (number.wrapping_sub(1), Refusal::Stale),
        (number.wrapping_add(2), Refusal::Stale),
    ] {
        assert_eq!(rig.send(&two_segments(again)), Err(why));
    }
    assert_eq!(written(&mut rig), []);
    assert_eq!(rig.send(&two_segments(number.wrapping_add(1))), answer);
    assert_eq!(rig.server.safety().state(), State::Armed);
}

#[test]
fn words_for_the_segments_without_a_number_in_front_of_them_are_refused() {
    let (mut rig, number) = streamed();
    written(&mut rig);
    assert_eq!(rig.write(map::SEGMENTS, 6000), Err(Refusal::ReadOnly));
    // The number after the words it belongs to.
    let words = [
        HEADER,
        0,
        0x000f_0100,
        map::SEGMENTS,
        6000,
        0x000f_0100,
        map::SESSION_SEGMENTS,
        number,
    ];
    assert_eq!(rig.send(&words), Err(Refusal::ReadOnly));
    assert_eq!(rig.read(map::SESSION_SEGMENTS), Ok(number.wrapping_sub(1)));
    assert_eq!(written(&mut rig), []);
}

#[test]
fn what_the_segments_say_is_no_more_writable_than_other_registers() {
    let (mut rig, number) = streamed();
    written(&mut rig);
    for word in 22..40 {
        let to = map::SEGMENTS + 4 * word;
        let words = [
            HEADER,
            0,
            0x000f_0100,
            map::SESSION_SEGMENTS,
            number,
            0x000f_0100,
            to,
            1,
        ];
        assert_eq!(rig.send(&words), Err(Refusal::ReadOnly), "word {word}");
    }
    assert_eq!(written(&mut rig), []);
}

#[test]
fn only_the_owner_writes_segments_and_every_client_reads_them() {
    let (mut rig, number) = streamed();
    written(&mut rig);
    assert_eq!(
        rig.send_as(BOB, &two_segments(number)[..5]),
        Err(Refusal::NotOwner)
    );
    assert_eq!(
        rig.write_as(BOB, map::SEGMENTS, 6000),
        Err(Refusal::ReadOnly)
    );
    let status = map::SEGMENTS + 88;
    assert_eq!(rig.read_as(BOB, status), Ok(status ^ 0x5555_0000));
    assert_eq!(written(&mut rig), []);
    // Datagrams on their way when the session ended do not belong to the next one.
    rig.board.bite();
    rig.server.poll(&mut rig.board);
    assert_eq!(rig.send(&two_segments(number)), Err(Refusal::NotOwner));
    rig.board.now += 1;
    rig.acquire();
    written(&mut rig);
    assert_eq!(rig.send(&two_segments(number)), Err(Refusal::Stale));
    assert_eq!(written(&mut rig), []);
}

#[test]
fn a_board_that_executes_jobs_by_itself_or_none_takes_no_segments() {
    for state in JobsState::ALL
        .iter()
        .filter(|state| **state != JobsState::Streamed)
    {
        let mut rig = Rig::new();
        rig.server.jobs(*state);
        rig.arm();
        let number = rig.read(map::SESSION_SEGMENTS).unwrap().wrapping_add(1);
        written(&mut rig);
        assert_eq!(
            rig.send(&two_segments(number)),
            Err(Refusal::ReadOnly),
            "{state:?}"
        );
        assert_eq!(
            rig.write(map::SEGMENTS + 68, 1),
            Err(Refusal::ReadOnly),
            "{state:?}"
        );
        assert_eq!(written(&mut rig), [], "{state:?}");
        let status = map::SEGMENTS + 88;
        assert_eq!(rig.read(status), Ok(status ^ 0x5555_0000), "{state:?}");
    }
}
