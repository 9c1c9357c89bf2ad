//! C and D as commands of the queue: each begins when all before it has ended, and what comes behind
//! it begins when it has arrived.
//!
//! Owns what happens between [`PositionsC`] and [`SwitchD`], their pulse hardware and their limits.
//! Neither has a ramp, so every stop is a halt; a limit that comes before the place that was asked
//! for means that nobody knew where the axis was, and is told.

use super::{Motion, MotionEvent, What, marks::Mark};
use crate::{
    Direction, StepBackend, Ticks,
    io::{
        enable::AxisSet,
        input::{Role, Switch},
        named::{
            ConfigC, ConfigD, EndD, GotoError, NamedConfigError, PositionsC, StatusCd, SwitchD,
            interval_ticks,
        },
    },
    limits::{CHANNELS, TICKS_PER_US},
};
use core::fmt;

/// How C and D move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConfigCd {
    /// C.
    pub c: ConfigC,
    /// D. Its limits are those of the input map.
    pub d: ConfigD,
}

/// Why C or D did not arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CdError {
    /// C does not go.
    Goto(GotoError),
    /// C came to a limit before its position.
    Limit(Switch),
    /// Both limits of D are pressed.
    LimitsD,
    /// D did not come to its limit in the time that the way takes.
    NotReachedD,
}

impl fmt::Display for CdError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Goto(error) => error.fmt(f),
            Self::Limit(switch) => write!(f, "C came to its {switch} before its position"),
            Self::LimitsD => write!(f, "both limits of D are pressed"),
            Self::NotReachedD => write!(f, "D did not come to its limit in time"),
        }
    }
}

impl core::error::Error for CdError {}

/// C and D of a node that has them.
#[derive(Clone, Debug)]
pub(super) struct Cd {
    c: PositionsC,
    d: SwitchD,
    /// Position of C = origin + its count.
    origin_steps: i64,
    /// Where C goes, and when its last step is due.
    going: Option<(u8, Ticks)>,
    /// What begins when the shift register has turned it.
    turning: Option<Turning>,
}

/// What waits for its direction.
#[derive(Clone, Copy, Debug)]
enum Turning {
    C {
        index: u8,
        steps: i64,
        interval_ticks: u64,
    },
    D {
        on: bool,
    },
}

impl Cd {
    /// Takes the axes as they are: limits that are pressed now are known.
    pub(super) fn new(
        config: ConfigCd,
        is_active: impl Fn(Role) -> bool,
    ) -> Result<Self, NamedConfigError> {
        let mut cd = Self {
            c: PositionsC::new(config.c)?,
            d: SwitchD::new(config.d)?,
            origin_steps: 0,
            going: None,
            turning: None,
        };
        for switch in [Switch::Min, Switch::Max] {
            if let Some(at) = cd.c.limit(switch, is_active(Role::C(switch))) {
                cd.origin_steps = at.position_steps;
            }
            cd.d.limit(switch, is_active(Role::D(switch)));
        }
        Ok(cd)
    }

    fn is_moving(&self) -> bool {
        self.going.is_some() || self.d.is_moving()
    }
}

impl<B: StepBackend> Motion<'_, B> {
    /// Returns whether C or D moves.
    pub fn is_cd_moving(&self) -> bool {
        self.cd.as_ref().is_some_and(Cd::is_moving)
    }

    /// Returns where C and D are; `None` without them.
    pub fn status_cd(&self) -> Option<StatusCd<'_>> {
        let cd = self.cd.as_ref()?;
        Some(StatusCd {
            c: &cd.c,
            c_position_steps: cd.origin_steps + self.backend.counted_c(),
            d: &cd.d,
        })
    }

    /// Returns when something of C or D ends.
    pub(super) fn cd_timeout(&self) -> Option<Ticks> {
        let cd = self.cd.as_ref()?;
        let c = cd
            .going
            .map(|(_, until)| until.max(self.now.plus(TICKS_PER_US)));
        c.into_iter().chain(cd.d.poll_timeout()).min()
    }

    /// Lets C and D move up to `until`, or to where something ends. Returns how far it came.
    pub(super) fn service_cd(&mut self, until: Ticks) -> Ticks {
        if !self.is_cd_moving() {
            return until;
        }
        let due = self.cd.as_ref().and_then(|cd| cd.d.poll_timeout());
        let until = due.map_or(until, |due| due.max(self.now).min(until));
        self.backend.cd().map_or(until, |cd| cd.service(until))
    }

    /// Takes what has ended by now.
    pub(super) fn pass_cd(&mut self) {
        match self.cd.as_ref().and_then(|cd| cd.turning) {
            Some(Turning::C {
                index,
                steps,
                interval_ticks,
            }) => self.run_c(index, steps, interval_ticks),
            Some(Turning::D { on }) => self.begin_d(on),
            None => {}
        }
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        if cd.going.is_some() && !pins.is_c_running() {
            cd.going = None;
            cd.c.rest(cd.origin_steps + pins.counted_c());
            self.end_station();
        } else if let Some(end) = cd.d.poll(self.now) {
            pins.halt_d(self.now);
            self.end_d(end);
        }
    }

    pub(super) fn begin_c(&mut self, index: u8) {
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        let counted_steps = pins.counted_c();
        match cd.c.goto(i64::from(index), cd.origin_steps + counted_steps) {
            Err(error) => self.fail_cd(CdError::Goto(error)),
            Ok(go) => {
                if let Some(at) = go.at {
                    cd.origin_steps = at.position_steps - counted_steps;
                }
                let Some(run) = go.run else {
                    self.end_station();
                    return;
                };
                let interval = interval_ticks(run.rate_hz).expect("it is 1 Hz at least");
                self.run_c(index, run.steps, interval);
            }
        }
    }

    /// Lets C go, once it points that way.
    fn run_c(&mut self, index: u8, steps: i64, interval_ticks: u64) {
        let turned = self.turn_beside(CHANNELS, Direction::of(steps));
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        let waits = Turning::C {
            index,
            steps,
            interval_ticks,
        };
        cd.turning = (!turned).then_some(waits);
        if turned {
            let ticks = steps.unsigned_abs().saturating_mul(interval_ticks);
            cd.going = Some((index, self.now.plus(ticks)));
            pins.run_c(self.now, steps, interval_ticks);
        }
    }

    pub(super) fn begin_d(&mut self, on: bool) {
        let way = if on {
            Direction::Positive
        } else {
            Direction::Negative
        };
        let turned = self.turn_beside(CHANNELS + 1, way);
        if let Some(cd) = self.cd.as_mut() {
            cd.turning = (!turned).then_some(Turning::D { on });
        }
        if !turned {
            return;
        }
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        match cd.d.go(on, self.now) {
            Err(_) => self.fail_cd(CdError::LimitsD),
            Ok(None) => self.end_station(),
            Ok(Some(run)) => {
                let interval = interval_ticks(run.rate_hz).expect("it is 1 Hz at least");
                pins.run_d(self.now, run.way, interval);
            }
        }
    }

    /// A limit of C changed.
    pub(super) fn limit_c(&mut self, switch: Switch, active: bool) {
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        let Some(at) = cd.c.limit(switch, active) else {
            return;
        };
        pins.halt_c(self.now);
        cd.origin_steps = at.position_steps - pins.counted_c();
        let waits = match cd.turning.take() {
            Some(Turning::C { index, .. }) => Some((index, self.now)),
            other => {
                cd.turning = other;
                None
            }
        };
        match cd.going.take().or(waits) {
            Some((index, _)) if cd.c.index() == Some(usize::from(index)) => self.end_station(),
            Some(_) => self.fail_cd(CdError::Limit(switch)),
            None => {}
        }
    }

    /// A limit of D changed.
    pub(super) fn limit_d(&mut self, switch: Switch, active: bool) {
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        let was_moving = cd.d.is_moving();
        if let Some(end) = cd.d.limit(switch, active) {
            pins.halt_d(self.now);
            if was_moving {
                self.end_d(end);
            }
        }
    }

    fn end_d(&mut self, end: EndD) {
        match end {
            EndD::Arrived => self.end_station(),
            EndD::NotReached => self.fail_cd(CdError::NotReachedD),
        }
    }

    /// Stops both where they are.
    pub(super) fn halt_cd(&mut self) {
        let (Some(cd), Some(pins)) = (self.cd.as_mut(), self.backend.cd()) else {
            return;
        };
        pins.halt_c(self.now);
        pins.halt_d(self.now);
        cd.going = None;
        cd.turning = None;
        cd.c.rest(cd.origin_steps + pins.counted_c());
        cd.d.stop();
        self.enables.rests(AxisSet::C.with(AxisSet::D), self.now);
    }

    fn fail_cd(&mut self, error: CdError) {
        self.tell(MotionEvent::CdFailed { error });
    }

    /// The command that ran while all else rested has ended.
    pub(super) fn end_station(&mut self) {
        self.station = false;
        self.enables.rests(AxisSet::C.with(AxisSet::D), self.now);
        self.ring.advance();
        self.marks.push(Mark {
            end: self.now,
            what: What::Rest,
        });
    }
}
