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
#![no_std]
#![no_main]

#[path = "../board.rs"]
#[expect(dead_code, reason = "the pin table is that of the firmware")]
mod board;
#[path = "../rmt.rs"]
mod rmt;

use crate::rmt::{RmtBackend, WANTED, now_ticks};
use core::sync::atomic::{AtomicU32, Ordering};
use esp_hal::{clock::CpuClock, main, system::software_reset};
use esp_println::println;
use keys::{AxisId, Command, StopMode, command::COMMAND_WORDS};
use motion::{CommandRing, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend, Ticks};
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

#[main]
fn main() -> ! {
    let parts = esp_hal::init(esp_hal::Config::default().with_cpu_clock(CpuClock::max()));
    // A dependency may ask for a heap; nothing here does.
    esp_alloc::heap_allocator!(size: 1024);
    let backend = RmtBackend::new(
        parts.RMT,
        #[cfg(feature = "counters")]
        parts.PCNT,
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
    println!("{} failures", bench.failures);
    loop {}
}
