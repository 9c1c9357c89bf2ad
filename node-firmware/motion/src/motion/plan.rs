//! From the ring to the planner: what is begun, when, and what is noted of it.

use super::{
    Hold, Motion, Phase, Place,
    marks::{Mark, What},
    turns::Turns,
};
use crate::{
    Axis, CommandRing, StepBackend, Ticks,
    io::enable::AxisSet,
    law::{Law, speed_from_hz},
    limits::{CHANNELS, PATH_AHEAD_TICKS},
    lookahead::{LINES_MAX, Line, Lines},
    planner::{Begun, Run, Split, command_ticks, runs_of, ticks_of},
    steps::Moment,
};
use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
};

impl<B: StepBackend> Motion<'_, B> {
    /// Plans as much as fits.
    pub(super) fn plan(&mut self) {
        if self.phase == Phase::Stopped {
            return;
        }
        if self.phase != Phase::Rest && self.is_starved() {
            // What is left of the plan is left out: one axis slows down already.
            for axis in &mut self.backend.axes()[..self.axis_count] {
                axis.slow_down_with_others();
            }
            return;
        }
        if self.is_driving() {
            let lead_ticks = self.lead_ticks;
            if let Some(at) = self.plan_drives(lead_ticks) {
                self.started_at = at;
                self.backend.start(at, lead_ticks);
            }
            if self.planner.wants_brakes() {
                let axes = &mut self.backend.axes()[..self.axis_count];
                self.planner.leave_way_brakes(axes);
            }
            return;
        }
        self.pass_change();
        self.extend_path();
        if self.phase != Phase::Rest {
            let axes = &self.backend.axes()[..self.axis_count];
            let encoded = axes.iter().map(Axis::encoded_ticks).min().unwrap_or(0);
            self.planner.retire(self.started_at.0 + encoded);
        }
        let mut starts_at = None;
        let mut lead_ticks = self.lead_ticks;
        while self
            .planner
            .write(&mut self.backend.axes()[..self.axis_count])
            && self.planner.has_room()
        {
            if self.phase == Phase::Decelerating && !self.planner.is_at_speed() {
                break;
            }
            if let Hold::Resuming(place) = self.hold {
                if self.phase != Phase::Rest || !self.are_enabled(AxisSet::QUEUE, lead_ticks) {
                    break;
                }
                let at = self.now.max(self.quiet_at);
                starts_at = Some(at);
                self.hold = Hold::None;
                match place {
                    Place::Raw { left_ticks } => self.go_on_raw(left_ticks, at.plus(lead_ticks)),
                    Place::Path(split) => {
                        let own = self.marks.take_back(self.now).map(|mark| mark.what);
                        let at = Moment::of(at.plus(lead_ticks).0);
                        if let Some(own) = own {
                            self.undo_steps(own);
                        }
                        self.go_on(Split { at, ..split }, own);
                    }
                }
                continue;
            }
            let Some(command) = self.ring.peek() else {
                break;
            };
            // What is held may have steps left, and they go the way that the pins point now.
            let held = self.rests_on_path() && !self.planner.is_at_speed();
            if self.marks.is_full()
                || self.waits_for_rest(&command)
                || self.refuse_blocked(&command)
                || held
                || !self.are_turned(&command)
            {
                break;
            }
            let line = self.line_of(&command);
            if self.phase == Phase::Decelerating && line.is_none() {
                // It takes no time; what it would do is over.
                self.ring.advance();
                continue;
            }
            let takes_time = line.is_some() || ticks_of(&command).is_some_and(|ticks| ticks > 0);
            let enabled = self.phase != Phase::Rest || !takes_time || {
                let lead_ticks = self.resume_at.0.saturating_sub(self.now.0).max(lead_ticks);
                self.are_enabled(AxisSet::QUEUE, lead_ticks)
            };
            let begin = match self.phase {
                Phase::Stopped => break,
                Phase::Decelerating => Ticks(0),
                Phase::Playing { timeline }
                    if matches!(command, Command::Line { .. })
                        && starts_at.is_none()
                        && timeline > self.now.plus(PATH_AHEAD_TICKS) =>
                {
                    break;
                }
                Phase::Playing { timeline } => {
                    if takes_time && !self.can_append(starts_at.is_some()) {
                        break;
                    }
                    timeline
                }
                Phase::Rest if takes_time && !enabled => break,
                Phase::Rest if takes_time => {
                    let at = self.now.max(self.quiet_at);
                    lead_ticks = self.resume_at.0.saturating_sub(at.0).max(self.lead_ticks);
                    starts_at = Some(at);
                    at.plus(lead_ticks)
                }
                Phase::Rest => self.now.max(self.resume_at),
            };
            let mut first_edge_at = None;
            if let Some((line, jump_steps)) = line {
                let begun = self.begin_line(line, jump_steps, begin);
                first_edge_at = begun.first_edge_ticks.map(Ticks);
                self.ring.advance();
                if self.phase == Phase::Decelerating {
                    continue;
                }
                for (planned, steps) in self.planned_steps.iter_mut().zip(line.steps) {
                    *planned += steps;
                }
                self.note_path(&begun, Some(What::Path(line.steps)));
            } else {
                let mut end = begin;
                if takes_time {
                    let axes = &mut self.backend.axes()[..self.axis_count];
                    end = begin.plus(self.planner.plan(&command, axes));
                    self.phase = Phase::Playing { timeline: end };
                }
                let mut runs = runs_of(&command);
                let runs = [runs.next(), runs.next()];
                if runs[0].is_some() {
                    first_edge_at = Some(Ticks(end.0 - command_ticks(&runs)));
                }
                self.ring.advance();
                self.note(&command, runs, end);
            }
            self.watch_edge(first_edge_at);
            self.dry_by_hold &= self.rests_on_path();
            if let Some(start) = self.start.as_mut()
                && start.first_edge_at.is_none()
            {
                start.first_edge_at = first_edge_at;
            }
        }
        if let Some(at) = starts_at {
            self.started_at = at;
            self.backend.start(at, lead_ticks);
            self.give_laser_back();
        }
        if self.planner.wants_brakes() {
            let axes = &mut self.backend.axes()[..self.axis_count];
            self.planner.leave_brakes(axes, self.started_at.0);
        }
    }

    /// Returns whether a command begins only when all before it has ended.
    pub(super) fn waits_for_rest(&self, command: &Command) -> bool {
        match command {
            Command::Barrier { .. }
            | Command::Home { .. }
            | Command::MoveC { .. }
            | Command::MoveD { .. } => true,
            Command::LidarRead => self.lidar_wait_ticks.is_some(),
            _ => false,
        }
    }

    /// Returns the way of a ramp or a line and how many steps of its ramp it jumps over; `None`
    /// for other commands and where there is no way to go.
    pub(super) fn line_of(&self, command: &Command) -> Option<(Line, u16)> {
        self.line_from(command, &self.planned_steps, &self.planned_origins_steps)
    }

    /// The same from these steps since boot and origins.
    pub(super) fn line_from(
        &self,
        command: &Command,
        from_steps: &[i64; CHANNELS],
        origins_steps: &[i64; CHANNELS],
    ) -> Option<(Line, u16)> {
        let ramp = |axis: AxisId, steps: i64, ramp: Ramp| {
            if steps == 0 {
                return None;
            }
            let mut all = [0; CHANNELS];
            all[usize::from(axis.0)] = steps;
            let jump_steps = match ramp.shape {
                RampShape::Trapezoid { jump_steps, .. } => jump_steps,
                RampShape::Jerk { .. } | RampShape::Smooth { .. } => 0,
            };
            let speed = speed_from_hz(ramp.speed_hz);
            let law = Law::of(speed, ramp.accel_hz_per_s, ramp.shape);
            let line = Line {
                joins: false,
                ..Line::new(all, speed, law)
            };
            Some((line, jump_steps))
        };
        match *command {
            Command::Ramp {
                axis,
                steps,
                ramp: how,
            } => ramp(axis, i64::from(steps), how),
            Command::RampTo {
                axis,
                position_steps,
                ramp: how,
            } => {
                let index = usize::from(axis.0);
                let here = origins_steps[index].wrapping_add(from_steps[index]);
                let way = i128::from(position_steps) - i128::from(here);
                let way = way.clamp(-WAY_STEPS_MAX, WAY_STEPS_MAX);
                ramp(axis, way as i64, how)
            }
            _ => Line::of(command).map(|line| (line, 0)),
        }
    }

    pub(super) fn begin_line(&mut self, line: Line, jump_steps: u16, begin: Ticks) -> Begun {
        let ring = &self.ring;
        let behind = lines_behind(ring, 1, self.lidar_wait_ticks.is_some(), self.turns);
        let axes = &self.backend.axes()[..self.axis_count];
        let base_steps = self.planned_steps;
        self.planner
            .begin(line, jump_steps, behind, begin.0, base_steps, axes)
    }

    /// Returns whether every axis can take one more command. An axis that has ended cannot go on,
    /// and then none does: all rest, and start anew together.
    pub(super) fn can_append(&mut self, before_start: bool) -> bool {
        let axes = &self.backend.axes()[..self.axis_count];
        axes.iter()
            .all(|axis| axis.has_room() && (before_start || !axis.has_ended()))
    }

    /// Notes what ends when, of what is no path.
    pub(super) fn note(&mut self, command: &Command, runs: [Option<Run>; 2], end: Ticks) {
        let what = match *command {
            Command::Laser { power_percent } => What::Laser { power_percent },
            Command::LidarRead => What::Lidar,
            Command::StatusCd => What::StatusCd,
            Command::SetPosition {
                axis,
                position_steps,
            } => {
                let index = usize::from(axis.0);
                let before_steps = self.planned_origins_steps[index];
                // A position is a place on a ring of 2⁶⁴ steps.
                let origin_steps = position_steps.wrapping_sub(self.planned_steps[index]);
                self.planned_origins_steps[index] = origin_steps;
                What::Origin {
                    axis,
                    origin_steps,
                    before_steps,
                }
            }
            _ if runs[0].is_some() => What::Moves(runs),
            _ => What::Rest,
        };
        for run in runs.into_iter().flatten() {
            self.planned_steps[usize::from(run.axis.0)] += i64::from(run.steps);
        }
        self.marks.push(Mark { end, what });
    }
}

/// Longest way of one ramp: 4·10¹⁸ steps, 630,000 years at 200 kHz.
const WAY_STEPS_MAX: i128 = 1 << 62;

/// Commands behind a line that are looked at: [`LINES_MAX`] lines and as many between them that
/// take no time.
const LOOK_COMMANDS_MAX: usize = 2 * LINES_MAX;

/// Returns the commands for lines that follow behind so many commands. What takes no time does not end
/// a path, but for a reading that is waited for.
pub(super) fn lines_behind<'r, 'm>(
    ring: &'r CommandRing<'m>,
    count: usize,
    lidar_waits: bool,
    turns: Turns,
) -> LinesBehind<'r, 'm> {
    LinesBehind {
        ring,
        begin: count,
        next: count,
        lidar_waits,
        turns,
    }
}

/// The lines that follow, read one by one.
#[derive(Clone)]
pub(super) struct LinesBehind<'r, 'm> {
    ring: &'r CommandRing<'m>,
    /// Place in the ring of the first command, and of the next one that is read.
    begin: usize,
    next: usize,
    lidar_waits: bool,
    turns: Turns,
}

impl Iterator for LinesBehind<'_, '_> {
    type Item = Command;

    /// Behind the end of the path it gives `None` again and again.
    fn next(&mut self) -> Option<Command> {
        while self.next < self.begin + LOOK_COMMANDS_MAX {
            let command = self.ring.peek_at(self.next)?;
            let waits = self.lidar_waits && matches!(command, Command::LidarRead);
            if waits {
                return None;
            }
            if !takes_no_time(&command) {
                let goes_on = matches!(command, Command::Line { .. }) && self.turns.joins(&command);
                self.next += usize::from(goes_on);
                return goes_on.then_some(command);
            }
            self.next += 1;
        }
        None
    }
}

impl Lines for LinesBehind<'_, '_> {
    fn leave_out(&mut self, places: usize) {
        self.next = self.begin + places;
    }

    fn places(&self) -> usize {
        self.next - self.begin
    }
}

fn takes_no_time(command: &Command) -> bool {
    matches!(
        command,
        Command::Laser { .. }
            | Command::LidarRead
            | Command::SetPosition { .. }
            | Command::StatusCd
    )
}
