//! Many small corners in a row are an acceleration, too: each axis by itself, over windows of lines.
//!
//! Along its way a path speeds up by the lines' acceleration at most; and each corner, whose jump
//! of an axis' speed is bounded, must have as much time as that acceleration needs for the jump. So
//! over a window an axis is accelerated by both at most, and by one jump more that may lie in the
//! window alone.

use super::{
    TICK_HZ,
    track::{Fault, Point, Track, scales},
};

/// The share of the acceleration with which an axis may be turned. A corner's time is reckoned at
/// the corner's speed: from the middle of one line to the middle of the next. Where the tool speeds up
/// behind it as hard as it may, the second half of that takes √2 − 1 instead of ½ of it.
const TURN_SHARE: f64 = 1.25;

/// An edge in an axis' own steps.
#[derive(Clone, Copy)]
struct Place {
    at: f64,
    steps: f64,
    piece: usize,
}

impl Track<'_> {
    /// The first axis that lines in a row turn harder than they may.
    pub(super) fn turning(&self, points: &[Point]) -> Option<Fault> {
        (0..keys::command::LINE_AXES).find_map(|axis| self.turning_of(axis, points))
    }

    fn turning_of(&self, axis: usize, points: &[Point]) -> Option<Fault> {
        let mut steps = 0.0;
        let own = points.iter().filter(|point| point.axis == axis);
        let places: Vec<Place> = own
            .map(|point| {
                let going = self.pieces[point.piece].axes.iter();
                let sign = going
                    .filter(|going| going.axis == axis)
                    .map(|going| going.steps.signum() as f64)
                    .sum::<f64>();
                steps += sign;
                Place {
                    at: point.at,
                    steps: steps - sign / 2.0,
                    piece: point.piece,
                }
            })
            .collect();
        scales(places.len(), 2).find_map(|(index, scale)| {
            let [first, middle, last] = [0, 1, 2].map(|number| places[index + number * scale]);
            if first.piece == last.piece {
                return None;
            }
            let off = 2.0 * self.edge_ticks + self.skew();
            let speed = |from: Place, to: Place| {
                let ticks = to.at - from.at;
                let speed = (to.steps - from.steps) * TICK_HZ as f64 / ticks;
                (speed, speed.abs() * off / (ticks - off).max(1e-3))
            };
            let (before, slack_before) = speed(first, middle);
            let (behind, slack_behind) = speed(middle, last);
            let half_s = (last.at - first.at) / TICK_HZ as f64 / 2.0;
            let found = ((behind - before) / half_s).abs();
            let pieces = &self.pieces[first.piece..=last.piece];
            let accel = pieces.iter().map(|piece| piece.law.accel);
            let most = accel.fold(0.0, f64::max) * (1.0 + TURN_SHARE);
            let jump = f64::from(self.limits.junction_hz);
            let slack = (slack_before + slack_behind + jump) / half_s;
            (found > most + slack + found * off / (last.at - first.at)).then(|| {
                let message = format!(
                    "axis {axis}, commands {} to {}: turned by {found:.0} steps/s² over {} steps, \
                     {most:.0} is the limit",
                    pieces[0].number,
                    pieces[pieces.len() - 1].number,
                    2 * scale,
                );
                (last.at, message)
            })
        })
    }
}
