//! The pulse path of core 1 while core 0 has its hands full.

#[cfg(feature = "psram")]
use crate::pulses::rest;
use crate::{pulses::Bench, rmt::now_ticks};
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use embassy_time::Timer;
use embedded_storage::nor_flash::NorFlash;
use esp_println::println;
use esp_storage::FlashStorage;
use esp_wifi::wifi::{WifiController, scan::ScanConfig};
use keys::{AxisId, Command, command::LINE_AXES};
use motion::TICKS_PER_US;
use update::layout;

/// Nothing.
const IDLE: u8 = 0;
/// Scan for networks, again and again.
const SCAN: u8 = 1;
/// Erase and write a piece of flash, once.
const WRITE: u8 = 2;
/// Nothing any more.
const ENDED: u8 = 3;

/// What core 0 is to do.
static WANTED: AtomicU8 = AtomicU8::new(IDLE);
/// Scans that it has made.
static SCANS: AtomicU32 = AtomicU32::new(0);
/// How long the last write took, µs; [`u32::MAX`]: it failed.
static WRITE_US: AtomicU32 = AtomicU32::new(0);

/// The last erase unit of the second slot: no image is so long.
const PIECE: u32 = layout::SLOTS[1].at + layout::SLOTS[1].bytes - FlashStorage::ERASE_SIZE as u32;

/// What is written: from internal RAM, aligned as the flash's registers want it.
#[repr(align(4))]
struct Piece([u8; 256]);

/// Core 0: does what is asked until it is enough.
#[cfg_attr(
    not(feature = "dual"),
    expect(dead_code, reason = "one core tests, and nobody serves")
)]
pub(crate) async fn serve(
    mut wifi: Option<WifiController<'static>>,
    mut flash: FlashStorage<'static>,
) {
    loop {
        match (WANTED.load(Ordering::Acquire), wifi.as_mut()) {
            (SCAN, Some(wifi)) => {
                let config = ScanConfig::default().with_max(8);
                if wifi.scan_async(&config).await.is_ok() {
                    SCANS.fetch_add(1, Ordering::AcqRel);
                }
            }
            (WRITE, _) => {
                let begun = now_ticks();
                let end = PIECE + FlashStorage::ERASE_SIZE as u32;
                let erased = NorFlash::erase(&mut flash, PIECE, end);
                let piece = core::hint::black_box(Piece([0x5a; 256]));
                let written = erased.and_then(|()| NorFlash::write(&mut flash, PIECE, &piece.0));
                let took_us = (now_ticks() - begun) / TICKS_PER_US;
                WRITE_US.store(
                    written.map_or(u32::MAX, |()| took_us as u32),
                    Ordering::Release,
                );
                WANTED.store(IDLE, Ordering::Release);
            }
            (ENDED, _) => return,
            _ => Timer::after_micros(500).await,
        }
    }
}

/// Lets core 0 rest.
pub(crate) fn end() {
    WANTED.store(ENDED, Ordering::Release);
}

/// Moves all axes fast and long, and counts what came too late; then once more around a write of flash.
pub(crate) fn check(bench: &mut Bench) {
    let mut steps = [0; LINE_AXES];
    let axes = crate::board::axes().min(LINE_AXES);
    steps[..axes].fill(2_000_000);
    let line = |steps| Command::Line {
        steps,
        speed_hz: 200_000,
        accel_hz_per_s: 2_000_000,
        jerk_hz_per_s2: 0,
    };
    WANTED.store(SCAN, Ordering::Release);
    let (scans, late) = (SCANS.load(Ordering::Acquire), bench.late);
    bench.order(&line(steps));
    bench.run_to_rest();
    let scans = SCANS.load(Ordering::Acquire) - scans;
    let late = bench.late - late;
    let lost = differences(bench, axes);
    let verdict = bench.fail(late != 0 || lost != 0);
    println!(
        "{verdict} load: {axes} axes of 2000000 steps at 200 kHz, {scans} scans, {late} late refills, {lost} \
         steps off"
    );
    if !cfg!(feature = "dual") {
        println!("SKIP flash: there is one core");
        return;
    }
    WANTED.store(WRITE, Ordering::Release);
    // Stopped in here, wherever it is.
    let (mut longest, mut before) = (0, now_ticks());
    while WANTED.load(Ordering::Acquire) == WRITE {
        let at = now_ticks();
        longest = longest.max(at - before);
        before = at;
    }
    let write_us = WRITE_US.load(Ordering::Acquire);
    steps[..axes].fill(-20_000);
    bench.order(&line(steps));
    bench.run_to_rest();
    let lost = differences(bench, axes);
    let verdict = bench.fail(lost != 0 || write_us == u32::MAX);
    let stood_us = longest / TICKS_PER_US;
    println!(
        "{verdict} flash: written in {write_us} us, core 1 stood still for {stood_us} us at once, {lost} steps off"
    );
}

fn differences(bench: &mut Bench, axes: usize) -> u64 {
    let all = (0..axes as u8).map(|axis| bench.difference(AxisId(axis)).unsigned_abs());
    all.sum()
}

/// Writes the ring's memory and reads it, by another pattern each time, while core 0 scans.
#[cfg(feature = "psram")]
pub(crate) fn check_psram(bench: &mut Bench, psram: esp_hal::peripherals::PSRAM<'static>) {
    use esp_hal::psram::{Psram, PsramConfig};

    /// As the command ring: 512 KiB.
    const WORDS: usize = 128 * 1024;
    const PASSES: u32 = 64;
    let psram = Psram::new(psram, PsramConfig::default());
    let (start, bytes) = psram.raw_parts();
    if bytes < 4 * WORDS {
        println!("SKIP PSRAM: {bytes} bytes");
        return;
    }
    WANTED.store(SCAN, Ordering::Release);
    let first = start.cast::<u32>();
    let pattern = |pass: u32, index: usize| (index as u32 ^ pass).wrapping_mul(0x9e37_79b9);
    let mut wrong = 0_u32;
    let begun = now_ticks();
    for pass in 0..PASSES {
        for index in 0..WORDS {
            // SAFETY: mapped memory that nobody else has; any bits are a number.
            unsafe { first.add(index).write_volatile(pattern(pass, index)) };
        }
        rest(1_000);
        for index in 0..WORDS {
            // SAFETY: as above.
            let read = unsafe { first.add(index).read_volatile() };
            wrong += u32::from(read != pattern(pass, index));
        }
    }
    let ms = (now_ticks() - begun) / TICKS_PER_US / 1_000;
    let verdict = bench.fail(wrong != 0);
    println!("{verdict} PSRAM: {PASSES} times 512 KiB in {ms} ms, {wrong} words wrong");
}
