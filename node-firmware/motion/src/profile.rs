//! What a motor driver demands of its step and direction inputs, and how its axis may stop.

use crate::{
    driver::{Driver, Needs},
    law::speed_from_hz,
    limits::{
        HOLD_TICKS_MAX, PART_TICKS_MAX, PART_TICKS_MIN, REFILL_WORDS, SETUP_TICKS_MAX, TICK_HZ,
        TURN_LATENCY_TICKS, WORD_TICKS_MIN,
    },
    real::Real,
};

/// One axis. Times are minima, in ns; they are rounded up to whole ticks of 62.5 ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisProfile {
    /// Shortest high time of a step.
    pub high_ns_min: u32,
    /// Shortest low time between steps.
    pub low_ns_min: u32,
    /// High time of slow steps: what `high_ns_min` becomes where there is time for more. Half the
    /// interval at most.
    pub high_ns: u32,
    /// From a change of direction to the next active edge; at most 200 µs.
    pub dir_setup_ns: u32,
    /// From the end of a step to a change of direction; at most 200 µs.
    pub dir_hold_ns: u32,
    /// Deceleration of a controlled stop of raw moves, steps/s², from 1. Ramps and lines slow down
    /// by their own acceleration.
    pub stop_accel_hz_per_s: u32,
    /// Most that the speed may jump at a corner of a path, Hz. 0: every corner is a stop.
    pub junction_hz: u32,
    /// Whether the direction pin is low for positive.
    pub direction_inverted: bool,
}

impl Default for AxisProfile {
    /// Suits every common driver up to the rate that its own minimum allows: 2.5 µs high where
    /// there is time, and 1 MHz at most.
    fn default() -> Self {
        Self {
            high_ns_min: 500,
            low_ns_min: 500,
            high_ns: 2_500,
            dir_setup_ns: 10_000,
            dir_hold_ns: 10_000,
            stop_accel_hz_per_s: 100_000,
            junction_hz: 200,
            direction_inverted: false,
        }
    }
}

impl AxisProfile {
    /// Allegro A4988 (data sheet; LinuxCNC's stepper table): 500 kHz at most.
    pub fn a4988() -> Self {
        Self::of_driver(Driver::A4988)
    }

    /// TI DRV8825 (data sheet; LinuxCNC's stepper table): 263 kHz at most.
    pub fn drv8825() -> Self {
        Self::of_driver(Driver::Drv8825)
    }

    /// Trinamic TMC22xx and TMC51xx (data sheet; Klipper's default pulse): 5 MHz at most.
    pub fn tmc2209() -> Self {
        Self::of_driver(Driver::Tmc22xx)
    }

    /// Leadshine DM556, DM856 (LinuxCNC's stepper table): 200 kHz at most.
    pub fn dm556() -> Self {
        Self::of_driver(Driver::Dm556)
    }

    /// Returns the shortest time from step to step, ticks: the driver's, in what the hardware can play.
    pub fn step_ticks_min(self) -> u64 {
        Timing::from(self).interval_ticks_min()
    }

    /// Returns the greatest speed, mHz, rounded down.
    pub fn speed_mhz_max(self) -> u64 {
        1_000 * TICK_HZ / self.step_ticks_min()
    }

    /// What a driver demands: the table in [`Driver`]. One that steps on the falling edge gets the same
    /// high time at every speed.
    pub fn of_driver(driver: Driver) -> Self {
        let Needs {
            high_ns,
            low_ns,
            hold_ns,
            setup_ns,
        } = driver.needs();
        let default = Self::default();
        Self {
            high_ns_min: high_ns,
            low_ns_min: low_ns,
            high_ns: if driver.steps_on_falling_edge() {
                high_ns
            } else {
                default.high_ns.max(high_ns)
            },
            dir_setup_ns: setup_ns,
            dir_hold_ns: hold_ns,
            ..default
        }
    }
}

/// A profile in ticks, within what the hardware can play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Timing {
    pub(crate) high_ticks_min: u64,
    pub(crate) low_ticks_min: u64,
    pub(crate) high_ticks: u64,
    pub(crate) setup_ticks: u64,
    pub(crate) hold_ticks: u64,
    pub(crate) stop_accel_hz_per_s: u32,
    /// Steps per tick.
    pub(crate) junction_speed: Real,
}

impl From<AxisProfile> for Timing {
    fn from(profile: AxisProfile) -> Self {
        let ticks = |ns: u32| (u64::from(ns) * TICK_HZ).div_ceil(1_000_000_000);
        let part = |ns: u32| ticks(ns).clamp(PART_TICKS_MIN, PART_TICKS_MAX);
        let high_ticks_min = part(profile.high_ns_min);
        Self {
            high_ticks_min,
            low_ticks_min: part(profile.low_ns_min),
            high_ticks: part(profile.high_ns).max(high_ticks_min),
            setup_ticks: ticks(profile.dir_setup_ns).clamp(1, SETUP_TICKS_MAX),
            hold_ticks: ticks(profile.dir_hold_ns).clamp(1, HOLD_TICKS_MAX),
            stop_accel_hz_per_s: profile.stop_accel_hz_per_s.max(1),
            junction_speed: speed_from_hz(profile.junction_hz),
        }
    }
}

impl Timing {
    /// The shortest that the hardware can play, for an axis that nothing is known of.
    pub(crate) const LEAST: Self = Self {
        high_ticks_min: PART_TICKS_MIN,
        low_ticks_min: PART_TICKS_MIN,
        high_ticks: PART_TICKS_MIN,
        setup_ticks: 1,
        hold_ticks: 1,
        stop_accel_hz_per_s: 1,
        junction_speed: Real::ZERO,
    };

    /// Returns the shortest interval between two steps, ticks.
    pub(crate) const fn interval_ticks_min(&self) -> u64 {
        self.high_ticks_min + self.low_ticks_min
    }

    /// Returns the shortest interval whose high time is the full one, ticks.
    pub(crate) fn full_high_ticks_min(&self) -> u64 {
        (2 * self.high_ticks).max(self.high_ticks + self.low_ticks_min)
    }

    /// Returns the high time of a step with this interval, ticks.
    pub(crate) fn high_of(&self, interval_ticks: u64) -> u64 {
        (interval_ticks / 2)
            .min(self.high_ticks)
            .min(interval_ticks.saturating_sub(self.low_ticks_min))
            .max(self.high_ticks_min)
    }

    /// Returns the rest that must surround a switch of the direction pin, ticks: the rest of a
    /// half block, which may hold one step only and has to last until the next one is written; then a
    /// half block in which the refill finds nothing stepping.
    pub(crate) fn window_ticks(&self) -> u64 {
        let hold = self.hold_ticks.max(self.low_ticks_min);
        let half = REFILL_WORDS as u64 * WORD_TICKS_MIN;
        (hold + half).max(TURN_LATENCY_TICKS) + self.turn_ticks()
    }

    /// Returns the least that the half block of a turn lasts, ticks.
    pub(crate) fn turn_ticks(&self) -> u64 {
        let half = REFILL_WORDS as u64 * WORD_TICKS_MIN;
        half.max(TURN_LATENCY_TICKS + self.setup_ticks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nanoseconds_round_up_to_ticks() {
        let timing = |profile| Timing::from(profile);
        // LinuxCNC's table: DIR setup of A4988, DRV8825 and DM556 are 4, 11 and 80 ticks.
        assert_eq!(timing(AxisProfile::a4988()).setup_ticks, 4);
        assert_eq!(timing(AxisProfile::drv8825()).setup_ticks, 11);
        assert_eq!(timing(AxisProfile::dm556()).setup_ticks, 80);
        assert_eq!(timing(AxisProfile::dm556()).hold_ticks, 160);
        assert_eq!(timing(AxisProfile::drv8825()).interval_ticks_min(), 62);
        assert_eq!(timing(AxisProfile::tmc2209()).high_ticks_min, 2);
    }

    #[test]
    fn slow_steps_get_the_full_high_time_and_fast_ones_half() {
        let timing = Timing::from(AxisProfile::default());
        assert_eq!(timing.high_of(16), 8);
        assert_eq!(timing.high_of(40), 20);
        assert_eq!(timing.high_of(8_000), 40);
        let slow_driver = Timing::from(AxisProfile {
            low_ns_min: 5_000,
            ..AxisProfile::default()
        });
        assert_eq!(slow_driver.high_of(88), 8, "the low time comes first");
    }
}
