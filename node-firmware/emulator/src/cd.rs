//! A model of the pulse hardware of C and D: a timer whose edges a counter counts, and a PWM channel.
//!
//! C is one MCPWM timer with a PCNT unit (its 16 bits are extended by the overflow interrupt, so the
//! count is whole), D one LEDC channel. Both have a duty of half. A halt takes effect at once; a
//! pulse that is high then ends, as the pin is forced low.

use crate::pins::{Pin, PinEvent};
use motion::{CdBackend, Direction, Ticks};

/// One timer that steps.
#[derive(Clone, Debug)]
struct Timer {
    step: Pin,
    direction: Pin,
    positive: bool,
    /// Its direction pin is behind a shift register.
    external: bool,
    high: bool,
    /// The next edge, up or down.
    edge_at: u64,
    interval_ticks: u64,
    /// Steps that are still to begin; `None`: it does not run.
    left: Option<u64>,
    /// Active edges with sign.
    counted_steps: i64,
}

impl Timer {
    const fn new(step: Pin, direction: Pin) -> Self {
        Self {
            step,
            direction,
            positive: false,
            external: false,
            high: false,
            edge_at: 0,
            interval_ticks: 1,
            left: None,
            counted_steps: 0,
        }
    }

    fn note(edges: &mut Vec<PinEvent>, at_ticks: u64, pin: Pin, level: bool) {
        edges.push(PinEvent {
            at_ticks,
            pin,
            level,
        });
    }

    fn run(
        &mut self,
        now: u64,
        positive: bool,
        steps: u64,
        interval: u64,
        edges: &mut Vec<PinEvent>,
    ) {
        self.halt(now, edges);
        if self.positive != positive && !self.external {
            self.positive = positive;
            Self::note(edges, now, self.direction, positive);
        }
        self.interval_ticks = interval;
        self.edge_at = now + interval;
        self.left = Some(steps);
    }

    fn halt(&mut self, now: u64, edges: &mut Vec<PinEvent>) {
        self.left = None;
        if self.high {
            self.high = false;
            Self::note(edges, now, self.step, false);
        }
    }

    /// Plays up to `until`. Returns when it has ended, if that was by then.
    fn play(&mut self, until: u64, edges: &mut Vec<PinEvent>) -> Option<u64> {
        while let Some(left) = self.left.filter(|_| self.edge_at <= until) {
            let at = self.edge_at;
            let half = self.interval_ticks / 2;
            self.high = !self.high;
            Self::note(edges, at, self.step, self.high);
            if self.high {
                self.counted_steps += if self.positive { 1 } else { -1 };
                self.left = Some(left - 1);
                self.edge_at += half;
            } else if left == 0 {
                self.left = None;
                return Some(at);
            } else {
                self.edge_at += self.interval_ticks - half;
            }
        }
        None
    }
}

/// C and D of an emulated node.
#[derive(Clone, Debug)]
pub struct VirtualCd {
    c: Timer,
    d: Timer,
    edges: Vec<PinEvent>,
}

impl Default for VirtualCd {
    fn default() -> Self {
        Self::new()
    }
}

impl VirtualCd {
    /// Both rest.
    pub const fn new() -> Self {
        Self {
            c: Timer::new(Pin::StepC, Pin::DirectionC),
            d: Timer::new(Pin::StepD, Pin::DirectionD),
            edges: Vec::new(),
        }
    }

    /// A shift register gives the direction pin of C (0) or D (1) this level.
    pub(crate) fn set_direction_pin(&mut self, index: usize, level: bool, now: Ticks) {
        let timer = if index == 0 { &mut self.c } else { &mut self.d };
        timer.external = true;
        if timer.positive != level {
            timer.positive = level;
            Timer::note(&mut self.edges, now.0, timer.direction, level);
        }
    }

    /// Returns whether one of them steps.
    pub fn is_running(&self) -> bool {
        self.c.left.is_some() || self.d.left.is_some()
    }

    /// Gives the changes of pins since the last call.
    pub fn take_edges(&mut self) -> impl Iterator<Item = PinEvent> + use<'_> {
        self.edges.drain(..)
    }

    /// Returns the steps of D, with sign: what nobody counts on the chip.
    pub fn d_steps(&self) -> i64 {
        self.d.counted_steps
    }
}

impl CdBackend for VirtualCd {
    fn run_c(&mut self, now: Ticks, steps: i64, interval_ticks: u64) {
        let count = steps.unsigned_abs();
        self.c
            .run(now.0, steps > 0, count, interval_ticks, &mut self.edges);
    }

    fn halt_c(&mut self, now: Ticks) {
        self.c.halt(now.0, &mut self.edges);
    }

    fn is_c_running(&self) -> bool {
        self.c.left.is_some()
    }

    fn counted_c(&self) -> i64 {
        self.c.counted_steps
    }

    fn run_d(&mut self, now: Ticks, way: Direction, interval_ticks: u64) {
        let positive = way == Direction::Positive;
        self.d
            .run(now.0, positive, u64::MAX, interval_ticks, &mut self.edges);
    }

    fn halt_d(&mut self, now: Ticks) {
        self.d.halt(now.0, &mut self.edges);
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        let c_ended = self.c.play(until.0, &mut self.edges);
        let until = c_ended.unwrap_or(until.0);
        self.d.play(until, &mut self.edges);
        Ticks(until)
    }
}
