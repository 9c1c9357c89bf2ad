//! The input pins: their registers, their interrupt, and what the planning task takes from them.
//!
//! Logic is in [`periphery::inputs`]; here is one access after the other. All switches are to ground,
//! with the chip's pull-ups, and behind its glitch filter.

use crate::board::pin;
use core::{
    cell::UnsafeCell,
    sync::atomic::{AtomicBool, AtomicU8, Ordering},
};
use esp_hal::{
    gpio::{Event, Input, InputConfig, Io, Pull},
    handler,
    interrupt::Priority,
    peripherals::{GPIO, IO_MUX},
    ram,
};
use motion::io::input::PinLevel;
use periphery::{Capture, InputRegisters};
use rmt::Registers;

/// What lets an edge interrupt the core that plans: INT_ENA of a pin, as the HAL sets it there.
static ENABLE: AtomicU8 = AtomicU8::new(0);

/// There may be something to take.
static CAUGHT: AtomicBool = AtomicBool::new(false);

/// The hardware itself, and which pins it was ever told to listen to.
#[derive(Debug)]
struct Pins {
    known: u64,
}

impl InputRegisters for Pins {
    #[inline(always)]
    fn levels(&self) -> u64 {
        let gpio = GPIO::regs();
        u64::from(gpio.in1().read().bits()) << 32 | u64::from(gpio.in_().read().bits())
    }

    #[inline(always)]
    fn acknowledge(&mut self, pins: u64) {
        let gpio = GPIO::regs();
        // SAFETY: registers that ignore zeros, and the pins are this driver's.
        unsafe {
            gpio.status_w1tc().write(|w| w.bits(pins as u32));
            gpio.status1_w1tc().write(|w| w.bits((pins >> 32) as u32));
        }
    }

    #[inline(always)]
    fn listen(&mut self, pins: u64) {
        let enable = ENABLE.load(Ordering::Relaxed);
        self.known |= pins;
        let (mut rest, mut listen, mut number) = (self.known, pins, 0);
        while rest != 0 {
            if rest & 1 != 0 {
                let bits = if listen & 1 != 0 { enable } else { 0 };
                let config = GPIO::regs().pin(number);
                // SAFETY: the bits that the HAL has set there, or none.
                config.modify(|_, w| unsafe { w.int_ena().bits(bits) });
            }
            (rest, listen, number) = (rest >> 1, listen >> 1, number + 1);
        }
    }

    #[inline(always)]
    fn now(&self) -> u64 {
        crate::rmt::now_ticks()
    }

    #[inline(always)]
    fn counter(&self, axis: usize) -> Option<i16> {
        crate::rmt::Chip.counter(axis)
    }
}

struct Shared(UnsafeCell<Capture<Pins>>);

// SAFETY: it is used by one core only, by its interrupt and by its planning task, and never by both
// at once: the task masks interrupts while it does.
unsafe impl Sync for Shared {}

static CAPTURE: Shared = Shared(UnsafeCell::new(Capture::new(Pins { known: 0 })));

/// The interrupt of the input pins. As urgent as a refill, so neither comes into the other.
#[handler(priority = Priority::Priority3)]
#[ram]
fn edge() {
    // SAFETY: the planning task is on this core and masks interrupts while it uses it.
    let capture = unsafe { &mut *CAPTURE.0.get() };
    capture.on_interrupt();
    CAUGHT.store(true, Ordering::Release);
}

fn with_capture<T>(use_it: impl FnOnce(&mut Capture<Pins>) -> T) -> T {
    critical_section::with(|_| {
        // SAFETY: the only other user is the interrupt, which is masked on this core, and it runs on
        // no other one.
        use_it(unsafe { &mut *CAPTURE.0.get() })
    })
}

/// The inputs that the node has.
#[derive(Debug)]
pub(crate) struct InputPins {
    _own: (),
}

impl InputPins {
    /// Takes the pins, in the order of motion's inputs, on the core that plans. Gives their levels
    /// too, a bit for each.
    pub(crate) fn new(io_mux: IO_MUX<'static>, numbers: &[u8]) -> (Self, u32) {
        let mut io = Io::new(io_mux);
        io.set_interrupt_handler(edge);
        for number in numbers {
            let config = InputConfig::default().with_pull(Pull::Up);
            let mut input = Input::new(pin(*number), config);
            filter(*number);
            input.listen(Event::AnyEdge);
            let bits = GPIO::regs().pin(usize::from(*number)).read().int_ena();
            ENABLE.store(bits.bits(), Ordering::Relaxed);
            // The pin stays as it is for as long as the program runs.
            core::mem::forget(input);
        }
        let levels = with_capture(|capture| capture.begin(numbers));
        (Self { _own: () }, levels)
    }

    /// Gives the next change; see [`Capture::poll`].
    pub(crate) fn poll(&mut self, counted_steps: impl Fn(usize) -> i64) -> Option<PinLevel> {
        if !CAUGHT.load(Ordering::Acquire) {
            return None;
        }
        with_capture(|capture| {
            let level = capture.poll(counted_steps);
            if level.is_none() {
                // Still masked: an edge behind this sets it again.
                CAUGHT.store(false, Ordering::Release);
            }
            level
        })
    }

    /// Returns whether an edge waits.
    pub(crate) fn has_caught(&self) -> bool {
        CAUGHT.load(Ordering::Acquire)
    }
}

/// Sets the glitch filter of a pin: what is shorter than two cycles of the bus clock is not seen.
pub(crate) fn filter(number: u8) {
    let config = IO_MUX::regs().gpio(usize::from(number));
    config.modify(|_, w| w.filter_en().set_bit());
}
