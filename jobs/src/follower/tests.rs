use super::*;

#[test]
fn a_segment_that_leads_to_the_reference_by_itself_is_not_corrected() {
    // 100 000 steps/s at 60 MHz, in 2^16 moves.
    let fast = 7_158_000i32;
    for (from, to) in [(0, fast), (fast, 0), (fast, -fast), (-fast, fast)] {
        let change = i64::from(to - from).unsigned_abs() << 24;
        let mut segment = Segment {
            clocks: (1 << 16) + COMMIT_CLOCKS,
            ..Segment::default()
        };
        (segment.velocity[0], segment.accel[0]) = (to, (change >> 16) as u32);
        let begin = Axis {
            velocity: i64::from(from) << 24,
            ..Axis::default()
        };
        let end = segment.play(0).after(begin, segment.clocks);
        let aim = aim(&begin, segment.clocks, end.position, end.velocity, u32::MAX);
        assert_eq!(aim, (to, segment.accel[0]), "{from} to {to}");
    }
}
