//! Ramps and lines, edge by edge against the ideal.
//!
//! A path's beginning is never seen, only its edges. Each edge says within which window the
//! beginning must lie for it to be in its place; all windows, and what the commands before allow,
//! must have an instant in common.

use super::{
    Judge, TICK_HZ, TICKS_PER_US,
    queues::{Anchor, Scope, Window},
    track::{Point, Stopped, Track},
};
use crate::{kinematics::Ideal, record::TakenCommand};
use keys::{
    Command,
    command::{Ramp, RampShape},
};

/// How far an edge, or a beginning or an end, may be from the ideal, ticks.
pub(super) const EDGE_TICKS: f64 = 1.0;

/// Sums of `f64` and of a board's own arithmetic near one half, ticks: both roundings are right.
const ROUNDING_TICKS: f64 = 0.01;

/// One axis on a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Going {
    pub(super) axis: usize,
    /// With sign, never 0.
    pub(super) steps: i64,
}

/// Limits along the axis with most steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Law {
    pub(super) speed: f64,
    pub(super) accel: f64,
    pub(super) jerk: Option<f64>,
    pub(super) ramp: Ramp,
}

/// One ramp or line.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub(super) number: u64,
    /// Ticks.
    pub(super) taken: u64,
    pub(super) axes: Vec<Going>,
    /// Steps of the axis with most.
    pub(super) most: f64,
    /// Length in the space of all axes' steps.
    pub(super) tool: f64,
    pub(super) law: Law,
    pub(super) ideal: Ideal,
}

impl Piece {
    /// Returns `None` for other commands and for a path of no steps. `planned` is where the axes
    /// stand before it.
    pub(super) fn new(taken: &TakenCommand, planned: &[i64]) -> Option<Self> {
        let (steps, ramp) = match taken.command {
            Command::Ramp { axis, steps, ramp } => (vec![(axis.index(), i64::from(steps))], ramp),
            Command::RampTo {
                axis,
                position_steps,
                ramp,
            } => {
                let steps = position_steps - planned[axis.index()];
                (vec![(axis.index(), steps)], ramp)
            }
            Command::Line {
                steps,
                speed_hz,
                accel_hz_per_s,
                jerk_hz_per_s2,
            } => {
                let shape = match jerk_hz_per_s2 {
                    0 => RampShape::Trapezoid {
                        linear_steps: 0,
                        jump_steps: 0,
                    },
                    jerk_hz_per_s2 => RampShape::Jerk { jerk_hz_per_s2 },
                };
                let ramp = Ramp {
                    speed_hz,
                    accel_hz_per_s,
                    shape,
                };
                (steps.map(i64::from).into_iter().enumerate().collect(), ramp)
            }
            _ => return None,
        };
        let axes: Vec<_> = steps
            .into_iter()
            .filter(|(_, steps)| *steps != 0)
            .map(|(axis, steps)| Going { axis, steps })
            .collect();
        let most = axes.iter().map(|going| going.steps.unsigned_abs()).max()?;
        let squares = axes.iter().map(|going| (going.steps as f64).powi(2));
        Some(Self {
            number: taken.number,
            taken: taken.at.0 * TICKS_PER_US,
            most: most as f64,
            tool: squares.sum::<f64>().sqrt(),
            law: Law {
                speed: f64::from(ramp.speed_hz),
                accel: Ideal::accel_of(&ramp),
                jerk: match ramp.shape {
                    RampShape::Trapezoid { .. } | RampShape::Smooth { .. } => None,
                    RampShape::Jerk { jerk_hz_per_s2 } => Some(f64::from(jerk_hz_per_s2)),
                },
                ramp,
            },
            ideal: Ideal::of_ramp(most, &ramp),
            axes,
        })
    }

    /// The same up to another speed.
    pub(super) fn at_speed_of(&self, speed: f64) -> Self {
        let mut piece = self.clone();
        piece.law.speed = speed;
        piece.ideal = Ideal::of_ramp_up_to(self.most as u64, &self.law.ramp, speed);
        piece
    }

    /// Whether the textbook has a path of that speed: a smoothstep is none beyond its ends.
    pub(super) fn has_ideal(&self) -> bool {
        let ramp = &self.law.ramp;
        match ramp.shape {
            RampShape::Smooth { start_hz, .. } => {
                (f64::from(start_hz)..=f64::from(ramp.speed_hz)).contains(&self.law.speed)
            }
            RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => true,
        }
    }

    /// The axis with most steps.
    pub(super) fn main(&self) -> usize {
        let most = |going: &&Going| going.steps.unsigned_abs() as f64 == self.most;
        self.axes.iter().find(most).map_or(0, |going| going.axis)
    }

    /// Its duration in whole ticks; a window, if the rounding could go either way.
    fn ticks(&self) -> Window {
        let ticks = self.ideal.total_s() * TICK_HZ as f64;
        Window {
            low: (ticks - ROUNDING_TICKS).round(),
            high: (ticks + ROUNDING_TICKS).round(),
        }
    }

    /// When the middle of the first step is due, seconds from the beginning.
    pub(super) fn first_edge_s(&self) -> f64 {
        self.ideal.time_at(0.5)
    }

    /// Seconds from the middle of the last step to the end.
    pub(super) fn last_edge_s(&self) -> f64 {
        self.ideal.total_s() - self.ideal.time_at(self.most - 0.5)
    }

    /// By how much an edge may take longer from the end where the line rests, if its other end is
    /// passed at speed. An S-curve has no acceleration there, so it needs more way between that
    /// speed and its peak than from rest, and the peak is lower: by 0.72 % of the time at most
    /// ((1 + r)·√(1 − r) is 1.089 at r = 1/3). The whole takes less time all the same.
    fn at_speed(&self) -> f64 {
        if self.law.jerk.is_some() { 1.01 } else { 1.0 }
    }
}

/// How the edges of one axis fit into a path.
pub(super) struct Fit {
    /// Edges that do.
    count: u64,
    /// When the path began by them.
    begin: Window,
    /// The first edge that does not.
    pub(super) off: Option<(u64, String)>,
}

impl Judge<'_> {
    pub(super) fn read_pieces(
        &mut self,
        pieces: &[Piece],
        scope: &Scope,
        anchor: &mut Option<Anchor>,
        broken: &mut [bool],
    ) {
        let (first, last) = (&pieces[0], &pieces[pieces.len() - 1]);
        let signs = first
            .axes
            .iter()
            .map(|going| (going.axis, going.steps.signum()));
        let pace = self.pace_of(pieces, scope);
        let first_at = self.axes[first.main()].next(scope.until);
        self.relax_held(
            anchor,
            first_at.map_or(f64::INFINITY, |step| step.at as f64),
        );
        let begin = self.begin(anchor, first.taken, first.main(), signs);
        let begin = begin.unwrap_or(Window {
            low: 0.0,
            high: f64::INFINITY,
        });
        // Behind `taken` no instant is too early, whatever came before.
        let begin = begin.meet(Window {
            low: first.taken.max(self.not_before) as f64,
            high: begin.high.max(first.taken as f64),
        });
        let planned = pace.as_ref().map(|pace| pace.planned(pieces, self));
        let end = match (&pace, planned) {
            (Some(pace), planned) if pace.is_changed() || matches!(planned, Some(None)) => {
                self.read_changed(pieces, pace, begin, scope)
            }
            (_, planned) => {
                let planned = planned.flatten();
                let pieces = planned.as_deref().unwrap_or(pieces);
                match pieces {
                    [piece] => self.read_single(piece, begin, scope),
                    _ => self.read_chain(pieces, begin, scope),
                }
            }
        };
        self.pass_path(pace.as_ref());
        // What began on one axis may end on another one, which started a little off.
        let skew = if first.main() == last.main() {
            0.0
        } else {
            self.limits.skew_ticks as f64
        };
        let end = end.map(|end| {
            end.plus(Window {
                low: -skew,
                high: skew,
            })
        });
        *anchor = end.map(|end| Anchor::new(last.main(), end, last.taken));
        if end.is_none() {
            let axes = pieces.iter().flat_map(|piece| &piece.axes);
            axes.for_each(|going| broken[going.axis] = true);
        }
    }

    /// Reads one path and returns when it ended, `None` if it was not whole.
    fn read_single(&mut self, piece: &Piece, begin: Window, scope: &Scope) -> Option<Window> {
        let must_be_whole = piece.number < scope.executed;
        let skew = self.limits.skew_ticks as f64;
        let main = piece.main();
        let mut fits = Vec::new();
        for going in &piece.axes {
            let slack = if going.axis == main { 0.0 } else { skew };
            let begin = begin.plus(Window {
                low: -slack,
                high: slack,
            });
            fits.push((*going, self.fit(piece, *going, begin, scope.until)));
        }
        let off = fits.iter().filter_map(|(_, fit)| fit.off.as_ref()).min();
        let whole = |(going, fit): &(Going, Fit)| fit.count == going.steps.unsigned_abs();
        match off {
            // A step off the plan behind a stop is on the way to rest.
            Some((at, _)) if !must_be_whole && *at > scope.stop_at => {}
            Some((at, message)) => {
                self.wrong(*at, message.clone());
                self.lost = true;
                return None;
            }
            None if fits.iter().all(whole) => {
                let start = |axis: usize| fits.iter().find(|(going, _)| going.axis == axis);
                let begin = start(main).map_or(begin, |(_, fit)| fit.begin);
                self.check_skew(piece, &fits);
                fits.iter().for_each(|(going, fit)| self.take(going, fit));
                let whole_ticks = Window {
                    low: (begin.low - ROUNDING_TICKS).ceil(),
                    high: (begin.high + ROUNDING_TICKS).floor(),
                };
                return Some(whole_ticks.plus(piece.ticks()));
            }
            None if must_be_whole => {
                self.lost = true;
                for (going, fit) in fits.iter().filter(|fit| !whole(fit)) {
                    self.wrong(
                        None,
                        format!(
                            "axis {}: command {} counts as executed, {} of its {} steps were found",
                            going.axis,
                            piece.number,
                            fit.count,
                            going.steps.unsigned_abs()
                        ),
                    );
                }
                return None;
            }
            None => {}
        }
        let (points, _) = self.take_points(std::slice::from_ref(piece), scope);
        if scope.stop_at < u64::MAX {
            self.check_way_to_rest(std::slice::from_ref(piece), &points, scope, false);
        }
        None
    }

    fn take(&mut self, going: &Going, fit: &Fit) {
        (0..fit.count).for_each(|_| self.axes[going.axis].take());
    }

    /// All axes of a line must have begun together.
    fn check_skew(&mut self, piece: &Piece, fits: &[(Going, Fit)]) {
        let latest = fits.iter().map(|(_, fit)| fit.begin.low);
        let earliest = fits.iter().map(|(_, fit)| fit.begin.high);
        let skew = latest.fold(0.0, f64::max) - earliest.fold(f64::INFINITY, f64::min);
        let skew = skew.max(0.0).ceil() as u64;
        self.summary.skew_ticks_max = self.summary.skew_ticks_max.max(skew);
        if skew > self.limits.skew_ticks {
            let at = fits.iter().map(|(_, fit)| fit.begin.high as u64).min();
            self.wrong(
                at,
                format!(
                    "the axes of command {} differ by {skew} ticks",
                    piece.number
                ),
            );
        }
    }

    /// Compares the next steps of an axis with a path that begins within `begin`.
    pub(super) fn fit(&self, piece: &Piece, going: Going, begin: Window, until: u64) -> Fit {
        let seen = &self.axes[going.axis];
        let count = going.steps.unsigned_abs();
        let mut fit = Fit {
            count: 0,
            begin,
            off: None,
        };
        for (number, step) in (1..=count).zip(&seen.steps[seen.used..]) {
            if step.at >= until {
                break;
            }
            let off = |what: String| Some((step.at, format!("axis {}: {what}", going.axis)));
            let step_of = format_args!("step {number} of {count} of command {}", piece.number);
            if step.sign != going.steps.signum() {
                fit.off = off(format!("{step_of} goes the wrong way"));
                break;
            }
            let due = piece.ideal.edge_s(number, count) * TICK_HZ as f64;
            let slack = EDGE_TICKS + ROUNDING_TICKS;
            let window = Window {
                low: step.at as f64 - due - slack,
                high: step.at as f64 - due + slack,
            };
            let common = fit.begin.meet(window);
            if common.is_empty() {
                let late = window.low - fit.begin.high;
                let early = fit.begin.low - window.high;
                fit.off = if late > 0.0 && number == 1 {
                    off(format!(
                        "a gap of {late:.1} ticks before command {}",
                        piece.number
                    ))
                } else if late > 0.0 {
                    off(format!("{step_of} is {late:.1} ticks too late"))
                } else {
                    off(format!("{step_of} is {early:.1} ticks too early"))
                };
                break;
            }
            fit.begin = common;
            fit.count += 1;
        }
        fit
    }

    /// Takes the steps of pieces that follow each other, by count and direction alone. Returns
    /// them in order of place, and how many pieces are whole.
    pub(super) fn take_points(&mut self, pieces: &[Piece], scope: &Scope) -> (Vec<Point>, usize) {
        let mut points = Vec::new();
        let mut begin = 0.0;
        for (index, piece) in pieces.iter().enumerate() {
            let mut whole = true;
            let from = points.len();
            for going in &piece.axes {
                let count = going.steps.unsigned_abs();
                for number in 1..=count {
                    let seen = &mut self.axes[going.axis];
                    let sign = going.steps.signum();
                    let step = seen.next(scope.until);
                    let Some(step) = step.filter(|step| step.sign == sign) else {
                        whole = false;
                        let found = number - 1;
                        let message = format!(
                            "axis {}: {found} of {count} steps of command {}",
                            going.axis, piece.number
                        );
                        if let Some(step) = step {
                            self.lost = true;
                            self.wrong(step.at, format!("{message}, then one the wrong way"));
                        } else if piece.number < scope.executed {
                            self.lost = true;
                            self.wrong(None, format!("{message}, which counts as executed"));
                        }
                        break;
                    };
                    seen.take();
                    points.push(Point {
                        at: step.at as f64,
                        place: begin + (number as f64 - 0.5) / count as f64 * piece.tool,
                        axis: going.axis,
                        piece: index,
                        main: going.axis == piece.main(),
                    });
                }
            }
            points[from..].sort_by(|a, b| a.place.total_cmp(&b.place));
            if !whole {
                return (points, index);
            }
            begin += piece.tool;
        }
        (points, pieces.len())
    }

    /// Reads lines that may be joined and returns when they ended, `None` if they are not whole.
    fn read_chain(&mut self, pieces: &[Piece], begin: Window, scope: &Scope) -> Option<Window> {
        let (points, whole) = self.take_points(pieces, scope);
        let track = Track::new(pieces, self.limits, None);
        for (at, message) in track.faults(&points) {
            self.wrong(at as u64, message);
        }
        let (first, last) = (
            points.iter().find(|point| point.main)?,
            points.iter().rfind(|point| point.main)?,
        );
        // From rest nothing is quicker than full acceleration or slower than a halt at the end.
        let hz = TICK_HZ as f64;
        let fastest = track.fastest_s(first.place) * hz;
        let mut start = Window {
            low: first.at - pieces[0].first_edge_s() * pieces[0].at_speed() * hz - EDGE_TICKS,
            high: first.at - fastest + EDGE_TICKS,
        };
        if first.at > scope.stop_at as f64 {
            // It may slow down already.
            start.low = f64::NEG_INFINITY;
        }
        if start.high < begin.low {
            self.check_window(begin, start.high, pieces[0].number);
        } else if start.low > begin.high {
            self.check_window(begin, start.low, pieces[0].number);
        }
        let start = start.meet(begin);
        if whole < pieces.len() {
            if scope.stop_at < u64::MAX {
                self.check_way_to_rest(pieces, &points, scope, false);
            }
            return None;
        }
        let rest = (track.total_s() - track.fastest_s(last.place)) * hz;
        let last_piece = &pieces[pieces.len() - 1];
        let slow = last_piece.last_edge_s() * last_piece.at_speed() * hz;
        let end = Window {
            low: last.at + rest - EDGE_TICKS,
            high: last.at + slow + EDGE_TICKS,
        };
        for (at, message) in track.delays(&points) {
            self.wrong(at as u64, message);
        }
        let ahead = self.limits.ahead_ticks;
        let in_time = pieces
            .iter()
            .all(|piece| (piece.taken + ahead) as f64 <= start.low);
        let longest: f64 = pieces.iter().map(|piece| piece.ticks().high).sum();
        if in_time && end.low > start.high + longest {
            let late = end.low - start.high - longest;
            self.wrong(
                last.at as u64,
                format!(
                    "commands {} to {}: {late:.1} ticks longer than with a halt at each corner",
                    pieces[0].number,
                    pieces[pieces.len() - 1].number
                ),
            );
        }
        Some(end)
    }

    /// What is made of a path after a stop: on the path, by its limits, and soon at rest.
    pub(super) fn check_way_to_rest(
        &mut self,
        pieces: &[Piece],
        points: &[Point],
        scope: &Scope,
        changed: bool,
    ) {
        let axes = pieces.iter().flat_map(|piece| &piece.axes);
        axes.for_each(|going| self.axes[going.axis].rests = true);
        let Some(last) = points.iter().map(|point| point.at).reduce(f64::max) else {
            return;
        };
        let stopped = Stopped {
            at: scope.stop_at as f64,
            last,
        };
        let single = pieces.len() == 1 && !changed;
        // Where it will rest, nobody has seen yet.
        let end = stopped.end_of(pieces, points).filter(|_| !scope.stopping);
        let mut track = Track::new(pieces, self.limits, end);
        if changed {
            track = track.changed();
        }
        let faults = if single {
            track.faults(points)
        } else {
            // Without the new end they were told already.
            track.envelope(points).into_iter().collect()
        };
        for (at, message) in faults {
            self.wrong(at as u64, format!("behind a stop: {message}"));
        }
        if let Some((at, message)) = track.late_rest(points, &stopped) {
            self.wrong(at as u64, message);
        }
    }
}
