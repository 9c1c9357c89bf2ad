//! Drivers by name: what they demand is in [`motion::Driver`].

use crate::record::AxisSettings;
use motion::{AxisProfile, Driver};

/// Longest that a part of a step may be told to last, ns: 15 bits of ticks, as an RMT word has them.
pub const PART_NS_MAX: u32 = 2_000_000;

/// Longest that a change of direction may be told to keep away from a step, ns: what motion waits at most.
pub const DIRECTION_NS_MAX: u32 = 200_000;

/// What suits most drivers.
const DEFAULT: &str = "default";

/// Returns the names that there are.
pub fn names() -> impl Iterator<Item = &'static str> {
    core::iter::once(DEFAULT).chain(Driver::ALL.into_iter().map(Driver::name))
}

impl AxisSettings {
    /// Returns what a driver of this name demands.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let profile = match name {
            DEFAULT => AxisProfile::default(),
            _ => AxisProfile::of_driver(name.parse().ok()?),
        };
        Some(Self::from(profile))
    }

    /// Returns whether motion plays it as it is told, and not what comes nearest.
    #[must_use]
    pub fn is_legal(&self) -> bool {
        let parts = [self.high_ns_min, self.low_ns_min, self.high_ns];
        let direction = [self.dir_setup_ns, self.dir_hold_ns];
        parts.iter().all(|ns| (1..=PART_NS_MAX).contains(ns))
            && direction
                .iter()
                .all(|ns| (1..=DIRECTION_NS_MAX).contains(ns))
            && self.stop_accel_hz_per_s > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_a_legal_driver_and_no_two_are_the_same() {
        for (index, name) in names().enumerate() {
            let driver = AxisSettings::named(name).expect("it is in the list");
            assert!(driver.is_legal(), "{name}");
            for other in names().take(index) {
                assert_ne!(AxisSettings::named(other), Some(driver), "{name} {other}");
            }
        }
        assert_eq!(AxisSettings::named("tmc"), None);
    }

    #[test]
    fn what_motion_would_change_is_not_legal() {
        let legal = AxisSettings::default();
        for (wrong, what) in [
            (
                AxisSettings {
                    high_ns_min: 0,
                    ..legal
                },
                "no pulse",
            ),
            (
                AxisSettings {
                    low_ns_min: PART_NS_MAX + 1,
                    ..legal
                },
                "low",
            ),
            (
                AxisSettings {
                    dir_setup_ns: DIRECTION_NS_MAX + 1,
                    ..legal
                },
                "setup",
            ),
            (
                AxisSettings {
                    dir_hold_ns: 0,
                    ..legal
                },
                "hold",
            ),
            (
                AxisSettings {
                    stop_accel_hz_per_s: 0,
                    ..legal
                },
                "never stops",
            ),
        ] {
            assert!(!wrong.is_legal(), "{what}");
        }
    }
}
