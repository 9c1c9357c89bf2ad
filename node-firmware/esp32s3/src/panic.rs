//! A panic: outputs off first, then tell.
//!
//! Reason, stack and the last events are written to RTC RAM, which a reset leaves alone, and are
//! published at the next start. Everything here is in internal RAM as far as the compiler allows:
//! the formatting of the reason is not, and comes last.

use crate::{
    board::{AXES, DIRECTION_PINS, ENABLE_PIN, LASER_PIN, PLACES, STEP_PIN_C, STEP_PIN_D},
    rmt::take_pin,
};
use core::{
    fmt::{self, Write},
    panic::PanicInfo,
    ptr::{addr_of, addr_of_mut},
};
use esp_backtrace::Backtrace;
use esp_hal::{ram, system::software_reset};
use rmt::Registers;

/// Bytes of the reason that are kept.
const REASON_BYTES: usize = 120;
/// Frames of the stack that are kept.
const FRAMES: usize = 10;
/// Events that are kept.
pub(crate) const EVENTS: usize = 8;
const REASON_WORDS: usize = REASON_BYTES / 4;
const WORDS: usize = 4 + REASON_WORDS + FRAMES + 2 * EVENTS;
const MAGIC: u32 = 0x5354_4f50;

/// magic, checksum, bytes of the reason, frames; reason; frames; events (ms since boot, kind).
#[ram(unstable(rtc_fast, persistent))]
static mut KEPT: [u32; WORDS] = [0; WORDS];

const REASON_AT: usize = 4;
const FRAMES_AT: usize = REASON_AT + REASON_WORDS;
const EVENTS_AT: usize = FRAMES_AT + FRAMES;

fn put(index: usize, word: u32) {
    // SAFETY: a volatile write of one word within the array. Writers are the panic handler, when
    // nothing else runs on its core any more, and the planning task, whose events are beyond what
    // the checksum covers: a torn event is a wrong line in a log, no more.
    unsafe {
        addr_of_mut!(KEPT)
            .cast::<u32>()
            .add(index)
            .write_volatile(word)
    };
}

fn get(index: usize) -> u32 {
    // SAFETY: a volatile read of one word within the array; any bits are a number.
    unsafe { addr_of!(KEPT).cast::<u32>().add(index).read_volatile() }
}

fn checksum() -> u32 {
    (2..EVENTS_AT).fold(MAGIC, |sum, index| sum.rotate_left(5) ^ get(index))
}

/// Switches drivers and laser off, and the timers' steps: their pins are taken away from them, so
/// that it does not matter what a timer does.
#[ram]
pub(crate) fn pins_off() {
    for pin in [LASER_PIN, ENABLE_PIN, STEP_PIN_C, STEP_PIN_D] {
        take_pin(pin);
    }
}

/// Switches everything off that moves or burns.
#[ram]
fn outputs_off() {
    pins_off();
    let mut chip = crate::rmt::Chip;
    for place in PLACES {
        chip.stop(place.channel);
        chip.update(place.channel);
    }
    const { assert!(DIRECTION_PINS.len() == AXES) };
}

/// Notes an event that a panic would tell: `slot` counts up.
pub(crate) fn keep_event(slot: usize, at_ms: u32, kind: u32) {
    let at = EVENTS_AT + 2 * (slot % EVENTS);
    put(at, at_ms);
    put(at + 1, kind | 0x100);
}

struct Reason {
    bytes: [u8; REASON_BYTES],
    used: usize,
}

impl Write for Reason {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            if self.used < REASON_BYTES {
                self.bytes[self.used] = byte;
                self.used += 1;
            }
        }
        Ok(())
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    outputs_off();
    let mut reason = Reason {
        bytes: [0; REASON_BYTES],
        used: 0,
    };
    if let Some(place) = info.location() {
        let _ = write!(reason, "{}:{}: ", place.file(), place.line());
    }
    let _ = write!(reason, "{}", info.message());
    put(0, 0);
    put(2, reason.used as u32);
    for (index, word) in reason.bytes.chunks_exact(4).enumerate() {
        put(
            REASON_AT + index,
            u32::from_le_bytes([word[0], word[1], word[2], word[3]]),
        );
    }
    let backtrace = Backtrace::capture();
    let frames = backtrace.frames();
    put(3, frames.len().min(FRAMES) as u32);
    for index in 0..FRAMES {
        let frame = frames.get(index);
        put(
            FRAMES_AT + index,
            frame.map_or(0, |frame| frame.program_counter() as u32),
        );
    }
    put(1, checksum());
    put(0, MAGIC);
    software_reset()
}

/// What a panic before this boot left behind.
#[derive(Clone, Debug)]
pub(crate) struct Report {
    /// Where and why.
    pub(crate) reason: heapless::String<REASON_BYTES>,
    /// Program counters, innermost first.
    pub(crate) frames: heapless::Vec<u32, FRAMES>,
    /// Time (ms since the boot before) and kind of the last events, in no order.
    pub(crate) events: heapless::Vec<(u32, u8), EVENTS>,
}

/// Takes the report of the last boot, if it ended in a panic, and forgets it.
pub(crate) fn take_report() -> Option<Report> {
    let known = get(0) == MAGIC && get(1) == checksum();
    let report = known.then(|| {
        let used = (get(2) as usize).min(REASON_BYTES);
        let mut reason = heapless::String::new();
        for index in 0..used {
            let byte = get(REASON_AT + index / 4).to_le_bytes()[index % 4];
            let _ = reason.push(if byte.is_ascii() {
                char::from(byte)
            } else {
                '?'
            });
        }
        let count = (get(3) as usize).min(FRAMES);
        let event = |slot: usize| (get(EVENTS_AT + 2 * slot), get(EVENTS_AT + 2 * slot + 1));
        Report {
            reason,
            frames: (0..count).map(|index| get(FRAMES_AT + index)).collect(),
            events: (0..EVENTS)
                .map(event)
                .filter(|(_, kind)| kind & 0x100 != 0)
                .map(|(at_ms, kind)| (at_ms, kind as u8))
                .collect(),
        }
    });
    put(0, 0);
    for index in EVENTS_AT..WORDS {
        put(index, 0);
    }
    report
}
