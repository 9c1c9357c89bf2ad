//! Two hardware watchdogs: one for each core, and one of them for the boot.
//!
//! | watchdog | runs from | fed by | limit |
//! |---|---|---|---|
//! | of the RTC | the first line of `main` | the boot does not feed it; then a task of core 0 | [`BOOT_MS`], then [`NETWORK_MS`] |
//! | of timer group 1 | the planning task's begin | the planning task, each turn | [`PLANNING_MS`] |
//!
//! Core 1 feeds its own, so that it does not matter to it what keeps core 0 busy. While flash is written
//! core 1 stands still and core 0 waits: then whoever writes feeds both, after each step of bounded
//! length. Either ends in a reset, at which all pins float and the drivers' own pull-downs switch them off.

use core::sync::atomic::{AtomicBool, Ordering};
use embassy_time::{Duration, Timer};
use esp_hal::{
    peripherals::{RTC_TIMER, TIMG1},
    rtc_cntl::{Rtc, RwdtStage},
    timer::timg::{MwdtStage, TimerGroup, Wdt},
};

/// Longest time from reset to the first wait of core 0: the boot loader's own limit. Reading a full
/// store of scripts takes the longest of it, some hundred ms.
const BOOT_MS: u64 = 9_000;

/// Longest time without a turn of core 0's tasks: the longest calls are a handshake of TLS and the
/// compilation of a long script. Motion does not depend on this core; see what a node does when the link
/// is lost.
const NETWORK_MS: u64 = 4_000;

/// Longest time without a turn of the planning task.
const PLANNING_MS: u64 = 1_000;

/// Watches the boot. Call it first of all.
pub(crate) fn watch_boot(rtc: RTC_TIMER<'_>) {
    let mut watchdog = Rtc::new(rtc).rwdt;
    watchdog.set_timeout(
        RwdtStage::Stage0,
        esp_hal::time::Duration::from_millis(BOOT_MS),
    );
    watchdog.enable();
}

/// Watches core 0 for ever.
#[embassy_executor::task]
pub(crate) async fn watch(rtc: RTC_TIMER<'static>) {
    let mut watchdog = Rtc::new(rtc).rwdt;
    watchdog.feed();
    watchdog.set_timeout(
        RwdtStage::Stage0,
        esp_hal::time::Duration::from_millis(NETWORK_MS),
    );
    loop {
        watchdog.feed();
        Timer::after(Duration::from_millis(NETWORK_MS / 20)).await;
    }
}

/// The watchdog of the planning task runs.
static WATCHES_PLANNING: AtomicBool = AtomicBool::new(false);

/// The watchdog of the planning task.
pub(crate) struct PlanningWatchdog(Wdt<TIMG1<'static>>);

impl PlanningWatchdog {
    /// Begins to watch.
    pub(crate) fn begin(timers: TIMG1<'static>) -> Self {
        let mut watchdog = TimerGroup::new(timers).wdt;
        watchdog.set_timeout(
            MwdtStage::Stage0,
            esp_hal::time::Duration::from_millis(PLANNING_MS),
        );
        watchdog.enable();
        WATCHES_PLANNING.store(true, Ordering::Release);
        Self(watchdog)
    }

    /// A turn was taken.
    pub(crate) fn feed(&mut self) {
        self.0.feed();
    }
}

/// Feeds both: core 0 has done a step of writing flash, during which core 1 stood still.
pub(crate) fn feed_both() {
    // SAFETY: one write to a register that does nothing but this. Core 1 may have been stopped between
    // opening the registers and its own write, which then does nothing, and this one counts for it.
    let rtc = unsafe { RTC_TIMER::steal() };
    Rtc::new(rtc).rwdt.feed();
    // Before, the timer group has no clock, and its registers are not to be touched.
    if WATCHES_PLANNING.load(Ordering::Acquire) {
        Wdt::<TIMG1<'static>>::new().feed();
    }
}
