//! The pause before the next connection attempt.
//!
//! Doubles with every failure up to a cap; each pause is drawn from the upper half of its range,
//! so that a fleet whose router restarts does not return in step.

use crate::random::Random;

#[derive(Debug, Clone)]
pub(crate) struct Backoff {
    us_min: u64,
    us_max: u64,
    failure_count: u32,
}

impl Backoff {
    pub(crate) fn new(us_min: u64, us_max: u64) -> Self {
        let us_min = us_min.max(1);
        Self {
            us_min,
            us_max: us_max.max(us_min),
            failure_count: 0,
        }
    }

    /// A connection proved itself: the next pause is the first again.
    pub(crate) fn reset(&mut self) {
        self.failure_count = 0;
    }

    /// The pause after one more failure, in microseconds.
    pub(crate) fn pause_us(&mut self, random: &mut Random) -> u64 {
        let doubled = self
            .us_min
            .checked_shl(self.failure_count.min(32))
            .unwrap_or(u64::MAX);
        let ceiling_us = doubled.clamp(self.us_min, self.us_max);
        self.failure_count = self.failure_count.saturating_add(1);
        ceiling_us - random.below(ceiling_us / 2 + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_cap_and_stay_in_the_upper_half() {
        let mut random = Random::new(1);
        let mut backoff = Backoff::new(100, 1000);
        for ceiling_us in [100, 200, 400, 800, 1000, 1000] {
            let pause_us = backoff.pause_us(&mut random);
            assert!(
                (ceiling_us / 2..=ceiling_us).contains(&pause_us),
                "{pause_us} {ceiling_us}"
            );
        }
        backoff.reset();
        assert!(backoff.pause_us(&mut random) <= 100);
    }

    #[test]
    fn a_hundred_failures_do_not_overflow() {
        let mut random = Random::new(2);
        let mut backoff = Backoff::new(u64::MAX / 2, u64::MAX);
        for _ in 0..100 {
            assert!(backoff.pause_us(&mut random) > 0);
        }
    }

    #[test]
    fn two_devices_do_not_pause_alike() {
        let pause = |seed| Backoff::new(1_000_000, 1_000_000).pause_us(&mut Random::new(seed));
        assert_ne!(pause(1), pause(2));
    }
}
