//! The highest speeds that a way allows: between two ends, and before one.

use super::{
    Kind, Law,
    approach::{SHARE_BITS, X_BITS, X_SLACK, share_of_swing},
    piece::SEARCH_STEPS_MAX,
};
use crate::real::Real;

impl Law {
    /// Returns the speed at which a rise from `from` and a fall to `to` meet if they make `way`
    /// together, at most `speed_max`. The way suffices for the change from `from` to `to`.
    pub fn peak(&self, way: Real, from: Real, to: Real, speed_max: Option<Real>) -> Real {
        let most = |speed: Real| speed_max.map_or(speed, |max| speed.min(max));
        match self.kind {
            Kind::Constant => {
                let square = self.accel * way + (from.squared() + to.squared()).half();
                most(square.root().max(from).max(to))
            }
            Kind::Linear { .. } | Kind::Smooth { .. } => {
                let sum = way + self.way_from_rest(from) + self.way_from_rest(to);
                most(self.speed_after(sum.half()).max(from).max(to))
            }
            Kind::Jerk { jerk, swing, .. } if from == Real::ZERO && to == Real::ZERO => {
                let least = (self.accel * swing.squared()).twice();
                most(if way >= least {
                    let root = (swing.squared() + (way / self.accel).shifted(2)).root();
                    way.twice() / (swing + root)
                } else {
                    (way.squared() * jerk).shifted(-2).cube_root()
                })
            }
            Kind::Jerk { .. } => {
                if let Some(max) = speed_max
                    && self.way(from, max) + self.way(to, max) <= way
                {
                    return max;
                }
                most(self.search_peak(way, from.max(to), from.min(to)))
            }
        }
    }

    /// Returns the speed at which rises of an S-curve from `high` and from `low` make `way`
    /// together.
    ///
    /// Newton's method in u = √(gain / jerk) of the smaller gain: in it the way is convex, so that
    /// it comes from above and never leaves the bounds.
    fn search_peak(&self, way: Real, high: Real, low: Real) -> Real {
        let Kind::Jerk {
            jerk, swing, full, ..
        } = self.kind
        else {
            return high;
        };
        // Constant acceleration needs less way, and so does jerk alone from rest.
        let square = self.accel * way + (high.squared() + low.squared()).half();
        let steady = (square.root() - high) / jerk;
        let alone = (way.half() / jerk).cube_root();
        let mut u = steady.root().min(alone);
        // Two rises from `high` need less way, if the longer one is not from far below.
        let most = jerk * alone.squared();
        if !most.is_none() && low + low.twice() >= high + most {
            let share = (high / most).fixed(SHARE_BITS) as u64;
            let x = share_of_swing(share);
            if x > 0 {
                u = u.min(alone * Real::of(u64::from(x + 2 * X_SLACK)).shifted(-X_BITS));
            }
        }
        // Duration of a rise by this gain, and what it is longer for each unit of gain more.
        let rise = |gain: Real| {
            if gain >= full {
                (gain / self.accel + swing, Real::of(1) / self.accel)
            } else {
                let ticks = (gain / jerk).root().twice();
                (ticks, ticks / gain.twice())
            }
        };
        for _ in 0..SEARCH_STEPS_MAX {
            if u.is_none() {
                break;
            }
            let gain = jerk * u.squared();
            let peak = high + gain;
            // Of the larger gain, by the peak; of the smaller one, by u: its change by u is finite.
            let (ticks, longer) = rise(peak - low);
            let mean = (low + peak).half();
            let (own_ticks, own_longer) = if gain >= full {
                rise(gain)
            } else {
                (u.twice(), Real::of(1) / (jerk * u))
            };
            let own_mean = (high + peak).half();
            let error = own_mean * own_ticks + mean * ticks - way;
            let slope = (ticks + own_ticks).half() + mean * longer + own_mean * own_longer;
            let change = error / (slope * jerk * u.twice());
            u = u - change;
            if change.is_none() || change < u.shifted(-PEAK_BITS) {
                break;
            }
        }
        // No more way than there is, for all that was cut.
        let peak = high + jerk * u.max(Real::ZERO).squared();
        high.max(peak - peak.shifted(2 - 2 * PEAK_BITS))
    }

    /// Returns the highest speed from which `to` is reached within `way`, at most `speed_max`.
    pub fn speed_before(&self, way: Real, to: Real, speed_max: Real) -> Real {
        match self.kind {
            Kind::Jerk {
                jerk, swing, full, ..
            } => {
                if speed_max <= to || self.way(to, speed_max) <= way {
                    return speed_max;
                }
                if way.is_none() {
                    return to;
                }
                if way >= (to.twice() + full) * swing {
                    // The acceleration reaches its greatest: a square equation.
                    let part = full.half();
                    let square = (part - to).squared() + (self.accel * way).twice();
                    return (square.root() - part).max(to).min(speed_max);
                }
                // way = (2·to + jerk·u²)·u with u = √(gain / jerk): Newton's method from above.
                let mut u = (way / jerk).cube_root();
                if !to.is_none() {
                    u = u.min(way / to.twice());
                }
                for _ in 0..SEARCH_STEPS_MAX {
                    let square = jerk * u.squared();
                    let next = ((square * u).twice() + way) / (square + (square + to).twice());
                    let change = u - next;
                    u = next;
                    if change.is_none() || change < u.shifted(-SEARCH_BITS) {
                        break;
                    }
                }
                let speed = to + jerk * u.squared();
                to.max(speed - speed.shifted(-PEAK_SLACK_BITS))
                    .min(speed_max)
            }
            Kind::Constant => (to.squared() + (self.accel * way).twice())
                .root()
                .min(speed_max),
            Kind::Linear { .. } | Kind::Smooth { .. } => self
                .speed_after(self.way_from_rest(to) + way)
                .min(speed_max),
        }
    }
}

/// A search by Newton's method from above ends when it moves by less than 2⁻³⁰: the next step would
/// be the square of that.
const SEARCH_BITS: i32 = 30;

/// The search for a peak ends when it moves by less than 2⁻²⁴.
const PEAK_BITS: i32 = 24;

/// A speed that was searched is lowered by 2⁻⁵⁴ of it.
const PEAK_SLACK_BITS: i32 = 54;
