//! Speed that rises with the place by 3x² - 2x³: ESP-IDF's smoothstep table, made continuous.
//!
//! The table's frequencies lie in the middle of their steps: half a step at the first one, then the
//! curve. Its time is the integral of 1 / speed, which has no closed form: Simpson's rule on pieces
//! that are short where the speed is low.

/// From a first speed on, as far as a way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Smoothstep {
    /// Steps/s at its beginning, more than 0.
    start: f64,
    /// Steps/s that it gains.
    gain: f64,
    /// Steps of the curve: one less than the table has frequencies.
    steps: f64,
    /// Share of the curve and seconds from its beginning, where its pieces begin and where it ends.
    nodes: Vec<(f64, f64)>,
}

/// Steps at the first speed.
const LEAD: f64 = 0.5;

/// Intervals of Simpson's rule in one piece: 10⁻¹² of the time of one as short as here.
const INTERVALS: u32 = 16;

impl Smoothstep {
    /// The rise to `end` (steps/s) over `steps` frequencies, but not farther than `way` steps.
    pub(super) fn new(start: f64, end: f64, steps: f64, way: f64) -> Self {
        let mut curve = Self {
            start,
            gain: end - start,
            steps: steps - 1.0,
            nodes: vec![(0.0, 0.0)],
        };
        let most = ((way - LEAD) / curve.steps).clamp(0.0, 1.0);
        // 1 / speed varies little over a part of its distance from there.
        let scale = (start / (3.0 * curve.gain)).sqrt();
        let (mut x, mut seconds) = (0.0, 0.0);
        while x < most {
            let next = (x + ((x + scale) / 16.0).min(1.0 / 16.0)).min(most);
            seconds += curve.seconds_between(x, next);
            curve.nodes.push((next, seconds));
            x = next;
        }
        curve
    }

    fn speed_at_share(&self, x: f64) -> f64 {
        self.start + self.gain * x * x * (3.0 - 2.0 * x)
    }

    /// Steps until a speed between that of its beginning and that of the whole curve.
    pub(super) fn way_to(start: f64, end: f64, steps: f64, speed: f64) -> f64 {
        let curve = Self::new(start, end, steps, 0.0);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if curve.speed_at_share(middle) < speed {
                low = middle;
            } else {
                high = middle;
            }
        }
        LEAD + high * curve.steps
    }

    fn accel_at_share(&self, x: f64) -> f64 {
        self.gain * 6.0 * x * (1.0 - x) / self.steps * self.speed_at_share(x)
    }

    fn seconds_between(&self, from: f64, to: f64) -> f64 {
        let width = (to - from) / f64::from(INTERVALS);
        let inner: f64 = (1..INTERVALS)
            .map(|index| {
                let weight = if index % 2 == 1 { 4.0 } else { 2.0 };
                weight / self.speed_at_share(from + f64::from(index) * width)
            })
            .sum();
        let ends = 1.0 / self.speed_at_share(from) + 1.0 / self.speed_at_share(to);
        (ends + inner) * width / 3.0 * self.steps
    }

    fn end(&self) -> (f64, f64) {
        self.nodes[self.nodes.len() - 1]
    }

    /// Seconds of it all.
    pub(super) fn duration_s(&self) -> f64 {
        LEAD / self.start + self.end().1
    }

    /// Steps of it all.
    pub(super) fn way(&self) -> f64 {
        LEAD + self.end().0 * self.steps
    }

    /// Steps/s at its end.
    pub(super) fn speed(&self) -> f64 {
        self.speed_at_share(self.end().0)
    }

    /// Greatest acceleration of the whole curve, steps/s²: above its middle, where it is fast.
    pub(super) fn accel_max(&self) -> f64 {
        let (mut low, mut high) = (0.5, 1.0);
        for _ in 0..100 {
            let (a, b) = ((2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0);
            if self.accel_at_share(a) < self.accel_at_share(b) {
                low = a;
            } else {
                high = b;
            }
        }
        self.accel_at_share(low)
    }

    /// Seconds until `place`.
    pub(super) fn time_at(&self, place: f64) -> f64 {
        if place <= LEAD {
            return place / self.start;
        }
        let x = ((place - LEAD) / self.steps).min(self.end().0);
        let index = self.nodes.partition_point(|(node, _)| *node <= x) - 1;
        let (node, seconds) = self.nodes[index];
        LEAD / self.start + seconds + self.seconds_between(node, x)
    }

    /// Place, speed and acceleration after `t` seconds.
    pub(super) fn at(&self, t: f64) -> super::State {
        let curve_s = t - LEAD / self.start;
        if curve_s <= 0.0 {
            return super::State {
                place: t * self.start,
                speed: self.start,
                accel: 0.0,
            };
        }
        let (mut low, mut high) = (LEAD, self.way());
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if self.time_at(middle) < t {
                low = middle;
            } else {
                high = middle;
            }
        }
        let x = (low - LEAD) / self.steps;
        super::State {
            place: low,
            speed: self.speed_at_share(x),
            accel: self.accel_at_share(x),
        }
    }
}
