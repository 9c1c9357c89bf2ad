//! Ramps and lines of a node that was held, or told another speed.
//!
//! ```text
//!   speed ▲      ______ hold      resume ______
//!         │    ╱       ╲                ╱      ╲___ 50 %
//!         │  ╱          ╲______________╱            ╲
//!         └──┤judged to the tick┊ by limits: ┊────────────▶
//! ```
//!
//! What was told when is in the record; where on its path that took effect is not. So a path with a
//! change in it is judged as it was planned up to the first change, to a tick, and as a whole by its
//! limits: it stays on its line, and no speed, acceleration, jerk or corner is beyond what the
//! greatest speed of that time allows; and in a hold it comes to rest in time. A path without a
//! change in it, or just before it, is judged as any other, at the speed that was told before.

use super::{
    Judge,
    paths::{EDGE_TICKS, Piece},
    queues::{Anchor, Scope, Window},
    track::{Stopped, Track},
};

/// What a path was told while it was made.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    /// Shares of its speed: the one that it began with, and all that were told until its end.
    shares: Vec<f64>,
    /// The first change, ticks; `None` if there was none from some time before it.
    first: Option<u64>,
    /// It may have been planned for what was told before its begin.
    pending: bool,
    /// Not later than its begin and not earlier than its end, ticks.
    from: u64,
    until: u64,
}

impl Pace {
    /// The pieces at the greatest of its speeds.
    pub(super) fn fastest(&self, pieces: &[Piece], judge: &Judge<'_>) -> Vec<Piece> {
        let share = self.shares.iter().copied().fold(0.0, f64::max);
        self.at(share, pieces, judge)
    }

    fn at(&self, share: f64, pieces: &[Piece], judge: &Judge<'_>) -> Vec<Piece> {
        let limits = judge.limits;
        let driver = super::TICK_HZ as f64 / (limits.high_ticks_min + limits.low_ticks_min) as f64;
        let scaled = |piece: &Piece| piece.at_speed_of((piece.law.speed * share).min(driver));
        pieces.iter().map(scaled).collect()
    }

    /// The pieces as they were planned, if nothing was changed since and the textbook has them.
    pub(super) fn planned(&self, pieces: &[Piece], judge: &Judge<'_>) -> Option<Vec<Piece>> {
        let scaled = self.at(self.shares[0], pieces, judge);
        let known = scaled.iter().all(Piece::has_ideal);
        (known && !self.pending).then_some(scaled)
    }

    pub(super) fn is_changed(&self) -> bool {
        self.first.is_some() || self.pending
    }
}

impl Judge<'_> {
    /// What was told around these pieces, `None` if nobody has told anything or they have no edge.
    pub(super) fn pace_of(&self, pieces: &[Piece], scope: &Scope) -> Option<Pace> {
        if self.speeds.is_empty() && self.held.is_empty() {
            return None;
        }
        let mut used: Vec<usize> = self.axes.iter().map(|seen| seen.used).collect();
        let (mut from, mut until) = (u64::MAX, 0);
        for going in pieces.iter().flat_map(|piece| &piece.axes) {
            let steps = &self.axes[going.axis].steps;
            let begin = used[going.axis].min(steps.len());
            let end = (begin + going.steps.unsigned_abs() as usize).min(steps.len());
            let own = &steps[begin..end];
            let own = &own[..own.partition_point(|step| step.at < scope.until)];
            if let (Some(first), Some(last)) = (own.first(), own.last()) {
                from = from.min(first.at);
                until = until.max(last.at);
            }
            used[going.axis] = end;
        }
        if from > until {
            return None;
        }
        // It begins before its first edge and ends behind its last one.
        let slowest = self.speeds.iter().map(|speed| speed.share).min();
        let slowest = slowest.map_or(1.0, |share| (f64::from(share) / 65_536.0).min(1.0));
        let slow = |piece: &Piece| piece.at_speed_of(piece.law.speed * slowest);
        let hz = super::TICK_HZ as f64;
        let lead = slow(&pieces[0]).first_edge_s() * hz;
        let trail = slow(&pieces[pieces.len() - 1]).last_edge_s() * hz;
        let from = from.saturating_sub(lead.ceil() as u64);
        let until = until + trail.ceil() as u64;
        let before = from.saturating_sub(self.limits.ahead_ticks);
        let holds = self.held.iter();
        let holds = holds.flat_map(|held| [Some(held.from_ticks), held.until_ticks]);
        let speeds = self.speeds.iter().map(|speed| speed.at_ticks);
        // What was planned meanwhile is taken back with the path under way; where none is, a path that
        // was there already begins as it was planned.
        let stale = self.path_until.saturating_sub(self.limits.ahead_ticks);
        let stale = stale.max(pieces[0].taken);
        let near = |at: &u64| (before.min(stale)..=until).contains(at);
        let changes: Vec<u64> = holds.flatten().chain(speeds).filter(near).collect();
        let first = changes.iter().copied().min();
        let before = first.map_or(before, |first| first.min(before));
        let begin = self.speeds.partition_point(|speed| speed.at_ticks < before);
        let end = self.speeds.partition_point(|speed| speed.at_ticks <= until);
        let told = self.speeds[begin.saturating_sub(1)..end].iter();
        let mut shares: Vec<f64> = told
            .map(|speed| f64::from(speed.share) / 65_536.0)
            .collect();
        if begin == 0 {
            shares.insert(0, 1.0);
        }
        Some(Pace {
            shares,
            first,
            pending: changes.iter().any(|at| *at < from),
            from,
            until,
        })
    }

    /// Notes that a path was under way until then.
    pub(super) fn pass_path(&mut self, pace: Option<&Pace>) {
        let until = pace.map_or(0, |pace| pace.until);
        self.path_until = self.path_until.max(until);
    }

    /// Whether a hold may have made the queue wait since its anchor.
    pub(super) fn was_held_since(&self, seen: f64, until: f64) -> bool {
        let slack = 2.0 * self.limits.stop_begin_ticks as f64;
        self.held.iter().any(|held| {
            let end = held.until_ticks.map_or(f64::INFINITY, |until| until as f64);
            held.from_ticks as f64 <= until && end + slack >= seen
        })
    }

    /// Reads a path that was changed in flight. Returns when it ended, `None` if it is not whole.
    pub(super) fn read_changed(
        &mut self,
        pieces: &[Piece],
        pace: &Pace,
        begin: Window,
        scope: &Scope,
    ) -> Option<Window> {
        if let [piece] = pieces
            && let Some(first) = pace.first
            && let Some(planned) = pace.planned(pieces, self)
        {
            // A piece of one axis: the axes of a line begin within a few ticks of each other.
            for going in piece.axes.iter().take(1) {
                let fit = self.fit(&planned[0], *going, begin, scope.until.min(first));
                if let Some((at, message)) = fit.off {
                    self.wrong(at, format!("before it was changed: {message}"));
                    self.lost = true;
                    return None;
                }
            }
        }
        let fastest = pace.fastest(pieces, self);
        let (points, whole) = self.take_points(&fastest, scope);
        let limits = self.limits;
        let track = Track::new(&fastest, limits, None).changed();
        let mut faults = track.faults(&points);
        for held in self.held.iter().filter(|held| held.from_ticks >= pace.from) {
            let until = held.until_ticks.map_or(f64::INFINITY, |until| until as f64);
            let end = points.iter().filter(|point| point.at < until);
            let Some(last) = end.map(|point| point.at).reduce(f64::max) else {
                continue;
            };
            let until: Vec<_> = points
                .iter()
                .filter(|point| point.at <= last)
                .copied()
                .collect();
            let stopped = Stopped {
                at: held.from_ticks as f64,
                last,
            };
            if held.from_ticks <= pace.until {
                faults.extend(track.late_rest(&until, &stopped));
            }
        }
        for (at, message) in faults {
            self.wrong(at as u64, format!("held or at another speed: {message}"));
        }
        self.holds.pass(pace.until);
        let (first, last) = (
            points.iter().find(|point| point.main)?,
            points.iter().rfind(|point| point.main)?,
        );
        let hz = super::TICK_HZ as f64;
        let earliest = first.at - track.fastest_s(first.place) * hz + EDGE_TICKS;
        if earliest < begin.low {
            self.check_window(begin, earliest, pieces[0].number);
        }
        if whole < pieces.len() {
            if scope.stop_at < u64::MAX {
                self.check_way_to_rest(&fastest, &points, scope, true);
            }
            return None;
        }
        let rest = (track.total_s() - track.fastest_s(last.place)) * hz;
        Some(Window {
            low: last.at + rest - EDGE_TICKS,
            high: f64::INFINITY,
        })
    }

    /// Nobody knows for how long it was held: the end of a command is no bound any more.
    pub(super) fn relax_held(&self, anchor: &mut Option<Anchor>, until: f64) {
        if let Some(anchor) = anchor
            && self.was_held_since(anchor.seen(), until)
        {
            anchor.relax();
        }
    }
}
