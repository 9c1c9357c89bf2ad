//! On-board tests of the pulse path and of what surrounds it, for whoever has a board on the desk:
//! `cargo +esp run --release --bin hil`. No wire is needed, nothing must be connected: what leaves a pin is
//! read back at the pin. It has never run; its types were checked, and it links for the relatives.
//!
//! Each test says PASS or FAIL with its figures. It restarts three times, on purpose; the last line counts
//! the failures.
//!
//! | test | what it shows |
//! |---|---|
//! | loopback | an RMT receiver measures what a transmitter sends: each interval, to the tick |
//! | rates | 1 kHz to 500 kHz, ledger and counter agree at the end |
//! | turns | 2,000 changes of direction, none lost |
//! | halts | 500 stops anywhere; their difference is what `board::PREFETCH_WORDS` is off by |
//! | load | four axes at 200 kHz for 10 s, by core 1, while core 0 scans for networks: late refills, counts |
//! | flash | a write of flash between moves: how long core 1 stands still, and that no count is touched |
//! | PSRAM | the command ring's memory, written and read again and again during a scan |
//! | inputs | every switch input, moved by its own pin: one edge each, in order, at its time |
//! | C | runs of 1 to 70,000 steps end by themselves with exactly as many, counted at the pin |
//! | laser | share of time that its pin is high, at 0 to 100 % |
//! | shift register | 256 words there and back; without one it is said and skipped |
//! | panic | its reason is there after the reset, in RTC RAM |
//! | watchdogs | both bite, and the next boot knows which |
//!
//! With four axes each transmitter has its own block, so the receivers' are free for the loopback. The ESP32-C6
//! has two transmitters, of which one borrows the receivers' blocks: no loopback there, and with one core no load.
#![no_std]
#![no_main]

extern crate alloc;

#[path = "hil/beside.rs"]
mod beside;
#[path = "../board.rs"]
#[expect(dead_code, reason = "the table is that of the firmware")]
mod board;
#[cfg(feature = "timers")]
#[path = "../cd.rs"]
mod cd;
#[path = "../heap.rs"]
#[expect(dead_code, reason = "nothing large is asked for")]
mod heap;
#[path = "../inputs.rs"]
mod inputs;
#[path = "hil/load.rs"]
mod load;
#[cfg(not(feature = "esp32c6"))]
#[path = "hil/loopback.rs"]
mod loopback;
#[path = "../panic.rs"]
#[expect(dead_code, reason = "nobody keeps events")]
mod panic;
#[path = "hil/pulses.rs"]
mod pulses;
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
#[path = "hil/stages.rs"]
mod stages;
#[path = "../watchdog.rs"]
#[expect(dead_code, reason = "no task feeds anything here")]
mod watchdog;

use crate::{pulses::Bench, rmt::RmtBackend};
use embassy_executor::Spawner;
#[cfg(feature = "counters")]
use esp_hal::pcnt::Pcnt;
use esp_hal::{clock::CpuClock, timer::timg::TimerGroup};
use esp_storage::FlashStorage;
use esp_wifi::wifi::{ControllerConfig, WifiController};
use provision::{Machine, Wiring, machine::SwitchSettings, wiring::KIT_SWITCHES};

esp_bootloader_esp_idf::esp_app_desc!();

/// As the firmware's: what the boot loader leaves behind.
const HEAP_BYTES: usize = 72 * 1024;

/// Stack of the second core.
#[cfg(feature = "dual")]
const STACK_BYTES: usize = 64 * 1024;

/// As many axes as the chip drives; then each transmitter has its own block.
fn wire() {
    let wiring = Wiring {
        axis_count: board::AXES_MAX as u8,
        ..Wiring::default()
    };
    let machine = Machine {
        has_cd: true,
        ..Machine::default()
    };
    board::wire(&wiring, &machine);
}

/// The pins of the kit's switches, but for those that an axis has here.
fn input_pins() -> heapless::Vec<u8, { KIT_SWITCHES.len() }> {
    let pins = KIT_SWITCHES.iter().filter_map(|(of, end)| {
        let switch = SwitchSettings {
            of: *of,
            end: *end,
            normally_closed: true,
            homes: false,
        };
        provision::wiring::kit_pin(provision::PinUse::of_switch(&switch))
    });
    let is_free = |pin: &u8| board::driven_pins().all(|driven| driven != *pin);
    pins.filter(is_free).collect()
}

#[esp_rtos::main]
async fn main(_spawner: Spawner) -> ! {
    let config = esp_hal::Config::default().with_cpu_clock(CpuClock::max());
    let parts = esp_hal::init(config);
    #[cfg(feature = "esp32s3")]
    esp_alloc::heap_allocator!(#[esp_hal::ram(reclaimed)] size: HEAP_BYTES);
    #[cfg(not(feature = "esp32s3"))]
    esp_alloc::heap_allocator!(size: HEAP_BYTES);
    let timers = TimerGroup::new(parts.TIMG0);
    esp_rtos::start(timers.timer0, parts.FROM_CPU_INTR0);
    if !stages::begins(panic::take_report()) {
        stages::go_on(parts.RTC_TIMER, parts.TIMG1);
    }
    wire();
    let wifi = WifiController::new(parts.WIFI, ControllerConfig::default());
    #[cfg(feature = "psram")]
    let psram = parts.PSRAM;
    let (rmt_parts, mux_parts) = (parts.RMT, parts.IO_MUX);
    #[cfg(feature = "counters")]
    let counter_parts = parts.PCNT;
    #[cfg(feature = "timers")]
    let (timer_parts, pwm_parts) = (parts.MCPWM0, parts.LEDC);
    let tests = move || {
        #[cfg(feature = "counters")]
        #[cfg_attr(
            not(feature = "timers"),
            expect(unused_mut, reason = "C is what changes it")
        )]
        let mut counters = Pcnt::new(counter_parts);
        let backend = RmtBackend::new(
            rmt_parts,
            #[cfg(feature = "counters")]
            &counters,
        );
        let mut bench = Bench::new(backend);
        #[cfg(not(feature = "esp32c6"))]
        loopback::check(&mut bench);
        bench.check_rates();
        bench.check_turns();
        bench.check_halts();
        load::check(&mut bench);
        #[cfg(feature = "psram")]
        load::check_psram(&mut bench, psram);
        #[cfg(feature = "timers")]
        {
            let pwm = pwm::PwmChip::new(pwm_parts);
            let mut c = cd::Cd::new(timer_parts, &mut counters);
            bench.failures += beside::check_c(&mut c);
            bench.failures += beside::check_laser(pwm);
        }
        bench.failures += beside::check_inputs(mux_parts, &input_pins());
        bench.failures += beside::check_shift();
        load::end();
        stages::tests_done(bench.failures);
    };
    #[cfg(feature = "dual")]
    {
        use esp_hal::system::{CpuControl, Stack};
        static STACK: static_cell::StaticCell<Stack<STACK_BYTES>> = static_cell::StaticCell::new();
        let core = CpuControl::new(parts.CPU_CTRL).start_app_core(STACK.init(Stack::new()), tests);
        core::mem::forget(core.expect("it does not run yet"));
        let storage = FlashStorage::new(parts.FLASH).multicore_auto_park();
        load::serve(wifi.ok(), storage).await;
    }
    #[cfg(not(feature = "dual"))]
    {
        // One core: nobody scans while it tests.
        core::mem::forget((wifi, FlashStorage::new(parts.FLASH)));
        tests();
    }
    loop {
        embassy_time::Timer::after_secs(1).await;
    }
}
