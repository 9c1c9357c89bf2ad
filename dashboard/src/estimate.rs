//! What a list of commands would do, by the formulas of a textbook: how long, how far, and where.
//!
//! An estimate and no promise: the node counts in whole ticks and steps, and what it waits for
//! (a meeting point, a switch, a mechanism) nobody can foresee. With speed v, acceleration a, jerk
//! j and n steps:
//!
//! | motion | time |
//! |---|---|
//! | `move` | n · delay |
//! | trapezoid, v reached (n ≥ v²/a) | n/v + v/a |
//! | trapezoid, v not reached | 2 · √(n/a) |
//! | S-curve, a reached (v ≥ a²/j) | v/a + a/j to speed up, over half of v · that |
//! | S-curve, a not reached | 2 · √(v/j) to speed up |
//!
//! (Biagiotti, Melchiorri: Trajectory Planning for Automatic Machines and Robots, sections 3.2 and
//! 3.4.)

use keys::{
    AXES_MAX,
    job::{JobCommand, Work},
};

/// Most points of the path that are kept; of a longer list every second, third, … command's end.
pub const POINTS_MAX: usize = 10_000;

/// A place that the path goes through, steps of each axis.
pub type Place = [i64; AXES_MAX];

/// One axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reach {
    /// Lowest position, steps.
    pub least_steps: i64,
    /// Highest position, steps.
    pub most_steps: i64,
    /// Steps in both directions.
    pub travel_steps: u64,
    /// Whether any command moves it.
    pub moves: bool,
}

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Time without what nobody can foresee, s.
    pub duration_s: f64,
    /// Commands whose time nobody can foresee: `home`, `barrier`, `movc`, `movd`.
    pub open_ended: usize,
    /// Each axis.
    pub reach: [Reach; AXES_MAX],
    /// Where it goes; a new line after each `set_position`.
    pub lines: Vec<Vec<Place>>,
}

/// Returns what the work would do from this place; nothing for a script, which decides by itself.
pub fn estimate(work: &Work, start_steps: &[i64]) -> Option<Estimate> {
    let Work::Commands(commands) = work else {
        return None;
    };
    let mut at = Place::default();
    for (axis, steps) in at.iter_mut().zip(start_steps) {
        *axis = *steps;
    }
    let mut walk = Walk {
        at,
        estimate: Estimate {
            duration_s: 0.0,
            open_ended: 0,
            reach: at.map(|steps| Reach {
                least_steps: steps,
                most_steps: steps,
                ..Reach::default()
            }),
            lines: vec![vec![at]],
        },
    };
    let stride = commands.len() / POINTS_MAX + 1;
    for (index, command) in commands.iter().enumerate() {
        walk.command(command);
        if (index + 1).is_multiple_of(stride) || index + 1 == commands.len() {
            walk.point();
        }
    }
    Some(walk.estimate)
}

struct Walk {
    at: Place,
    estimate: Estimate,
}

impl Walk {
    fn command(&mut self, command: &JobCommand) {
        let seconds = match command {
            JobCommand::Move(f) => {
                self.shift(f.axis, f.steps.into());
                constant_s(f.steps, f.delay_us)
            }
            JobCommand::SyncMove(f) => self.sync_move(f.delay_us, f.steps),
            JobCommand::Ramp(f) => {
                self.shift(f.axis, f.steps.into());
                let n = f64::from(f.steps.unsigned_abs());
                ramp_s(n, f.speed_hz, f.accel, f.jerk, f.linear_steps, f.jump_steps)
            }
            JobCommand::RampTo(f) => {
                let from = self.at.get(usize::from(f.axis)).copied().unwrap_or(0);
                let steps = f.position.saturating_sub(from);
                self.shift(f.axis, steps);
                let n = steps.unsigned_abs() as f64;
                ramp_s(n, f.speed_hz, f.accel, f.jerk, f.linear_steps, f.jump_steps)
            }
            JobCommand::SmoothRamp(f) => {
                self.shift(f.axis, f.steps.into());
                let n = f64::from(f.steps.unsigned_abs());
                smooth_s(n, f.start_hz, f.speed_hz, f.ramp_steps)
            }
            JobCommand::SmoothRampTo(f) => {
                let from = self.at.get(usize::from(f.axis)).copied().unwrap_or(0);
                let steps = f.position.saturating_sub(from);
                self.shift(f.axis, steps);
                smooth_s(
                    steps.unsigned_abs() as f64,
                    f.start_hz,
                    f.speed_hz,
                    f.ramp_steps,
                )
            }
            JobCommand::Line(f) => {
                for (axis, steps) in (0..).zip(&f.steps) {
                    self.shift(axis, (*steps).into());
                }
                let longest = f.steps.iter().map(|steps| steps.unsigned_abs()).max();
                let n = f64::from(longest.unwrap_or(0));
                ramp_s(n, f.speed_hz, f.accel, f.jerk, 0, 0)
            }
            JobCommand::Pause(f) => f64::from(f.ms) / 1e3,
            JobCommand::SetPosition(f) => {
                if let Some(axis) = self.at.get_mut(usize::from(f.axis)) {
                    *axis = f.position;
                }
                self.shift(f.axis, 0);
                self.estimate.lines.push(vec![self.at]);
                0.0
            }
            JobCommand::Home(_)
            | JobCommand::Barrier(_)
            | JobCommand::WaitResume(_)
            | JobCommand::MoveC(_)
            | JobCommand::MoveD(_) => {
                self.estimate.open_ended += 1;
                0.0
            }
            JobCommand::Laser(_) | JobCommand::LidarRead(_) | JobCommand::StatusCd(_) => 0.0,
        };
        self.estimate.duration_s += seconds;
    }

    /// Both axes start together; the one that ends first rests while the other goes on.
    fn sync_move(&mut self, delay_us: [u32; 2], steps: [i32; 2]) -> f64 {
        let times = [0, 1].map(|axis| constant_s(steps[axis], delay_us[axis]));
        let (first, last) = if times[0] <= times[1] { (0, 1) } else { (1, 0) };
        let share = if times[last] > 0.0 {
            times[first] / times[last]
        } else {
            1.0
        };
        let until_bend = (f64::from(steps[last]) * share) as i64;
        self.shift(first as u8, steps[first].into());
        self.shift(last as u8, until_bend);
        self.point();
        self.shift(last as u8, i64::from(steps[last]) - until_bend);
        times[last]
    }

    fn shift(&mut self, axis: u8, steps: i64) {
        let axis = usize::from(axis);
        let (Some(at), Some(reach)) = (self.at.get_mut(axis), self.estimate.reach.get_mut(axis))
        else {
            return;
        };
        *at = at.saturating_add(steps);
        reach.least_steps = reach.least_steps.min(*at);
        reach.most_steps = reach.most_steps.max(*at);
        reach.travel_steps = reach.travel_steps.saturating_add(steps.unsigned_abs());
        reach.moves |= steps != 0;
    }

    fn point(&mut self) {
        if let Some(line) = self.estimate.lines.last_mut()
            && line.last() != Some(&self.at)
        {
            line.push(self.at);
        }
    }
}

fn constant_s(steps: i32, delay_us: u32) -> f64 {
    f64::from(steps.unsigned_abs()) * f64::from(delay_us) / 1e6
}

/// Returns the time of a move of n steps by a smoothstep from `start` to `speed` Hz over so many
/// steps, and back, s: half a step at the first speed, then ∫ ds / v by Simpson's rule. The way is
/// taken as the cube of what is summed over, which makes the slow begin as wide as the rest.
fn smooth_s(n: f64, start: u32, speed: u32, ramp_steps: u32) -> f64 {
    const PARTS: u32 = 400;
    let (start, gain) = (f64::from(start), f64::from(speed) - f64::from(start));
    let curve = f64::from(ramp_steps) - 1.0;
    if n <= 0.0 || start <= 0.0 || curve <= 0.0 {
        return 0.0;
    }
    let most = ((n / 2.0 - 0.5) / curve).clamp(0.0, 1.0).cbrt();
    let value = |part: u32| {
        let y = most * f64::from(part) / f64::from(PARTS);
        let x = y * y * y;
        3.0 * y * y / (start + gain * x * x * (3.0 - 2.0 * x))
    };
    let inner: f64 = (1..PARTS)
        .map(|part| value(part) * if part % 2 == 1 { 4.0 } else { 2.0 })
        .sum();
    let rise =
        0.5 / start + (value(0) + inner + value(PARTS)) * most / 3.0 / f64::from(PARTS) * curve;
    let coast = (n - 1.0 - 2.0 * curve).max(0.0) / (start + gain);
    2.0 * rise + coast
}

/// Returns the time of a move of n steps with a ramp at both ends, s.
fn ramp_s(n: f64, speed: u32, accel: u32, jerk: Option<u32>, linear: u16, jump: u16) -> f64 {
    let (v, a) = (f64::from(speed), f64::from(accel));
    if n <= 0.0 {
        return 0.0;
    }
    match jerk {
        Some(jerk) => s_curve_s(n, v, a, f64::from(jerk)),
        None => trapezoid_s(n, v, a, f64::from(linear), f64::from(jump)),
    }
}

/// From rest the ramp covers its first h steps with acceleration that grows linearly to a: the time
/// for them is √(6h/a), the speed then √(3ha/2). A jump leaves out the ramp's first steps.
fn trapezoid_s(n: f64, v: f64, a: f64, h: f64, jump: f64) -> f64 {
    let (h_s, h_v) = ((6.0 * h / a).sqrt(), (1.5 * h * a).sqrt());
    let speed_after = |d: f64| {
        if d < h {
            h_v * (d / h).powf(2.0 / 3.0)
        } else {
            (h_v * h_v + 2.0 * a * (d - h)).sqrt()
        }
    };
    let time_of = |d: f64| {
        if d < h {
            h_s * (d / h).cbrt()
        } else {
            h_s + (speed_after(d) - h_v) / a
        }
    };
    let steps_to_v = if v < h_v {
        h * (v / h_v).powf(1.5)
    } else {
        h + (v * v - h_v * h_v) / (2.0 * a)
    };
    // As fast from the start as it shall ever be: no ramp is left.
    if jump >= steps_to_v {
        return n / v;
    }
    let end = steps_to_v.min(jump + n / 2.0);
    let at_speed = (n - 2.0 * (end - jump)) / speed_after(end);
    2.0 * (time_of(end) - time_of(jump)) + at_speed
}

fn s_curve_s(n: f64, v: f64, a: f64, j: f64) -> f64 {
    let speeding_s = |v: f64| {
        if v * j >= a * a {
            v / a + a / j
        } else {
            2.0 * (v / j).sqrt()
        }
    };
    // Speeding up and slowing down together cover v · the time for one of them.
    if n >= v * speeding_s(v) {
        return n / v + speeding_s(v);
    }
    let with_a = a / 2.0 * ((a * a / (j * j) + 4.0 * n / a).sqrt() - a / j);
    let peak = if with_a * j >= a * a {
        with_a
    } else {
        (n * n * j / 4.0).cbrt()
    };
    2.0 * speeding_s(peak)
}

#[cfg(test)]
mod tests {
    use super::*;
    use keys::job::JobRequest;

    fn of(commands: &str) -> Estimate {
        let text = format!("{{\"commands\":[{commands}]}}");
        let job = JobRequest::from_json(text.as_bytes()).expect("a job");
        estimate(&job.work, &[0, 0]).expect("no script")
    }

    fn takes(commands: &str, expected_s: f64) {
        let took_s = of(commands).duration_s;
        let off = (took_s - expected_s).abs();
        assert!(
            off < 1e-9 * expected_s,
            "{commands}: {took_s} s, not {expected_s} s"
        );
    }

    #[test]
    fn moves_and_pauses_take_what_they_say() {
        takes(r#"{"move":{"axis":0,"delay_us":500,"steps":-2000}}"#, 1.0);
        takes(
            r#"{"sync_move":{"delay_us":[500,1000],"steps":[2000,1500]}}"#,
            1.5,
        );
        takes(
            r#"{"pause":{"ms":250}},{"laser":{"power_percent":5}}"#,
            0.25,
        );
    }

    #[test]
    fn a_trapezoid_has_its_two_textbook_times() {
        // v²/a = 500 steps: reached, then not.
        takes(
            r#"{"ramp":{"axis":0,"steps":2000,"speed_hz":1000,"accel":2000}}"#,
            2.5,
        );
        takes(
            r#"{"ramp":{"axis":0,"steps":-320,"speed_hz":1000,"accel":2000}}"#,
            0.8,
        );
        takes(
            r#"{"line":{"steps":[1000,-2000],"speed_hz":1000,"accel":2000}}"#,
            2.5,
        );
    }

    #[test]
    fn a_jump_and_a_linear_start_change_the_ends_of_the_ramp() {
        // With v0 = 500 Hz after 62.5 → here 64 steps: (1000 − 506)/2000 s at each end.
        let v0 = (2.0 * 2_000.0 * 64.0_f64).sqrt();
        let ramp_s = (1_000.0 - v0) / 2_000.0;
        let expected = 2.0 * ramp_s + (2_000.0 - 2.0 * (250.0 - 64.0)) / 1_000.0;
        let jump =
            r#"{"ramp":{"axis":0,"steps":2000,"speed_hz":1000,"accel":2000,"jump_steps":64}}"#;
        takes(jump, expected);
        // h = 12 steps: √(72/2000) s and √(36000) Hz, the rest of the way to v at 2000 steps/s².
        let (h_s, h_v) = (0.036_f64.sqrt(), 36_000.0_f64.sqrt());
        let ramp_s = h_s + (1_000.0 - h_v) / 2_000.0;
        let ramp_steps = 12.0 + (1e6 - 36_000.0) / 4_000.0;
        let expected = 2.0 * ramp_s + (2_000.0 - 2.0 * ramp_steps) / 1_000.0;
        let linear =
            r#"{"ramp":{"axis":0,"steps":2000,"speed_hz":1000,"accel":2000,"linear_steps":12}}"#;
        takes(linear, expected);
    }

    #[test]
    fn a_smoothstep_takes_what_its_curve_says() {
        // ESP-IDF's example: ∫ ds / v over 499 steps twice, 5,000 steps at the top and one at the start.
        let ramp = |steps: u32| {
            format!(
                r#"{{"smooth_ramp":{{"axis":0,"steps":{steps},"start_hz":500,"speed_hz":1500,"ramp_steps":500}}}}"#
            )
        };
        takes(&ramp(6_000), 4.483_577_419_938);
        takes(&ramp(1), 0.002);
        takes(
            r#"{"smooth_ramp_to":{"axis":1,"position":-1,"start_hz":20,"speed_hz":21,"ramp_steps":2}}"#,
            0.05,
        );
    }

    #[test]
    fn an_s_curve_has_its_four_textbook_times() {
        let ramp = |steps: u32, speed: u32, jerk: u32| {
            format!(
                r#"{{"ramp":{{"axis":0,"steps":{steps},"speed_hz":{speed},"accel":2000,"jerk":{jerk}}}}}"#
            )
        };
        // a reached: 1000/2000 + 2000/10000 = 0.7 s; v and then not v.
        takes(&ramp(2_000, 1_000, 10_000), 2.7);
        // Peak p with p²/2000 + p/5 = 480: p = 800, twice 0.6 s.
        takes(&ramp(480, 1_000, 10_000), 1.2);
        // a not reached: 2·√(160/1000) = 0.8 s; v and then not v.
        takes(&ramp(1_600, 160, 1_000), 10.8);
        // Peak ∛(16²·1000/4) = 40 Hz, twice 2·√(40/1000).
        takes(&ramp(16, 160, 1_000), 0.8);
    }

    #[test]
    fn bounds_travel_and_path_follow_the_commands() {
        let path = of(r#"{"line":{"steps":[100,50],"speed_hz":100,"accel":100}},
            {"ramp_to":{"axis":0,"position":-20,"speed_hz":100,"accel":100}},
            {"sync_move":{"delay_us":[10,10],"steps":[30,60]}}"#);
        let x = path.reach[0];
        assert_eq!(
            (x.least_steps, x.most_steps, x.travel_steps),
            (-20, 100, 250)
        );
        let xy: Vec<[i64; 2]> = path.lines[0].iter().map(|at| [at[0], at[1]]).collect();
        assert_eq!(xy, [[0, 0], [100, 50], [-20, 50], [10, 80], [10, 110]]);
        assert!(path.reach[1].moves && !path.reach[2].moves);
    }

    #[test]
    fn what_nobody_can_foresee_is_counted_and_a_new_name_of_a_place_is_no_motion() {
        let path = of(
            r#"{"home":{"axis":0}},{"set_position":{"axis":0,"position":500}},
            {"move":{"axis":0,"delay_us":10,"steps":5}}"#,
        );
        assert_eq!(path.open_ended, 1);
        assert_eq!(path.reach[0].travel_steps, 5);
        assert_eq!(path.lines.len(), 2);
        assert!(estimate(&Work::Lua("print(1)".to_owned()), &[]).is_none());
    }

    #[test]
    fn a_long_list_keeps_few_points_and_its_end() {
        let one = r#"{"move":{"axis":1,"delay_us":1,"steps":1}}"#;
        let path = of(&vec![one; 3 * POINTS_MAX + 1].join(","));
        assert!(path.lines[0].len() <= POINTS_MAX);
        assert_eq!(
            path.lines[0].last().map(|at| at[1]),
            Some(3 * POINTS_MAX as i64 + 1)
        );
    }
}
