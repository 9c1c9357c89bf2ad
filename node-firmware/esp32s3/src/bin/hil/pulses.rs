//! The pulses themselves, counted at the pins.

use crate::rmt::{RmtBackend, WANTED, now_ticks};
use core::sync::atomic::{AtomicU32, Ordering};
use esp_println::println;
use keys::{AxisId, Command, StopMode, command::COMMAND_WORDS, status::FaultCode};
use motion::{
    CommandRing, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend, TICKS_PER_US, Ticks,
};
use static_cell::ConstStaticCell;

const RING_COMMANDS: usize = 512;
static RING: [AtomicU32; RING_COMMANDS * COMMAND_WORDS] =
    [const { AtomicU32::new(0) }; RING_COMMANDS * COMMAND_WORDS];

/// The axis that most tests move.
pub(crate) const X: AxisId = AxisId(0);

/// Motion on this board, and what has failed.
pub(crate) struct Bench {
    pub(crate) motion: Motion<'static, RmtBackend>,
    pub(crate) failures: u32,
    /// Refills that came too late.
    pub(crate) late: u32,
}

impl Bench {
    pub(crate) fn new(backend: RmtBackend) -> Self {
        static PLANS: ConstStaticCell<PlanMemory> = ConstStaticCell::new(PlanMemory::new());
        let config = MotionConfig {
            axis_count: crate::board::axes(),
            ..MotionConfig::default()
        };
        let ring = CommandRing::new(&RING);
        Self {
            motion: Motion::new(ring, PLANS.take().plans(), backend, config),
            failures: 0,
            late: 0,
        }
    }

    pub(crate) fn fail(&mut self, failed: bool) -> &'static str {
        self.failures += u32::from(failed);
        if failed { "FAIL" } else { "PASS" }
    }

    pub(crate) fn order(&mut self, command: &Command) {
        let Ok(mut reservation) = self.motion.reserve(1) else {
            println!("FAIL the ring is full");
            self.failures += 1;
            return;
        };
        reservation.push(command);
        reservation.commit();
    }

    pub(crate) fn turn(&mut self) {
        while let Some(event) = self.motion.poll(Ticks(now_ticks())) {
            if let MotionEvent::Fault(code) = event {
                println!("FAIL fault {}: {}", code.0, code.as_str());
                self.failures += 1;
                self.late += u32::from(code == FaultCode::REFILL_LATE);
            }
        }
        self.motion.backend_mut().resume();
        WANTED.store(false, Ordering::Release);
    }

    fn run_until(&mut self, at: u64) {
        while now_ticks() < at {
            self.turn();
        }
    }

    pub(crate) fn run_to_rest(&mut self) {
        self.turn();
        while self.motion.is_active() {
            self.turn();
        }
    }

    /// Returns what the ledger of an axis has more than its counter; an axis without one has nothing.
    pub(crate) fn difference(&mut self, axis: AxisId) -> i64 {
        let backend = self.motion.backend();
        let played = backend.played_steps(axis);
        let counted = backend.counted_steps(axis).unwrap_or(played);
        self.motion.backend_mut().resume();
        played - counted
    }

    fn check(&mut self, test: &str, value: i64) {
        let difference = self.difference(X);
        let verdict = self.fail(difference != 0);
        println!("{verdict} {test} {value}: ledger {difference:+} against the counter");
    }

    pub(crate) fn check_rates(&mut self) {
        for delay_us in [1_000, 100, 20, 10, 5, 2] {
            self.order(&steps(delay_us, 20_000));
            self.run_to_rest();
            self.check("rates, us a step:", i64::from(delay_us));
        }
    }

    pub(crate) fn check_turns(&mut self) {
        for turn in 0..2_000 {
            let sign = if turn % 2 == 0 { 1 } else { -1 };
            self.order(&steps(10, sign * (1 + turn % 40)));
            self.turn();
            if turn % 200 == 199 {
                self.run_to_rest();
            }
        }
        self.check("turns:", 2_000);
    }

    pub(crate) fn check_halts(&mut self) {
        let mut histogram = [0_u32; 9];
        for halt in 0..500_u64 {
            self.order(&steps(3 + (halt % 40) as u32, 5_000));
            let begun = now_ticks();
            self.run_until(begun + 40_000 + halt * 613 % 60_000);
            self.motion.stop(StopMode::Halt, Ticks(now_ticks()));
            self.run_to_rest();
            self.motion.begin_queue();
            let difference = self.difference(X);
            let slot = (difference + 4).clamp(0, 8) as usize;
            histogram[slot] += 1;
        }
        let verdict = self.fail(histogram[4] != 500);
        println!("{verdict} halts: ledger minus counter, -4 to +4: {histogram:?}");
        println!("     all in the middle: PREFETCH_WORDS is right; else it is off by the place");
    }
}

/// A raw move of the axis that most tests move.
pub(crate) fn steps(delay_us: u32, steps: i32) -> Command {
    Command::Move {
        axis: X,
        delay_us,
        steps,
    }
}

/// Waits.
pub(crate) fn rest(us: u64) {
    let until = now_ticks() + us * TICKS_PER_US;
    while now_ticks() < until {}
}
