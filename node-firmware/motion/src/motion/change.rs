//! Changes in flight: hold, resume, another speed. What is planned behind what the hardware holds is
//! taken back, and the path goes on from there under what has changed.

use super::{
    Hold, Motion, Phase, Place,
    marks::{Mark, What},
    plan::lines_behind,
};
use keys::Command;

use crate::{
    Axis, StepBackend, Ticks,
    planner::{Begun, Split},
};

/// Most that [`Motion::set_speed_percent`] takes.
const SPEED_PERCENT_MAX: u16 = 400;

impl<B: StepBackend> Motion<'_, B> {
    /// Takes back what is planned behind what the hardware holds and goes on from there with the
    /// same line, under what has changed. Returns when the line ends now, `None` if no ramp or line
    /// is under way: then nothing has happened.
    pub(super) fn change_path(&mut self) -> Option<Begun> {
        self.leave_path(false)
    }

    /// The same for a stop, which must not have to wait.
    pub(super) fn stop_path(&mut self) -> Option<Begun> {
        self.leave_path(true)
    }

    fn leave_path(&mut self, stops: bool) -> Option<Begun> {
        let Phase::Playing { .. } = self.phase else {
            return None;
        };
        let axes = &mut self.backend.axes()[..self.axis_count];
        let (cut, on_path) = self.planner.cut_ticks(axes, self.started_at.0);
        let room = self.planner.can_change(cut, stops);
        if !on_path || !room || axes.iter().any(Axis::has_ended) {
            return None;
        }
        self.planner.rewind(axes, self.started_at.0);
        let split = self.planner.split(cut)?;
        let mut taken_back = 0_usize;
        let mut own = None;
        while let Some(mark) = self.marks.take_back(Ticks(cut)) {
            taken_back += 1;
            own = Some(mark.what);
            self.undo_steps(mark.what);
        }
        // The first of them is the line itself.
        self.ring.retract(taken_back.saturating_sub(1));
        self.planner.set_share(self.share);
        Some(self.go_on(split, own))
    }

    /// Goes on with a line that was left; `own` is its mark.
    pub(super) fn go_on(&mut self, split: Split, own: Option<What>) -> Begun {
        let ring = &self.ring;
        let behind = lines_behind(ring, 0, self.lidar_wait_ticks.is_some(), self.turns);
        let axes = &self.backend.axes()[..self.axis_count];
        let begun = self.planner.go_on(split, behind, axes);
        if let Some(What::Path(steps)) = own {
            for (planned, steps) in self.planned_steps.iter_mut().zip(steps) {
                *planned += steps;
            }
        }
        self.note_path(&begun, own);
        begun
    }

    /// Notes when a line ends, if it is known.
    pub(super) fn note_path(&mut self, begun: &Begun, what: Option<What>) {
        let mut end = Ticks(begun.end_ticks);
        self.phase = Phase::Playing { timeline: end };
        if let Some(split) = begun.held {
            self.hold = Hold::At(Place::Path(split));
            end = Ticks(u64::MAX);
        }
        self.dry_by_hold &= self.rests_on_path();
        if let Some(what) = what {
            self.marks.push(Mark { end, what });
        }
    }

    /// Slows down on the path and rests; [`MotionEvent::Held`](crate::MotionEvent::Held) tells when.
    /// What is no ramp and no line has no path to slow down on: raw moves and pauses stand still
    /// behind what the hardware holds, and go on from there.
    pub fn hold(&mut self, now: Ticks) {
        if self.is_stopping() {
            return;
        }
        match self.hold {
            Hold::Slowing | Hold::At(_) => return,
            Hold::Resuming(place) => self.hold = Hold::At(place),
            Hold::None => self.hold = Hold::Slowing,
        }
        self.planner.hold(true);
        self.dry_by_hold = true;
        self.withhold_laser();
        if now >= self.now {
            self.change_soon();
        }
    }

    /// Changes the path, or raw moves that are held, as soon as that is possible: what the hardware
    /// holds, and up to a few ms behind it, must be of one kind.
    fn change_soon(&mut self) {
        self.change_due = !self.change();
    }

    fn change(&mut self) -> bool {
        if self.is_driving() {
            self.change_drives();
            return true;
        }
        self.change_path().is_some() || (self.rests_on_path() && self.stand_still())
    }

    /// Makes a change that could not be made at once.
    pub(super) fn pass_change(&mut self) {
        let playing = matches!(self.phase, Phase::Playing { .. });
        if self.change_due && (!playing || self.change()) {
            self.change_due = false;
        }
    }

    /// Goes on where [`Motion::hold`] has left off. Nothing happens if it is not held.
    pub fn resume(&mut self) {
        if self.is_stopping() {
            return;
        }
        self.planner.hold(false);
        match self.hold {
            // Back to life where it rests.
            Hold::At(place @ Place::Raw { .. }) => self.hold = Hold::Resuming(place),
            Hold::At(place) => {
                self.hold = Hold::None;
                if self.change_path().is_none() {
                    self.hold = Hold::Resuming(place);
                }
            }
            Hold::Slowing => {
                self.hold = Hold::None;
                self.change_soon();
            }
            Hold::None | Hold::Resuming(_) => {}
        }
        if let Phase::Playing { .. } = self.phase
            && !self.is_driving()
        {
            self.give_laser_back();
        }
    }

    /// More of the path has arrived while its last line was planned to end at rest: it goes on.
    pub(super) fn extend_path(&mut self) {
        let Phase::Playing { timeline } = self.phase else {
            return;
        };
        let more = self.extended_commands != self.accepted_commands;
        let line_follows = matches!(self.ring.peek(), Some(Command::Line { .. }));
        if !more || !line_follows || self.rests_on_path() || !self.planner.ends_early(timeline.0) {
            return;
        }
        // Only if the last line is the one under way: another one has not begun yet, and is seen
        // again.
        if self
            .planner
            .is_last_under_way(&self.backend.axes()[..self.axis_count], self.started_at.0)
        {
            self.extended_commands = self.accepted_commands;
            self.change_path();
        }
    }

    /// Returns whether motion is held or about to be. A stop that comes to rest on the path is no
    /// hold.
    pub fn is_held(&self) -> bool {
        self.rests_on_path() && !self.is_stopping()
    }

    /// Returns whether what is planned comes to rest on the path: for a hold or for a stop.
    pub(super) fn rests_on_path(&self) -> bool {
        matches!(self.hold, Hold::Slowing | Hold::At(_))
    }

    /// Returns whether motion is held and rests.
    pub fn is_paused(&self) -> bool {
        self.is_held() && self.phase == Phase::Rest
    }

    /// Runs ramps and lines at this share of their speed from now on, also the one under way:
    /// 1 to 400 percent, but never faster than the drivers allow.
    pub fn set_speed_percent(&mut self, percent: u16) {
        let percent = u32::from(percent.clamp(1, SPEED_PERCENT_MAX));
        if self.is_stopping() {
            return;
        }
        self.share = (percent << 16) / 100;
        self.change_soon();
        self.planner.set_share(self.share);
    }

    /// Returns the share of their speed at which ramps and lines run, 2⁻¹⁶.
    pub fn speed_share(&self) -> u32 {
        self.share
    }

    pub(super) fn undo_steps(&mut self, what: What) {
        match what {
            What::Moves(runs) => {
                for run in runs.into_iter().flatten() {
                    self.planned_steps[usize::from(run.axis.0)] -= i64::from(run.steps);
                }
            }
            What::Path(steps) => {
                for (planned, steps) in self.planned_steps.iter_mut().zip(steps) {
                    *planned -= steps;
                }
            }
            What::Origin {
                axis, before_steps, ..
            } => self.planned_origins_steps[usize::from(axis.0)] = before_steps,
            What::Rest | What::Laser { .. } | What::Lidar | What::StatusCd => {}
        }
    }
}
