use super::*;
use proptest::prelude::*;

const US: Us = Us {
    mac: [2, 0, 0, 0, 0, 1],
    ip: 0xc0a8_0232,
    port: 1234,
};
const THEIRS: [u8; 6] = [2, 0, 0, 0, 0, 9];

/// Ones' complement sum, not by the library that is tested.
fn sum(bytes: &[u8]) -> u16 {
    let words = bytes.chunks(2);
    let sum = words.fold(0u32, |sum, pair| {
        sum + (u32::from(pair[0]) << 8 | u32::from(*pair.get(1).unwrap_or(&0)))
    });
    let sum = (sum >> 16) + (sum & 0xffff);
    ((sum >> 16) + (sum & 0xffff)) as u16
}

fn answered(frame: &[u8]) -> Option<Vec<u8>> {
    let mut out = [0xee; ROOM];
    answer(frame, &US, &mut out).map(|length| out[..length].to_vec())
}

/// A request for this address.
fn arp_request(about: [u8; 4]) -> Vec<u8> {
    let mut frame = [0xff; 6].to_vec();
    frame.extend(THEIRS);
    frame.extend([8, 6, 0, 1, 8, 0, 6, 4, 0, 1]);
    frame.extend(THEIRS);
    frame.extend([192, 168, 2, 1, 0, 0, 0, 0, 0, 0]);
    frame.extend(about);
    frame.resize(60, 0);
    frame
}

/// A ping with this payload.
fn echo_request(payload: &[u8]) -> Vec<u8> {
    let mut icmp = vec![8, 0, 0, 0, 0x12, 0x34, 0, 7];
    icmp.extend(payload);
    let check = !sum(&icmp);
    icmp[2..4].copy_from_slice(&check.to_be_bytes());
    let length = (20 + icmp.len()) as u16;
    let mut ip = vec![0x45, 0];
    ip.extend(length.to_be_bytes());
    ip.extend([
        0xbe, 0xef, 0x40, 0, 64, 1, 0, 0, 192, 168, 2, 1, 192, 168, 2, 50,
    ]);
    let check = !sum(&ip);
    ip[10..12].copy_from_slice(&check.to_be_bytes());
    [&US.mac[..], &THEIRS, &[8, 0], &ip, &icmp].concat()
}

#[test]
fn an_arp_request_about_us_is_answered_to_its_sender_and_no_other_one_is() {
    let expected = [
        &THEIRS[..],
        &US.mac,
        &[8, 6, 0, 1, 8, 0, 6, 4, 0, 2],
        &US.mac,
        &[192, 168, 2, 50],
        &THEIRS,
        &[192, 168, 2, 1],
    ];
    assert_eq!(
        answered(&arp_request([192, 168, 2, 50])),
        Some(expected.concat())
    );
    assert_eq!(answered(&arp_request([192, 168, 2, 51])), None);
    let mut reply = arp_request([192, 168, 2, 50]);
    reply[21] = 2;
    assert_eq!(answered(&reply), None, "an answer is no question");
}

#[test]
fn a_ping_comes_back_with_its_payload_and_right_sums() {
    for length in [0, 1, 8, 56, 86, 1472] {
        let payload: Vec<u8> = (0..length).map(|at| at as u8).collect();
        let answer = answered(&echo_request(&payload)).expect("an answer");
        assert_eq!(answer[..14], [&THEIRS[..], &US.mac, &[8, 0]].concat());
        assert_eq!(answer[26..34], [192, 168, 2, 50, 192, 168, 2, 1]);
        assert_eq!(answer[22..24], [64, 1], "a life of 64 hops, ICMP");
        assert_eq!((sum(&answer[14..34]), sum(&answer[34..])), (0xffff, 0xffff));
        assert_eq!(answer[34..36], [0, 0], "an echo reply");
        assert_eq!(answer[38..42], [0x12, 0x34, 0, 7], "the same number");
        assert_eq!(answer[42..], payload[..]);
    }
}

#[test]
fn a_ping_that_came_a_long_way_is_answered_with_a_long_life() {
    for ttl in [0, 1, 63, 65, 255] {
        let mut frame = echo_request(b"far");
        frame[22] = ttl;
        frame[24..26].fill(0);
        let check = !sum(&frame[14..34]);
        frame[24..26].copy_from_slice(&check.to_be_bytes());
        let answer = answered(&frame).expect("an answer");
        assert_eq!((answer[22], sum(&answer[14..34])), (64, 0xffff), "{ttl}");
    }
}

#[test]
fn a_damaged_ping_a_fragment_and_what_is_no_ping_get_no_answer() {
    let whole = echo_request(&[1, 2, 3, 4]);
    for at in 14..whole.len() {
        let mut frame = whole.clone();
        frame[at] ^= 0x10;
        assert_eq!(answered(&frame), None, "byte {at}");
    }
    for length in 0..whole.len() {
        assert_eq!(answered(&whole[..length]), None, "{length} bytes of it");
    }
    let mut fragment = whole;
    fragment[20] = 0x20;
    fragment[24..26].fill(0);
    let check = !sum(&fragment[14..34]);
    fragment[24..26].copy_from_slice(&check.to_be_bytes());
    assert_eq!(answered(&fragment), None, "more fragments follow");
}

proptest! {
    #[test]
    fn any_bytes_are_answered_or_not_and_nothing_else(frame in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = answered(&frame);
    }

    #[test]
    fn a_frame_with_any_bytes_changed_too(changes in proptest::collection::vec((0usize..100, any::<u8>()), 0..6), arp: bool) {
        let mut frame = if arp { arp_request([192, 168, 2, 50]) } else { echo_request(&[7; 40]) };
        for (at, byte) in changes {
            if let Some(place) = frame.get_mut(at) {
                *place = byte;
            }
        }
        let _ = answered(&frame);
    }
}
