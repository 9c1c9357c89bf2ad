//! A panic: outputs off first, then tell. And what a reset that nobody asked for leaves to tell.
//!
//! Reason, stack and the last events are in RTC RAM, which a reset leaves alone, and are published at the
//! next start: [`periphery::blackbox`]. Everything that switches off is in internal RAM as far as the
//! compiler allows: the formatting of the reason is not, and comes last.

use crate::{
    board::{LAYOUT, driven_pins},
    rmt::take_pin,
};
use core::{
    fmt::{self, Write},
    panic::PanicInfo,
    ptr::{addr_of, addr_of_mut},
    sync::atomic::{AtomicU8, Ordering},
};
use esp_backtrace::Backtrace;
use esp_hal::{
    ram,
    system::{Cpu, software_reset},
};
use periphery::blackbox::{BlackBox, FRAMES, REASON_BYTES, Report, Reset, WORDS, Words};
use rmt::Registers;

#[ram(unstable(rtc_fast, persistent))]
static mut KEPT: [u32; WORDS] = [0; WORDS];

/// The memory itself. Writers are the panic handler, when nothing else runs any more, and the planning
/// task, whose events are beyond what the checksum covers.
struct RtcRam;

impl Words for RtcRam {
    fn get(&self, index: usize) -> u32 {
        debug_assert!(index < WORDS);
        // SAFETY: a volatile read of one word within the array; any bits are a number.
        unsafe { addr_of!(KEPT).cast::<u32>().add(index).read_volatile() }
    }

    fn put(&mut self, index: usize, word: u32) {
        debug_assert!(index < WORDS);
        // SAFETY: a volatile write of one word within the array.
        unsafe {
            addr_of_mut!(KEPT)
                .cast::<u32>()
                .add(index)
                .write_volatile(word)
        };
    }
}

/// Switches drivers and laser off, and all steps: their pins are taken away from whatever drives them,
/// so that it does not matter what a timer does. Before the board is wired there are none, and nothing is
/// driven.
#[ram]
fn pins_off() {
    for pin in driven_pins() {
        take_pin(pin);
    }
}

/// Switches everything off that moves or burns.
#[ram]
fn outputs_off() {
    pins_off();
    let mut chip = crate::rmt::Chip;
    for channel in 0..LAYOUT.transmitters {
        chip.stop(channel);
        chip.update(channel);
    }
}

/// Stops the other core where it is. It may hold a lock: nothing behind this may want one.
#[cfg(feature = "dual")]
fn stop_other_core() {
    use esp_hal::{peripherals::CPU_CTRL, system::CpuControl};

    let other = match Cpu::current() {
        Cpu::ProCpu => Cpu::AppCpu,
        Cpu::AppCpu => Cpu::ProCpu,
    };
    // SAFETY: whoever else parks a core does not go on, and it is not this core.
    unsafe { CpuControl::new(CPU_CTRL::steal()).park_core(other) };
}

/// Notes an event that the report of a reset would tell: `slot` counts up.
pub(crate) fn keep_event(slot: usize, at_ms: u32, kind: u8) {
    BlackBox::new(RtcRam).keep_event(slot, at_ms, kind);
}

/// Takes the report of the boot before, if it did not end as it should, and forgets it.
pub(crate) fn take_report() -> Option<Report> {
    let number = esp_hal::rtc_cntl::reset_reason(Cpu::ProCpu).map(|reason| reason as u8);
    BlackBox::new(RtcRam).take(Reset::from_number(number))
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

/// Nobody panics yet.
const NOBODY: u8 = 0;

/// The core that panics, from 1.
static PANICS: AtomicU8 = AtomicU8::new(NOBODY);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    // Twice: at once, and when nobody is left who could switch something on again.
    outputs_off();
    let this = Cpu::current() as u8 + 1;
    match PANICS.compare_exchange(NOBODY, this, Ordering::AcqRel, Ordering::Acquire) {
        Ok(_) => {}
        // In the middle of telling: what is kept is not whole, and so is not told.
        Err(other) if other == this => software_reset(),
        // The other core tells, and stops this one.
        Err(_) => loop {
            core::hint::spin_loop();
        },
    }
    #[cfg(feature = "dual")]
    stop_other_core();
    outputs_off();
    let mut reason = Reason {
        bytes: [0; REASON_BYTES],
        used: 0,
    };
    if let Some(place) = info.location() {
        let _ = write!(reason, "{}:{}: ", place.file(), place.line());
    }
    let _ = write!(reason, "{}", info.message());
    let backtrace = Backtrace::capture();
    let mut frames: heapless::Vec<u32, FRAMES> = heapless::Vec::new();
    for frame in backtrace.frames() {
        // The outermost are left out.
        let _ = frames.push(frame.program_counter() as u32);
    }
    BlackBox::new(RtcRam).keep_panic(&reason.bytes[..reason.used], &frames);
    software_reset()
}
