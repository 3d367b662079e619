extern crate std;
use super::*;
use proptest::prelude::*;
use std::vec::Vec;

fn written(program: &[(Instruction, u32)]) -> Vec<u8> {
    let mut writer = Writer::new("part");
    let mut file = writer.header().to_vec();
    for (instruction, line) in program {
        writer.add(instruction, *line, |block| file.extend(block));
    }
    writer.finish(|block| file.extend(block));
    file
}

fn read(file: &[u8]) -> Result<Vec<(Instruction, u32)>, Error> {
    let (mut reader, mut program, mut at) = (Reader::default(), Vec::new(), 0);
    while at < file.len() {
        at += reader.block(&file[at..], |instruction, line| {
            program.push((instruction, line))
        })?;
    }
    reader.summary().map(|_| program).ok_or(Error::Cut)
}

fn any_instruction() -> impl Strategy<Value = Instruction> {
    let nm = prop_oneof![Just(0), -1000..1000i64, -FARTHEST..=FARTHEST];
    let place = proptest::array::uniform3(nm.clone());
    let feed = prop_oneof![
        Just(Feed::Rapid),
        Just(Feed::Rate(7)),
        (1..=u32::MAX).prop_map(Feed::Rate)
    ];
    let rate = (1..=u32::MAX).prop_map(Feed::Rate);
    prop_oneof![
        (place.clone(), feed).prop_map(|(to, feed)| Instruction::Line { to, feed }),
        (place, proptest::array::uniform2(nm), any::<bool>(), rate).prop_map(
            |(to, center, clockwise, feed)| {
                Instruction::Arc(Arc {
                    to,
                    center,
                    clockwise,
                    feed,
                })
            }
        ),
        (0..=DWELL_LONGEST).prop_map(|micros| Instruction::Dwell { micros }),
        any::<u16>().prop_map(|bits| Instruction::Aux { bits }),
        any::<[bool; 3]>().prop_map(|axes| Instruction::Home { axes }),
        Just(Instruction::Pause),
        Just(Instruction::End),
    ]
}

fn any_program() -> impl Strategy<Value = Vec<(Instruction, u32)>> {
    proptest::collection::vec((any_instruction(), any::<u32>()), 0..300)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(100) })]

    #[test]
    fn what_is_written_is_read(program in any_program()) {
        prop_assert_eq!(read(&written(&program)).unwrap(), program);
    }

    #[test]
    fn a_changed_byte_is_noticed(program in any_program(), at: proptest::sample::Index, change in 1..=255u8) {
        let mut file = written(&program);
        let at = at.index(file.len());
        file[at] ^= change;
        prop_assert!(read(&file).is_err());
    }

    #[test]
    fn a_cut_is_noticed(program in any_program(), at: proptest::sample::Index) {
        let file = written(&program);
        prop_assert!(read(&file[..at.index(file.len())]).is_err());
    }

    #[test]
    fn no_payload_makes_it_panic(payload in proptest::collection::vec(any::<u8>(), 0..300)) {
        let mut reader = Reader::default();
        let mut fields = Fields(&payload);
        while !fields.0.is_empty() && reader.instruction(&mut fields).is_ok() {}
    }
}

#[test]
fn a_dwell_longer_than_a_week_is_no_instruction() {
    for micros in [DWELL_LONGEST + 1, u64::MAX / 60, u64::MAX] {
        let mut writer = Writer::new("x");
        let mut file = writer.header().to_vec();
        writer.add(&Instruction::Dwell { micros }, 1, |block| {
            file.extend(block)
        });
        writer.finish(|block| file.extend(block));
        let mut reader = Reader::default();
        let header = reader.block(&file, |_, _| {}).unwrap();
        let read = reader.block(&file[header..], |instruction, _| panic!("{instruction:?}"));
        assert!(matches!(read, Err(Error::Instruction(_))), "{read:?}");
    }
}

/// The blocks of a file.
fn blocks(file: &[u8]) -> Vec<&[u8]> {
    let (mut blocks, mut at, mut crc) = (Vec::new(), 0, 0);
    while at < file.len() {
        let block = Block::parse(&file[at..], crc).unwrap();
        crc = block.crc;
        blocks.push(&file[at..at + block.length]);
        at += block.length;
    }
    blocks
}

fn many_lines() -> Vec<u8> {
    let line = |i: u32| {
        (
            Instruction::Line {
                to: [i64::from(i) * 12_345, 0, 0],
                feed: Feed::Rate(1_000_000),
            },
            i,
        )
    };
    written(&(1..2000).map(line).collect::<Vec<_>>())
}

#[test]
fn a_block_lost_doubled_or_moved_is_noticed() {
    let file = many_lines();
    let blocks = blocks(&file);
    assert!(blocks.len() > 5);
    let lost = [&blocks[..2], &blocks[3..]].concat().concat();
    let doubled = [&blocks[..3], &blocks[2..]].concat().concat();
    let moved = [&blocks[..1], &[blocks[2], blocks[1]], &blocks[3..]]
        .concat()
        .concat();
    for file in [lost, doubled, moved] {
        assert!(
            matches!(read(&file), Err(Error::Crc { .. })),
            "{:?}",
            read(&file)
        );
    }
}

#[test]
fn a_line_of_a_millimetre_takes_six_bytes() {
    let file = many_lines();
    assert!(file.len() < 2000 * 6, "{} bytes", file.len());
}

#[test]
fn another_version_says_so() {
    assert_eq!(name_of(&[2, b'x']), Err(Error::Version { theirs: 2 }));
    assert_eq!(name_of(b"\x01part"), Ok("part"));
}

#[test]
fn a_long_name_is_cut_between_letters() {
    let name = "ö".repeat(40);
    let mut writer = Writer::new(&name);
    let block = Block::parse(writer.header(), 0).unwrap();
    assert_eq!(name_of(block.payload), Ok("ö".repeat(32).as_str()));
}

#[test]
fn other_files_are_no_jobs() {
    assert_eq!(read(b"G1 X1 F100 and so on"), Err(Error::NoBlock));
    assert_eq!(read(b""), Err(Error::Cut));
}
