//! [`Real`]: a number with 62 significant bits, in integer arithmetic.
//!
//! The ESP32-S3 has no double-precision unit, and single precision is far too coarse for edges
//! that must be right to 62.5 ns within hours. A mantissa and an exponent in integers give nine
//! bits more than a double, the same result on every machine, and no range to think of. It is for
//! planning (some dozen operations for each ramp and each segment), never for the refill.

mod wide;

use core::ops::{Add, Div, Mul, Neg, Sub};

/// A mantissa of this size is normal: 2⁶¹ ≤ |mantissa| < 2⁶².
const BITS: i32 = 62;

/// mantissa · 2^exponent. Results are cut, not rounded: each operation is right to 2⁻⁶⁰ of its
/// result, a difference to 2⁻⁶⁰ of its larger operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Real {
    mantissa: i64,
    exponent: i32,
}

impl Real {
    /// 0.
    pub const ZERO: Self = Self {
        mantissa: 0,
        exponent: 0,
    };

    /// Returns this integer.
    pub const fn of(value: u64) -> Self {
        Self::from_size(value, false, 0)
    }

    /// Returns this integer with its sign.
    pub const fn of_signed(value: i64) -> Self {
        Self::from_size(value.unsigned_abs(), value < 0, 0)
    }

    /// Returns ± size · 2^exponent, cut downwards.
    const fn from_size(size: u64, negative: bool, exponent: i32) -> Self {
        if size == 0 {
            return Self::ZERO;
        }
        let shift = size.leading_zeros() as i32 - (64 - BITS);
        let mantissa = if shift >= 0 {
            size << shift
        } else if negative {
            // Downwards is away from 0.
            ((size - 1) >> -shift) + 1
        } else {
            size >> -shift
        };
        Self {
            mantissa: if negative {
                -(mantissa as i64)
            } else {
                mantissa as i64
            },
            exponent: exponent - shift,
        }
    }

    /// Returns whether it is 0 or less.
    pub const fn is_none(self) -> bool {
        self.mantissa <= 0
    }

    /// Returns whether it is less than 0.
    pub const fn is_negative(self) -> bool {
        self.mantissa < 0
    }

    /// Returns this times 2^power.
    #[must_use]
    pub const fn shifted(self, power: i32) -> Self {
        if self.mantissa == 0 {
            return self;
        }
        Self {
            mantissa: self.mantissa,
            exponent: self.exponent + power,
        }
    }

    /// Returns half of it.
    #[must_use]
    pub const fn half(self) -> Self {
        self.shifted(-1)
    }

    /// Returns twice of it.
    #[must_use]
    pub const fn twice(self) -> Self {
        self.shifted(1)
    }

    /// Returns a third of it.
    #[must_use]
    pub fn third(self) -> Self {
        self * TWO_THIRDS.half()
    }

    /// Returns its square.
    #[must_use]
    pub fn squared(self) -> Self {
        self * self
    }

    /// Returns its size without its sign.
    #[must_use]
    pub fn abs(self) -> Self {
        if self.mantissa < 0 { -self } else { self }
    }

    /// Returns its square root; 0 for what is negative, which only rounding makes of a square.
    #[must_use]
    pub fn root(self) -> Self {
        if self.mantissa <= 0 {
            return Self::ZERO;
        }
        // 2⁶² is a mantissa of what was negative.
        let carry = (self.mantissa >> BITS) as i32;
        let (mantissa, exponent) = (self.mantissa as u64 >> carry, self.exponent + carry);
        // An even exponent, and a square of 124 bits, whose root has 62.
        let odd = exponent & 1;
        Self {
            mantissa: wide::root(mantissa << (1 - odd)) as i64,
            exponent: (exponent - (BITS - odd)) >> 1,
        }
    }

    /// Returns its cube root; 0 for what is negative.
    #[must_use]
    pub fn cube_root(self) -> Self {
        if self.mantissa <= 0 {
            return Self::ZERO;
        }
        // value = m · 8^k with 1 ≤ m < 8.
        let size = self.exponent + BITS - 1;
        let k = size.div_euclid(3);
        let m = self.shifted(-3 * k);
        let inverse = Self::of(u64::from(inverse_cube_root(m.fixed(28) as u32))).shifted(-31);
        // With z near 1/∛m and c = m·z³, ∛m = m·z²·c^(-2/3): two terms from c - 1, some 2⁻²⁷.
        let root = m * inverse.squared();
        let error = root * inverse - Self::of(1);
        let factor = error * (TWO_THIRDS - error * FIVE_NINTHS);
        (root - root * factor).shifted(k)
    }

    /// Returns the nearest integer, halves upwards; saturates.
    pub const fn rounded(self) -> i64 {
        // One bit more than the integer, then half is added.
        let twice = self.fixed(1);
        (twice + 1) >> 1
    }

    /// Returns floor(value · 2^fraction_bits), saturating at ± 2⁶².
    pub const fn fixed(self, fraction_bits: i32) -> i64 {
        let shift = self.exponent + fraction_bits;
        if shift > 0 {
            return match self.mantissa {
                0 => 0,
                negative if negative < 0 => -(1 << BITS),
                _ => 1 << BITS,
            };
        }
        let shift = if shift < -63 { 63 } else { -shift };
        self.mantissa >> shift
    }

    /// Returns the smaller of both.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        if other < self { other } else { self }
    }

    /// Returns the larger of both.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        if other > self { other } else { self }
    }
}

/// 2/3, cut.
const TWO_THIRDS: Real = Real {
    mantissa: ((1_u64 << (BITS + 1)) / 3) as i64,
    exponent: -BITS,
};

/// 5/9, cut.
const FIVE_NINTHS: Real = Real {
    mantissa: ((5_u128 << BITS) / 9) as i64,
    exponent: -BITS,
};

/// Returns 2³¹ / ∛(value / 2²⁸), right to 2⁻²⁸; `value` from 2²⁸ to 2³¹ - 1.
fn inverse_cube_root(value: u32) -> u32 {
    // The middle of each factor of 2, an eighth off at most. Each step squares that and doubles it.
    let mut inverse: u32 = match value >> 28 {
        1 => 0x7200_0000,
        2 | 3 => 0x5a80_0000,
        _ => 0x4800_0000,
    };
    let high = |a: u32, b: u32, shift: u32| ((u64::from(a) * u64::from(b)) >> shift) as u32;
    for _ in 0..4 {
        // z · (4 - value · z³) / 3.
        let cube = high(high(inverse, inverse, 32), inverse, 31);
        let left = high(cube, value, 28).wrapping_neg();
        let triple = high(inverse, left, 31);
        inverse = triple - triple / 3;
    }
    inverse
}

impl Add for Real {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        if self.mantissa == 0 {
            return other;
        }
        if other.mantissa == 0 {
            return self;
        }
        let (large, small) = if self.exponent >= other.exponent {
            (self, other)
        } else {
            (other, self)
        };
        let shift = large.exponent - small.exponent;
        if shift >= BITS {
            return large;
        }
        // 62 bits each: their sum fits.
        let sum = large.mantissa + (small.mantissa >> shift);
        if sum == 0 {
            return Self::ZERO;
        }
        let move_up = sum.unsigned_abs().leading_zeros() as i32 - (64 - BITS);
        let mantissa = if move_up >= 0 {
            sum << move_up
        } else {
            sum >> -move_up
        };
        Self {
            mantissa,
            exponent: large.exponent - move_up,
        }
    }
}

impl Neg for Real {
    type Output = Self;

    fn neg(self) -> Self {
        Self {
            mantissa: -self.mantissa,
            exponent: self.exponent,
        }
    }
}

impl Sub for Real {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Real {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        if self.mantissa == 0 || other.mantissa == 0 {
            return Self::ZERO;
        }
        let (a, b) = (self.mantissa.unsigned_abs(), other.mantissa.unsigned_abs());
        // From 2⁶⁰ to 2⁶² in the upper half.
        let (mut high, mut low) = wide::product(a << 1, b << 1);
        let mut exponent = self.exponent + other.exponent + BITS;
        if high < 1 << (BITS - 1) {
            high = (high << 1) | (low >> 63);
            low <<= 1;
            exponent -= 1;
        } else if high == 1 << BITS {
            high >>= 1;
            exponent += 1;
        }
        let mantissa = if (self.mantissa ^ other.mantissa) < 0 {
            // What is cut is cut downwards.
            -((high + u64::from(low != 0)) as i64)
        } else {
            high as i64
        };
        Self { mantissa, exponent }
    }
}

impl Div for Real {
    type Output = Self;

    /// # Panics
    /// `other` is 0.
    fn div(self, other: Self) -> Self {
        assert!(other.mantissa != 0, "divided by 0");
        if self.mantissa == 0 {
            return Self::ZERO;
        }
        let (a, b) = (self.mantissa.unsigned_abs(), other.mantissa.unsigned_abs());
        let negative = (self.mantissa ^ other.mantissa) < 0;
        let exponent = self.exponent - other.exponent - BITS;
        Self::from_size(wide::quotient(a, b), negative, exponent)
    }
}

impl PartialOrd for Real {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Real {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        let signs = self.mantissa.signum().cmp(&other.mantissa.signum());
        if signs.is_ne() || self.mantissa == 0 {
            return signs;
        }
        let sizes = if self.exponent == other.exponent {
            return self.mantissa.cmp(&other.mantissa);
        } else {
            self.exponent.cmp(&other.exponent)
        };
        if self.mantissa > 0 {
            sizes
        } else {
            sizes.reverse()
        }
    }
}

#[cfg(test)]
#[expect(clippy::float_arithmetic, reason = "compared with doubles")]
mod tests {
    extern crate std;
    use super::*;
    use std::format;

    fn double(value: Real) -> f64 {
        value.mantissa as f64 * f64::from(value.exponent).exp2()
    }

    fn real(value: f64) -> Real {
        let scaled = (value * f64::from(80).exp2()) as i128;
        plain::from_parts(scaled, -80)
    }

    /// The same in 128-bit integers, as plainly as can be.
    mod plain {
        use super::{BITS, Real};

        /// Returns value · 2^exponent.
        pub(super) fn from_parts(value: i128, exponent: i32) -> Real {
            if value == 0 {
                return Real::ZERO;
            }
            let size = 128 - value.unsigned_abs().leading_zeros() as i32;
            let shift = size - BITS;
            let mantissa = if shift >= 0 {
                value >> shift
            } else {
                value << -shift
            };
            Real {
                mantissa: mantissa as i64,
                exponent: exponent + shift,
            }
        }

        pub(super) fn product(a: Real, b: Real) -> Real {
            let product = i128::from(a.mantissa) * i128::from(b.mantissa);
            from_parts(product, a.exponent + b.exponent)
        }

        pub(super) fn quotient(a: Real, b: Real) -> Real {
            let quotient = (i128::from(a.mantissa) << BITS) / i128::from(b.mantissa);
            from_parts(quotient, a.exponent - b.exponent - BITS)
        }

        pub(super) fn root(value: Real) -> Real {
            if value.mantissa <= 0 {
                return Real::ZERO;
            }
            let odd = value.exponent & 1;
            let square = (value.mantissa as u128) << (BITS - odd);
            from_parts(square.isqrt() as i128, (value.exponent - (BITS - odd)) >> 1)
        }

        pub(super) fn cube_root(value: Real) -> Real {
            let k = (value.exponent + BITS - 1).div_euclid(3);
            let m = value.shifted(-3 * k);
            let mut root = Real::of(2);
            for _ in 0..8 {
                let sum = root.twice() + quotient(m, product(root, root));
                root = quotient(sum, Real::of(3));
            }
            root.shifted(k)
        }
    }

    /// Mantissas at the edges of every digit, and random ones with runs of ones and zeros.
    fn mantissa(state: &mut u64) -> i64 {
        let mut next = || {
            *state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            *state ^ (*state >> 29)
        };
        let (kind, bits) = (next() >> 60, next());
        let low = bits >> 3;
        let size = match kind {
            // -2⁶² is a mantissa too: what is negative is cut downwards.
            0 => 1 << 62,
            1 => 1 << 61,
            2 => (1 << 62) - 1 - (low >> 40),
            3 => (1 << 61) + (low >> 40),
            4..=6 => (1 << 61) + (low & (u64::MAX << (next() >> 58))),
            7..=9 => (1 << 61) + (low | ((1 << (next() >> 58)) - 1)),
            10 => ((low >> 30) | 1 << 31) << 30,
            _ => (1 << 61) + low,
        };
        let size = size.clamp(1 << 61, 1 << 62) as i64;
        if bits & 1 == 0 { size } else { -size }
    }

    #[test]
    fn every_bit_is_that_of_128_bit_integers() {
        let mut state = 11;
        for case in 0..3_000_000 {
            let exponent = (case % 90) - 45;
            let a = Real {
                mantissa: mantissa(&mut state),
                exponent,
            };
            let b = Real {
                mantissa: mantissa(&mut state),
                exponent: 7,
            };
            assert_eq!(a * b, plain::product(a, b), "{a:?} * {b:?}");
            assert_eq!(a / b, plain::quotient(a, b), "{a:?} / {b:?}");
            assert_eq!(a.root(), plain::root(a), "root of {a:?}");
            let value = a.mantissa >> (case % 64);
            let integer = plain::from_parts(i128::from(value), 0);
            assert_eq!(Real::of_signed(value), integer, "{value}");
            let value = value as u64;
            let integer = plain::from_parts(i128::from(value), 0);
            assert_eq!(Real::of(value), integer, "{value}");
        }
    }

    #[test]
    fn a_cube_root_is_right_to_two_units_of_its_last_place() {
        let mut state = 5;
        for case in 0..1_000_000 {
            let value = Real {
                mantissa: mantissa(&mut state).abs(),
                exponent: (case % 90) - 45,
            };
            let (found, plain) = (value.cube_root(), plain::cube_root(value));
            let error = (found - plain).abs();
            let unit = found.shifted(1 - BITS);
            assert!(error <= unit.twice(), "{value:?}: {found:?} {plain:?}");
        }
    }

    #[test]
    fn it_computes_what_doubles_compute() {
        let mut state = 7_u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let size = f64::from((state >> 58) as u32) - 32.0;
            let value = ((state >> 11) as f64 / 9e15 + 0.1) * size.exp2();
            if state & 1 == 0 { value } else { -value }
        };
        for _ in 0..100_000 {
            let (a, b) = (next(), next());
            let (ra, rb) = (real(a), real(b));
            let (a, b) = (double(ra), double(rb));
            let close = |found: Real, expected: f64, of: f64, what: &str| {
                let error = (double(found) - expected).abs();
                assert!(
                    error <= of.abs() * 4e-16,
                    "{what} {a} {b}: {found:?} {expected}"
                );
            };
            let larger = a.abs().max(b.abs());
            close(ra + rb, a + b, larger, "+");
            close(ra - rb, a - b, larger, "-");
            close(ra * rb, a * b, a * b, "*");
            close(ra / rb, a / b, a / b, "/");
            close(ra.abs().root(), a.abs().sqrt(), a.abs().sqrt(), "root");
            close(
                ra.abs().cube_root(),
                a.abs().cbrt(),
                a.abs().cbrt(),
                "cube root",
            );
            assert_eq!(ra < rb, a < b, "{a} {b}");
            assert_eq!(ra.rounded(), (a + 0.5).floor() as i64, "{a}");
        }
    }

    #[test]
    fn integers_stay_integers() {
        for value in [1_u64, 2, 3, 1_000, 16_000_000, 1 << 40, (1 << 60) + 1] {
            let real = Real::of(value);
            assert_eq!(real.rounded(), value as i64, "{value}");
            assert_eq!((real * Real::of(4) / Real::of(4)).rounded(), value as i64);
            assert_eq!(real - real, Real::ZERO);
            assert_eq!((real + real).half(), real);
        }
        assert_eq!(Real::of(144).root(), Real::of(12));
        assert_eq!(Real::of(0).root(), Real::ZERO);
        assert_eq!((Real::of(1) / Real::of(2)).rounded(), 1, "halves go up");
        assert_eq!((-(Real::of(1) / Real::of(2))).rounded(), 0);
        assert_eq!(Real::of_signed(-5).rounded(), -5);
        assert_eq!(Real::of(5).fixed(4), 80);
        assert!(format!("{:?}", Real::ZERO).contains('0'));
    }

    #[test]
    fn the_order_is_that_of_numbers() {
        let order = [-8_i64, -3, -2, 0, 1, 2, 3, 1_000_000];
        for (index, a) in order.iter().enumerate() {
            for (other, b) in order.iter().enumerate() {
                assert_eq!(
                    Real::of_signed(*a).cmp(&Real::of_signed(*b)),
                    index.cmp(&other)
                );
            }
        }
    }
}
