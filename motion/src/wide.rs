//! Products and quotients of more than 32 bits, for a 32-bit processor.
//!
//! The code a compiler makes for `i128`, or for a division of `u64`, takes the softcore up to about
//! a thousand clocks: bit by bit, and through memory. This module uses schoolbook arithmetic with
//! digits of 32 bits, where a digit of a quotient takes two of the processor's divisions. A PC has
//! instructions for all of it, and uses them; the tests compare both.

const PC: bool = cfg!(target_pointer_width = "64");

/// `a * b`, the low half first.
pub fn product(a: u64, b: u64) -> [u64; 2] {
    if PC {
        let all = u128::from(a) * u128::from(b);
        [all as u64, (all >> 64) as u64]
    } else {
        product_by_digits(a, b)
    }
}

/// `floor(a * b / 2^shift)`, its lowest 64 bits; `shift` is from 1 to 127.
#[inline]
pub fn scaled(a: i64, b: i64, shift: u32) -> i64 {
    if PC {
        ((i128::from(a) * i128::from(b)) >> shift) as i64
    } else {
        scaled_by_digits(a, b, shift)
    }
}

/// `floor(n / d)`; `u64::MAX` by 0.
pub fn quotient(n: u64, d: u64) -> u64 {
    if d == 0 {
        u64::MAX
    } else if PC {
        n / d
    } else {
        quotient_by_digits(n, d)
    }
}

/// `n / d`, rounded up; `u64::MAX` by 0.
pub fn quotient_up(n: u64, d: u64) -> u64 {
    match n {
        0 => 0,
        _ => quotient(n - 1, d).saturating_add(1),
    }
}

/// `floor(n / d)` and the remainder, if the quotient has at most 32 bits: `n < d * 2^32`.
pub fn short(n: u64, d: u32) -> (u32, u32) {
    if PC {
        let d = u64::from(d.max(1));
        ((n / d) as u32, (n % d) as u32)
    } else {
        let [low, high] = digits(n);
        digit(high, low, d)
    }
}

/// `floor(n / d)` of 128 bits, the low half first; `u64::MAX` if it is more than that.
pub fn wide([low, high]: [u64; 2], d: u64) -> u64 {
    if high >= d {
        u64::MAX
    } else if PC {
        ((u128::from(high) << 64 | u128::from(low)) / u128::from(d)) as u64
    } else {
        wide_by_digits([low, high], d)
    }
}

/// `floor(sqrt(n))` of 128 bits, the low half first.
pub fn root([low, high]: [u64; 2]) -> u64 {
    if PC {
        (u128::from(high) << 64 | u128::from(low)).isqrt() as u64
    } else {
        root_by_digits([low, high])
    }
}

/// `floor(n * 2^shift / d)` towards 0, with the sign of `n`, for `shift` from 1 to 63; what does
/// not fit is the largest there is.
pub fn ratio(n: i64, shift: u32, d: u64) -> i64 {
    let size = n.unsigned_abs();
    let all = [size << shift, size >> (64 - shift)];
    let size = i64::try_from(wide(all, d)).unwrap_or(i64::MAX);
    if n < 0 { -size } else { size }
}

fn digits(n: u64) -> [u32; 2] {
    [n as u32, (n >> 32) as u32]
}

fn both(low: u32, high: u32) -> u64 {
    u64::from(high) << 32 | u64::from(low)
}

fn times(a: u32, b: u32) -> u64 {
    u64::from(a) * u64::from(b)
}

fn product_by_digits(a: u64, b: u64) -> [u64; 2] {
    let ([a0, a1], [b0, b1]) = (digits(a), digits(b));
    let low = times(a0, b0);
    // A product of digits leaves room for two more of them.
    let middle = times(a1, b0) + (low >> 32);
    let other = times(a0, b1) + (middle & 0xffff_ffff);
    let high = times(a1, b1) + (middle >> 32) + (other >> 32);
    [other << 32 | low & 0xffff_ffff, high]
}

#[inline]
fn scaled_by_digits(a: i64, b: i64, shift: u32) -> i64 {
    let [low, high] = product_by_digits(a as u64, b as u64);
    let high = (high as i64)
        .wrapping_sub(a >> 63 & b)
        .wrapping_sub(b >> 63 & a);
    match shift {
        64.. => high >> (shift - 64),
        _ => (low >> shift) as i64 | high << (64 - shift),
    }
}

fn quotient_by_digits(n: u64, d: u64) -> u64 {
    let ([n0, n1], [d0, d1]) = (digits(n), digits(d));
    match (n1, d1) {
        (0, 0) => u64::from(n0 / d0),
        (_, 0) => {
            let (low, _) = digit(n1 % d0, n0, d0);
            both(low, n1 / d0)
        }
        _ => wide_by_digits([n, 0], d),
    }
}

/// `high < d`.
fn wide_by_digits([low, high]: [u64; 2], d: u64) -> u64 {
    let [d0, d1] = digits(d);
    if d1 == 0 {
        let ([n0, n1], [n2, _]) = (digits(low), digits(high));
        let (q1, rest) = digit(n2, n1, d0);
        let (q0, _) = digit(rest, n0, d0);
        return both(q0, q1);
    }
    // If the divisor's highest bit is set, a digit guessed from its upper half is at most two too
    // large.
    let up = d1.leading_zeros();
    let d = d << up;
    let high = high << up | if up == 0 { 0 } else { low >> (64 - up) };
    let [n0, n1] = digits(low << up);
    let (q1, rest) = digit_by_two(high, n1, d);
    let (q0, _) = digit_by_two(rest, n0, d);
    both(q0, q1)
}

/// A digit of a quotient and the remainder: two digits by one; `high < d`.
fn digit(high: u32, low: u32, d: u32) -> (u32, u32) {
    if high == 0 {
        return (low / d, low % d);
    }
    // The same with half digits, which the processor can divide.
    let up = d.leading_zeros();
    let d = d << up;
    let n = both(low, high) << up;
    let [low, high] = digits(n);
    let (q1, rest) = half_digit(high, low >> 16, d);
    let (q0, rest) = half_digit(rest, low & 0xffff, d);
    (q1 << 16 | q0, rest >> up)
}

/// Half a digit: `high * 2^16 + low` by `d`, with the highest bit of `d` set.
fn half_digit(high: u32, low: u32, d: u32) -> (u32, u32) {
    let (d1, d0) = (d >> 16, d & 0xffff);
    let (mut q, mut rest) = (high / d1, high % d1);
    // The guess ignores the divisor's lower half.
    while q >> 16 != 0 || q.wrapping_mul(d0) > (rest << 16 | low) {
        q -= 1;
        rest += d1;
        if rest >> 16 != 0 {
            break;
        }
    }
    let all = (high << 16 | low).wrapping_sub(q.wrapping_mul(d));
    (q, all)
}

/// A digit: three digits by two, the divisor's highest bit set; `high < d`.
fn digit_by_two(high: u64, low: u32, d: u64) -> (u32, u64) {
    let ([_, d1], [n1, n2]) = (digits(d), digits(high));
    let mut q = if n2 < d1 {
        digit(n2, n1, d1).0
    } else {
        u32::MAX
    };
    let [low_part, high_part] = product_by_digits(d, q.into());
    let (mut rest, borrow) = both(low, n1).overflowing_sub(low_part);
    let mut over = u64::from(n2)
        .wrapping_sub(high_part)
        .wrapping_sub(borrow.into());
    while over != 0 {
        let (more, carry) = rest.overflowing_add(d);
        (q, rest, over) = (q - 1, more, over.wrapping_add(carry.into()));
    }
    (q, rest)
}

/// The root of the upper half is the root's upper digit. The remainder divided by twice the digit
/// is the lower digit, or one more than it.
fn root_by_digits([low, high]: [u64; 2]) -> u64 {
    if (low, high) == (0, 0) {
        return 0;
    }
    let zeros = match high {
        0 => 64 + low.leading_zeros(),
        _ => high.leading_zeros(),
    };
    // Scaled up by a power of four, until one of the two highest bits is set.
    let up = zeros & !1;
    let (low, high) = match up {
        0 => (low, high),
        1..64 => (low << up, high << up | low >> (64 - up)),
        _ => (0, low << (up - 64)),
    };
    let [n0, n1] = digits(low);
    let upper = high.isqrt();
    // At most twice the digit: with half of the next digit after it, it still has 64 bits.
    let half = (high - upper * upper) << 31 | u64::from(n1 >> 1);
    let lower = quotient_by_digits(half, upper);
    let left = (half - lower * upper) << 1 | u64::from(n1 & 1);
    // The guess ignores its own square.
    let square = lower.checked_mul(lower);
    let large = left >> 32 == 0 && square.is_none_or(|square| both(n0, left as u32) < square);
    let root = (upper << 32).wrapping_add(lower);
    root.wrapping_sub(large.into()) >> (up / 2)
}

/// Divides many numbers by one, with a product each: [`Inverse::of`] is at most 2 too small, and
/// never too large.
#[derive(Clone, Copy, Debug)]
pub struct Inverse {
    /// `2^(127 - zeros) / d`: its highest bit is set.
    inverse: u64,
    zeros: u32,
}

impl Inverse {
    /// For `d` = 0 the inverse of 1.
    pub fn new(d: u64) -> Self {
        let d = d.max(1);
        let zeros = d.leading_zeros();
        Inverse {
            inverse: wide([0, 1 << 63], d << zeros),
            zeros,
        }
    }

    /// `n * 2^shift / d` towards 0, for `shift` up to 63; what does not fit is cut.
    pub fn of(self, n: i64, shift: u32) -> i64 {
        let [low, high] = product(n.unsigned_abs(), self.inverse);
        let size = match 127 - self.zeros - shift {
            0 => low,
            down @ 1..64 => low >> down | high << (64 - down),
            down => high >> (down - 64),
        };
        let sign = n >> 63;
        (size as i64 ^ sign) - sign
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    /// Every magnitude as likely as any other, and the ends of digits.
    fn any_word() -> impl Strategy<Value = u64> {
        let edge =
            (0..64u32, -2i64..=2).prop_map(|(bit, off)| (1u64 << bit).wrapping_add_signed(off));
        let even = (any::<u64>(), 0..64u32).prop_map(|(word, less)| word >> less);
        prop_oneof![even, edge]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn products_and_quotients_by_digits_are_those_of_the_pc(a in any_word(), b in any_word(), d in any_word(), shift in 1u32..128) {
            let [low, high] = product_by_digits(a, b);
            let all = u128::from(a) * u128::from(b);
            prop_assert_eq!((low, high), (all as u64, (all >> 64) as u64));
            prop_assert_eq!(product(a, b), [low, high]);
            let (x, y) = (a as i64, b as i64);
            let expected = ((i128::from(x) * i128::from(y)) >> shift) as i64;
            prop_assert_eq!(scaled_by_digits(x, y, shift), expected);
            prop_assert_eq!(scaled(x, y, shift), expected);
            if let (Some(quotient), true) = (a.checked_div(d), d > 0) {
                prop_assert_eq!(quotient_by_digits(a, d), quotient);
                prop_assert_eq!(super::quotient(a, d), quotient);
                prop_assert_eq!(quotient_up(a, d), a.div_ceil(d));
            }
            if high < d {
                prop_assert_eq!(wide_by_digits([low, high], d), (all / u128::from(d)) as u64);
                prop_assert_eq!(wide([low, high], d), (all / u128::from(d)) as u64);
            }
            let (d, n) = (d as u32, a % (u64::from(d as u32).max(1) << 32));
            if d > 0 {
                let expected = ((n / u64::from(d)) as u32, (n % u64::from(d)) as u32);
                prop_assert_eq!(digit((n >> 32) as u32, n as u32, d), expected);
                prop_assert_eq!(short(n, d), expected);
            }
        }

        #[test]
        fn a_ratio_keeps_its_sign_and_says_what_does_not_fit(n: i64, shift in 1u32..64, d in any_word()) {
            let exact = if d == 0 { i128::MAX * i128::from(n.signum()) } else { (i128::from(n.unsigned_abs()) << shift) / i128::from(d) * i128::from(n.signum()) };
            let expected = exact.clamp(-i128::from(i64::MAX), i64::MAX.into()) as i64;
            prop_assert_eq!(ratio(n, shift, d), expected);
        }

        #[test]
        fn an_inverse_divides_to_within_two(n: i64, d in any_word(), shift in 0u32..64) {
            let exact = (i128::from(n.unsigned_abs()) << shift) / i128::from(d.max(1));
            if exact < 1 << 63 {
                let found = i128::from(Inverse::new(d).of(n, shift)) * i128::from(n.signum());
                prop_assert!((exact - 2..=exact).contains(&found), "{found} for {exact}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        #[test]
        fn a_root_by_digits_is_that_of_the_pc(low in any_word(), high in any_word(), root in any_word(), off in -2i64..=2) {
            // Random numbers, and squares and their neighbours.
            let square = (u128::from(root) * u128::from(root)).wrapping_add_signed(off.into());
            for [low, high] in [[low, high], [low, 0], [square as u64, (square >> 64) as u64]] {
                let exact = (u128::from(high) << 64 | u128::from(low)).isqrt() as u64;
                prop_assert_eq!(root_by_digits([low, high]), exact, "{}, {}", low, high);
                prop_assert_eq!(super::root([low, high]), exact);
            }
        }
    }

    #[test]
    fn nothing_by_zero_is_nothing_that_panics() {
        assert_eq!(quotient(5, 0), u64::MAX);
        assert_eq!(wide([5, 0], 0), u64::MAX);
        assert_eq!(root_by_digits([0, 0]), 0);
        assert_eq!(root_by_digits([u64::MAX, u64::MAX]), u64::MAX);
    }
}
