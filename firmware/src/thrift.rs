//! Small and slow replacements for functions of the compiler's own library.
//!
//! The image has 72 KiB of ROM ([decision 7](../../docs/decisions/0007-an-ip-stack-that-fits.md)).
//! A `memmove` costs 960 bytes of it and a 64-bit division 724, for a console's text and a time
//! stamp. No exchange uses these functions.

/// Moves all bytes from `count` on to the front: `bytes.copy_within(count.., 0)`, except that the
/// bytes after the moved ones may change. A `count` beyond the end moves nothing.
pub fn move_down(bytes: &mut [u8], count: usize) {
    // Swapped, not copied: the compiler would turn a loop that copies into the `memmove`.
    for at in count..bytes.len() {
        // A pattern instead of two indices, so that the compiler sees no index out of range.
        if let Some([to, .., from]) = bytes.get_mut(at - count..=at) {
            core::mem::swap(to, from);
        }
    }
}

/// `dividend / divisor`, one bit at a time; 0 when the divisor is 0.
pub fn divide(dividend: u64, divisor: u32) -> u64 {
    if divisor == 0 {
        return 0;
    }
    let (mut rest, mut quotient) = (0, 0);
    for bit in (0..u64::BITS).rev() {
        rest = rest << 1 | (dividend >> bit & 1);
        quotient <<= 1;
        if rest >= u64::from(divisor) {
            rest -= u64::from(divisor);
            quotient |= 1;
        }
    }
    quotient
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_moved_down_is_what_copy_within_moves(bytes in proptest::collection::vec(any::<u8>(), 0..80), count in 0usize..90) {
            let (mut moved, mut copied) = (bytes.clone(), bytes);
            let count = count.min(moved.len());
            move_down(&mut moved, count);
            copied.copy_within(count.., 0);
            let left = copied.len() - count;
            prop_assert_eq!(&moved[..left], &copied[..left]);
        }

        #[test]
        fn a_quotient_is_the_processors(dividend: u64, divisor in 1u32..) {
            prop_assert_eq!(divide(dividend, divisor), dividend / u64::from(divisor));
        }
    }

    #[test]
    fn the_ends_of_the_numbers_divide() {
        for dividend in [0, 1, u64::from(u32::MAX), 1 << 32, u64::MAX - 1, u64::MAX] {
            for divisor in [1, 2, 60, 60_000, 1 << 31, u32::MAX] {
                assert_eq!(divide(dividend, divisor), dividend / u64::from(divisor));
            }
            assert_eq!(divide(dividend, 0), 0);
        }
    }

    #[test]
    fn a_count_beyond_the_end_moves_nothing() {
        let mut bytes = [1, 2, 3];
        move_down(&mut bytes, 4);
        assert_eq!(bytes, [1, 2, 3]);
    }
}
