//! Jobs are stored whole or not at all, by name, and an interrupted upload can be continued.

use crate::rig::*;
use proptest::prelude::*;
use wire::Name;
use wire::crc::crc32;
use wire::jobs::{self, Entry, Request, Status, Welcome};

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn many_lines(count: u32, seed: u32) -> Vec<u8> {
    let lines: String = (0..count)
        .map(|n| format!("G1 X{} Y{} F6000\n", n % 97, (n * seed) % 83))
        .collect();
    file(&program(&(lines + "M2\n")))
}

fn put(bytes: &[u8], text: &str) -> Request<'static> {
    Request::Put {
        total: bytes.len() as u32,
        crc: crc32(bytes),
        name: name(text),
    }
}

fn list(rig: &mut Rig) -> Vec<Entry> {
    let mut entries = Vec::new();
    loop {
        let index = entries.len() as u8;
        match rig.ask(&Request::List { index }) {
            (Status::Normal, payload) => entries.push(Entry::parse(&payload).unwrap()),
            (status, _) => {
                assert_eq!(status, Status::NoSuchJob);
                return entries;
            }
        }
    }
}

#[test]
fn several_jobs_are_kept_listed_deleted_and_make_room() {
    let mut rig = Rig::plotter();
    let empty = rig.connect();
    assert_eq!(empty.free, empty.room);
    let jobs: Vec<Vec<u8>> = (1..4).map(|n| many_lines(2000 * n, n)).collect();
    for (n, bytes) in (0..).zip(&jobs) {
        let entry = rig.send(&format!("job {n}"), bytes);
        assert!(
            entry.ready && entry.instructions == 2000 * (n + 1) + 1,
            "{entry:?}"
        );
    }
    let entries = list(&mut rig);
    assert_eq!(entries.len(), 3);
    for (entry, bytes) in entries.iter().zip(&jobs) {
        assert_eq!(
            (entry.count, entry.ready, entry.crc),
            (3, true, crc32(bytes))
        );
    }
    rig.ok(&Request::Delete {
        name: name("job 1"),
    });
    assert_eq!(
        rig.status(&Request::Delete {
            name: name("job 1")
        }),
        Status::NoSuchJob
    );
    assert_eq!(list(&mut rig).len(), 2);
    // Into the hole, and more of it than the hole is.
    let entry = rig.send("job 3", &many_lines(7000, 5));
    assert!(entry.ready);
    for text in ["job 0", "job 2", "job 3"] {
        rig.ok(&Request::Delete { name: name(text) });
    }
    assert_eq!(rig.connect().free, empty.room);
}

#[test]
fn an_upload_that_was_cut_goes_on_where_it_was() {
    let mut rig = Rig::plotter();
    let bytes = many_lines(3000, 7);
    assert_eq!(jobs::word(&rig.ok(&put(&bytes, "x"))), Some(0));
    for piece in bytes.chunks(1000).take(7).enumerate() {
        rig.ok(&Request::Data {
            offset: 1000 * piece.0 as u32,
            bytes: piece.1,
        });
    }
    assert_eq!(rig.ask(&Request::Commit).0, Status::Incomplete);
    // Half a request, and the connection is gone. Another job comes in between.
    let mut out = [0; jobs::FRAME];
    let length = Request::Data {
        offset: 7000,
        bytes: &bytes[7000..8000],
    }
    .emit(99, &mut out);
    rig.bytes(&out[..8]);
    let _ = length;
    rig.connect();
    rig.send("y", &many_lines(100, 3));
    assert_eq!(
        rig.command_with(2, jobs::UNATTENDED, 0, "x"),
        Status::Incomplete
    );
    assert_eq!(jobs::word(&rig.ok(&put(&bytes, "x"))), Some(7000));
    // Bytes that were here already are not taken again.
    let again = Request::Data {
        offset: 6000,
        bytes: &bytes[6000..7000],
    };
    let (status, payload) = rig.ask(&again);
    assert_eq!((status, jobs::word(&payload)), (Status::Offset, Some(7000)));
    assert!(rig.send("x", &bytes).ready);
    // All of it is here: nothing is sent again.
    assert_eq!(
        jobs::word(&rig.ok(&put(&bytes, "x"))),
        Some(bytes.len() as u32)
    );
    assert!(Entry::parse(&rig.ok(&Request::Commit)).unwrap().ready);
    rig.ok(&Request::Delete { name: name("y") });
}

#[test]
fn a_store_that_is_full_says_what_is_free_and_keeps_what_it_has() {
    let mut rig = Rig::with_room(sim::plant::Plant::direct(0), 100_000);
    let Welcome { room, .. } = rig.connect();
    assert_eq!(room, 24 * 4096);
    rig.send("small", &many_lines(1000, 3));
    let free = rig.connect().free;
    let put = Request::Put {
        total: free + 1,
        crc: 0,
        name: name("big"),
    };
    let (status, payload) = rig.ask(&put);
    assert_eq!((status, jobs::word(&payload)), (Status::Full, Some(free)));
    let put = Request::Put {
        total: free,
        crc: 0,
        name: name("big"),
    };
    assert_eq!(rig.status(&put), Status::Normal);
    // What is promised to one is not given to another.
    let put = Request::Put {
        total: 1,
        crc: 0,
        name: name("other"),
    };
    assert_eq!(rig.status(&put), Status::Full);
    assert_eq!(list(&mut rig).len(), 2);
    assert!(list(&mut rig)[0].ready);
}

#[test]
fn a_job_that_would_not_fit_leaves_the_one_of_its_name_and_one_that_does_takes_its_room() {
    let mut rig = Rig::with_room(sim::plant::Plant::direct(0), 100_000);
    let small = many_lines(1000, 3);
    rig.send("x", &small);
    let Welcome { room, free, .. } = rig.connect();
    assert!(free < room);
    let big = |total| Request::Put {
        total,
        crc: 0,
        name: name("x"),
    };
    assert_eq!(rig.status(&big(room + 1)), Status::Full);
    let [entry] = list(&mut rig)[..] else {
        panic!("it is gone")
    };
    assert!(entry.ready && entry.crc == crc32(&small), "{entry:?}");
    assert_eq!(rig.connect().free, free);
    assert_eq!(jobs::word(&rig.ok(&big(room))), Some(0));
    assert_eq!(rig.connect().free, room);
}

#[test]
fn what_arrived_garbled_and_what_is_no_job_are_told_apart() {
    let mut rig = Rig::plotter();
    let good = many_lines(500, 3);
    let mut bad = good.clone();
    bad[2000] ^= 4;
    // Sent as said, but no job.
    rig.ok(&put(&bad, "x"));
    for (n, piece) in (0..).zip(bad.chunks(jobs::DATA)) {
        rig.ok(&Request::Data {
            offset: n * jobs::DATA as u32,
            bytes: piece,
        });
    }
    let (status, payload) = rig.ask(&Request::Commit);
    assert_eq!(status, Status::NoJob);
    assert!(
        (1000..2000).contains(&jobs::word(&payload).unwrap()),
        "the block of it"
    );
    // Said otherwise than sent.
    rig.ok(&put(&good, "x"));
    for (n, piece) in (0..).zip(bad.chunks(jobs::DATA)) {
        rig.ok(&Request::Data {
            offset: n * jobs::DATA as u32,
            bytes: piece,
        });
    }
    assert_eq!(rig.status(&Request::Commit), Status::Crc);
    assert!(list(&mut rig).is_empty(), "begins again");
    assert!(rig.send("x", &good).ready);
    // No job at all, a cut one, and two in one.
    let cut = &good[..good.len() - 12];
    let two = [&good[..], &good[..]].concat();
    for bytes in [&b"G1 X10\n"[..], cut, &two] {
        rig.ok(&put(bytes, "z"));
        for (n, piece) in (0..).zip(bytes.chunks(jobs::DATA)) {
            rig.ok(&Request::Data {
                offset: n * jobs::DATA as u32,
                bytes: piece,
            });
        }
        assert_eq!(rig.status(&Request::Commit), Status::NoJob);
    }
}

#[test]
fn a_frame_that_is_garbled_is_the_last_of_its_connection() {
    let mut rig = Rig::plotter();
    let mut out = [0; jobs::FRAME];
    let length = Request::Report.emit(3, &mut out);
    out[length - 1] ^= 1;
    let answer = rig.bytes(&out[..length]);
    assert_eq!(answer[1], Status::Garbled.code());
    rig.connect();
    rig.report();
}

#[test]
fn a_client_without_a_hello_is_asked_for_one() {
    let mut rig = Rig::plotter();
    rig.hang_up();
    assert_eq!(rig.status(&Request::Report), Status::NoHello);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(6) })]

    /// With any sizes of pieces and any number of interruptions the stored job equals the one that
    /// was sent.
    #[test]
    fn an_upload_in_any_pieces_is_byte_identical(sizes in proptest::collection::vec(1..=jobs::DATA, 5..40), cuts in proptest::collection::vec(0..60usize, 0..4)) {
        let mut rig = Rig::plotter();
        let bytes = many_lines(1500, 11);
        let mut offset = jobs::word(&rig.ok(&put(&bytes, "x"))).unwrap() as usize;
        for (n, size) in sizes.iter().cycle().enumerate() {
            if offset == bytes.len() {
                break;
            }
            if cuts.contains(&n) {
                rig.connect();
                prop_assert_eq!(jobs::word(&rig.ok(&put(&bytes, "x"))), Some(offset as u32));
            }
            let end = bytes.len().min(offset + size);
            let data = Request::Data { offset: offset as u32, bytes: &bytes[offset..end] };
            offset = jobs::word(&rig.ok(&data)).unwrap() as usize;
            prop_assert_eq!(offset, end);
        }
        let entry = Entry::parse(&rig.ok(&Request::Commit)).unwrap();
        prop_assert!(entry.ready && entry.crc == crc32(&bytes));
    }
}
