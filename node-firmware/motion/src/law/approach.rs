//! [`Approach`]: the highest speed before one way, for many speeds behind it. The look-ahead asks
//! that of dozens of lines whenever it learns of one line more.
//!
//! An S-curve from `to` that never reaches its greatest acceleration takes u ticks for each half of
//! its gain j·u², and its way is (2·to + j·u²)·u. With V = ∛(j·way²), the speed that it reaches from
//! rest, and u = x·∛(way / j) that is
//!
//! ```text
//!   x³ + 2·s·x = 1    s = to / V        speed before = to + V·x²
//! ```
//!
//! From a little above rest that is less than from rest itself: there is less way for each u. The speed
//! before must not shrink when more lines become known and `to` rises, or the line could not be left as
//! fast as then allowed, having been begun as fast as was allowed before. So while `to` may still rise,
//! the least is taken that any higher one gives: at 2^(-5/3)·V, 0.945·V.
//!
//! So all depends on one number, and 28 bits of x are enough: what is cut of them is cut downwards, and
//! a speed that is lower by 2⁻²³ of its gain is still one from which `to` is reached.

use super::{Kind, Law};
use crate::real::Real;

/// How fast a way may be begun.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Approach {
    /// Constant acceleration: what the way takes of the speed's square.
    Square(Real),
    /// An S-curve.
    Swing(Swing),
}

/// What an S-curve's way makes of a speed behind it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Swing {
    /// V, and 1 / V.
    speed: Real,
    inverse: Real,
    /// Up to this speed behind, the acceleration reaches its greatest.
    full_to: Real,
    /// The speed behind before which the speed is least.
    least_to: Real,
    /// Half of what speed rises at least when the acceleration reaches its greatest.
    part: Real,
    /// Twice the acceleration times the way.
    square: Real,
}

/// A speed, or its square: whichever is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pace {
    /// The speed itself, steps per tick.
    Speed(Real),
    /// Its square.
    Square(Real),
}

impl Pace {
    /// At rest.
    pub(crate) const REST: Self = Self::Square(Real::ZERO);

    /// Returns the speed.
    pub(crate) fn speed(self) -> Real {
        match self {
            Self::Speed(speed) => speed,
            Self::Square(square) => square.root(),
        }
    }

    fn squared(self) -> Real {
        match self {
            Self::Speed(speed) => speed.squared(),
            Self::Square(square) => square,
        }
    }

    /// Returns whether it is at least this speed, whose square is given, too.
    pub(crate) fn reaches(self, speed: Real, square: Real) -> bool {
        match self {
            Self::Speed(own) => own >= speed,
            Self::Square(own) => own >= square,
        }
    }
}

impl Approach {
    /// Takes a law of constant acceleration or jerk and a way, steps.
    ///
    /// # Panics
    /// Another law: lines have none.
    pub(crate) fn new(law: &Law, way: Real) -> Self {
        let square = (law.accel * way).twice();
        match law.kind {
            Kind::Constant => Self::Square(square),
            Kind::Jerk {
                jerk, swing, full, ..
            } => {
                let speed = (jerk * way.squared()).cube_root();
                let (full_to, part) = ((way / swing - full).half(), full.half());
                let least_to = if part <= full_to {
                    part
                } else {
                    full_to.max(speed * LEAST_SHARE)
                };
                Self::Swing(Swing {
                    speed,
                    inverse: Real::of(1) / speed,
                    full_to,
                    least_to,
                    part,
                    square,
                })
            }
            Kind::Linear { .. } | Kind::Smooth { .. } => panic!("a line's law is none of these"),
        }
    }

    /// Returns the highest speed from which `to` is reached within the way, or one a little lower;
    /// if not `settled`, one from which also every speed above `to` is.
    pub(crate) fn before(&self, to: Pace, settled: bool) -> Pace {
        match self {
            Self::Square(square) => Pace::Square(to.squared() + *square),
            Self::Swing(swing) if settled => Pace::Speed(swing.before(to.speed())),
            Self::Swing(swing) => Pace::Speed(swing.before(to.speed().max(swing.least_to))),
        }
    }
}

impl Swing {
    fn before(&self, to: Real) -> Real {
        if to <= self.full_to {
            // A square equation.
            let square = (self.part - to).squared() + self.square;
            return (square.root() - self.part).max(to);
        }
        let share = (to * self.inverse).fixed(SHARE_BITS) as u64;
        let x = u64::from(share_of_swing(share));
        to + self.speed * Real::of(x * x).shifted(-2 * X_BITS)
    }
}

/// 2^(-5/3), cut.
const LEAST_SHARE: Real = Real::of(1_352_829_926).shifted(-32);

/// Fraction of `s`.
pub(super) const SHARE_BITS: i32 = 24;

/// Fraction of `x`.
pub(super) const X_BITS: i32 = 31;

/// What is cut from `x`, so that it is never too large.
pub(super) const X_SLACK: u32 = 1 << 8;

/// Faster than 2¹⁰·V a way adds less than 2⁻³⁰ to the speed.
const SHARE_MAX: u64 = 1 << (SHARE_BITS + 10);

/// Returns x of x³ + 2·s·x = 1 in 2⁻³¹, by 2⁻²³ too small at most; `s` in 2⁻²⁴.
pub(super) fn share_of_swing(s: u64) -> u32 {
    if s >= SHARE_MAX {
        return 0;
    }
    let x = if s < 1 << SHARE_BITS {
        slow_share(s as u32)
    } else {
        quick_share(s)
    };
    x.saturating_sub(X_SLACK)
}

const ONE: i64 = 1 << X_BITS;

fn product(a: u32, b: u32) -> u32 {
    ((u64::from(a) * u64::from(b)) >> X_BITS) as u32
}

/// Newton's step: `error` / `slope`, both in 2⁻³¹; the slope is from 1 to 8.
fn step(error: i64, slope: i64) -> i64 {
    let inverse = u32::MAX / (slope >> 16) as u32;
    (error * i64::from(inverse)) >> 17
}

/// `s` < 1: Newton's method from above, where the chord of x over s lies.
fn slow_share(s: u32) -> u32 {
    /// 1 - x(1) in 2⁻²⁴, cut.
    const FALL: u64 = 9_170_000;
    let mut x = (ONE as u64 - ((u64::from(s) * FALL) >> (2 * SHARE_BITS - X_BITS))) as u32;
    let twice = i64::from(s) << (X_BITS - SHARE_BITS + 1);
    for _ in 0..3 {
        let square = product(x, x);
        let linear = (u64::from(s) * u64::from(x)) >> (SHARE_BITS - 1);
        let error = i64::from(product(square, x)) + linear as i64 - ONE;
        let slope = 3 * i64::from(square) + twice;
        x = (i64::from(x) - step(error, slope)) as u32;
    }
    x
}

/// `s` ≥ 1: x = y·w with y = 1 / 2s, so that y³·w³ + w = 1 and w is near to 1.
fn quick_share(s: u64) -> u32 {
    let spare = if s >> 32 == 0 { 0 } else { 2 };
    let short = (s >> spare) as u32;
    let shift = short.leading_zeros();
    let divisor = u64::from(short << shift);
    // 2⁶³ / divisor, by less than 2⁻²⁸ of it too small: one short division, one step of Newton's.
    let first = u64::from(u32::MAX / (divisor >> 16) as u32);
    let error = (1 << 48) - (divisor * first) as i64;
    let inverse = ((first << 15) as i64 + ((error * first as i64) >> 33)) as u64;
    // 2⁵⁴ / s.
    let y = (inverse >> (9 + spare - shift)) as u32;
    let cube = product(product(y, y), y);
    /// (1 - w(1)) / y(1)³, cut: the chord of w over y³.
    const FALL: u32 = 0x5e00_0000;
    let mut w = (ONE as u32) - product(cube, FALL);
    for _ in 0..2 {
        let square = product(w, w);
        let slope = product(cube, square);
        let error = i64::from(product(slope, w)) + i64::from(w) - ONE;
        w = (i64::from(w) - step(error, ONE + 3 * i64::from(slope))) as u32;
    }
    product(y, w)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::law::speed_from_hz;
    use keys::command::RampShape;

    #[test]
    fn the_share_of_a_swing_solves_its_equation_from_below() {
        let mut s = 0_u64;
        while s < SHARE_MAX {
            let found = f64::from(share_of_swing(s)) / f64::from(X_BITS).exp2();
            let twice = s as f64 * f64::from(1 - SHARE_BITS).exp2();
            let over = found.powi(3) + twice * found - 1.0;
            // The equation's slope at the solution.
            let off = over / (3.0 * found * found + twice);
            let least = -(f64::from(-22).exp2());
            assert!(off <= 0.0 && off > least, "{s}: {found} is {off} off");
            s += 1 + s / 1_000 + s % 7;
        }
        assert_eq!(share_of_swing(SHARE_MAX), 0);
    }

    #[test]
    fn a_speed_before_a_way_is_never_above_the_law_s_own_and_next_to_it() {
        let mut state = 3_u64;
        let mut next = |most: u64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % most
        };
        for case in 0..20_000 {
            let accel = 1 + next(1 << (1 + case % 24)) as u32;
            let shape = match case % 3 {
                0 => RampShape::Trapezoid {
                    linear_steps: 0,
                    jump_steps: 0,
                },
                _ => RampShape::Jerk {
                    jerk_hz_per_s2: 1 + next(1 << (1 + case % 31)) as u32,
                },
            };
            let law = Law::new(accel, shape);
            let way = Real::of(1 + next(1 << (1 + case % 20))).shifted(-(next(4) as i32));
            let to = speed_from_hz(next(1 << (case % 21)) as u32);
            let most = Real::of(1_000);
            let exact = law.speed_before(way, to, most);
            let approach = Approach::new(&law, way);
            let found = approach.before(Pace::Speed(to), true).speed();
            let slack = exact.shifted(-52);
            assert!(found <= exact + slack, "{case}: {found:?}, not {exact:?}");
            let off = exact - found;
            assert!(
                off <= exact.shifted(-20),
                "{case}: {found:?}, not {exact:?}"
            );
            // What still rises makes it no lower, but by rounding.
            let low = approach.before(Pace::Speed(to), false).speed();
            let higher = to + to.shifted(-(next(30) as i32));
            let later = approach.before(Pace::Speed(higher), true).speed();
            assert!(
                low <= later + later.shifted(-20),
                "{case}: {low:?} {later:?}"
            );
        }
    }
}
