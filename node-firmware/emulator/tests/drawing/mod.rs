//! Records that are drawn by the textbook instead of recorded: good to the tick, until they are
//! spoiled on purpose.

use emulator::{
    EmulatedNode, EmulatorConfig,
    kinematics::{Ideal, line_steps},
    pins::{Pin, PinEvent},
    record::{Life, TakenCommand},
};
use keys::{AxisId, Command, LocalMicros, NodeId, StopReason, StopReport};

pub(crate) const TICK_HZ: f64 = 16e6;

/// A step that was drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stroke {
    pub(crate) at: u64,
    pub(crate) axis: usize,
    pub(crate) sign: i64,
    /// The command it belongs to.
    pub(crate) command: usize,
}

/// Commands that were all there long before, and their steps.
#[derive(Clone, Default)]
pub(crate) struct Drawing {
    pub(crate) commands: Vec<Command>,
    pub(crate) strokes: Vec<Stroke>,
    /// Where the next command begins, ticks.
    pub(crate) now: u64,
    origin: [i64; 4],
    stop: Option<(u64, usize)>,
}

fn ticks(seconds: f64) -> u64 {
    (seconds * TICK_HZ).round() as u64
}

impl Drawing {
    pub(crate) fn new() -> Self {
        Self {
            now: 16_000_000,
            ..Self::default()
        }
    }

    pub(crate) fn position(&self, axis: usize) -> i64 {
        let strokes = self.strokes.iter().filter(|stroke| stroke.axis == axis);
        self.origin[axis] + strokes.map(|stroke| stroke.sign).sum::<i64>()
    }

    fn stroke(&mut self, at: u64, axis: usize, sign: i64) {
        self.strokes.push(Stroke {
            at,
            axis,
            sign,
            command: self.commands.len(),
        });
    }

    /// Draws a command as it is meant.
    pub(crate) fn draw(&mut self, command: Command) {
        self.draw_as(command, command);
    }

    /// Draws `command`, but what is told is `told`.
    pub(crate) fn draw_as(&mut self, told: Command, command: Command) {
        match command {
            Command::Move {
                axis,
                delay_us,
                steps,
            } => {
                let interval = u64::from(delay_us) * 16;
                for _ in 0..steps.unsigned_abs() {
                    self.stroke(self.now, axis.index(), i64::from(steps.signum()));
                    self.now += interval;
                }
            }
            Command::Pause { pause_ms } => self.now += u64::from(pause_ms) * 16_000,
            Command::SetPosition {
                axis,
                position_steps,
            } => {
                let axis = axis.index();
                self.origin[axis] += position_steps - self.position(axis);
            }
            Command::Ramp { axis, steps, ramp } => {
                if steps != 0 {
                    let ideal = Ideal::of_ramp(u64::from(steps.unsigned_abs()), &ramp);
                    self.path(&ideal, &[(axis.index(), i64::from(steps))]);
                }
            }
            Command::RampTo {
                axis,
                position_steps,
                ramp,
            } => {
                let steps = position_steps - self.position(axis.index());
                if steps != 0 {
                    let ideal = Ideal::of_ramp(steps.unsigned_abs(), &ramp);
                    self.path(&ideal, &[(axis.index(), steps)]);
                }
            }
            Command::Line { steps, .. } => {
                if let Some(ideal) = Ideal::of_line(&command) {
                    let axes = steps.map(i64::from);
                    self.path(&ideal, &axes.into_iter().enumerate().collect::<Vec<_>>());
                }
            }
            _ => panic!("not drawn"),
        }
        self.commands.push(told);
    }

    fn path(&mut self, ideal: &Ideal, axes: &[(usize, i64)]) {
        for (axis, steps) in axes {
            let count = steps.unsigned_abs();
            for number in 1..=count {
                let at = self.now + ticks(ideal.edge_s(number, count));
                self.stroke(at, *axis, steps.signum());
            }
        }
        self.now += ticks(ideal.total_s());
    }

    /// Draws lines that pass their corners with these speeds of the tool, as fast as they may.
    pub(crate) fn join(&mut self, lines: &[Command], corners: &[f64]) {
        let mut begin_s = self.now as f64 / TICK_HZ;
        for (index, line) in lines.iter().enumerate() {
            let Command::Line {
                steps,
                speed_hz,
                accel_hz_per_s,
                ..
            } = *line
            else {
                panic!("a line");
            };
            let squares = steps.iter().map(|steps| f64::from(*steps).powi(2));
            let tool = squares.sum::<f64>().sqrt();
            let share = tool / f64::from(line_steps(&steps));
            let (top, accel) = (
                f64::from(speed_hz) * share,
                f64::from(accel_hz_per_s) * share,
            );
            let enter = if index == 0 { 0.0 } else { corners[index - 1] };
            let leave = corners.get(index).copied().unwrap_or(0.0);
            let peak = (accel * tool + (enter * enter + leave * leave) / 2.0).sqrt();
            let peak = peak.min(top);
            assert!(peak >= enter && peak >= leave, "too short for its corners");
            let rise = (peak * peak - enter * enter) / (2.0 * accel);
            let fall = (peak * peak - leave * leave) / (2.0 * accel);
            let coast_s = (tool - rise - fall) / peak;
            let total_s = (peak - enter) / accel + coast_s + (peak - leave) / accel;
            let time_at = |place: f64| {
                if place < rise {
                    ((enter * enter + 2.0 * accel * place).sqrt() - enter) / accel
                } else if place < tool - fall {
                    (peak - enter) / accel + (place - rise) / peak
                } else {
                    let rest = tool - place;
                    total_s - ((leave * leave + 2.0 * accel * rest).sqrt() - leave) / accel
                }
            };
            for (axis, steps) in steps.iter().enumerate() {
                let count = steps.unsigned_abs();
                for number in 1..=count {
                    let place = (f64::from(number) - 0.5) / f64::from(count) * tool;
                    let at = ticks(begin_s + time_at(place));
                    self.stroke(at, axis, i64::from(steps.signum()));
                }
            }
            begin_s += total_s;
            self.commands.push(*line);
        }
        self.now = ticks(begin_s);
    }

    /// Index of the step `number` (from 0) of a command on an axis.
    pub(crate) fn nth(&self, command: usize, axis: usize, number: usize) -> usize {
        let strokes = self.strokes.iter().enumerate();
        let of = |(_, stroke): &(usize, &Stroke)| stroke.command == command && stroke.axis == axis;
        strokes.filter(of).nth(number).expect("there are more").0
    }

    /// All that comes at `from` or later comes so much later.
    pub(crate) fn delay(&mut self, from: u64, ticks: u64) {
        for stroke in self.strokes.iter_mut().filter(|stroke| stroke.at >= from) {
            stroke.at += ticks;
        }
        self.now += ticks;
    }

    /// A stop is taken at this tick, and steps behind `cut` are forgotten.
    pub(crate) fn stop(&mut self, at: u64, cut: u64, executed: usize) {
        self.strokes.retain(|stroke| stroke.at <= cut);
        self.stop = Some((at, executed));
    }

    /// After a stop: the axes go on from `place` (of the axis with most steps) with this speed and
    /// deceleration from tick `at` on. All steps so far count.
    pub(crate) fn brake(&mut self, at: u64, axes: &[i64], place: f64, speed: f64, accel: f64) {
        let most = axes.iter().map(|steps| steps.unsigned_abs()).max();
        let most = most.expect("axes") as f64;
        for (axis, steps) in axes.iter().enumerate() {
            let made = self.strokes.iter().filter(|stroke| stroke.axis == axis);
            for number in made.count() as u64 + 1..=steps.unsigned_abs() {
                let edge = (number as f64 - 0.5) * most / steps.unsigned_abs() as f64;
                let square = speed * speed - 2.0 * accel * (edge - place).max(0.0);
                if square < 0.0 {
                    break;
                }
                let at = at + ticks((speed - square.sqrt()) / accel);
                self.strokes.push(Stroke {
                    at,
                    axis,
                    sign: steps.signum(),
                    command: usize::MAX,
                });
            }
        }
    }

    /// The record.
    pub(crate) fn life(&self) -> Life {
        let mut config = EmulatorConfig::new(NodeId::new("bench").expect("legal"));
        config.axis_count = 4;
        let mut life = EmulatedNode::new(config, 7).life();
        let queue = life.status.queue;
        let taken = |(number, command): (usize, &Command)| TakenCommand {
            at: LocalMicros(1),
            queue,
            number: number as u64,
            command: *command,
        };
        life.commands = self.commands.iter().enumerate().map(taken).collect();
        let mut strokes = self.strokes.clone();
        strokes.sort_by_key(|stroke| stroke.at);
        let mut positive = [false; 4];
        for stroke in &strokes {
            let axis = AxisId(stroke.axis as u8);
            let mut event = |at_ticks: u64, pin: Pin, level: bool| {
                life.edges.push(PinEvent {
                    at_ticks,
                    pin,
                    level,
                });
            };
            if positive[stroke.axis] != (stroke.sign > 0) {
                positive[stroke.axis] = stroke.sign > 0;
                event(stroke.at - 200, Pin::Direction(axis), stroke.sign > 0);
            }
            event(stroke.at, Pin::Step(axis), true);
            event(stroke.at + 40, Pin::Step(axis), false);
            life.counted_steps[stroke.axis] += stroke.sign;
        }
        life.edges.sort_by_key(|event| event.at_ticks);
        for (axis, status) in life.status.axes.iter_mut().enumerate() {
            status.position_steps = self.position(axis);
        }
        life.status.accepted_commands = life.commands.len() as u64;
        life.status.executed_commands = life.commands.len() as u64;
        if let Some((at, executed)) = self.stop {
            life.stops.push(StopReport {
                queue,
                reason: StopReason::Client,
                at: LocalMicros(at / 16),
                accepted_commands: life.commands.len() as u64,
                executed_commands: executed as u64,
                positions_steps: (0..4).map(|axis| self.position(axis)).collect(),
            });
            life.status.queue.flush += 1;
            life.status.accepted_commands = 0;
            life.status.executed_commands = 0;
        }
        life
    }
}
