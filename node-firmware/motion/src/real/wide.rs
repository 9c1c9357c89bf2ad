//! Products, quotients and roots of 62-bit mantissas, for a machine that multiplies 32 bits by 32
//! and divides 32 by 32. Exact: what is cut is known, no result depends on the machine.
//!
//! Quotient and root begin with a reciprocal of some 28 bits (one short division, one step of
//! Newton's method) and take the result in three digits, each with the exact rest of the one
//! before. Where a digit is one too small or too large, the next one or the last test mends it.

/// Returns the 128 bits of a · b, upper half first.
pub(super) const fn product(a: u64, b: u64) -> (u64, u64) {
    let (a_high, a_low) = (a >> 32, a & LOW);
    let (b_high, b_low) = (b >> 32, b & LOW);
    let low = a_low * b_low;
    let (cross, other) = (a_high * b_low, a_low * b_high);
    let middle = (low >> 32) + (cross & LOW) + (other & LOW);
    let high = a_high * b_high + (cross >> 32) + (other >> 32) + (middle >> 32);
    (high, (middle << 32) | (low & LOW))
}

const LOW: u64 = 0xffff_ffff;

/// Returns ⌊a · 2⁶² / b⌋; both from 2⁶¹ to 2⁶².
pub(super) const fn quotient(a: u64, b: u64) -> u64 {
    // ≥ 2⁻³¹ · b, so that no digit is too large.
    let divisor = (b >> 31) + 1;
    let short = (u32::MAX / (divisor >> 15) as u32) as u64;
    let error = (1 << 47) - (divisor * short) as i64;
    // ≤ 2⁹³ / b, by less than 2⁻²⁸ of it.
    let inverse = ((short << 15) as i64 + ((error * short as i64) >> 32)) as u64 & LOW;
    let (first, rest) = digit(a, b, inverse, 21);
    let (second, rest) = digit(rest, b, inverse, 21);
    let (third, mut rest) = digit(rest, b, inverse, 20);
    let mut quotient = (first << 41) + (second << 20) + third;
    while rest >= b {
        rest -= b;
        quotient += 1;
    }
    quotient
}

/// Returns the next bits of rest / b, at most one too small, and what is left; `rest` < 2b + 1.
#[inline(always)]
const fn digit(rest: u64, b: u64, inverse: u64, bits: u32) -> (u64, u64) {
    let digit = ((rest >> 32) * inverse) >> (61 - bits);
    let left = (rest << bits).wrapping_sub(b.wrapping_mul(digit));
    (digit, left)
}

/// Returns ⌊√(value · 2⁶¹)⌋; `value` from 2⁶¹ to 2⁶³ - 1.
pub(super) const fn root(value: u64) -> u64 {
    let short = (value >> 31) as u32;
    // 2³¹ / √short, 16 bits.
    let inverse = (i32::MAX as u32 / short.isqrt()) as u64;
    // Newton's method gives it less than 2⁻²⁷ too small: 2⁴⁶ / √short.
    let error = (1 << 62) - (short as u64 * (inverse * inverse)) as i64;
    let inverse = (inverse << 15) as i64 + (((error >> 16) * inverse as i64) >> 32);
    // 24 bits of the root, then 18 and 20 more from what is left.
    let first = (short as u64 * inverse as u64) >> 38;
    let left = (value >> 15) as i64 - (first * first) as i64;
    let digit = (left as i32 as i64 * inverse) >> 37;
    let second = (first << 18).wrapping_add_signed(digit);
    let left = (value << 21).wrapping_sub(second.wrapping_mul(second)) as i64;
    let digit = ((left >> 13) as i32 as i64 * inverse) >> 40;
    let mut root = (second << 20).wrapping_add_signed(digit);
    // It may be one off: its square must not exceed value · 2⁶¹, and the next one's must.
    let (high, low) = product(root, root);
    let mut high = (value >> 3) as i64 - high as i64;
    let (mut low, borrow) = (value << 61).overflowing_sub(low);
    high -= borrow as i64;
    while high < 0 {
        root -= 1;
        let (sum, carry) = low.overflowing_add(2 * root + 1);
        low = sum;
        high += carry as i64;
    }
    while high > 0 || low > 2 * root {
        let (sum, borrow) = low.overflowing_sub(2 * root + 1);
        low = sum;
        high -= borrow as i64;
        root += 1;
    }
    root
}
