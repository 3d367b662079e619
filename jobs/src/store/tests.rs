use super::*;
use crate::instruction::{Feed, Instruction};
use crate::job::Writer;
use proptest::prelude::*;
use wire::crc::crc32;

const MEMORY: usize = 64 * (PIECE + 2);

/// A job of several blocks.
fn a_job(lines: i64) -> Vec<u8> {
    let mut writer = Writer::new("zigzag");
    let mut file = writer.header().to_vec();
    for line in 0..lines {
        let to = [1_000_003 * (line % 97), -7_919 * line, 0];
        let instruction = Instruction::Line {
            to,
            feed: Feed::Rate(1 + line as u32 % 5),
        };
        writer.add(&instruction, line as u32, |full| file.extend(full));
    }
    writer.finish(|full| file.extend(full));
    file
}

/// Uploads in chunks of these sizes, repeatedly, with this many polls of the store after each.
fn upload(file: &[u8], chunks: &[usize], looks: usize) -> Result<Entry, (Status, u32)> {
    let mut memory = vec![0xa5; MEMORY];
    let mut store = Store::new(&mut memory);
    let name = Name::new("zigzag").expect("a name");
    let mut at = store
        .put(name, file.len() as u32, crc32(file))
        .expect("room") as usize;
    for chunk in chunks.iter().cycle() {
        if at == file.len() {
            break;
        }
        let end = file.len().min(at + chunk);
        at = store.data(at as u32, &file[at..end]).expect("in order") as usize;
        (0..looks).for_each(|_| store.poll());
    }
    loop {
        match store.commit() {
            Some(end) => return end,
            None => store.poll(),
        }
    }
}

#[test]
fn a_job_that_comes_byte_by_byte_is_read_through() {
    let file = a_job(1000);
    assert!(file.len() > 5 * job::BLOCK);
    let entry = upload(&file, &[1], 1).expect("a job");
    assert_eq!((entry.ready, entry.instructions), (true, 1000));
}

proptest! {
    #[test]
    fn a_job_is_read_through_whatever_the_pieces_it_comes_in(
        lines in 0i64..1500,
        chunks in proptest::collection::vec(1usize..=wire::jobs::DATA, 1..8),
        looks in 0usize..3,
    ) {
        let entry = upload(&a_job(lines), &chunks, looks).expect("a job");
        prop_assert_eq!((entry.ready, i64::from(entry.instructions)), (true, lines));
    }
}
