//! Textbook kinematics in closed form: where an ideal axis is at which instant.
//!
//! ```text
//!  speed                 ┌── coast ──┐            A rise: phases of constant jerk from rest.
//!    │             ╭─────┴───────────┴─────╮      The fall is its mirror image, measured from
//!    │    rise  ╭──╯                       ╰──╮   the end, so that both ends are exact to the
//!    │       ╭──╯                             ╰─  last bit.
//!    └───────┴────────────────────────────────▶ time
//! ```
//!
//! It owns the ideal of one move from rest to rest. Edges are due in the middle of a step: edge k
//! at the place k − ½. Seconds, steps and `f64` throughout; nothing here runs on a board, and
//! nothing here knows how a board computes. Deliberately absent: moves that begin or end in
//! motion, and time in ticks.

mod smoothstep;

use keys::{
    Command,
    command::{LINE_AXES, Ramp, RampShape},
};
use smoothstep::Smoothstep;

/// A stretch of constant jerk.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Phase {
    /// Since the beginning of the rise, seconds.
    begin_s: f64,
    /// Seconds.
    duration_s: f64,
    /// Steps from where the rise began.
    place: f64,
    /// Steps/s at the beginning.
    speed: f64,
    /// Steps/s² at the beginning.
    accel: f64,
    /// Steps/s³.
    jerk: f64,
}

impl Phase {
    /// Place, speed and acceleration after `t` seconds of it.
    fn at(&self, t: f64) -> State {
        State {
            place: self.place + t * (self.speed + t * (self.accel / 2.0 + t * self.jerk / 6.0)),
            speed: self.speed + t * (self.accel + t * self.jerk / 2.0),
            accel: self.accel + t * self.jerk,
        }
    }

    /// Seconds of it until `place`.
    fn time_at(&self, place: f64) -> f64 {
        let way = (place - self.place).max(0.0);
        if self.jerk == 0.0 {
            let speed = (self.speed * self.speed + 2.0 * self.accel * way).sqrt();
            let sum = self.speed + speed;
            return if sum > 0.0 { 2.0 * way / sum } else { 0.0 };
        }
        if self.speed == 0.0 && self.accel == 0.0 {
            return (6.0 * way / self.jerk).cbrt();
        }
        // Newton, kept between bounds: the place only grows.
        let (mut low, mut high) = (0.0, self.duration_s);
        let mut t = (way / (self.speed + 1e-300)).min(high);
        for _ in 0..100 {
            let state = self.at(t);
            let error = state.place - self.place - way;
            if error > 0.0 {
                high = t;
            } else {
                low = t;
            }
            let newton = t - error / state.speed;
            let next = if newton > low && newton < high {
                newton
            } else {
                (low + high) / 2.0
            };
            if (next - t).abs() <= t * 1e-16 {
                return next;
            }
            t = next;
        }
        t
    }
}

/// Where, how fast, and how fast that changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Steps from the beginning.
    pub place: f64,
    /// Steps/s.
    pub speed: f64,
    /// Steps/s².
    pub accel: f64,
}

/// From rest to a speed.
#[derive(Clone, Debug, PartialEq)]
struct Rise {
    phases: Vec<Phase>,
    /// Instead of phases.
    curve: Option<Smoothstep>,
    duration_s: f64,
    way: f64,
    speed: f64,
}

impl Rise {
    fn new(jerks: impl IntoIterator<Item = (f64, f64, f64)>) -> Self {
        let mut rise = Self {
            phases: Vec::new(),
            curve: None,
            duration_s: 0.0,
            way: 0.0,
            speed: 0.0,
        };
        for (duration_s, accel, jerk) in jerks {
            let phase = Phase {
                begin_s: rise.duration_s,
                duration_s,
                place: rise.way,
                speed: rise.speed,
                accel,
                jerk,
            };
            let end = phase.at(duration_s);
            rise.duration_s += duration_s;
            (rise.way, rise.speed) = (end.place, end.speed);
            rise.phases.push(phase);
        }
        rise
    }

    /// Constant acceleration after a cubic beginning, as far as `way`.
    fn of_linear(accel: f64, linear: f64, way: f64) -> Self {
        if linear == 0.0 {
            return Self::new([((2.0 * way / accel).sqrt(), accel, 0.0)]);
        }
        let jerk = (accel * accel * accel / (6.0 * linear)).sqrt();
        let cubic_s = (6.0 * way.min(linear) / jerk).cbrt();
        let cubic = (cubic_s, 0.0, jerk);
        if way <= linear {
            return Self::new([cubic]);
        }
        let handover = (1.5 * accel * linear).sqrt();
        let speed = (2.0 * accel * (way - linear / 4.0)).sqrt();
        Self::new([cubic, ((speed - handover) / accel, accel, 0.0)])
    }

    /// The jerk-limited way to `speed`.
    fn of_jerk(speed: f64, accel: f64, jerk: f64) -> Self {
        let ramp_s = (speed / jerk).sqrt().min(accel / jerk);
        let peak = jerk * ramp_s;
        let constant_s = (speed / peak - ramp_s).max(0.0);
        Self::new([
            (ramp_s, 0.0, jerk),
            (constant_s, peak, 0.0),
            (ramp_s, peak, -jerk),
        ])
    }

    /// The smoothstep from `start` towards `end`, as far as `way`.
    fn of_curve(start: f64, end: f64, ramp_steps: f64, way: f64) -> Self {
        let curve = Smoothstep::new(start, end, ramp_steps, way);
        Self {
            phases: Vec::new(),
            duration_s: curve.duration_s(),
            way: curve.way(),
            speed: curve.speed(),
            curve: Some(curve),
        }
    }

    fn phase(&self, is_behind: impl Fn(&Phase) -> bool) -> &Phase {
        let index = self.phases.iter().rposition(|phase| !is_behind(phase));
        &self.phases[index.unwrap_or(0)]
    }

    fn time_at(&self, place: f64) -> f64 {
        if let Some(curve) = &self.curve {
            return curve.time_at(place);
        }
        let phase = self.phase(|phase| phase.place > place);
        phase.begin_s + phase.time_at(place).min(phase.duration_s)
    }

    fn at(&self, t: f64) -> State {
        if let Some(curve) = &self.curve {
            return curve.at(t);
        }
        let phase = self.phase(|phase| phase.begin_s > t);
        phase.at(t - phase.begin_s)
    }
}

/// Steps of the linear law until `speed`.
fn linear_way(speed: f64, accel: f64, linear: f64) -> f64 {
    let handover2 = 1.5 * accel * linear;
    if speed * speed >= handover2 {
        return speed * speed / (2.0 * accel) + linear / 4.0;
    }
    let jerk = (accel * accel * accel / (6.0 * linear)).sqrt();
    let t = (2.0 * speed / jerk).sqrt();
    jerk * t * t * t / 6.0
}

/// The ideal of one move from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Ideal {
    /// Up to the peak, and mirrored, down from it.
    rise: Rise,
    /// Where on the rise the move begins: steps and seconds of it that are left out.
    skipped_way: f64,
    skipped_s: f64,
    coast_s: f64,
    /// Place where the fall begins.
    fall: f64,
    steps: f64,
    total_s: f64,
}

impl Ideal {
    fn new(steps: f64, rise: Rise, skipped_way: f64) -> Self {
        let skipped_way = skipped_way.min(rise.way);
        let skipped_s = rise.time_at(skipped_way);
        let coast = (steps - 2.0 * rise.way + skipped_way).max(0.0);
        let coast_s = if rise.speed > 0.0 {
            coast / rise.speed
        } else {
            0.0
        };
        Self {
            skipped_way,
            skipped_s,
            coast_s,
            fall: steps - rise.way,
            steps,
            total_s: 2.0 * rise.duration_s - skipped_s + coast_s,
            rise,
        }
    }

    /// Constant acceleration: a trapezoid, or a triangle where `speed` (steps/s) is not reached.
    /// All arguments are positive; acceleration in steps/s².
    pub fn trapezoid(steps: f64, speed: f64, accel: f64) -> Self {
        Self::linear(steps, speed, accel, 0.0, 0.0)
    }

    /// A trapezoid whose acceleration grows linearly over the first `linear` steps and shrinks so
    /// over the last; at the peak it ends abruptly. It begins as if `jump` steps had been made.
    pub fn linear(steps: f64, speed: f64, accel: f64, linear: f64, jump: f64) -> Self {
        let way = linear_way(speed, accel, linear);
        let skipped = jump.min(steps).min(way);
        let peak = way.min((steps + skipped) / 2.0);
        Self::new(steps, Rise::of_linear(accel, linear, peak), skipped)
    }

    /// Seven phases: speed, acceleration and jerk (steps/s³) are limited.
    pub fn s_curve(steps: f64, speed: f64, accel: f64, jerk: f64) -> Self {
        let rise = Rise::of_jerk(speed, accel, jerk);
        if 2.0 * rise.way <= steps {
            return Self::new(steps, rise, 0.0);
        }
        let ramp_s = accel / jerk;
        let peak = if steps >= 2.0 * accel * ramp_s * ramp_s {
            accel / 2.0 * ((ramp_s * ramp_s + 4.0 * steps / accel).sqrt() - ramp_s)
        } else {
            (steps * steps / 4.0 * jerk).cbrt()
        };
        Self::new(steps, Rise::of_jerk(peak, accel, jerk), 0.0)
    }

    /// ESP-IDF's smoothstep of `ramp_steps` frequencies from `start` to `end`, and back; it is left
    /// at `speed`, and a shorter move turns back half way.
    pub fn smoothstep(steps: f64, start: f64, end: f64, ramp_steps: f64, speed: f64) -> Self {
        let way = if speed < end {
            Smoothstep::way_to(start, end, ramp_steps, speed)
        } else {
            f64::INFINITY
        };
        let rise = Rise::of_curve(start, end, ramp_steps, way.min(steps / 2.0));
        Self::new(steps, rise, 0.0)
    }

    /// The move of [`Command::Ramp`] over so many steps, at least one.
    pub fn of_ramp(steps: u64, ramp: &Ramp) -> Self {
        Self::of_ramp_up_to(steps, ramp, f64::from(ramp.speed_hz))
    }

    /// The same at another speed, steps/s. A smoothstep keeps its curve and leaves it there; beyond
    /// its ends nothing is known of it.
    pub fn of_ramp_up_to(steps: u64, ramp: &Ramp, speed: f64) -> Self {
        let accel = f64::from(ramp.accel_hz_per_s);
        match ramp.shape {
            RampShape::Trapezoid {
                linear_steps,
                jump_steps,
            } => {
                let (linear, jump) = (f64::from(linear_steps), f64::from(jump_steps));
                Self::linear(steps as f64, speed, accel, linear, jump)
            }
            RampShape::Jerk { jerk_hz_per_s2 } => {
                Self::s_curve(steps as f64, speed, accel, f64::from(jerk_hz_per_s2))
            }
            RampShape::Smooth {
                start_hz,
                ramp_steps,
            } => {
                let (start, end) = (f64::from(start_hz), f64::from(ramp.speed_hz));
                Self::smoothstep(steps as f64, start, end, f64::from(ramp_steps), speed)
            }
        }
    }

    /// The path of a lonely [`Command::Line`], along the axis with most steps; `None` if it is
    /// none or has no steps.
    pub fn of_line(command: &Command) -> Option<Self> {
        let Command::Line {
            steps,
            speed_hz,
            accel_hz_per_s,
            jerk_hz_per_s2,
        } = *command
        else {
            return None;
        };
        let most = f64::from(line_steps(&steps));
        let (speed, accel) = (f64::from(speed_hz), f64::from(accel_hz_per_s));
        (most > 0.0).then(|| match jerk_hz_per_s2 {
            0 => Self::trapezoid(most, speed, accel),
            jerk => Self::s_curve(most, speed, accel, f64::from(jerk)),
        })
    }

    /// Length of the path, steps.
    pub fn steps(&self) -> f64 {
        self.steps
    }

    /// Duration, seconds.
    pub fn total_s(&self) -> f64 {
        self.total_s
    }

    /// The highest speed, steps/s.
    pub fn peak_speed(&self) -> f64 {
        self.rise.speed
    }

    /// The greatest acceleration by which [`Command::Ramp`] gains or loses speed, steps/s².
    pub fn accel_of(ramp: &Ramp) -> f64 {
        match ramp.shape {
            RampShape::Smooth {
                start_hz,
                ramp_steps,
            } => {
                let (start, end) = (f64::from(start_hz), f64::from(ramp.speed_hz));
                Smoothstep::new(start, end, f64::from(ramp_steps), 0.0).accel_max()
            }
            RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => f64::from(ramp.accel_hz_per_s),
        }
    }

    /// Steps from the top speed to rest.
    pub fn fall_steps(&self) -> f64 {
        self.rise.way
    }

    /// Seconds from the top speed to rest.
    pub fn fall_s(&self) -> f64 {
        self.rise.duration_s
    }

    /// When the move is at `place` steps (0 to its length), seconds from its beginning.
    pub fn time_at(&self, place: f64) -> f64 {
        if place >= self.fall {
            return self.total_s - self.rise.time_at((self.steps - place).max(0.0));
        }
        let on_rise = place + self.skipped_way;
        if on_rise <= self.rise.way {
            return self.rise.time_at(on_rise) - self.skipped_s;
        }
        let coast = on_rise - self.rise.way;
        self.rise.duration_s - self.skipped_s + coast / self.rise.speed
    }

    /// Where it is at `t` seconds, and how fast.
    pub fn at(&self, t: f64) -> State {
        let rest = self.total_s - t;
        if rest <= self.rise.duration_s {
            let mirrored = self.rise.at(rest.max(0.0));
            return State {
                place: self.steps - mirrored.place,
                speed: mirrored.speed,
                accel: -mirrored.accel,
            };
        }
        let on_rise = t.max(0.0) + self.skipped_s;
        if on_rise <= self.rise.duration_s {
            let mut state = self.rise.at(on_rise);
            state.place -= self.skipped_way;
            return state;
        }
        let coast = (on_rise - self.rise.duration_s) * self.rise.speed;
        State {
            place: self.rise.way - self.skipped_way + coast,
            speed: self.rise.speed,
            accel: 0.0,
        }
    }

    /// When edge `number` of `count` (from 1) is due, seconds: in the middle of its step. With
    /// `count` less than the length, the edges of an axis that goes along on a line.
    pub fn edge_s(&self, number: u64, count: u64) -> f64 {
        self.time_at((number as f64 - 0.5) * (self.steps / count as f64))
    }
}

/// Steps of the axis with most steps: the unit of a line's limits.
pub fn line_steps(steps: &[i32; LINE_AXES]) -> u32 {
    steps
        .iter()
        .map(|count| count.unsigned_abs())
        .max()
        .unwrap_or(0)
}
