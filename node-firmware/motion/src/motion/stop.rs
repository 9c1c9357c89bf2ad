//! The one stop: from every state to rest, at once or on the path.

use super::{Barrier, Hold, Motion, MotionEvent, Phase, TOLD_MAX, outputs::Laser};
use crate::{
    StepBackend, Ticks,
    limits::{CHANNELS, TICK_HZ},
    real::Real,
};
use keys::{AxisId, StopMode};

impl<B: StepBackend> Motion<'_, B> {
    /// The one stop: drops everything that is not played. [`StopMode::Halt`] is complete when this
    /// returns, [`StopMode::Decelerate`] when [`Motion::poll`] says [`MotionEvent::Stopped`].
    pub fn stop(&mut self, mut mode: StopMode, now: Ticks) {
        // What belongs to the time before the stop happened before it. Of its events only what is
        // wrong still matters, and what the pins say and are to show.
        let mut missed = None;
        let mut kept: heapless::Vec<MotionEvent, TOLD_MAX> = heapless::Vec::new();
        while let Some(event) = self.poll(now) {
            match event {
                MotionEvent::Limit { .. } => {
                    mode = StopMode::Halt;
                    missed = Some(event);
                    break;
                }
                MotionEvent::HomeFailed { .. }
                | MotionEvent::CdFailed { .. }
                | MotionEvent::StopInput { .. } => {
                    missed = Some(event);
                    break;
                }
                MotionEvent::Probe { .. }
                | MotionEvent::Output(_)
                | MotionEvent::ShiftOut { .. }
                | MotionEvent::ShiftFault(_) => {
                    // Cannot fail: it ends before it is full, and later calls tell the rest.
                    let _ = kept.push(event);
                    if kept.len() + 1 == TOLD_MAX {
                        break;
                    }
                }
                MotionEvent::Fault(code) => {
                    self.fault = Some(code);
                    break;
                }
                MotionEvent::Miscount { axis, .. } => {
                    // Told again when the stop is complete.
                    self.miscounts_steps[usize::from(axis.0)] = 0;
                    break;
                }
                MotionEvent::Stopped => {
                    self.phase = Phase::Stopped;
                    break;
                }
                _ => {}
            }
        }
        let told = kept.into_iter().chain(missed);
        told.for_each(|event| self.tell(event));
        self.homing = None;
        self.station = false;
        self.lidar_until = None;
        self.halt_cd();
        match (self.phase, mode) {
            (Phase::Stopped, _) | (Phase::Decelerating, StopMode::Decelerate) => {}
            (Phase::Rest, _) => self.end_stop(),
            (Phase::Playing { .. }, StopMode::Decelerate) => self.decelerate(),
            (Phase::Playing { .. } | Phase::Decelerating, StopMode::Halt) => {
                self.halt_backend();
                self.end_stop();
            }
        }
    }

    /// Halts the channels. What comes next may begin with a turn, and the last step's direction has
    /// to be held before it.
    pub(super) fn halt_backend(&mut self) {
        let timing = &self.timing[..self.axis_count];
        let hold_ticks = timing.iter().map(|axis| axis.hold_ticks).max();
        self.quiet_at = self.backend.halt(self.now).plus(hold_ticks.unwrap_or(0));
    }

    /// After [`MotionEvent::Stopped`]: the next queue begins, its counters at 0.
    pub fn begin_queue(&mut self) {
        self.accepted_commands = 0;
        self.executed_commands = 0;
        self.expected_commands = 0;
        self.extended_commands = 0;
        self.watch = None;
    }

    /// Begins a controlled stop: on its path, by its own law, where a ramp or a line is under way;
    /// else each axis by itself.
    pub(super) fn decelerate(&mut self) {
        self.planner.hold(true);
        if self.is_driving() {
            self.rest_drives();
        }
        if self.is_driving() || self.stop_path().is_some() {
            self.phase = Phase::Decelerating;
            self.note_speeds();
            return;
        }
        self.ring.clear();
        self.planner.forget();
        let mut cut_ticks = u64::MAX;
        for axis in &mut self.backend.axes()[..self.axis_count] {
            cut_ticks = cut_ticks.min(axis.encoded_ticks());
            axis.decelerate();
        }
        // Up to there every axis plays what was planned.
        let cut = self.started_at.plus(cut_ticks);
        self.marks.cut(cut);
        self.phase = Phase::Decelerating;
        self.note_speeds();
    }

    pub(super) fn note_speeds(&mut self) {
        let started_at = self.started_at.0;
        let axes = &self.backend.axes()[..self.axis_count];
        for (index, (to, axis)) in self.encoded_mhz.iter_mut().zip(axes).enumerate() {
            let mut speed_mhz = axis.speed_mhz();
            if speed_mhz == 0 && self.drives[index].is_some() {
                // Behind a change in flight the encoder rests until the next edge, and the axis moves.
                let speed = self.planner.way_speed(index, axis, started_at);
                speed_mhz = (speed * Real::of(1_000 * TICK_HZ)).rounded();
            }
            *to = match i32::try_from(speed_mhz) {
                Ok(speed_mhz) => speed_mhz,
                Err(_) if speed_mhz < 0 => i32::MIN,
                Err(_) => i32::MAX,
            };
        }
    }

    pub(super) fn end_stop(&mut self) {
        self.unchecked_axes = self.axis_count;
        self.marks.cut(self.now);
        self.pass_marks_silently();
        self.ring.clear();
        self.planner.forget();
        self.hold = Hold::None;
        self.change_due = false;
        self.dry_by_hold = false;
        self.drives.fill(None);
        self.homing = None;
        self.laser = Laser::default();
        self.rest_enables();
        self.limit_told = false;
        self.headings = [None; CHANNELS];
        for axis in 0..self.axis_count {
            self.planned_steps[axis] = self.backend.played_steps(AxisId(axis as u8));
        }
        self.planned_origins_steps = self.origins_steps;
        self.phase = Phase::Stopped;
        self.barrier = Barrier::Open;
        self.start = None;
        self.resume_at = Ticks(0);
    }

    pub(super) fn pass_marks_silently(&mut self) {
        while self.pass_marks().is_some() {}
    }

    /// Returns whether a stop is under way and has not been told.
    pub fn is_stopping(&self) -> bool {
        matches!(self.phase, Phase::Decelerating | Phase::Stopped)
    }
}
