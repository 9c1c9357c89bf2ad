//! Reals against `f64`, and against their own inverses.

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

#[test]
fn whole_and_part_make_the_number_and_short_quotients_and_logarithms_are_near() {
    let mut state = 21_u64;
    for case in 0..100_000 {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let value = Real::of_signed((state as i64) >> (case % 60)).shifted(-(case % 90) - 2);
        let (whole, part) = value.split();
        assert_eq!(whole, value.fixed(0), "{value:?}");
        assert!(!part.is_negative() && part <= Real::of(1), "{value:?}");
        let off = (Real::of_signed(whole) + part - value).abs();
        let size = value.abs().max(Real::of(1));
        assert!(off <= size.shifted(-58), "{value:?}");
        let divisor = 1 + ((state >> 7) as u32 >> (case % 32));
        let quotient = value / Real::of(u64::from(divisor));
        let off = (value.over(divisor) - quotient).abs();
        assert!(off <= quotient.abs().shifted(-40), "{value:?} / {divisor}");
        if !value.is_none() {
            let off = f64::from(value.log()) / 65_536.0 - double(value).log2();
            assert!(off.abs() < 0.01, "{value:?} is {off} off");
        }
    }
}
