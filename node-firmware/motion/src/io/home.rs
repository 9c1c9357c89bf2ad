//! Homing of one axis: the place of its switch becomes a known position.
//!
//! ```text
//!   begin ──▶ seek ──pressed──▶ slow down ─rest─▶ back off ──released──▶ margin
//!     │                                              ▲                      │ rest
//!     └── pressed already ───────────────────────────┘                      ▼
//!   done ◀─rest─ pull off ◀── set position ◀─rest─ halt ◀──pressed── approach, slowly
//! ```
//!
//! Owns the order of the phases and the ways. Promises: the position of the switch is the one at
//! the edge of the slow approach, however far the axis ran on; every way is bounded, so homing ends;
//! an axis is never sent toward a limit that is pressed, but for the switch it looks for; homing
//! that fails leaves the axis at rest, with the positions it had, or, if it only could not pull
//! off, with the right ones.
//!
//! Absent: the axis. Effects say what it shall do, events what it did; positions in both are those
//! of the axis at that time, so those after [`HomeEffect::SetPosition`] are the new ones.

use super::input::Switch;
use crate::Direction;
use keys::StopMode;

/// How an axis is homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomeConfig {
    /// The switch that it looks for.
    pub switch: Switch,
    /// Where that is. A limit is at its own end: [`Switch::Min`] is negative.
    pub direction: Direction,
    /// Speed of the seek, Hz, from 1.
    pub seek_hz: u32,
    /// Speed of backing off, of the approach and of pulling off, Hz, 1 to `seek_hz`.
    pub approach_hz: u32,
    /// Acceleration of all of them, steps/s², from 1.
    pub accel_hz_per_s: u32,
    /// How the seek ends on the switch. [`StopMode::Decelerate`] needs v²/2a steps behind it.
    pub seek_stop: StopMode,
    /// Longest way of the seek, steps, 1 to [`HOME_STEPS_MAX`].
    pub travel_steps_max: u64,
    /// Longest way until the switch is released, steps, 1 to [`HOME_STEPS_MAX`].
    pub back_off_steps_max: u64,
    /// Way behind the release from which the approach begins, steps, 1 to [`HOME_STEPS_MAX`].
    pub margin_steps: u64,
    /// Position of the switch.
    pub home_position_steps: i64,
    /// Where the axis ends: so many steps off the switch, at most [`HOME_STEPS_MAX`]. 0: where the
    /// approach has stopped.
    pub pull_off_steps: u64,
}

/// Longest way of one phase: 10¹² steps, 58 days at 200 kHz.
pub const HOME_STEPS_MAX: u64 = 1_000_000_000_000;

impl HomeConfig {
    /// The limit at the low end becomes 0: 5 kHz there, 500 Hz for the approach, 50 kHz/s.
    pub const fn min_switch(travel_steps_max: u64) -> Self {
        Self {
            switch: Switch::Min,
            direction: Direction::Negative,
            seek_hz: 5_000,
            approach_hz: 500,
            accel_hz_per_s: 50_000,
            seek_stop: StopMode::Decelerate,
            travel_steps_max,
            back_off_steps_max: 4_000,
            margin_steps: 100,
            home_position_steps: 0,
            pull_off_steps: 200,
        }
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), HomeConfigError> {
        let wrong_way = match self.switch {
            Switch::Min => self.direction != Direction::Negative,
            Switch::Max => self.direction != Direction::Positive,
            Switch::Home => false,
        };
        let way = |steps: u64| (1..=HOME_STEPS_MAX).contains(&steps);
        if wrong_way {
            Err(HomeConfigError::Direction)
        } else if self.approach_hz == 0 || self.approach_hz > self.seek_hz {
            Err(HomeConfigError::Speed)
        } else if self.accel_hz_per_s == 0 {
            Err(HomeConfigError::Acceleration)
        } else if !way(self.travel_steps_max)
            || !way(self.back_off_steps_max)
            || !way(self.margin_steps)
            || self.pull_off_steps > HOME_STEPS_MAX
        {
            Err(HomeConfigError::Way)
        } else {
            Ok(())
        }
    }
}

/// Why an axis cannot be homed like this.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomeConfigError {
    /// A limit is looked for at the other end.
    Direction,
    /// `approach_hz` is 0 or more than `seek_hz`.
    Speed,
    /// No acceleration.
    Acceleration,
    /// A way is 0 or longer than [`HOME_STEPS_MAX`].
    Way,
}

impl core::fmt::Display for HomeConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Direction => write!(f, "homing looks for a limit at the other end"),
            Self::Speed => write!(f, "the approach of homing is 1 Hz to the speed of its seek"),
            Self::Acceleration => write!(f, "homing needs an acceleration"),
            Self::Way => write!(f, "each way of homing is 1 to {HOME_STEPS_MAX} steps"),
        }
    }
}

impl core::error::Error for HomeConfigError {}

/// Why homing failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomeError {
    /// The seek ended without the switch.
    NotFound,
    /// Backing off ended without its release.
    NotReleased,
    /// The axis ran over the switch, and it was not there on the way back.
    NotThere,
    /// It was not there again at the slow approach.
    NotFoundAgain,
    /// The axis came to another limit.
    WrongLimit(Switch),
    /// The axis was stopped.
    Canceled,
}

impl core::fmt::Display for HomeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotFound => write!(f, "switch never found"),
            Self::NotReleased => write!(f, "switch never released"),
            Self::NotThere => write!(f, "switch not there on the way back"),
            Self::NotFoundAgain => write!(f, "switch not found again by the slow approach"),
            Self::WrongLimit(switch) => write!(f, "came to the {switch}"),
            Self::Canceled => write!(f, "stopped before its end"),
        }
    }
}

impl core::error::Error for HomeError {}

/// Which switches of an axis are active.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Switches {
    /// [`Switch::Min`].
    pub min: bool,
    /// [`Switch::Max`].
    pub max: bool,
    /// [`Switch::Home`].
    pub home: bool,
}

impl Switches {
    /// Returns whether one is active.
    pub const fn get(&self, switch: Switch) -> bool {
        match switch {
            Switch::Min => self.min,
            Switch::Max => self.max,
            Switch::Home => self.home,
        }
    }

    /// Notes whether one is active.
    pub const fn set(&mut self, switch: Switch, active: bool) {
        match switch {
            Switch::Min => self.min = active,
            Switch::Max => self.max = active,
            Switch::Home => self.home = active,
        }
    }
}

/// What happens to the axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomeEvent {
    /// Homing begins. The axis rests.
    Begin {
        /// Where.
        position_steps: i64,
        /// What is active.
        switches: Switches,
    },
    /// One of its switches became active or inactive.
    Input {
        /// Which.
        switch: Switch,
        /// Whether it is active now.
        active: bool,
        /// Where the axis was at that edge.
        at_position_steps: i64,
    },
    /// The axis rests: at the end of a run, or after a halt.
    Rest {
        /// Where.
        position_steps: i64,
    },
    /// The axis was stopped by another, or is about to be.
    Stopped,
}

/// What the axis shall do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomeEffect {
    /// Go there, from rest or from another run.
    Run {
        /// The position to go to.
        to_steps: i64,
        /// Speed, Hz.
        speed_hz: u32,
        /// Acceleration, steps/s².
        accel_hz_per_s: u32,
    },
    /// Come to rest, and tell by [`HomeEvent::Rest`].
    Halt(StopMode),
    /// The place where the axis rests has this position.
    SetPosition(i64),
    /// Homing has ended.
    Done,
    /// Homing has ended without a result. The axis rests, or is being stopped.
    Failed(HomeError),
}

/// Effects in order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HomeEffects([Option<HomeEffect>; 2]);

impl HomeEffects {
    const NONE: Self = Self([None; 2]);

    const fn one(effect: HomeEffect) -> Self {
        Self([Some(effect), None])
    }

    const fn two(first: HomeEffect, second: HomeEffect) -> Self {
        Self([Some(first), Some(second)])
    }
}

impl IntoIterator for HomeEffects {
    type Item = HomeEffect;
    type IntoIter = core::iter::Flatten<core::array::IntoIter<Option<HomeEffect>, 2>>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter().flatten()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    Seek,
    /// The seek has found the switch and comes to rest.
    Found,
    BackOff {
        from_steps: i64,
        /// The switch was pressed at some time since.
        pressed: bool,
    },
    /// It is released; the axis goes on by the margin.
    Margin {
        from_steps: i64,
    },
    Approach,
    /// The approach has found the switch there, and comes to rest.
    At {
        edge_steps: i64,
    },
    PullOff,
    /// It comes to rest.
    Failing(HomeError),
}

/// Homing of one axis.
#[derive(Clone, Copy, Debug)]
pub struct HomeMachine {
    config: HomeConfig,
    switches: Switches,
    phase: Phase,
}

impl HomeMachine {
    /// Takes how the axis is homed.
    ///
    /// # Errors
    /// It cannot be homed like this.
    pub fn new(config: HomeConfig) -> Result<Self, HomeConfigError> {
        config.check()?;
        Ok(Self {
            config,
            switches: Switches::default(),
            phase: Phase::Idle,
        })
    }

    /// Returns whether homing has begun and not ended.
    pub const fn is_active(&self) -> bool {
        !matches!(self.phase, Phase::Idle)
    }

    /// Takes what happened, gives what is to be done. An event that a phase does not wait for means
    /// nothing; one while nothing is active, neither, but for [`HomeEvent::Begin`].
    pub fn handle(&mut self, event: HomeEvent) -> HomeEffects {
        match event {
            HomeEvent::Begin {
                position_steps,
                switches,
            } => self.begin(position_steps, switches),
            _ if !self.is_active() => HomeEffects::NONE,
            HomeEvent::Input {
                switch,
                active,
                at_position_steps,
            } => self.input(switch, active, at_position_steps),
            HomeEvent::Rest { position_steps } => self.rest(position_steps),
            HomeEvent::Stopped => self.fail(match self.phase {
                Phase::Failing(error) => error,
                _ => HomeError::Canceled,
            }),
        }
    }

    fn begin(&mut self, position_steps: i64, switches: Switches) -> HomeEffects {
        if self.is_active() {
            return HomeEffects::NONE;
        }
        self.switches = switches;
        if switches.get(self.config.switch) {
            self.back_off(position_steps)
        } else {
            self.phase = Phase::Seek;
            let to_steps = self.toward(position_steps, self.config.travel_steps_max);
            self.run(to_steps, self.config.seek_hz, self.config.direction)
        }
    }

    fn input(&mut self, switch: Switch, active: bool, at_steps: i64) -> HomeEffects {
        self.switches.set(switch, active);
        if switch != self.config.switch {
            return match self.heading() {
                Some(way) if self.is_blocked(way) => {
                    self.phase = Phase::Failing(HomeError::WrongLimit(limit_of(way)));
                    HomeEffects::one(HomeEffect::Halt(StopMode::Halt))
                }
                _ => HomeEffects::NONE,
            };
        }
        match self.phase {
            Phase::Seek if active => {
                self.phase = Phase::Found;
                HomeEffects::one(HomeEffect::Halt(self.config.seek_stop))
            }
            Phase::BackOff { from_steps, .. } if active => {
                self.phase = Phase::BackOff {
                    from_steps,
                    pressed: true,
                };
                HomeEffects::NONE
            }
            Phase::BackOff {
                from_steps,
                pressed: true,
            } => {
                self.phase = Phase::Margin { from_steps };
                let to_steps = self.off(at_steps, self.config.margin_steps);
                self.run_off(to_steps)
            }
            // It was no release yet.
            Phase::Margin { from_steps } if active => {
                self.phase = Phase::BackOff {
                    from_steps,
                    pressed: true,
                };
                self.run_off(self.off(from_steps, self.config.back_off_steps_max))
            }
            Phase::Approach if active => {
                self.phase = Phase::At {
                    edge_steps: at_steps,
                };
                HomeEffects::one(HomeEffect::Halt(StopMode::Halt))
            }
            _ => HomeEffects::NONE,
        }
    }

    fn rest(&mut self, position_steps: i64) -> HomeEffects {
        match self.phase {
            Phase::Idle => HomeEffects::NONE,
            Phase::Seek => self.fail(HomeError::NotFound),
            Phase::Found => self.back_off(position_steps),
            Phase::BackOff { pressed: true, .. } => self.fail(HomeError::NotReleased),
            Phase::BackOff { .. } => self.fail(HomeError::NotThere),
            Phase::Margin { from_steps } => {
                self.phase = Phase::Approach;
                // Where backing off began the switch was pressed or is behind; and as much again.
                let to_steps = self.toward(from_steps, self.config.margin_steps);
                self.run(to_steps, self.config.approach_hz, self.config.direction)
            }
            Phase::Approach => self.fail(HomeError::NotFoundAgain),
            Phase::At { edge_steps } => {
                let home_steps = self.config.home_position_steps;
                let beyond_steps = position_steps.saturating_sub(edge_steps);
                let set = HomeEffect::SetPosition(home_steps.saturating_add(beyond_steps));
                if self.config.pull_off_steps == 0 {
                    self.phase = Phase::Idle;
                    return HomeEffects::two(set, HomeEffect::Done);
                }
                self.phase = Phase::PullOff;
                let to_steps = self.off(home_steps, self.config.pull_off_steps);
                match self.run_off(to_steps).0 {
                    [Some(run @ HomeEffect::Run { .. }), _] => HomeEffects::two(set, run),
                    failed => HomeEffects(failed),
                }
            }
            Phase::PullOff => {
                self.phase = Phase::Idle;
                HomeEffects::one(HomeEffect::Done)
            }
            Phase::Failing(error) => self.fail(error),
        }
    }

    fn back_off(&mut self, from_steps: i64) -> HomeEffects {
        self.phase = Phase::BackOff {
            from_steps,
            pressed: self.switches.get(self.config.switch),
        };
        self.run_off(self.off(from_steps, self.config.back_off_steps_max))
    }

    /// Runs at the slow speed, off the switch.
    fn run_off(&mut self, to_steps: i64) -> HomeEffects {
        let away = opposite(self.config.direction);
        self.run(to_steps, self.config.approach_hz, away)
    }

    /// Runs, unless a limit is in the way. That can only be at rest: a limit that is pressed in
    /// motion ends it.
    fn run(&mut self, to_steps: i64, speed_hz: u32, way: Direction) -> HomeEffects {
        if self.is_blocked(way) {
            return self.fail(HomeError::WrongLimit(limit_of(way)));
        }
        HomeEffects::one(HomeEffect::Run {
            to_steps,
            speed_hz,
            accel_hz_per_s: self.config.accel_hz_per_s,
        })
    }

    /// Returns whether a limit is pressed in this direction that is not the switch looked for.
    fn is_blocked(&self, way: Direction) -> bool {
        let limit = limit_of(way);
        limit != self.config.switch && self.switches.get(limit)
    }

    /// Returns the direction in which the axis moves now.
    fn heading(&self) -> Option<Direction> {
        match self.phase {
            Phase::Seek | Phase::Found | Phase::Approach | Phase::At { .. } => {
                Some(self.config.direction)
            }
            Phase::BackOff { .. } | Phase::Margin { .. } | Phase::PullOff => {
                Some(opposite(self.config.direction))
            }
            Phase::Idle | Phase::Failing(_) => None,
        }
    }

    fn fail(&mut self, error: HomeError) -> HomeEffects {
        self.phase = Phase::Idle;
        HomeEffects::one(HomeEffect::Failed(error))
    }

    fn toward(&self, from_steps: i64, steps: u64) -> i64 {
        move_by(from_steps, steps, self.config.direction)
    }

    fn off(&self, from_steps: i64, steps: u64) -> i64 {
        move_by(from_steps, steps, opposite(self.config.direction))
    }
}

fn move_by(from_steps: i64, steps: u64, way: Direction) -> i64 {
    match way {
        Direction::Positive => from_steps.saturating_add_unsigned(steps),
        Direction::Negative => from_steps.saturating_sub_unsigned(steps),
    }
}

const fn opposite(way: Direction) -> Direction {
    match way {
        Direction::Positive => Direction::Negative,
        Direction::Negative => Direction::Positive,
    }
}

const fn limit_of(way: Direction) -> Switch {
    match way {
        Direction::Positive => Switch::Max,
        Direction::Negative => Switch::Min,
    }
}

#[cfg(test)]
mod tests;
