//! Joined or stopped paths: judged by what their limits allow, not by one ideal.
//!
//! All is measured along the tool's way: the length of the path in the space of all axes' steps.
//! Edges are known to a tick, so every test has a tolerance that follows from one tick at each end
//! of what it measures; it tests at many scales, and over a long stretch little is tolerated.
//!
//! - *Envelope*: nothing is quicker than the fastest run within speed, acceleration and corners.
//! - *Acceleration* and *jerk*: a divided difference of instants is a mean of the derivative with
//!   positive weights; no mean is beyond the limit.
//! - *Turning*: no axis is turned harder by lines in a row than their acceleration; see `turning`.
//! - *One place*: edges of all axes come in the order of their places.
//! - *Delays*: no line takes longer between its edges than with a halt at both ends.

use super::{
    Limits, TICK_HZ,
    paths::{EDGE_TICKS, Piece},
};
use crate::kinematics::Ideal;
use keys::command::RampShape;

/// An edge on a track.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// Ticks.
    pub(super) at: f64,
    /// Along the tool's way.
    pub(super) place: f64,
    pub(super) axis: usize,
    /// Index of its piece.
    pub(super) piece: usize,
    /// It belongs to the axis with most steps.
    pub(super) main: bool,
}

/// Where a path is changed, two edges may be so much farther off, on top of [`EDGE_TICKS`]: between
/// them may lie a rest that is shorter than a word of the pulse hardware (4 ticks), which is made
/// none or a whole word, whichever is nearer. The record does not tell where the change took effect, so
/// every edge of the path is given that.
const CHANGE_TICKS: f64 = 2.0;

/// Shortest time over which the speed of a stopped path is measured, ticks: a tick at both ends is
/// 1 ‰.
const SPEED_TICKS_MIN: f64 = 2_000.0;

/// Where and when, in words.
pub(super) type Fault = (f64, String);

/// A stop that ended a path early.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopped {
    /// When it was taken, ticks.
    pub(super) at: f64,
    /// The last edge, ticks.
    pub(super) last: f64,
}

impl Stopped {
    /// The place that was not reached, if the path was not cut by a halt: then it came to rest
    /// before that place by deceleration.
    pub(super) fn end_of(&self, pieces: &[Piece], points: &[Point]) -> Option<f64> {
        let mains: Vec<_> = points.iter().filter(|point| point.main).collect();
        let [.., before, last] = mains.as_slice() else {
            return None;
        };
        // A halt is over a step later at most.
        let halted = self.last <= self.at + (last.at - before.at) + 160.0;
        let piece = &pieces[last.piece];
        let end: f64 = pieces[..=last.piece].iter().map(|piece| piece.tool).sum();
        let next = last.place + piece.tool / piece.most;
        let next = match pieces.get(last.piece + 1) {
            Some(piece) if next > end => end + piece.tool / piece.most / 2.0,
            _ => next.min(end),
        };
        (!halted).then_some(next)
    }
}

/// One piece between two speeds.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// Place of its beginning.
    from: f64,
    length: f64,
    speed: f64,
    accel: f64,
    /// Greatest speeds at its beginning and its end.
    enter: f64,
    leave: f64,
    /// Fastest time from the beginning of the track, seconds.
    begin_s: f64,
}

impl Leg {
    /// Steps of speeding up and of slowing down, and the speed between.
    fn shape(&self) -> (f64, f64, f64) {
        let way = |speed: f64, end: f64| (speed * speed - end * end) / (2.0 * self.accel);
        let (rise, fall) = (way(self.speed, self.enter), way(self.speed, self.leave));
        if rise + fall <= self.length {
            return (rise, fall, self.speed);
        }
        let (enter2, leave2) = (self.enter * self.enter, self.leave * self.leave);
        let peak2 = self.accel * self.length + (enter2 + leave2) / 2.0;
        let rise = (peak2 - enter2).max(0.0) / (2.0 * self.accel);
        let rise = rise.min(self.length);
        (rise, self.length - rise, peak2.sqrt())
    }

    fn time_at(&self, place: f64) -> f64 {
        let (rise, fall, peak) = self.shape();
        let time = |way: f64, from: f64| {
            let speed = (from * from + 2.0 * self.accel * way).sqrt();
            let sum = from + speed;
            if sum > 0.0 { 2.0 * way / sum } else { 0.0 }
        };
        let way = (place - self.from).clamp(0.0, self.length);
        if way <= rise {
            return time(way, self.enter);
        }
        let coast = (way.min(self.length - fall) - rise).max(0.0) / peak;
        let before = time(rise, self.enter) + coast;
        if way <= self.length - fall {
            return before;
        }
        before + time(fall, self.leave) - time(self.length - way, self.leave)
    }
}

pub(super) struct Track<'p> {
    pub(super) pieces: &'p [Piece],
    legs: Vec<Leg>,
    pub(super) limits: &'p Limits,
    /// How far an edge may be off, ticks.
    pub(super) edge_ticks: f64,
    /// It may have rested on its way.
    rests: bool,
}

impl<'p> Track<'p> {
    /// From rest, or the jump of a ramp, to rest at the end, or at `end` if it is nearer.
    pub(super) fn new(pieces: &'p [Piece], limits: &'p Limits, end: Option<f64>) -> Self {
        let mut legs: Vec<Leg> = Vec::new();
        for (index, piece) in pieces.iter().enumerate() {
            let from = legs.last().map_or(0.0, |leg| leg.from + leg.length);
            let share = piece.tool / piece.most;
            let most = end.map_or(piece.tool, |end| (end - from).clamp(0.0, piece.tool));
            let mut leg = Leg {
                from,
                length: most,
                speed: piece.law.speed * share,
                accel: piece.law.accel * share,
                enter: piece.ideal.at(0.0).speed.min(piece.law.speed) * share,
                leave: 0.0,
                begin_s: 0.0,
            };
            if index > 0 {
                let before = &pieces[index - 1];
                let junction = f64::from(limits.junction_hz);
                let corner = corner_speed(before, piece, junction);
                leg.enter = corner.min(leg.speed).min(legs[index - 1].speed);
            }
            legs.push(leg);
        }
        for index in 1..legs.len() {
            let before = legs[index - 1];
            let reached = before.enter.powi(2) + 2.0 * before.accel * before.length;
            legs[index].enter = legs[index].enter.min(reached.sqrt());
        }
        // Rest, or the speed from which a smoothstep rests.
        let mut leave = pieces.last().map_or(0.0, |piece| {
            let speed = piece.ideal.at(piece.ideal.total_s()).speed;
            speed.min(piece.law.speed) * piece.tool / piece.most
        });
        for leg in legs.iter_mut().rev() {
            leg.leave = leave;
            let braked = (leave * leave + 2.0 * leg.accel * leg.length).sqrt();
            leg.enter = leg.enter.min(braked);
            leave = leg.enter;
        }
        let mut begin_s = 0.0;
        for leg in &mut legs {
            leg.begin_s = begin_s;
            begin_s += leg.time_at(leg.from + leg.length);
        }
        Self {
            pieces,
            legs,
            limits,
            edge_ticks: EDGE_TICKS,
            rests: false,
        }
    }

    /// The same for a path that was changed in flight: it may have come to rest anywhere, and where
    /// it was changed the hardware may not be able to rest as shortly as it should.
    pub(super) fn changed(self) -> Self {
        Self {
            edge_ticks: EDGE_TICKS + CHANGE_TICKS,
            rests: true,
            ..self
        }
    }

    pub(super) fn skew(&self) -> f64 {
        self.limits.skew_ticks as f64
    }

    /// The least time to a place, seconds.
    pub(super) fn fastest_s(&self, place: f64) -> f64 {
        let index = self.legs.partition_point(|leg| leg.from <= place).max(1) - 1;
        self.legs[index].begin_s + self.legs[index].time_at(place)
    }

    /// The least time to the end, seconds.
    pub(super) fn total_s(&self) -> f64 {
        self.fastest_s(f64::INFINITY)
    }

    /// Everything but delays; the first fault of each kind.
    pub(super) fn faults(&self, points: &[Point]) -> Vec<Fault> {
        let mains: Vec<_> = points.iter().filter(|point| point.main).copied().collect();
        [
            self.one_place(points),
            self.envelope(points),
            self.accel(&mains),
            self.jerk(&mains),
            self.turning(points),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    fn name(&self, point: &Point) -> String {
        let number = self.pieces[point.piece].number;
        format!("axis {}, command {number}", point.axis)
    }

    fn one_place(&self, points: &[Point]) -> Option<Fault> {
        let mut latest: Option<Point> = None;
        for point in points {
            if let Some(latest) = latest {
                let early = latest.at - point.at - 2.0 * self.edge_ticks - self.skew();
                if early > 0.0 {
                    let message = format!(
                        "{}: off the straight line, {early:.0} ticks before axis {} was there",
                        self.name(point),
                        latest.axis
                    );
                    return Some((point.at, message));
                }
            }
            if latest.is_none_or(|latest| point.at > latest.at) {
                latest = Some(*point);
            }
        }
        None
    }

    /// Time gained on the fastest run between any two edges.
    pub(super) fn envelope(&self, points: &[Point]) -> Option<Fault> {
        let mut behind = f64::NEG_INFINITY;
        let mut axis = None;
        for point in points {
            let delay = point.at - self.fastest_s(point.place) * TICK_HZ as f64;
            let skew = if axis.is_none_or(|axis| axis == point.axis) {
                0.0
            } else {
                self.skew()
            };
            let early = behind - delay - 2.0 * self.edge_ticks - skew - 0.01;
            if early > 0.0 {
                let message = format!(
                    "{}: too fast for speed, acceleration or corner, {early:.1} ticks early",
                    self.name(point)
                );
                return Some((point.at, message));
            }
            if delay > behind {
                (behind, axis) = (delay, Some(point.axis));
            }
        }
        None
    }

    fn accel(&self, points: &[Point]) -> Option<Fault> {
        scales(points.len(), 2).find_map(|(index, scale)| {
            let three = [0, 1, 2].map(|number| points[index + number * scale]);
            let (found, slack) = self.mean_accel(&three);
            let legs = &self.legs[three[0].piece..=three[2].piece];
            let most = legs.iter().map(|leg| leg.accel).fold(0.0, f64::max);
            let half_s = (three[2].at - three[0].at) / TICK_HZ as f64 / 2.0;
            let slack = slack + self.jump(&three) / half_s;
            (found.abs() > most * (1.0 + 1e-9) + slack).then(|| {
                let share = self.share(&three[2]);
                let message = format!(
                    "{}: acceleration {:.0} over {} steps, {:.0} is the limit",
                    self.name(&three[2]),
                    found / share,
                    2 * scale,
                    most / share
                );
                (three[2].at, message)
            })
        })
    }

    fn jerk(&self, points: &[Point]) -> Option<Fault> {
        scales(points.len(), 3).find_map(|(index, scale)| {
            let four = [0, 1, 2, 3].map(|number| points[index + number * scale]);
            let piece = &self.pieces[four[0].piece];
            if four[3].piece != four[0].piece {
                return None;
            }
            let most = piece.law.jerk? * self.share(&four[0]);
            let (before, slack_before) = self.mean_accel(&[four[0], four[1], four[2]]);
            let (behind, slack_behind) = self.mean_accel(&[four[1], four[2], four[3]]);
            let third_s = (four[3].at - four[0].at) / TICK_HZ as f64 / 3.0;
            let found = (behind - before) / third_s;
            let slack = (slack_before + slack_behind) / third_s;
            (found.abs() > most * (1.0 + 1e-6) + slack).then(|| {
                let message = format!(
                    "{}: jerk {:.0} over {} steps, {:.0} is the limit",
                    self.name(&four[3]),
                    found / self.share(&four[0]),
                    3 * scale,
                    piece.law.jerk.unwrap_or(0.0)
                );
                (four[3].at, message)
            })
        })
    }

    /// By how much the speed may jump where it has rested: to and from the first speed of a
    /// smoothstep.
    fn jump(&self, three: &[Point; 3]) -> f64 {
        if !self.rests {
            return 0.0;
        }
        let jump = |piece: &Piece| match piece.law.ramp.shape {
            RampShape::Smooth { start_hz, .. } => f64::from(start_hz) * piece.tool / piece.most,
            RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => 0.0,
        };
        let pieces = &self.pieces[three[0].piece..=three[2].piece];
        pieces.iter().map(jump).fold(0.0, f64::max)
    }

    /// Tool's way in one step of the axis with most.
    fn share(&self, point: &Point) -> f64 {
        let piece = &self.pieces[point.piece];
        piece.tool / piece.most
    }

    /// The mean acceleration over three edges, and by how much a tick may falsify it.
    fn mean_accel(&self, three: &[Point; 3]) -> (f64, f64) {
        let same = three.iter().all(|point| point.axis == three[0].axis);
        let off = self.edge_ticks + if same { 0.0 } else { self.skew() };
        let speed = |from: &Point, to: &Point| {
            let ticks = to.at - from.at;
            let speed = (to.place - from.place) * TICK_HZ as f64 / ticks;
            (speed, speed * 2.0 * off / (ticks - 2.0 * off).max(1e-3))
        };
        let (before, slack_before) = speed(&three[0], &three[1]);
        let (behind, slack_behind) = speed(&three[1], &three[2]);
        let half_s = (three[2].at - three[0].at) / TICK_HZ as f64 / 2.0;
        let accel = (behind - before) / half_s;
        let shorter = 2.0 * off / (three[2].at - three[0].at);
        let slack = (slack_before + slack_behind) / half_s + accel.abs() * shorter;
        (accel, slack)
    }

    /// Lines that took longer than with a halt at both ends though all was there in time.
    pub(super) fn delays(&self, points: &[Point]) -> Vec<Fault> {
        let ahead_ticks = self.limits.ahead_ticks;
        let hz = TICK_HZ as f64;
        let slack = 2.0 * EDGE_TICKS + self.skew() + 1.0;
        let mut faults = Vec::new();
        let mut before: Option<Point> = None;
        for point in points.iter().filter(|point| point.main) {
            if let Some(before) = before {
                let piece = &self.pieces[point.piece];
                let time = |point: &Point| {
                    let place = point.place - self.legs[point.piece].from;
                    let piece = &self.pieces[point.piece];
                    piece.ideal.time_at(place / piece.tool * piece.most)
                };
                let corner = before.piece != point.piece;
                let in_time = (piece.taken + ahead_ticks) as f64 <= before.at;
                let most_s = self.pieces[before.piece].ideal.total_s() - time(&before);
                let late = point.at - before.at - (most_s + time(point)) * hz - slack;
                if corner && in_time && late > 0.0 {
                    let message = format!(
                        "{}: a gap of {late:.1} ticks where lines meet",
                        self.name(point)
                    );
                    faults.push((point.at, message));
                }
            }
            before = Some(*point);
        }
        faults
    }

    /// After a stop and two milliseconds only deceleration.
    pub(super) fn late_rest(&self, points: &[Point], stopped: &Stopped) -> Option<Fault> {
        let hz = TICK_HZ as f64;
        let begin = stopped.at + self.limits.stop_begin_ticks as f64;
        let mains: Vec<_> = points.iter().filter(|point| point.main).collect();
        let first = mains[..mains.len().saturating_sub(1)]
            .iter()
            .rposition(|point| point.at <= begin)?;
        // Over so long that a tick does not matter: the speed before is no lower.
        let (from, behind) = (mains[first], &mains[first + 1..]);
        let long = |point: &&&Point| point.at >= from.at + SPEED_TICKS_MIN;
        let to = behind.iter().find(long).or(behind.last())?;
        let pair = [from, to];
        let speed = (to.place - from.place) * hz / (to.at - from.at);
        let apart = behind.first()?.at - from.at;
        let apart_s = apart / hz;
        let fall_s = |(leg, piece): (&Leg, &Piece)| {
            let share = piece.tool / piece.most;
            fall_s(piece, (speed + leg.accel * apart_s) / share)
        };
        let ahead = pair[0].piece..;
        let legs = self.legs[ahead.clone()].iter().zip(&self.pieces[ahead]);
        let fall_s = legs.map(fall_s).fold(0.0, f64::max);
        let late = stopped.last - pair[1].at - fall_s * hz;
        (late > 0.0).then(|| {
            let message = format!("{late:.0} ticks later at rest than a stop allows");
            (stopped.last, message)
        })
    }
}

/// The speed at which a corner may be passed: no axis' speed jumps by more than `junction`.
fn corner_speed(before: &Piece, behind: &Piece, junction: f64) -> f64 {
    let share = |piece: &Piece, axis: usize| {
        let going = piece.axes.iter().find(|going| going.axis == axis);
        going.map_or(0.0, |going| going.steps as f64 / piece.tool)
    };
    let axes = before.axes.iter().chain(&behind.axes);
    let jumps = axes.map(|going| share(before, going.axis) - share(behind, going.axis));
    junction / jumps.map(f64::abs).fold(0.0, f64::max)
}

/// The longest that a path's own way to rest takes from a speed of its axis with most steps: what
/// acceleration is left at first may have to fade.
fn fall_s(piece: &Piece, speed: f64) -> f64 {
    let law = &piece.law;
    let far = 1e15;
    match law.jerk {
        Some(jerk) => {
            let more = law.accel * law.accel / (2.0 * jerk);
            let speed = speed + more.min(law.speed);
            Ideal::s_curve(far, speed, law.accel, jerk).fall_s() + 2.0 * law.accel / jerk
        }
        None => {
            let linear = match law.ramp.shape {
                RampShape::Trapezoid { linear_steps, .. } => f64::from(linear_steps),
                RampShape::Jerk { .. } => 0.0,
                // Not longer than all of its fall.
                RampShape::Smooth { .. } => {
                    return Ideal::of_ramp(1 << 50, &law.ramp).fall_s();
                }
            };
            Ideal::linear(far, speed, law.accel, linear, 0.0).fall_s()
        }
    }
}

/// First index and distance of `spans` + 1 equidistant items out of `count`, from near to far.
pub(super) fn scales(count: usize, spans: usize) -> impl Iterator<Item = (usize, usize)> {
    let doubled = std::iter::successors(Some(1), |scale| Some(scale * 2));
    doubled
        .take_while(move |scale| spans * scale < count)
        .flat_map(move |scale| {
            let indices = (0..count - spans * scale).step_by((scale / 4).max(1));
            indices.map(move |index| (index, scale))
        })
}
