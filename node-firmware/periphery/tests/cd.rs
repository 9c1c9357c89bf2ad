//! C, D and the laser on a model of MCPWM timer, pulse counter and LEDC.
//!
//! The model is written from the chapters of the technical reference manual (ESP32-S3: 36 MCPWM, 38
//! PCNT, 35 LEDC), not from the driver: a timer that counts up, actions at compare value and zero, an
//! end at zero; a counter of 16 bits with a threshold that counts from a reset on; duties that count
//! from an overflow on.

use motion::{CdBackend, Direction, Ticks};
use periphery::{
    CdRegisters, Laser, PwmRegisters, PwmTimer, Timers,
    cd::{C_CYCLE_TICKS_MAX, C_CYCLE_TICKS_MIN, StepTimer},
    pwm::LASER_CYCLE_TICKS,
};

/// One LEDC channel on the timer of its own number.
#[derive(Clone, Copy, Debug)]
struct Channel {
    timer: PwmTimer,
    /// Written, and counting from the next overflow on.
    next: (u32, u32),
    duty: (u32, u32),
    on: bool,
    /// When its timer was 0 last, 256ths of a cycle of 80 MHz.
    began_at: u64,
}

/// The chip. Times in ticks of 62.5 ns.
#[derive(Clone, Debug)]
struct Chip {
    now: u64,
    setting: StepTimer,
    runs: bool,
    ends: bool,
    /// Ticks since the timer was 0.
    phase: u64,
    output: bool,
    gate: bool,
    pin: bool,
    edges: Vec<(u64, bool)>,
    count: u16,
    threshold: Option<u16>,
    event: bool,
    listens: bool,
    channels: [Channel; 2],
}

impl Chip {
    fn new() -> Self {
        let channel = Channel {
            timer: PwmTimer::of_cycle(u64::MAX),
            next: (0, 0),
            duty: (0, 5_000),
            on: true,
            began_at: 0,
        };
        Self {
            now: 0,
            setting: StepTimer::of_cycle(0),
            runs: false,
            ends: false,
            phase: 0,
            output: false,
            gate: true,
            pin: false,
            edges: Vec::new(),
            count: 77,
            threshold: None,
            event: true,
            listens: true,
            channels: [channel; 2],
        }
    }

    fn show(&mut self) {
        let level = self.gate && self.output;
        if level == self.pin {
            return;
        }
        self.pin = level;
        self.edges.push((self.now, level));
        if level {
            self.count = self.count.wrapping_add(1);
            self.event |= self.threshold == Some(self.count);
        }
    }

    fn advance(&mut self, until: u64) {
        let prescale = u64::from(self.setting.prescale);
        let rise = u64::from(self.setting.rise()) * prescale;
        let cycle = u64::from(self.setting.period) * prescale;
        while self.runs {
            let next = if self.phase < rise { rise } else { cycle };
            let at = self.now + next - self.phase;
            if at > until {
                break;
            }
            self.now = at;
            if next == rise {
                self.phase = rise;
                self.output = true;
            } else {
                self.phase = 0;
                self.output = false;
                self.runs = !self.ends;
            }
            self.show();
        }
        if self.runs {
            self.phase += until - self.now;
        }
        self.now = until;
    }

    /// Lets a channel's duty count, if its timer has come around.
    fn overflow(&mut self, channel: usize) {
        let now = self.now * 5 * 256;
        let of = &mut self.channels[channel];
        let cycle = of.timer.cycle_clocks_256();
        let cycles = (now - of.began_at) / cycle;
        if cycles > 0 {
            of.began_at += cycles * cycle;
            of.duty = of.next;
        }
    }

    /// Returns the share of a cycle that a channel is high now, in 1,000ths.
    fn power(&mut self, channel: usize) -> u32 {
        self.overflow(channel);
        let of = self.channels[channel];
        if of.on {
            of.duty.1 * 1_000 / (2 * of.timer.half())
        } else {
            0
        }
    }
}

impl PwmRegisters for Chip {
    fn set_timer(&mut self, timer: usize, setting: PwmTimer) {
        self.overflow(timer);
        self.channels[timer].timer = setting;
        self.channels[timer].began_at = self.now * 5 * 256;
    }

    fn set_duty(&mut self, channel: usize, from: u32, counts: u32) {
        self.overflow(channel);
        self.channels[channel].next = (from, counts);
    }

    fn output(&mut self, channel: usize, on: bool) {
        self.overflow(channel);
        self.channels[channel].on = on;
    }
}

impl CdRegisters for Chip {
    fn set_step_timer(&mut self, setting: StepTimer) {
        assert!((1..=256).contains(&setting.prescale));
        assert!((2..=65_536).contains(&setting.period));
        self.setting = setting;
        self.runs = false;
        self.phase = 0;
        self.output = false;
        self.show();
    }

    fn run_step_timer(&mut self) {
        self.runs = true;
        self.ends = false;
    }

    fn end_step_timer(&mut self) {
        self.ends = true;
    }

    fn set_gate(&mut self, open: bool) {
        self.gate = open;
        self.show();
    }

    fn step_pin_c(&self) -> bool {
        self.pin
    }

    fn reset_counter(&mut self, steps: u16) {
        self.count = 0;
        self.threshold = Some(steps);
    }

    fn count_c(&self) -> u16 {
        self.count
    }

    fn acknowledge_count(&mut self) {
        self.event = false;
    }

    fn listen_count(&mut self, on: bool) {
        self.listens = on;
    }
}

struct Bench {
    timers: Timers<Chip>,
    /// From an event to its interrupt, ticks.
    latency: u64,
}

impl Bench {
    fn new(latency: u64) -> Self {
        let mut timers = Timers::new(Chip::new());
        timers.begin();
        timers.registers_mut().edges.clear();
        Self { timers, latency }
    }

    fn now(&self) -> u64 {
        self.timers.registers().now
    }

    /// Lets time pass, with the interrupt as late as it is, and a turn of the task each millisecond.
    fn play(&mut self, ticks: u64) {
        let until = self.now() + ticks;
        let mut turn_at = self.now() + 16_000;
        while self.now() < until {
            let slice = (self.now() + 100).min(until).min(turn_at);
            self.timers.registers_mut().advance(slice);
            let chip = self.timers.registers();
            if chip.event && chip.listens {
                let at = self.now() + self.latency;
                self.timers.registers_mut().advance(at);
                self.timers.on_interrupt();
            }
            if self.now() >= turn_at {
                turn_at = self.now() + 16_000;
                let now = self.now();
                self.timers.service(Ticks(now));
            }
        }
    }

    fn run(&mut self, steps: i64, interval: u64) {
        let now = Ticks(self.now());
        self.timers.run_c(now, steps, interval);
    }

    fn rising(&self) -> Vec<u64> {
        let edges = self.timers.registers().edges.iter();
        edges.filter(|edge| edge.1).map(|edge| edge.0).collect()
    }
}

#[test]
fn c_makes_exactly_its_steps_at_its_rate_and_ends_by_itself() {
    // Up to 20 µs into the interrupt: what a refill of four axes takes.
    for latency in [0, 50, 320] {
        for (steps, interval) in [(1, 800), (-2, 8_000), (33, 801), (-700, 10_007)] {
            let mut bench = Bench::new(latency);
            let begun = bench.now();
            bench.run(steps, interval);
            assert!(bench.timers.is_c_running());
            let count = steps.unsigned_abs();
            bench.play(interval * (count + 1) + 32_000);
            assert!(!bench.timers.is_c_running());
            assert_eq!(bench.timers.counted_c(), steps);
            let edges = bench.rising();
            assert_eq!(edges.len() as u64, count, "latency {latency}");
            assert!(
                edges[0] >= begun + interval / 2 - 1,
                "the direction settles"
            );
            assert!(edges.windows(2).all(|pair| pair[1] - pair[0] == interval));
            bench.play(100 * interval);
            assert_eq!(bench.rising().len() as u64, count, "silent behind it");
        }
    }
}

#[test]
fn a_run_longer_than_the_counter_is_whole() {
    for steps in [-65_535, 65_536, 65_537, 131_072] {
        let mut bench = Bench::new(100);
        bench.run(steps, 0);
        let ticks = C_CYCLE_TICKS_MIN * (steps.unsigned_abs() + 100);
        bench.play(ticks);
        assert!(!bench.timers.is_c_running());
        assert_eq!(bench.timers.counted_c(), steps);
        assert_eq!(bench.rising().len() as u64, steps.unsigned_abs());
    }
}

#[test]
fn a_halt_anywhere_lets_no_edge_out_and_keeps_every_step() {
    let mut bench = Bench::new(50);
    let mut expected = 0;
    for number in 0..400_u64 {
        let way = if number % 3 == 0 { -1 } else { 1 };
        let before = bench.rising().len();
        bench.run(way * 40, 900 + number);
        bench.play(number * 97 % 20_000);
        let now = Ticks(bench.now());
        bench.timers.halt_c(now);
        let made = (bench.rising().len() - before) as i64;
        expected += way * made;
        assert_eq!(bench.timers.counted_c(), expected, "halt {number}");
        assert!(!bench.timers.is_c_running());
        assert!(!bench.timers.registers().pin, "the pin is low");
        bench.play(number % 5 * 700);
        assert_eq!(
            bench.rising().len() - before,
            made as usize,
            "halt {number}"
        );
    }
    assert!(expected > 1_000, "it moved: {expected}");
}

#[test]
fn an_interrupt_that_is_too_late_costs_steps_but_never_the_count() {
    let mut bench = Bench::new(5_000);
    bench.run(100, 800);
    bench.play(800 * 200);
    let made = bench.rising().len() as i64;
    assert!(made > 100, "it was too late");
    assert_eq!(bench.timers.counted_c(), made);
    assert!(!bench.timers.is_c_running());
}

#[test]
fn the_timer_of_c_is_as_slow_as_it_was_asked_for() {
    for cycle in [800, 801, 65_536, 65_537, 99_999, 1_600_000, 16_000_000] {
        let timer = StepTimer::of_cycle(cycle);
        let ticks = u64::from(timer.prescale) * u64::from(timer.period);
        assert!(ticks.abs_diff(cycle) <= u64::from(timer.prescale) / 2);
    }
    let slowest = StepTimer::of_cycle(u64::MAX);
    let ticks = u64::from(slowest.prescale) * u64::from(slowest.period);
    assert_eq!(ticks, C_CYCLE_TICKS_MAX);
}

#[test]
fn d_steps_at_its_rate_until_it_is_halted() {
    let mut bench = Bench::new(0);
    assert_eq!(bench.timers.registers_mut().power(1), 0, "off from boot on");
    bench.timers.run_d(Ticks(0), Direction::Positive, 8_000);
    bench.play(8_000);
    let chip = bench.timers.registers_mut();
    assert_eq!(chip.power(1), 500, "half a cycle is high");
    let timer = chip.channels[1].timer;
    assert_eq!(timer.cycle_clocks_256(), 8_000 * 5 * 256);
    assert_eq!(chip.channels[1].duty.0, timer.half(), "low first");
    bench.timers.halt_d(Ticks(8_000));
    assert_eq!(bench.timers.registers_mut().power(1), 0);
}

#[test]
fn the_laser_is_off_until_told_off_at_once_and_never_above_what_was_asked() {
    let mut chip = Chip::new();
    let mut laser = Laser::new(&mut chip, 0, 0);
    assert_eq!(chip.power(0), 0);
    let cycle = LASER_CYCLE_TICKS;
    // What was there before the boot is gone after a cycle.
    chip.advance(cycle);
    for (before, percent) in [(0, 30), (30, 100), (100, 1), (1, 255)] {
        laser.set(&mut chip, percent);
        let most = u32::from(percent.min(100).max(before)) * 10;
        assert!(chip.power(0) <= most);
        chip.advance(chip.now + cycle);
        let wanted = u32::from(percent.min(100)) * 10;
        assert!(chip.power(0).abs_diff(wanted) <= 1, "{percent} %");
    }
    laser.set(&mut chip, 0);
    assert_eq!((chip.power(0), laser.percent()), (0, 0));
    chip.advance(chip.now + 10 * cycle);
    assert_eq!(chip.power(0), 0);
    laser.set(&mut chip, 40);
    assert_eq!(chip.power(0), 0, "nothing of the power before");
}
