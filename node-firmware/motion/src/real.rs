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

    /// Returns it divided by an integer that is not 0, right to 2⁻⁴⁰.
    #[must_use]
    pub(crate) fn over(self, divisor: u32) -> Self {
        if divisor.is_power_of_two() {
            return self.shifted(-(divisor.trailing_zeros() as i32));
        }
        if divisor >= OVER_MAX {
            return self / Self::of(u64::from(divisor));
        }
        let size = self.mantissa.unsigned_abs();
        let (high, low) = ((size >> 32) as u32, size as u32);
        // Digit by digit: what is left of one has 20 bits, so each next one may have 12.
        let (first, left) = (high / divisor, high % divisor);
        let part = left << 12 | low >> 20;
        let (second, left) = (part / divisor, part % divisor);
        let part = left << 12 | (low >> 8) & 0xfff;
        let (third, left) = (part / divisor, part % divisor);
        let last = (left << 8 | low & 0xff) / divisor;
        let quotient = u64::from(first) << 32
            | u64::from(second) << 20
            | u64::from(third) << 8
            | u64::from(last);
        Self::from_size(quotient, self.mantissa < 0, self.exponent)
    }

    /// Returns its logarithm to base 2 in 2⁻¹⁶, less than 2⁻⁶ off; it is more than 0.
    pub(crate) const fn log(self) -> i32 {
        let share = (self.mantissa >> (BITS - 1 - 16)) as u32 & 0xffff;
        // log₂(1 + x) is near to x + 0.34·x·(1 − x).
        let bent = (share * (0x1_0000 - share)) >> 16;
        let log = share + ((bent * 22_300) >> 16);
        ((self.exponent + BITS - 1) << 16) + log as i32
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

    /// Returns the next integer below it and what it is more than that; of less than 2⁶² in size.
    pub(crate) fn split(self) -> (i64, Self) {
        let whole = self.fixed(0);
        if self.exponent >= 0 {
            return (whole, Self::ZERO);
        }
        if self.exponent < -BITS {
            let part = if whole < 0 { self + Self::of(1) } else { self };
            return (whole, part);
        }
        let part = self.mantissa - (whole << -self.exponent);
        (whole, Self::from_size(part as u64, false, self.exponent))
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

/// [`Real::over`] takes what a digit of 12 bits beside it lets fit 32 bits.
const OVER_MAX: u32 = 1 << 20;

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
        let size = sum.unsigned_abs();
        // Mostly it is normal or one bit too large, and not every machine counts zeros quickly.
        let move_up = match size >> (BITS - 1) {
            0 => size.leading_zeros() as i32 - (64 - BITS),
            1 => 0,
            _ => -1,
        };
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
mod tests;
