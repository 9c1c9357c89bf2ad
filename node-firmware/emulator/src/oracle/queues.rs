//! Commands against steps, queue by queue: each begins where the one before it ended.

use super::{
    Judge, TICKS_PER_US,
    moves::{Run, runs, ticks_of},
    paths::Piece,
};
use crate::record::{Life, TakenCommand};
use keys::{Command, QueueId, StopReason, StopReport};

/// Instants, both ends included, ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Window {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Window {
    pub(super) fn meet(self, other: Self) -> Self {
        Self {
            low: self.low.max(other.low),
            high: self.high.min(other.high),
        }
    }

    pub(super) fn is_empty(self) -> bool {
        self.low > self.high
    }

    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            low: self.low + other.low,
            high: self.high + other.high,
        }
    }
}

/// Where the timeline of a queue was last seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anchor {
    axis: usize,
    /// When the command that was seen last began, and what it and its successors last.
    due: Window,
    /// Commands without duration since.
    timeless: u32,
    /// When the latest of these commands was taken.
    taken: u64,
    /// When the first of them began or ended.
    seen: f64,
}

impl Anchor {
    pub(super) fn new(axis: usize, due: Window, taken: u64) -> Self {
        Self {
            axis,
            due,
            timeless: 0,
            taken,
            seen: due.low,
        }
    }

    /// When the command that was seen last began, or ended if it was a path, ticks.
    pub(super) fn seen(&self) -> f64 {
        self.seen
    }

    /// What comes next may come at any later time.
    pub(super) fn relax(&mut self) {
        self.due.high = f64::INFINITY;
    }
}

/// What bounds the reading of one queue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scope {
    /// Nothing of this queue can leave from then on, ticks.
    pub(super) until: u64,
    /// When its stop was taken; never, if there was none.
    pub(super) stop_at: u64,
    /// Commands before this one have all their steps.
    pub(super) executed: u64,
    /// The stop is under way: the record ends before the axes rest.
    pub(super) stopping: bool,
}

impl Judge<'_> {
    pub(super) fn read_queues(&mut self, life: &Life) {
        let mut rest = life.commands.as_slice();
        while let Some(first) = rest.first() {
            let queue = first.queue;
            let end = rest
                .iter()
                .position(|taken| taken.queue != queue)
                .unwrap_or(rest.len());
            let (commands, later) = rest.split_at(end);
            // Nothing of a later queue can leave before its first command was taken.
            let until = later
                .first()
                .map_or(u64::MAX, |taken| taken.at.0 * TICKS_PER_US);
            self.read_queue(life, queue, commands, until);
            if self.lost {
                return;
            }
            rest = later;
        }
        if !life.cut {
            self.check_rest(life);
        }
    }

    /// What is left when all commands were read, and what the node says of itself.
    fn check_rest(&mut self, life: &Life) {
        for axis in 0..self.axes.len() {
            let seen = &self.axes[axis];
            if let Some(step) = seen.next(u64::MAX) {
                let count = seen.steps.len() - seen.used;
                self.wrong(
                    step.at,
                    format!("axis {axis}: {count} steps that nobody ordered"),
                );
            }
            let seen = &self.axes[axis];
            let count: i64 = seen.steps.iter().map(|step| step.sign).sum();
            let count = count + seen.driven_steps;
            let (counted, position) = (
                life.counted_steps.get(axis).copied(),
                life.status.axes.get(axis).map(|axis| axis.position_steps),
            );
            let expected = seen.origin + count;
            if counted != Some(count) {
                self.wrong(
                    None,
                    format!("axis {axis}: {count} edges, the pulse counter says {counted:?}"),
                );
            }
            if position != Some(expected) {
                self.wrong(
                    None,
                    format!("axis {axis}: it is at {expected}, the status says {position:?}"),
                );
            }
        }
    }

    fn read_queue(&mut self, life: &Life, queue: QueueId, commands: &[TakenCommand], until: u64) {
        let under_way = stop_under_way(life, queue, commands);
        let reported = life.stops.iter().find(|stop| stop.queue == queue);
        let stopping = reported.is_none() && under_way.is_some();
        let stop = reported.or(under_way.as_ref());
        let stop = stop.map(|stop| since_cancel(life, stop));
        let stop = stop.as_ref();
        let reached = match stop {
            Some(stop) => stop.executed_commands,
            None if life.status.queue == queue => life.status.executed_commands,
            None => {
                self.wrong(None, format!("{queue:?} ended without a report"));
                0
            }
        };
        if let Some(stop) = stop.filter(|_| !life.cut) {
            self.check_count(stop, commands);
        }
        for (number, taken) in commands.iter().enumerate() {
            if taken.number != number as u64 {
                self.wrong(
                    None,
                    format!("command {number} has number {}", taken.number),
                );
            }
        }
        let scope = Scope {
            until,
            stop_at: stop.map_or(u64::MAX, |stop| stop.at.0 * TICKS_PER_US),
            executed: if life.cut { 0 } else { reached },
            stopping,
        };
        let mut anchor: Option<Anchor> = None;
        let mut broken = vec![false; self.axes.len()];
        // Where the commands lead, whether or not they are executed.
        let mut planned: Vec<i64> = self.axes.iter().map(super::Seen::position).collect();
        let mut index = 0;
        while let Some(taken) = commands.get(index) {
            if self.pass_drives(taken.at.0 * TICKS_PER_US, &mut planned) {
                anchor = None;
            }
            let (pieces, count) = self.pieces(&commands[index..], &mut planned);
            self.summary.commands += (index..index + count.max(1))
                .filter(|number| (*number as u64) < scope.executed)
                .count() as u64;
            if let Command::Home { axis } = taken.command {
                anchor = None;
                if !self.read_homing(taken, axis, &scope, stop) {
                    broken.fill(true);
                }
                planned[axis.index()] = self.axes[axis.index()].position();
                index += 1;
            } else if pieces.is_empty() {
                let number = index as u64;
                if let Command::SetPosition {
                    axis,
                    position_steps,
                } = taken.command
                    && number < reached
                {
                    let seen = &mut self.axes[axis.index()];
                    seen.origin = position_steps - seen.count;
                }
                self.read_command(taken, &scope, &mut anchor, &mut broken);
                index += 1;
            } else {
                self.rename(&commands[index..index + count], &pieces, reached);
                index += count;
                if !broken.contains(&true) {
                    self.read_pieces(&pieces, &scope, &mut anchor, &mut broken);
                }
                if self.lost {
                    return;
                }
            }
        }
        if let Some(stop) = stop {
            self.pass_drives(stop.at.0 * TICKS_PER_US, &mut planned);
        }
        if let Some(stop) = stop.filter(|_| !life.cut) {
            self.check_stop(stop, until);
        }
    }

    fn check_count(&mut self, stop: &StopReport, commands: &[TakenCommand]) {
        if stop.accepted_commands != commands.len() as u64 {
            self.wrong(
                None,
                format!(
                    "{:?}: {} commands were taken, the report says {}",
                    stop.queue,
                    commands.len(),
                    stop.accepted_commands
                ),
            );
        }
    }

    /// Positions that are set between joined lines.
    fn rename(&mut self, commands: &[TakenCommand], pieces: &[Piece], reached: u64) {
        for taken in commands.iter().filter(|taken| taken.number < reached) {
            let Command::SetPosition {
                axis,
                position_steps,
            } = taken.command
            else {
                continue;
            };
            let before = pieces.iter().filter(|piece| piece.number < taken.number);
            let made: i64 = before
                .flat_map(|piece| &piece.axes)
                .filter(|going| going.axis == axis.index())
                .map(|going| going.steps)
                .sum();
            let seen = &mut self.axes[axis.index()];
            seen.origin = position_steps - (seen.count + made);
        }
    }

    /// The path that these commands begin with: one ramp or line, or all the lines that could be
    /// joined; none for another command. And how many commands that are: what takes no time may
    /// stand between joined lines.
    fn pieces(&self, commands: &[TakenCommand], planned: &mut [i64]) -> (Vec<Piece>, usize) {
        let mut pieces: Vec<Piece> = Vec::new();
        let mut count = 0;
        let mut used: Vec<usize> = self.axes.iter().map(|seen| seen.used).collect();
        let mut after = planned.to_vec();
        for (index, taken) in commands.iter().enumerate() {
            let is_line = matches!(taken.command, Command::Line { .. });
            let timeless = matches!(
                taken.command,
                Command::Laser { .. }
                    | Command::LidarRead
                    | Command::SetPosition { .. }
                    | Command::StatusCd
            ) && !self.rests_at(&taken.command);
            let taken_at = taken.at.0 * TICKS_PER_US;
            // A line that came after the last edge of its predecessor cannot have been joined.
            let too_late = pieces.last().is_some_and(|piece: &Piece| {
                let axis = piece.main();
                let last = used[axis].checked_sub(1);
                let last = last.and_then(|last| self.axes[axis].steps.get(last));
                last.is_some_and(|step| step.at < taken_at)
            });
            if !pieces.is_empty() && timeless && !too_late {
                super::go(&mut after, &taken.command);
                continue;
            }
            if !pieces.is_empty() && (!is_line || too_late) {
                break;
            }
            let piece = Piece::new(taken, &after);
            super::go(&mut after, &taken.command);
            if pieces.is_empty() || piece.is_some() {
                planned.copy_from_slice(&after);
            }
            let Some(piece) = piece else {
                break;
            };
            for going in &piece.axes {
                used[going.axis] += going.steps.unsigned_abs() as usize;
            }
            pieces.push(piece);
            count = index + 1;
            if !is_line {
                break;
            }
        }
        (pieces, count)
    }

    /// Whether the queue rests at a command until something else has happened.
    fn rests_at(&self, command: &Command) -> bool {
        match command {
            Command::Barrier { .. } | Command::MoveC { .. } | Command::MoveD { .. } => true,
            Command::LidarRead => self.lidar_waits,
            _ => false,
        }
    }

    /// A command that is no path.
    fn read_command(
        &mut self,
        taken: &TakenCommand,
        scope: &Scope,
        anchor: &mut Option<Anchor>,
        broken: &mut [bool],
    ) {
        let must_be_whole = taken.number < scope.executed;
        if self.rests_at(&taken.command) {
            // The queue rests there for as long as others need.
            *anchor = None;
        }
        let runs = runs(&taken.command);
        let firsts: Vec<_> = runs
            .iter()
            .filter(|run| !broken[run.axis])
            .filter_map(|run| {
                let step = self.axes[run.axis].next(scope.until)?;
                Some((step.at, run.axis))
            })
            .collect();
        // Behind a stop, a step may belong to a deceleration instead.
        let planned =
            firsts.len() == runs.len() && firsts.iter().all(|(at, _)| *at <= scope.stop_at);
        if !broken.contains(&true) && (must_be_whole || planned) {
            self.check_begin(anchor, taken, &runs, &firsts);
        }
        if let Some(anchor) = anchor.as_mut() {
            let ticks = ticks_of(&taken.command);
            // No edge tells when it began: the queue may have been dry before it.
            let ahead = taken.at.0 * TICKS_PER_US + self.limits.ahead_ticks;
            if runs.is_empty() && ahead as f64 > anchor.due.low {
                anchor.due.high = f64::INFINITY;
            }
            anchor.due.low += ticks as f64;
            anchor.due.high += ticks as f64;
            anchor.timeless += u32::from(ticks == 0);
        }
        for run in runs {
            if broken[run.axis] {
                continue;
            }
            let found = self.take_steps(&run, scope.until);
            if found < run.steps.unsigned_abs() {
                broken[run.axis] = true;
                if must_be_whole {
                    self.wrong(
                        None,
                        format!(
                            "axis {}: command {} counts as executed, {found} of its {} steps were \
                             found",
                            run.axis,
                            taken.number,
                            run.steps.unsigned_abs()
                        ),
                    );
                }
            }
        }
        let stood = self.holds.take_found() as f64;
        if let Some(anchor) = anchor.as_mut().filter(|_| stood > 0.0) {
            // All axes start anew together behind a hold.
            let skew = self.limits.skew_ticks as f64;
            anchor.due.low += stood - skew;
            anchor.due.high += stood + skew;
        }
    }

    /// When a command on these axes (with their signs) may begin by the commands before it; and
    /// whether it was there in time, so that the end of the window counts.
    pub(super) fn begin(
        &self,
        anchor: &mut Option<Anchor>,
        taken: u64,
        first_axis: usize,
        mut signs: impl Iterator<Item = (usize, i64)>,
    ) -> Option<Window> {
        let anchor = anchor.as_mut()?;
        anchor.taken = anchor.taken.max(taken);
        let skew = if anchor.axis == first_axis {
            0
        } else {
            self.limits.skew_ticks
        };
        let turning = |(axis, sign): (usize, i64)| (sign != self.axes[axis].sign).then_some(axis);
        let (mut added, mut confirmed) = (0, true);
        for axis in signs.by_ref().filter_map(turning) {
            let seen = &self.axes[axis];
            let last = seen.used.checked_sub(1).map(|index| seen.steps[index].at);
            // What of a turn's rest has not passed by then; before its first step it has.
            let missing = last.map_or(0.0, |last| {
                self.limits.turn_ticks_max as f64 - (anchor.due.low - last as f64).max(0.0)
            });
            added = added.max(missing.max(0.0).ceil() as u64);
            // Nobody knows when the register confirms it.
            confirmed &= !self.external.get(axis).copied().unwrap_or(false);
        }
        let ahead = (anchor.taken + self.limits.ahead_ticks) as f64;
        let in_time = ahead <= anchor.due.low && anchor.timeless < 200;
        Some(Window {
            low: anchor.due.low - skew as f64,
            high: if in_time && confirmed {
                anchor.due.high + (skew + added) as f64
            } else {
                f64::INFINITY
            },
        })
    }

    /// The first edge of a command of raw moves against the commands before it.
    fn check_begin(
        &mut self,
        anchor: &mut Option<Anchor>,
        taken: &TakenCommand,
        runs: &[Run],
        firsts: &[(u64, usize)],
    ) {
        let taken_at = taken.at.0 * TICKS_PER_US;
        let (Some((at, axis)), Some((last, _))) = (firsts.iter().min(), firsts.iter().max()) else {
            if let Some(anchor) = anchor.as_mut() {
                anchor.taken = anchor.taken.max(taken_at);
            }
            return;
        };
        let (at, axis) = (*at, *axis);
        let skew = last - at;
        self.summary.skew_ticks_max = self.summary.skew_ticks_max.max(skew);
        if skew > self.limits.skew_ticks {
            self.wrong(
                at,
                format!("axes that start together differ by {skew} ticks"),
            );
        }
        if at < taken_at.max(self.not_before) {
            self.wrong(at, "a step before its command was taken or due".to_owned());
        }
        let signs = runs
            .iter()
            .map(|run| (run.axis, i64::from(run.steps.signum())));
        if let Some(window) = self.begin(anchor, taken_at, axis, signs) {
            self.check_window(window, at as f64, taken.number);
        }
        let due = Window {
            low: at as f64,
            high: at as f64,
        };
        *anchor = Some(Anchor::new(axis, due, taken_at));
    }

    /// Says so if a command does not begin within its window.
    pub(super) fn check_window(&mut self, window: Window, at: f64, number: u64) {
        if at > window.high && self.holds.fills_gap(window.high, at, self.limits) {
            return;
        }
        if at < window.low {
            let ticks = window.low - at;
            self.wrong(
                at as u64,
                format!("command {number} begins {ticks:.1} ticks early"),
            );
        } else if at > window.high {
            let ticks = at - window.high;
            self.wrong(
                at as u64,
                format!("a gap of {ticks:.1} ticks before command {number}"),
            );
        }
    }
}

/// What the report of a stop that is under way would say if it ended here.
fn stop_under_way(life: &Life, queue: QueueId, commands: &[TakenCommand]) -> Option<StopReport> {
    let (_, at) = life.stopping.filter(|(of, _)| *of == queue)?;
    let axes = life.status.axes.iter();
    Some(StopReport {
        queue,
        reason: StopReason::Client,
        at,
        accepted_commands: commands.len() as u64,
        executed_commands: life.status.executed_commands,
        positions_steps: axes.map(|axis| axis.position_steps).collect(),
    })
}

/// A stop overrides a cancel, and is reported with its own instant; but what was canceled slows down
/// since the cancel.
fn since_cancel(life: &Life, stop: &StopReport) -> StopReport {
    let cancels = life.cancels.iter();
    let canceled = cancels.filter(|(queue, _)| *queue == stop.queue);
    let first = canceled.map(|(_, at)| *at).min();
    StopReport {
        at: first.map_or(stop.at, |at| at.min(stop.at)),
        ..stop.clone()
    }
}
