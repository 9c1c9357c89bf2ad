//! What happens as time passes: commands end, barriers wait and go, the channels come to rest.

use super::{
    Barrier, CHANGE_AGAIN_TICKS, Hold, Motion, MotionEvent, Phase, Start,
    marks::{Mark, What},
    rest_from,
};
use crate::{
    Axis, StepBackend, Ticks,
    io::enable::AxisSet,
    limits::{ALARM_TICKS, MARKS_MAX, TICKS_PER_US},
};
use core::mem;
use keys::{AxisId, Command, status::FaultCode};

impl<B: StepBackend> Motion<'_, B> {
    /// Returns when [`Motion::poll`] has something to tell, `None` if only a command or a stop can
    /// change anything.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        let told = (!self.told.is_empty()).then_some(self.now);
        [
            self.phase_timeout(),
            self.inputs.poll_timeout(),
            self.cd_timeout(),
            self.outputs_timeout(),
            told,
        ]
        .into_iter()
        .flatten()
        .min()
    }

    pub(super) fn phase_timeout(&self) -> Option<Ticks> {
        match self.phase {
            Phase::Stopped => Some(self.now),
            // Its end depends on what the hardware still holds.
            Phase::Decelerating => Some(self.now.plus(1_000 * TICKS_PER_US)),
            Phase::Rest | Phase::Playing { .. } => {
                let event = self.marks.iter().find(|mark| mark.what.tells());
                let end = match self.phase {
                    Phase::Playing { timeline } if self.now < timeline => Some(timeline),
                    Phase::Playing { timeline } => {
                        Some(rest_from(timeline).max(self.now.plus(TICKS_PER_US)))
                    }
                    _ => None,
                };
                // Half of what is planned has ended: room for more of what waits.
                let plan = (self.ring.count() > 0)
                    .then(|| self.marks.iter().nth(MARKS_MAX / 2))
                    .flatten();
                let marks = [event, plan].into_iter().flatten().map(|mark| mark.end);
                let first_edge = self.start.map(|start| {
                    start
                        .first_edge_at
                        .unwrap_or(start.start_at)
                        .max(self.now.plus(1))
                });
                let alarm = self.alarm().filter(|_| self.phase == Phase::Rest);
                // A drive or a resumption begins with the next call.
                let begins = matches!(self.hold, Hold::Resuming(_)) || self.begins_drive();
                let begins = begins && self.phase == Phase::Rest && !self.waits_enable;
                let begin = begins.then_some(self.now);
                let drives = self.drives_timeout();
                let change = self.change_due && (self.rests_on_path() || self.planner.has_path());
                let change = change.then_some(self.now.plus(CHANGE_AGAIN_TICKS));
                marks
                    .chain(end)
                    .chain(first_edge)
                    .chain(alarm)
                    .chain(begin)
                    .chain(change)
                    .chain(drives)
                    .min()
            }
        }
    }

    /// Takes what has ended by `self.now`.
    pub(super) fn pass_marks(&mut self) -> Option<MotionEvent> {
        while let Some(mark) = self.marks.front()
            && mark.end <= self.now
        {
            let Mark { end, what } = *mark;
            self.marks.pop();
            self.ring.pop();
            self.executed_commands += 1;
            self.watch_end(end);
            match what {
                What::Moves(_) | What::Path(_) | What::Rest => {}
                What::Origin {
                    axis, origin_steps, ..
                } => {
                    self.origins_steps[usize::from(axis.0)] = origin_steps;
                }
                What::Laser { power_percent } => {
                    if let Some(event) = self.set_laser(power_percent) {
                        return Some(event);
                    }
                }
                What::Lidar => return Some(MotionEvent::LidarRequest),
                What::StatusCd => return Some(MotionEvent::StatusCd),
            }
        }
        None
    }

    /// Returns when the channels must be started for an armed barrier.
    pub(super) fn alarm(&self) -> Option<Ticks> {
        match self.barrier {
            Barrier::Armed { start_at } => Some(Ticks(start_at.0.saturating_sub(ALARM_TICKS))),
            Barrier::Open | Barrier::Waiting => None,
        }
    }

    /// Waits at a barrier, or goes on.
    pub(super) fn pass_barrier(&mut self) -> Option<MotionEvent> {
        let at_barrier = self.phase == Phase::Rest
            && self.marks.front().is_none()
            && matches!(self.ring.peek(), Some(Command::Barrier { .. }));
        if !at_barrier {
            return None;
        }
        let command = self.executed_commands;
        match self.barrier {
            Barrier::Open => {
                self.barrier = Barrier::Waiting;
                self.withhold_laser();
                // So that none of them delays the start.
                self.enables.wants_motion(AxisSet::QUEUE, self.now);
                Some(MotionEvent::AtBarrier { command })
            }
            Barrier::Waiting => None,
            Barrier::Armed { .. } if self.alarm() > Some(self.now) => None,
            Barrier::Armed { start_at }
                if self.now.max(self.quiet_at).plus(self.lead_ticks) > start_at =>
            {
                self.barrier = Barrier::Waiting;
                Some(MotionEvent::BarrierMissed { command })
            }
            Barrier::Armed { start_at } => {
                self.ring.advance();
                self.marks.push(Mark {
                    end: start_at,
                    what: What::Rest,
                });
                self.barrier = Barrier::Open;
                self.resume_at = start_at;
                self.start = Some(Start {
                    command,
                    start_at,
                    first_edge_at: None,
                });
                None
            }
        }
    }

    /// Tells when the first edge behind a barrier has left.
    pub(super) fn pass_start(&mut self) -> Option<MotionEvent> {
        let start = self.start?;
        let nothing_steps = self.phase == Phase::Rest
            && self.marks.front().is_none()
            && self
                .ring
                .peek()
                .is_none_or(|next| matches!(next, Command::Barrier { .. }));
        let first_edge_at = match start.first_edge_at {
            Some(at) => at,
            None if nothing_steps => start.start_at,
            None => return None,
        };
        if first_edge_at > self.now {
            return None;
        }
        self.start = None;
        Some(MotionEvent::Started {
            command: start.command,
            first_edge_at,
        })
    }

    /// Notices that the channels have come to rest.
    pub(super) fn pass_phase(&mut self) -> Option<MotionEvent> {
        match self.phase {
            // A drive that was ended before it began, or while it was held.
            Phase::Rest if matches!(self.hold, Hold::None) => self.pass_drive(),
            Phase::Rest => None,
            Phase::Stopped => {
                self.phase = Phase::Rest;
                Some(MotionEvent::Stopped)
            }
            Phase::Decelerating if self.backend.is_playing() => None,
            Phase::Decelerating => {
                self.settle_axes();
                self.end_stop();
                self.phase = Phase::Rest;
                Some(MotionEvent::Stopped)
            }
            Phase::Playing { timeline } => {
                if let Some(event) = self.pass_drive() {
                    return Some(event);
                }
                let starved = self.is_starved();
                let over = starved || self.now >= rest_from(timeline);
                if !over || self.backend.is_playing() {
                    return None;
                }
                self.settle_axes();
                self.phase = Phase::Rest;
                self.rest_enables();
                if starved || self.planner.is_unfinished() {
                    // The axes stood still in the middle of a path. Nothing goes on from there by
                    // itself.
                    self.fault = Some(FaultCode::PLAN_LATE);
                }
                self.planner.rest();
                self.settle_drives();
                match self.hold {
                    Hold::None if self.is_driving() => return self.pass_drive(),
                    Hold::None => {}
                    Hold::Slowing | Hold::At(_) => return Some(MotionEvent::Held),
                    Hold::Resuming(_) => return None,
                }
                let waits = self.ring.peek();
                let turns = waits.is_some_and(|next| self.must_turn(&next));
                if turns {
                    // It rests in the midst of a job, for as long as the register needs.
                    self.withhold_laser();
                }
                let waits = turns || waits.is_some_and(|next| self.waits_for_rest(&next));
                // What followed was not planned because motion was to be held.
                let waits = mem::take(&mut self.dry_by_hold) || waits;
                if self.executed_commands < self.expected_commands && !waits {
                    self.withhold_laser();
                    Some(MotionEvent::Underrun)
                } else {
                    Some(MotionEvent::Rest)
                }
            }
        }
    }

    /// Returns whether the planner came too late for an axis: its segments ended in full run.
    pub(super) fn is_starved(&mut self) -> bool {
        self.planner.has_brakes() && {
            let axes = &self.backend.axes()[..self.axis_count];
            axes.iter().any(Axis::is_starved)
        }
    }

    /// Compares the ledger with the counters after the axes have come to rest. A difference is told
    /// once.
    pub(super) fn check_counters(&mut self) -> Option<MotionEvent> {
        while self.unchecked_axes > 0 {
            self.unchecked_axes -= 1;
            let index = self.unchecked_axes;
            let axis = AxisId(index as u8);
            let ledger_steps = self.backend.played_steps(axis);
            let counted_steps = self.backend.counted_steps(axis).unwrap_or(ledger_steps);
            let miscount = counted_steps - ledger_steps;
            if mem::replace(&mut self.miscounts_steps[index], miscount) != miscount {
                // Nobody knows where the axis is.
                self.frames_steps[index] = None;
                return Some(MotionEvent::Miscount {
                    axis,
                    ledger_steps,
                    counted_steps,
                });
            }
        }
        None
    }

    /// All channels have ended by themselves.
    pub(super) fn settle_axes(&mut self) {
        self.unchecked_axes = self.axis_count;
        for axis in 0..self.axis_count {
            let played = self.backend.played_steps(AxisId(axis as u8));
            self.backend.axes()[axis].halt(played);
        }
    }
}
