//! How the chip is, for whoever looks at the fleet: see [`keys::vitals`]. All of it is read on core 0;
//! the planning task knows nothing of it.
//!
//! Stacks are painted before they are used. What still has the paint was never reached.

use crate::heap;
use core::{
    ptr::addr_of,
    sync::atomic::{AtomicUsize, Ordering},
};
use keys::{LocalMicros, Vitals};

/// What a word of a stack is until somebody uses it.
const PAINT: u32 = 0x5ac0_ffee;

/// What of the running stack is not painted: what this function and its callers have.
const MARGIN_BYTES: usize = 1_024;

/// What may be watched there by the hardware.
const GUARD_BYTES: usize = 64;

unsafe extern "C" {
    /// The guard word in the first core's stack, which nobody may write: esp-hal's linker script.
    static __stack_chk_guard: u32;
    /// The low end of that stack.
    #[cfg(feature = "dual")]
    static _stack_end: u32;
}

/// A stack from its guard up to where it was painted.
struct Painted {
    from: AtomicUsize,
    to: AtomicUsize,
}

impl Painted {
    const fn new() -> Self {
        Self {
            from: AtomicUsize::new(0),
            to: AtomicUsize::new(0),
        }
    }

    /// Paints the words between two addresses.
    ///
    /// # Safety
    /// They are memory that nobody uses now.
    unsafe fn paint(&self, from: usize, to: usize) {
        for at in (from..to).step_by(4) {
            // SAFETY: as promised.
            unsafe { (at as *mut u32).write_volatile(PAINT) };
        }
        self.to.store(to, Ordering::Relaxed);
        self.from.store(from, Ordering::Release);
    }

    /// Returns how many bytes were never used; `None` before it was painted.
    fn free_bytes(&self) -> Option<u32> {
        let from = self.from.load(Ordering::Acquire);
        let to = self.to.load(Ordering::Relaxed);
        let mut painted = (from..to).step_by(4).take_while(|at| {
            // SAFETY: memory of a stack for ever; a word that changes meanwhile is used.
            unsafe { (*at as *const u32).read_volatile() == PAINT }
        });
        let words = painted.by_ref().count();
        (from != 0).then(|| u32::try_from(4 * words).unwrap_or(u32::MAX))
    }
}

static FIRST: Painted = Painted::new();
#[cfg(feature = "dual")]
static SECOND: Painted = Painted::new();

#[cfg(feature = "dual")]
fn guard_offset() -> usize {
    // Addresses only: nothing is read.
    addr_of!(__stack_chk_guard) as usize - addr_of!(_stack_end) as usize
}

/// Paints what is left of the first core's stack. Call it first of all.
#[inline(never)]
pub(crate) fn paint_first() {
    let here = 0_u32;
    let to = (addr_of!(here) as usize - MARGIN_BYTES) & !3;
    let from = addr_of!(__stack_chk_guard) as usize + GUARD_BYTES;
    // SAFETY: below what is in use, above the guard.
    unsafe { FIRST.paint(from, to) };
}

/// Paints the second core's stack, which has not begun.
#[cfg(feature = "dual")]
pub(crate) fn paint_second<const BYTES: usize>(stack: &mut esp_hal::system::Stack<BYTES>) {
    let bottom = stack.bottom() as usize;
    // SAFETY: its memory, of which nobody has anything yet.
    unsafe { SECOND.paint(bottom + guard_offset() + GUARD_BYTES, bottom + BYTES) };
}

/// What measures.
pub(crate) struct Gauges {
    #[cfg(feature = "esp32c6")]
    sensor: Option<esp_hal::tsens::TemperatureSensor<'static>>,
}

impl Gauges {
    /// Switches the thermometer on.
    #[cfg(feature = "esp32c6")]
    pub(crate) fn new(sensor: esp_hal::peripherals::TSENS<'static>) -> Self {
        let config = esp_hal::tsens::Config::default();
        Self {
            sensor: esp_hal::tsens::TemperatureSensor::new(sensor, config).ok(),
        }
    }

    /// Switches the thermometer on, for which esp-hal has no driver: as ESP-IDF does it.
    #[cfg(feature = "esp32s3")]
    pub(crate) fn new() -> Self {
        let sens = esp_hal::peripherals::SENS::regs();
        sens.sar_peri_clk_gate_conf()
            .modify(|_, w| w.tsens_clk_en().set_bit());
        sens.sar_tsens_ctrl()
            .modify(|_, w| w.sar_tsens_power_up_force().set_bit());
        // SAFETY: one of the two bits, as in ESP-IDF.
        sens.sar_tsens_ctrl2()
            .modify(|_, w| unsafe { w.sar_tsens_xpd_force().bits(1) });
        sens.sar_tsens_ctrl()
            .modify(|_, w| w.sar_tsens_power_up().set_bit());
        Self {}
    }

    /// There is no thermometer that esp-hal drives.
    #[cfg(not(any(feature = "esp32s3", feature = "esp32c6")))]
    pub(crate) fn new() -> Self {
        Self {}
    }

    #[cfg(feature = "esp32c6")]
    fn chip_celsius(&self) -> Option<i16> {
        /// What esp-hal leaves the converter at, by its own formula.
        const RANGE: u8 = 7;
        let shown = self.sensor.as_ref()?.get_temperature();
        periphery::thermometer::celsius(shown.raw_value, RANGE)
    }

    #[cfg(feature = "esp32s3")]
    fn chip_celsius(&self) -> Option<i16> {
        unsafe extern "C" {
            /// In the chip's ROM: a register of an analogue block.
            fn esp_rom_regi2c_read(block: u8, host: u8, register: u8) -> u8;
        }
        /// The block of the SAR converters, and the register with the sensor's range in bits 0 to 3.
        const SAR: (u8, u8, u8) = (0x69, 1, 6);
        /// A reading takes some µs; a sensor that has none after so many looks has failed.
        const LOOKS_MAX: usize = 1_000;
        let sens = esp_hal::peripherals::SENS::regs();
        let control = sens.sar_tsens_ctrl();
        control.modify(|_, w| w.sar_tsens_dump_out().set_bit());
        let ready = (0..LOOKS_MAX).any(|_| control.read().sar_tsens_ready().bit_is_set());
        control.modify(|_, w| w.sar_tsens_dump_out().clear_bit());
        let raw = control.read().sar_tsens_out().bits();
        // SAFETY: a function of the ROM that reads one register; the radio, which sets the range, runs
        // on this core and masks interrupts while it writes there.
        let range = unsafe { esp_rom_regi2c_read(SAR.0, SAR.1, SAR.2) } & 0xf;
        periphery::thermometer::celsius(raw, range).filter(|_| ready)
    }

    #[cfg(not(any(feature = "esp32s3", feature = "esp32c6")))]
    fn chip_celsius(&self) -> Option<i16> {
        None
    }

    /// Reads everything.
    pub(crate) fn read(&self, now: LocalMicros) -> Vitals {
        let bytes = |bytes: usize| u32::try_from(bytes).ok();
        Vitals {
            at: now,
            uptime_s: u32::try_from(now.0 / 1_000_000).ok(),
            chip_celsius: self.chip_celsius(),
            internal_free_bytes: bytes(heap::internal_free_bytes()),
            psram_free_bytes: heap::external_free_bytes().and_then(bytes),
            network_stack_free_bytes: FIRST.free_bytes(),
            #[cfg(feature = "dual")]
            planning_stack_free_bytes: SECOND.free_bytes(),
            #[cfg(not(feature = "dual"))]
            planning_stack_free_bytes: None,
        }
    }
}
