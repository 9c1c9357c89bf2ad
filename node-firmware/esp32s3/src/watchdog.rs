//! Two hardware watchdogs: one for each core.
//!
//! The one of timer group 1 is fed while core 1 takes its turns, the one of the RTC while core 0
//! runs this task. Either ends in a reset, at which all pins float and the drivers' own pull-downs
//! switch them off.

use crate::plan::TURNS;
use core::sync::atomic::Ordering;
use embassy_time::{Duration, Timer};
use esp_hal::{
    peripherals::{RTC_TIMER, TIMG1},
    rtc_cntl::{Rtc, RwdtStage},
    timer::timg::{MwdtStage, TimerGroup},
};

/// Longest time without a turn.
const LIMIT_MS: u64 = 1_000;

/// Watches for ever.
#[embassy_executor::task]
pub(crate) async fn watch(group: TIMG1<'static>, rtc: RTC_TIMER<'static>) {
    let mut planning = TimerGroup::new(group).wdt;
    let mut running = Rtc::new(rtc).rwdt;
    let limit = esp_hal::time::Duration::from_millis(LIMIT_MS);
    planning.set_timeout(MwdtStage::Stage0, limit);
    planning.enable();
    running.set_timeout(RwdtStage::Stage0, limit);
    running.enable();
    let mut seen = TURNS.load(Ordering::Relaxed);
    loop {
        Timer::after(Duration::from_millis(LIMIT_MS / 10)).await;
        running.feed();
        let turns = TURNS.load(Ordering::Relaxed);
        if turns != seen {
            planning.feed();
            seen = turns;
        }
    }
}
