//! The clock of an emulated node: off by an offset, too fast or too slow, and able to jump.
//!
//! A node's clock never runs backwards, so a jump leads forwards only. All arithmetic is integer,
//! so that the same settings give the same microseconds everywhere.

use keys::LocalMicros;

/// Local time as a function of real time, both in µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LocalClock {
    /// Since when the line below holds.
    anchor_real_us: u64,
    /// What the clock showed then, billionths of a µs: nothing is lost when the rate changes.
    anchor_local: i128,
    drift_ppb: i64,
}

/// Billionths.
const PPB: i128 = 1_000_000_000;

/// Largest drift either way: a crystal is ten thousand times better.
pub const DRIFT_PPB_MAX: i64 = 500_000_000;

impl LocalClock {
    /// Makes a clock that shows `offset_us` at the real time `boot_real_us` and from then on gains
    /// `drift_ppb` nanoseconds a second, cut to ±[`DRIFT_PPB_MAX`].
    pub fn new(boot_real_us: u64, offset_us: u64, drift_ppb: i64) -> Self {
        Self {
            anchor_real_us: boot_real_us,
            anchor_local: i128::from(offset_us) * PPB,
            drift_ppb: drift_ppb.clamp(-DRIFT_PPB_MAX, DRIFT_PPB_MAX),
        }
    }

    /// Returns what the clock shows at this real time; before its boot, what it showed then.
    pub fn local_from_real(&self, real_us: u64) -> LocalMicros {
        let local = self.exact_local(real_us) / PPB;
        LocalMicros(u64::try_from(local).unwrap_or(u64::MAX))
    }

    fn exact_local(&self, real_us: u64) -> i128 {
        let passed = i128::from(real_us.saturating_sub(self.anchor_real_us));
        self.anchor_local + passed * (PPB + i128::from(self.drift_ppb))
    }

    /// Returns the first real microsecond at which the clock shows at least `local`.
    pub fn real_from_local(&self, local: LocalMicros) -> u64 {
        let passed = (i128::from(local.0) * PPB - self.anchor_local).max(0);
        let rate = PPB + i128::from(self.drift_ppb);
        let real = (passed + rate - 1) / rate;
        self.anchor_real_us
            .saturating_add(u64::try_from(real).unwrap_or(u64::MAX))
    }

    /// Gives the clock another rate from this real time on: a crystal that warms up.
    pub fn set_drift(&mut self, real_us: u64, drift_ppb: i64) {
        self.jump(real_us, 0);
        self.drift_ppb = drift_ppb.clamp(-DRIFT_PPB_MAX, DRIFT_PPB_MAX);
    }

    /// Lets the clock jump ahead at this real time.
    pub fn jump(&mut self, real_us: u64, ahead_us: u64) {
        self.anchor_local = self.exact_local(real_us) + i128::from(ahead_us) * PPB;
        self.anchor_real_us = real_us.max(self.anchor_real_us);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_of_50_ppm_gains_180_ms_an_hour() {
        let clock = LocalClock::new(1_000, 5_000_000, 50_000);
        let hour = 3_600_000_000;
        assert_eq!(clock.local_from_real(1_000).0, 5_000_000);
        assert_eq!(
            clock.local_from_real(1_000 + hour).0,
            5_000_000 + hour + 180_000
        );
    }

    #[test]
    fn the_two_directions_agree() {
        for drift_ppb in [-DRIFT_PPB_MAX, -37, 0, 37, 20_000, DRIFT_PPB_MAX] {
            let clock = LocalClock::new(77, 12_345, drift_ppb);
            for real_us in (77..2_000_000_000).step_by(7_654_321) {
                let local = clock.local_from_real(real_us);
                let first = clock.real_from_local(local);
                assert!(first <= real_us, "{drift_ppb}");
                assert_eq!(clock.local_from_real(first), local, "{drift_ppb}");
                assert!(first == 77 || clock.local_from_real(first - 1) < local);
            }
        }
    }

    #[test]
    fn another_rate_holds_from_then_on_and_time_does_not_jump() {
        let mut clock = LocalClock::new(0, 0, 100_000);
        clock.set_drift(1_000_000, -100_000);
        assert_eq!(clock.local_from_real(1_000_000).0, 1_000_100);
        assert_eq!(clock.local_from_real(2_000_000).0, 2_000_000);
    }

    #[test]
    fn a_jump_leads_ahead_and_the_rate_stays() {
        let mut clock = LocalClock::new(0, 0, 0);
        clock.jump(1_000, 500);
        assert_eq!(clock.local_from_real(1_000).0, 1_500);
        assert_eq!(clock.local_from_real(2_000).0, 2_500);
        assert_eq!(clock.real_from_local(LocalMicros(2_500)), 2_000);
    }
}
