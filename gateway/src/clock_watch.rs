//! When the wall clock is set while the gateway runs: by NTP after a start without a network, by hand, or by
//! a sleep of the machine, which the clock that never goes back has slept through too.
//!
//! The fleet's time ([`WallClock`](crate::bus::WallClock)) is read from the wall once and never jumps:
//! deadlines, clocks of nodes and starts hang on it. So records and schedules would be wrong by as much as
//! the wall was set. The rule: when the two disagree by [`STEP_US_MAX`] at two looks in a row, the gateway
//! begins anew from its store, in the same process, as after any restart, at the first look at which no
//! node has anything of it to do. Until then it says so. A clock that is only slewed is none of this: both
//! are slewed.

use std::{
    sync::{
        Arc,
        atomic::{AtomicI64, Ordering},
    },
    time::{Duration, SystemTime, UNIX_EPOCH},
};

/// How far the two may be apart, µs: more than a leap second.
pub const STEP_US_MAX: u64 = 2_000_000;

/// Time between two looks, µs.
pub const LOOK_EVERY_US: u64 = 5_000_000;

/// The clock on the wall, UTC. Copies of one show the same.
#[derive(Clone, Debug)]
pub struct Wall {
    look_every: Duration,
    /// What it shows beyond this machine's, µs.
    ahead_us: Arc<AtomicI64>,
}

impl Default for Wall {
    /// That of this machine.
    fn default() -> Self {
        Self::to_be_set(Duration::from_micros(LOOK_EVERY_US))
    }
}

impl Wall {
    /// One beside this machine's, which it does not touch, for those who want to see what happens when
    /// it is set. It is looked at so often.
    pub fn to_be_set(look_every: Duration) -> Self {
        Self {
            look_every,
            ahead_us: Arc::default(),
        }
    }

    /// Sets it, µs beyond this machine's.
    pub fn set_ahead_us(&self, us: i64) {
        self.ahead_us.store(us, Ordering::Relaxed);
    }

    /// Returns what it shows, µs since 1970.
    pub fn now_us(&self) -> u64 {
        let since_epoch = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        let ahead_us = self.ahead_us.load(Ordering::Relaxed);
        (since_epoch.as_micros() as u64).saturating_add_signed(ahead_us)
    }

    /// Returns the time between two looks.
    pub const fn look_every(&self) -> Duration {
        self.look_every
    }
}

/// What to do after a look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Advice {
    /// Nothing.
    GoOn,
    /// Somebody should know that times are wrong until the fleet rests; said once.
    Tell,
    /// Begin anew.
    BeginAnew,
}

/// Returns whether the two disagree. `ahead_us`: the wall less the fleet's time, µs.
pub const fn disagree(ahead_us: i64) -> bool {
    ahead_us.unsigned_abs() > STEP_US_MAX
}

/// Looks at both from time to time. Owns no clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClockWatch {
    /// Looks in a row at which they disagreed.
    looks: u32,
}

impl ClockWatch {
    /// Takes a look: how far the wall is ahead, µs, and whether the fleet rests.
    pub fn look(&mut self, ahead_us: i64, at_rest: bool) -> Advice {
        if !disagree(ahead_us) {
            self.looks = 0;
            return Advice::GoOn;
        }
        self.looks = self.looks.saturating_add(1);
        match self.looks {
            // A moment between the two readings may have been long.
            1 => Advice::GoOn,
            _ if at_rest => Advice::BeginAnew,
            2 => Advice::Tell,
            _ => Advice::GoOn,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000;

    /// Virtual time: both clocks, and what is advised at each look.
    struct Plant {
        wall_us: i64,
        fleet_us: i64,
        watch: ClockWatch,
    }

    impl Plant {
        fn new() -> Self {
            let now_us = 1_795_230_000 * S;
            Self {
                wall_us: now_us,
                fleet_us: now_us,
                watch: ClockWatch::default(),
            }
        }

        /// Lets time pass to the next look.
        fn look(&mut self, at_rest: bool) -> Advice {
            self.wall_us += LOOK_EVERY_US as i64;
            self.fleet_us += LOOK_EVERY_US as i64;
            let ahead_us = self.wall_us - self.fleet_us;
            let advice = self.watch.look(ahead_us, at_rest);
            if advice == Advice::BeginAnew {
                self.fleet_us = self.wall_us;
                self.watch = ClockWatch::default();
            }
            advice
        }
    }

    #[test]
    fn a_gateway_that_started_before_ntp_begins_anew_once() {
        for set_us in [50 * 365 * 86_400 * S, -3_600 * S, 3 * S] {
            let mut plant = Plant::new();
            assert_eq!(plant.look(true), Advice::GoOn);
            plant.wall_us += set_us;
            assert_eq!(plant.look(true), Advice::GoOn, "once may be chance");
            assert_eq!(plant.look(true), Advice::BeginAnew);
            for _ in 0..1_000 {
                assert_eq!(plant.look(true), Advice::GoOn);
            }
        }
    }

    #[test]
    fn a_fleet_at_work_is_left_alone_until_it_rests() {
        let mut plant = Plant::new();
        // The machine slept.
        plant.wall_us += 600 * S;
        assert_eq!(plant.look(false), Advice::GoOn);
        assert_eq!(plant.look(false), Advice::Tell);
        for _ in 0..1_000 {
            assert_eq!(plant.look(false), Advice::GoOn, "told once");
        }
        assert_eq!(plant.look(true), Advice::BeginAnew);
    }

    #[test]
    fn back_and_forth_between_looks_and_little_at_a_time_is_nothing() {
        let mut plant = Plant::new();
        for _ in 0..100 {
            plant.wall_us += 3_600 * S;
            assert_eq!(plant.look(true), Advice::GoOn);
            plant.wall_us -= 3_600 * S;
            assert_eq!(plant.look(true), Advice::GoOn);
        }
        plant.wall_us += STEP_US_MAX as i64;
        for _ in 0..100 {
            assert_eq!(plant.look(true), Advice::GoOn);
        }
    }
}
