//! Speeds, accelerations and jerks in steps and ticks.

use crate::{limits::TICK_HZ, real::Real};

/// Speed, steps per tick.
pub fn speed_from_hz(speed_hz: u32) -> Real {
    Real::of(u64::from(speed_hz)) / Real::of(TICK_HZ)
}

/// Speed, steps per tick.
pub fn speed_from_mhz(speed_mhz: u64) -> Real {
    Real::of(speed_mhz) / Real::of(1_000 * TICK_HZ)
}

/// Speed of one step in so many ticks, steps per tick.
///
/// # Panics
/// The interval is 0.
pub fn speed_from_interval(interval_ticks: u64) -> Real {
    Real::of(1) / Real::of(interval_ticks)
}

/// Acceleration, steps per tick².
pub fn accel_from_hz_per_s(accel_hz_per_s: u32) -> Real {
    speed_from_hz(accel_hz_per_s) / Real::of(TICK_HZ)
}

/// Returns an acceleration in steps/s², rounded; the greatest number if it is more.
pub fn hz_per_s_from_accel(accel: Real) -> i64 {
    (accel * Real::of(TICK_HZ) * Real::of(TICK_HZ)).rounded()
}

/// Jerk, steps per tick³.
pub fn jerk_from_hz_per_s2(jerk_hz_per_s2: u32) -> Real {
    accel_from_hz_per_s(jerk_hz_per_s2) / Real::of(TICK_HZ)
}
