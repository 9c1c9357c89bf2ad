//! C and D: axes beside the queue, stepped by timers.
//!
//! ```text
//!   run_c ─▶ MCPWM timer ─▶ gate ─▶ step C ─▶ PCNT ──at the last step──▶ interrupt ─▶ timer ends
//!   run_d ─▶ LEDC timer ──▶ step D                                 (D is not counted)
//! ```
//!
//! C's pulses are low first: the rising edge, which steps and is counted, is in the middle of a
//! cycle, the falling one at its end, where a timer that was told to ends. So the interrupt that
//! the last step raises has half a cycle to end the timer behind that very pulse. [`C_CYCLE_TICKS_MIN`]
//! makes that half longer than a refill that it may have to wait for. If it came too late all the
//! same, the steps too many would be counted like any: the position stays exact, and motion sees that
//! C is not where it was sent.
//!
//! A halt closes the gate (the pin belongs to the GPIO again, which is low) before anything else, so
//! no edge leaves after it; a pulse that is high then ends.
//!
//! Two contexts use [`Timers`], never at once: the interrupt ([`Timers::on_interrupt`]) and the
//! planning task, which masks interrupts for the length of a call.
//!
//! Absent: the direction pins. Both axes turn by the shift register ([`crate::shift`]), which motion
//! waits for, so their direction has been confirmed before they are told to run.

use crate::pwm::{PwmRegisters, PwmTimer};
use motion::{CdBackend, Direction, Ticks, limits::TICK_HZ};

/// Shortest cycle of C: 50 µs, 20 kHz. What is faster is made this fast: half of it is longer than a
/// refill and the way into the interrupt.
pub const C_CYCLE_TICKS_MIN: u64 = TICK_HZ / 20_000;

/// Longest cycle of C: its timer's 16 bits by its prescaler's 8, in ticks: 1.05 s.
pub const C_CYCLE_TICKS_MAX: u64 = 256 * 65_536;

/// Slowest that D steps, Hz: what is slower is made as slow as its timer can, see
/// [`PwmTimer::CYCLE_TICKS_MAX`].
pub const D_HZ_MIN: u64 = 5;

/// How C's timer is set. Its clock is divided to 16 MHz, so that it counts ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepTimer {
    /// TIMER_PRESCALE + 1: ticks of one count, 1 to 256.
    pub prescale: u16,
    /// TIMER_PERIOD + 1: counts of one cycle, 2 to 65,536.
    pub period: u32,
}

impl StepTimer {
    /// Sets one cycle to so many ticks, off by at most half a count.
    pub const fn of_cycle(cycle_ticks: u64) -> Self {
        let cycle_ticks = if cycle_ticks < C_CYCLE_TICKS_MIN {
            C_CYCLE_TICKS_MIN
        } else if cycle_ticks > C_CYCLE_TICKS_MAX {
            C_CYCLE_TICKS_MAX
        } else {
            cycle_ticks
        };
        let prescale = cycle_ticks.div_ceil(65_536);
        let period = (cycle_ticks + prescale / 2) / prescale;
        Self {
            prescale: prescale as u16,
            period: if period > 65_536 {
                65_536
            } else {
                period as u32
            },
        }
    }

    /// Returns the count at which the pin rises.
    pub const fn rise(self) -> u16 {
        (self.period / 2) as u16
    }
}

/// The registers of C's timer, gate and counter, beside those of D's LEDC channel.
pub trait CdRegisters: PwmRegisters {
    /// Stops the timer where it is, sets its counter to 0, prescaler, period and the compare value of
    /// the rising edge. Low from count 0 on, high from the compare value on.
    fn set_step_timer(&mut self, setting: StepTimer);

    /// Writes TIMER_START: it runs.
    fn run_step_timer(&mut self);

    /// Writes TIMER_START: it ends when it comes to 0.
    fn end_step_timer(&mut self);

    /// Writes FUNC_OUT_SEL of the step pin: the timer's (open), or the GPIO's, which is low.
    fn set_gate(&mut self, open: bool);

    /// Returns the level of the step pin.
    fn step_pin_c(&self) -> bool;

    /// Sets the counter to 0 and THRES0 to `steps`: an event when it comes there. After the write,
    /// as a threshold counts only from a reset of the counter on.
    fn reset_counter(&mut self, steps: u16);

    /// Reads the counter: rising edges since its reset, modulo 2¹⁶.
    fn count_c(&self) -> u16;

    /// Writes INT_CLR: events of the counter until now are answered.
    fn acknowledge_count(&mut self);

    /// Lets the counter's event interrupt, or not.
    fn listen_count(&mut self, on: bool);
}

/// LEDC timer and channel of D; the laser has 0.
const D_TIMER: usize = 1;
/// See above.
const D_CHANNEL: usize = 1;

/// C's run.
#[derive(Clone, Copy, Debug)]
struct Run {
    positive: bool,
    /// Steps ordered, at least 1.
    steps: u64,
    /// Steps counted, up to the last look.
    made: u64,
    /// The counter at the last look.
    seen: u16,
    /// The timer was told to end.
    ended: bool,
}

impl Run {
    fn made_now(&self, count: u16) -> u64 {
        // A look at least every 65,535 steps: every turn of the task is one.
        self.made + u64::from(count.wrapping_sub(self.seen))
    }

    fn look(&mut self, count: u16) {
        self.made = self.made_now(count);
        self.seen = count;
    }

    fn signed(&self, made: u64) -> i64 {
        let made = i64::try_from(made).expect("2⁶³ steps last millions of years");
        if self.positive { made } else { -made }
    }
}

/// See the module.
#[derive(Debug)]
pub struct Timers<R> {
    registers: R,
    run: Option<Run>,
    /// Steps of all runs before, with sign.
    settled_steps: i64,
}

impl<R: CdRegisters> Timers<R> {
    /// Hardware that nobody has touched: [`Timers::begin`] comes next.
    pub const fn new(registers: R) -> Self {
        Self {
            registers,
            run: None,
            settled_steps: 0,
        }
    }

    /// Sets the hardware, at rest: both pins low.
    pub fn begin(&mut self) {
        self.registers.set_gate(false);
        self.registers.output(D_CHANNEL, false);
        self.registers.listen_count(false);
    }

    /// The interrupt of C's counter: the last step has begun. An event that is none is nothing.
    pub fn on_interrupt(&mut self) {
        self.registers.acknowledge_count();
        self.look();
    }

    /// Counts, and ends the timer behind the last step.
    fn look(&mut self) {
        let Some(run) = self.run.as_mut() else {
            return;
        };
        run.look(self.registers.count_c());
        if run.made >= run.steps && !run.ended {
            run.ended = true;
            self.registers.end_step_timer();
        }
    }

    /// The end of a run, or of what was left of it.
    fn settle(&mut self) {
        self.registers.set_gate(false);
        self.registers.listen_count(false);
        if let Some(mut run) = self.run.take() {
            run.look(self.registers.count_c());
            self.settled_steps += run.signed(run.made);
        }
    }

    /// Returns the hardware.
    pub fn registers(&self) -> &R {
        &self.registers
    }

    /// Returns the hardware, for what belongs to it beside C and D.
    pub fn registers_mut(&mut self) -> &mut R {
        &mut self.registers
    }
}

impl<R: CdRegisters> CdBackend for Timers<R> {
    fn run_c(&mut self, _now: Ticks, steps: i64, interval_ticks: u64) {
        self.settle();
        if steps == 0 {
            return;
        }
        let count = steps.unsigned_abs();
        self.registers
            .set_step_timer(StepTimer::of_cycle(interval_ticks));
        // The threshold of a longer run comes around more than once: only the count decides.
        self.registers.reset_counter(count as u16);
        self.registers.acknowledge_count();
        self.run = Some(Run {
            positive: steps > 0,
            steps: count,
            made: 0,
            seen: 0,
            ended: false,
        });
        self.registers.listen_count(true);
        self.registers.set_gate(true);
        self.registers.run_step_timer();
    }

    fn halt_c(&mut self, _now: Ticks) {
        self.settle();
        self.registers.end_step_timer();
    }

    fn is_c_running(&self) -> bool {
        self.run.is_some()
    }

    fn counted_c(&self) -> i64 {
        let run = self.run.as_ref();
        let made = run.map_or(0, |run| run.signed(run.made_now(self.registers.count_c())));
        self.settled_steps + made
    }

    fn run_d(&mut self, _now: Ticks, _way: Direction, interval_ticks: u64) {
        self.registers.output(D_CHANNEL, false);
        let setting = PwmTimer::of_cycle(interval_ticks);
        // Low first, as with C.
        self.registers
            .set_duty(D_CHANNEL, setting.half(), setting.half());
        self.registers.set_timer(D_TIMER, setting);
        self.registers.output(D_CHANNEL, true);
    }

    fn halt_d(&mut self, _now: Ticks) {
        self.registers.output(D_CHANNEL, false);
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        self.look();
        let over = self.run.is_some_and(|run| run.ended);
        if over && !self.registers.step_pin_c() {
            self.settle();
        }
        until
    }
}
