use super::*;
use wire::regmap::rx_admission::{MODE_SELECT_NONE, MODE_SELECT_OURS, MODE_SELECT_OWNER};

/// Bytes of the frames here, with the two in front of them.
const BYTES: usize = 80;

/// The expected word of each word of a frame: its number plus one.
fn frame() -> Vec<u32> {
    (1..=BYTES as u32 / 4).collect()
}

/// A filter that expects that frame.
fn filter() -> RxAdmission {
    let mut filter = RxAdmission::default();
    let placed = (0..18u32).filter(|n| *n != 5 && *n != 12);
    for (place, number) in placed.enumerate() {
        filter.clock(&Input {
            header: Some((place, number + 1)),
            ..Input::default()
        });
    }
    filter
}

/// Sends a frame through; true if it is refused at its last word.
fn refused(filter: &mut RxAdmission, mode: u32, frame: &[u32]) -> bool {
    let mut refused = false;
    for word in Word::of_frame(frame, BYTES) {
        refused = filter.refuses(mode);
        filter.clock(&Input {
            mode,
            word: Some(word),
            ..Input::default()
        });
    }
    refused
}

fn admit(filter: &mut RxAdmission) {
    filter.clock(&Input {
        admit: true,
        ..Input::default()
    });
}

#[test]
fn every_word_of_the_head_is_compared_with_the_one_in_its_place() {
    for (bit, [high, low]) in [
        (31, [false, true]),
        (16, [false, true]),
        (15, [true, false]),
    ] {
        for number in 0..18u8 {
            let mut filter = filter();
            for word in Word::of_frame(&frame()[..number.into()], 0) {
                let word = Some(Word {
                    last: false,
                    ..word
                });
                filter.clock(&Input {
                    word,
                    ..Input::default()
                });
            }
            let right = frame()[usize::from(number)];
            if number != 5 && number != 12 {
                let all = Compared {
                    at: number,
                    high: true,
                    low: true,
                };
                assert_eq!(filter.compares(right), all);
                let wrong = Compared {
                    at: number,
                    high,
                    low,
                };
                assert_eq!(filter.compares(right ^ 1 << bit), wrong);
            }
        }
    }
}

#[test]
fn the_owner_s_frame_is_never_refused() {
    let mut filter = filter();
    for mode in [MODE_SELECT_NONE, MODE_SELECT_OURS, MODE_SELECT_OWNER] {
        assert!(!refused(&mut filter, mode, &frame()));
    }
    assert_eq!(filter.refused(), 0);
}

#[test]
fn a_frame_that_differs_in_a_word_that_counts_is_a_guest() {
    for number in 0..18 {
        let mut other = frame();
        other[number] ^= 1 << 7;
        let ours = matches!(number, 0 | 1);
        let owners = matches!(number, 0..4 | 7 | 9);
        assert!(!refused(&mut filter(), MODE_SELECT_NONE, &other));
        assert_eq!(refused(&mut filter(), MODE_SELECT_OURS, &other), ours);
        assert_eq!(refused(&mut filter(), MODE_SELECT_OWNER, &other), owners);
    }
}

#[test]
fn a_short_frame_is_a_guest_and_arp_of_the_owner_is_not() {
    let mut filter = filter();
    assert!(refused(&mut filter, MODE_SELECT_OWNER, &frame()[..15]));
    assert!(!refused(&mut filter, MODE_SELECT_OWNER, &frame()[..16]));
    let mut arp = frame();
    arp[3] ^= 6;
    arp[7] = 0;
    assert!(!refused(&mut filter, MODE_SELECT_OWNER, &arp));
}

#[test]
fn a_ticket_lets_in_one_guest() {
    let mut filter = filter();
    let guest = vec![0; 20];
    admit(&mut filter);
    admit(&mut filter);
    let (ours, owner) = (MODE_SELECT_OURS, MODE_SELECT_OWNER);
    assert!(!refused(&mut filter, owner, &frame()));
    assert!(!refused(&mut filter, owner, &guest));
    assert!(refused(&mut filter, ours, &guest));
    assert!(refused(&mut filter, owner, &guest));
    assert_eq!(filter.refused(), 2);
}
