//! What is left of a boot for the next one: three resets on purpose, each judged by the boot behind it.

use crate::watchdog::{PlanningWatchdog, watch_boot};
use core::ptr::{addr_of, addr_of_mut};
use esp_hal::{
    peripherals::{RTC_TIMER, TIMG1},
    ram,
};
use esp_println::println;
use periphery::blackbox::{Report, Reset};

/// Says that the words behind it are ours.
const MAGIC: u32 = 0x6869_6c31;

/// What is panicked with.
const MARKER: &str = "hil: on purpose";

/// The tests have run, and it has panicked.
const PANICKED: u32 = 1;
/// Nobody feeds the watchdog of the planning core.
const PLANNING: u32 = 2;
/// Nobody feeds the other one.
const NETWORK: u32 = 3;
/// All is done.
const DONE: u32 = 4;

/// Magic, stage, failures.
#[ram(unstable(rtc_fast, persistent))]
static mut KEPT: [u32; 3] = [0; 3];

fn kept() -> [u32; 3] {
    // SAFETY: a volatile read; any bits are numbers, and one core at a time is here.
    unsafe { addr_of!(KEPT).read_volatile() }
}

fn keep(stage: u32, failures: u32) {
    // SAFETY: a volatile write; one core at a time is here.
    unsafe { addr_of_mut!(KEPT).write_volatile([MAGIC, stage, failures]) };
}

/// Looks what the boot before has left, and judges it. Returns whether the tests begin.
pub(crate) fn begins(report: Option<Report>) -> bool {
    let [magic, stage, failures] = kept();
    let wanted = match (magic, stage) {
        (MAGIC, PANICKED) => "panic",
        (MAGIC, PLANNING) => "watchdog of the planning core",
        (MAGIC, NETWORK) => "watchdog of the network core",
        _ => return true,
    };
    let found = report.as_ref().is_some_and(|report| match stage {
        PANICKED => {
            let reason = report.panic.as_ref();
            reason.is_some_and(|reason| reason.ends_with(MARKER)) && !report.frames.is_empty()
        }
        PLANNING => report.reset == Reset::PlanningWatchdog,
        _ => report.reset == Reset::NetworkWatchdog,
    });
    let verdict = if found { "PASS" } else { "FAIL" };
    println!("{verdict} {wanted}: {report:?}");
    keep(stage + 1, failures + u32::from(!found));
    false
}

/// Ends the tests with a panic.
pub(crate) fn tests_done(failures: u32) -> ! {
    keep(PANICKED, failures);
    panic!("{MARKER}");
}

/// Does what the next reset comes from, or ends.
pub(crate) fn go_on(rtc: RTC_TIMER<'static>, timers: TIMG1<'static>) -> ! {
    let [_, stage, failures] = kept();
    match stage {
        PLANNING => core::mem::forget(PlanningWatchdog::begin(timers)),
        NETWORK => watch_boot(rtc),
        _ => {
            keep(DONE, failures);
            println!("{failures} failures");
        }
    }
    loop {
        core::hint::spin_loop();
    }
}
