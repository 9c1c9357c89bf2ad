//! On-board tests of the pulse path, for whoever has a board on the desk: `cargo +esp run --release
//! --bin hil`. No wire is needed, no motor must be connected: the step pins are read back by the
//! pulse counters. It has never run; only its types were checked.
//!
//! | test | what it shows |
//! |---|---|
//! | rates | 1 kHz to 500 kHz, ledger and counter agree at the end |
//! | turns | 2,000 changes of direction, none lost |
//! | halts | 500 stops anywhere; their difference is what `board::PREFETCH_WORDS` is off by |
//! | starts | from the order to the first edge, against the lead-in that was asked for |
//! | inputs | every switch input, moved by its own pin: one edge each, in order, at its time |
//! | C | runs of 1 to 70,000 steps end by themselves with exactly as many, counted at the pin |
//! | laser | share of time that its pin is high, at 0 to 100 % |
//! | shift register | 256 words there and back; without one it is said and skipped |
//!
//! The RMT's receivers are not used: with two axes their blocks belong to the transmitters, so what
//! leaves a pin is read back by its counter.
#![no_std]
#![no_main]

#[path = "../board.rs"]
#[expect(dead_code, reason = "the pin table is that of the firmware")]
mod board;
#[cfg(feature = "timers")]
#[path = "../cd.rs"]
mod cd;
#[path = "../heap.rs"]
#[expect(dead_code, reason = "the one small heap will do")]
mod heap;
#[path = "../inputs.rs"]
mod inputs;
#[cfg(feature = "timers")]
#[path = "../pwm.rs"]
mod pwm;
#[path = "../rmt.rs"]
#[cfg_attr(
    feature = "timers",
    expect(dead_code, reason = "C is tried by itself here")
)]
mod rmt;
#[path = "../shift.rs"]
mod shift;

#[cfg(feature = "timers")]
use crate::{cd::Cd, pwm::PwmChip};
use crate::{
    inputs::InputPins,
    rmt::{RmtBackend, WANTED, now_ticks},
    shift::ShiftRegister,
};
use core::sync::atomic::{AtomicU32, Ordering};
#[cfg(feature = "counters")]
use esp_hal::pcnt::Pcnt;
#[cfg(feature = "timers")]
use esp_hal::peripherals::GPIO;
use esp_hal::{clock::CpuClock, gpio::Flex, main, peripherals::IO_MUX, system::software_reset};
use esp_println::println;
use keys::{AxisId, Command, StopMode, command::COMMAND_WORDS};
#[cfg(feature = "timers")]
use motion::CdBackend;
use motion::{
    CommandRing, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend, TICKS_PER_US, Ticks,
};
#[cfg(feature = "timers")]
use periphery::Laser;
use static_cell::ConstStaticCell;

esp_bootloader_esp_idf::esp_app_desc!();

const RING_COMMANDS: usize = 512;
static RING: [AtomicU32; RING_COMMANDS * COMMAND_WORDS] =
    [const { AtomicU32::new(0) }; RING_COMMANDS * COMMAND_WORDS];

const X: AxisId = AxisId(0);

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    println!("PANIC {info}");
    software_reset()
}

struct Bench {
    motion: Motion<'static, RmtBackend>,
    failures: u32,
}

impl Bench {
    fn order(&mut self, command: &Command) {
        let Ok(mut reservation) = self.motion.reserve(1) else {
            println!("FAIL the ring is full");
            self.failures += 1;
            return;
        };
        reservation.push(command);
        reservation.commit();
    }

    fn turn(&mut self) {
        while let Some(event) = self.motion.poll(Ticks(now_ticks())) {
            if let MotionEvent::Fault(code) = event {
                println!("FAIL fault {}: {}", code.0, code.as_str());
                self.failures += 1;
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

    fn run_to_rest(&mut self) {
        self.turn();
        while self.motion.is_active() {
            self.turn();
        }
    }

    /// Returns what the ledger has more than the counter.
    fn difference(&mut self) -> i64 {
        let backend = self.motion.backend();
        let played = backend.played_steps(X);
        let counted = backend.counted_steps(X).unwrap_or(played);
        self.motion.backend_mut().resume();
        played - counted
    }

    fn check(&mut self, test: &str, value: i64) {
        let difference = self.difference();
        let verdict = if difference == 0 { "ok  " } else { "FAIL" };
        self.failures += u32::from(difference != 0);
        println!("{verdict} {test} {value}: ledger {difference:+} against the counter");
    }
}

fn steps(delay_us: u32, steps: i32) -> Command {
    Command::Move {
        axis: X,
        delay_us,
        steps,
    }
}

/// Waits.
fn rest(us: u64) {
    let until = now_ticks() + us * TICKS_PER_US;
    while now_ticks() < until {}
}

/// Every switch input is pressed and released by its own pin. Nothing may be connected that holds it.
fn check_inputs(io_mux: IO_MUX<'static>) -> u32 {
    let numbers = board::INPUT_PINS.map(|(_, number)| number);
    // Before they are inputs: taking a pin resets it.
    let mut pins = numbers.map(|number| Flex::new(board::pin(number)));
    let (mut inputs, levels) = InputPins::new(io_mux, &numbers);
    if levels.count_ones() as usize != numbers.len() {
        println!("note inputs: {levels:#b} at rest, all high expected");
    }
    let mut failures = 0;
    for (index, (number, pin)) in numbers.iter().zip(&mut pins).enumerate() {
        pin.set_high();
        pin.set_output_enable(true);
        for high in [false, true] {
            let at = now_ticks();
            pin.set_level(high.into());
            rest(50);
            let told = inputs.poll(|_| 0);
            let right = told.is_some_and(|told| {
                let late_ticks = told.at.0.wrapping_sub(at);
                told.index == index && told.level == high && late_ticks < 20 * TICKS_PER_US
            });
            if !right || inputs.has_caught() && inputs.poll(|_| 0).is_some() {
                failures += 1;
                println!("FAIL inputs: GPIO {number} to {high}: {told:?}");
            }
        }
        pin.set_output_enable(false);
    }
    println!("inputs: {failures} failures");
    failures
}

/// 256 words through the shift register.
fn check_shift() -> u32 {
    let mut register = ShiftRegister::new();
    if (0..256).all(|word| register.exchange(word) == 0) {
        println!("SKIP shift register: nothing comes back");
        return 0;
    }
    let wrong = (0..256_u32).filter(|word| register.exchange(*word) != *word);
    let failures = wrong.count() as u32;
    register.exchange(0);
    println!("shift register: {failures} of 256 words wrong");
    failures
}

/// C's runs, counted at the pin.
#[cfg(feature = "timers")]
fn check_c(c: &mut Cd) -> u32 {
    let mut failures = 0;
    let mut expected = 0;
    for (steps, interval_ticks) in [(1, 16_000), (-2, 1_600), (1_000, 800), (-70_000, 800)] {
        expected += steps;
        c.run_c(Ticks(now_ticks()), steps, interval_ticks);
        while c.is_c_running() {
            c.service(Ticks(now_ticks()));
        }
        rest(5_000);
        let counted = c.counted_c();
        if counted != expected {
            failures += 1;
            println!("FAIL C: {counted} steps, {expected} expected");
            expected = counted;
        }
    }
    println!("C: {failures} failures");
    failures
}

/// The laser's share of time. Nothing that burns may be connected.
#[cfg(feature = "timers")]
fn check_laser(mut pwm: PwmChip) -> u32 {
    let pin = board::LASER_PIN;
    IO_MUX::regs()
        .gpio(usize::from(pin))
        .modify(|_, w| w.fun_ie().set_bit());
    PwmChip::take(0);
    let mut laser = Laser::new(&mut pwm, 0, 0);
    let mut failures = 0;
    for percent in [0, 1, 25, 50, 99, 100, 0] {
        laser.set(&mut pwm, percent);
        rest(1_000);
        let (mut high, mut all) = (0_u32, 0_u32);
        let until = now_ticks() + 20_000 * TICKS_PER_US;
        while now_ticks() < until {
            high += GPIO::regs().in_().read().bits() >> pin & 1;
            all += 1;
        }
        let found = high * 100 / all;
        if found.abs_diff(u32::from(percent)) > 1 {
            failures += 1;
            println!("FAIL laser: {found} % of the time, {percent} expected");
        }
    }
    println!("laser: {failures} failures");
    failures
}

#[main]
fn main() -> ! {
    let parts = esp_hal::init(esp_hal::Config::default().with_cpu_clock(CpuClock::max()));
    // A dependency may ask for a heap; nothing here does.
    esp_alloc::heap_allocator!(size: 1024);
    #[cfg(feature = "counters")]
    #[cfg_attr(
        not(feature = "timers"),
        expect(unused_mut, reason = "C is what changes it")
    )]
    let mut counters = Pcnt::new(parts.PCNT);
    let backend = RmtBackend::new(
        parts.RMT,
        #[cfg(feature = "counters")]
        &counters,
    );
    static PLANS: ConstStaticCell<PlanMemory> = ConstStaticCell::new(PlanMemory::new());
    let motion = Motion::new(
        CommandRing::new(&RING),
        PLANS.take().plans(),
        backend,
        MotionConfig::default(),
    );
    let mut bench = Bench {
        motion,
        failures: 0,
    };
    for delay_us in [1_000, 100, 20, 10, 5, 2] {
        bench.order(&steps(delay_us, 20_000));
        bench.run_to_rest();
        bench.check("rates, us a step:", i64::from(delay_us));
    }
    for turn in 0..2_000 {
        let sign = if turn % 2 == 0 { 1 } else { -1 };
        bench.order(&steps(10, sign * (1 + turn % 40)));
        bench.turn();
        if turn % 200 == 199 {
            bench.run_to_rest();
        }
    }
    bench.check("turns:", 2_000);
    let mut histogram = [0_u32; 9];
    for halt in 0..500_u64 {
        bench.order(&steps(3 + (halt % 40) as u32, 5_000));
        let begun = now_ticks();
        bench.run_until(begun + 40_000 + halt * 613 % 60_000);
        bench.motion.stop(StopMode::Halt, Ticks(now_ticks()));
        bench.run_to_rest();
        bench.motion.begin_queue();
        let difference = bench.difference();
        let slot = (difference + 4).clamp(0, 8) as usize;
        histogram[slot] += 1;
    }
    println!("halts: ledger minus counter, -4 to +4: {histogram:?}");
    println!("       all in the middle: PREFETCH_WORDS is right; else it is off by the place");
    bench.failures += u32::from(histogram[4] != 500);
    #[cfg(feature = "timers")]
    {
        let pwm = PwmChip::new(parts.LEDC);
        bench.failures += check_c(&mut Cd::new(parts.MCPWM0, &mut counters));
        bench.failures += check_laser(pwm);
    }
    bench.failures += check_inputs(parts.IO_MUX);
    bench.failures += check_shift();
    println!("{} failures", bench.failures);
    loop {}
}
