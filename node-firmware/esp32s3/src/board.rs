//! The pins of this board: the named kit's (ESP32-S3-DevKitC-1 with the N8R8 module), and what its record
//! says otherwise. `provision::wiring` has the table and knows which pins can be what.
//!
//! Told once, by [`wire`], before anything has a pin. Until then there is none: nothing is driven, and a panic
//! finds nothing to switch off. The refill interrupt reads the table, so it lies in internal RAM.

use core::sync::atomic::{AtomicU8, Ordering};
use esp_hal::gpio::AnyPin;
use motion::limits::{CHANNEL_WORDS, CHANNELS};
use provision::{Chip, Machine, PinUse, Wiring};
use rmt::Layout;

/// The chip that this is built for.
pub(crate) const CHIP: Chip = if cfg!(feature = "esp32c6") {
    Chip::Esp32C6
} else if cfg!(feature = "esp32s31") {
    Chip::Esp32S31
} else {
    Chip::Esp32S3
};

/// Most axes that this chip drives.
pub(crate) const AXES_MAX: usize = CHIP.axes_max();

/// Stands for a pin that is not there.
const NO_PIN: u8 = 0xff;

/// A pin that may not be there.
#[derive(Debug)]
struct Slot(AtomicU8);

impl Slot {
    const fn new() -> Self {
        Self(AtomicU8::new(NO_PIN))
    }

    fn put(&self, number: Option<u8>) {
        self.0.store(number.unwrap_or(NO_PIN), Ordering::Release);
    }

    #[inline(always)]
    fn get(&self) -> Option<u8> {
        let number = self.0.load(Ordering::Relaxed);
        (number != NO_PIN).then_some(number)
    }
}

/// Outputs that belong to no axis, and what comes in, in the order of [`NAMED`].
const NAMED: [PinUse; 11] = [
    PinUse::Enable,
    PinUse::Laser,
    PinUse::Lamp,
    PinUse::StepC,
    PinUse::StepD,
    PinUse::ShiftData,
    PinUse::ShiftClock,
    PinUse::ShiftLatch,
    PinUse::ShiftBack,
    PinUse::Stop,
    PinUse::Lidar,
];

/// How many of them are driven by this board from its first lines on: the shift register's are not, as no
/// level of them does anything.
const DRIVEN: usize = 5;

static AXES: AtomicU8 = AtomicU8::new(0);
static STEP: [Slot; CHANNELS] = [const { Slot::new() }; CHANNELS];
static DIRECTION: [Slot; CHANNELS] = [const { Slot::new() }; CHANNELS];
static AXIS_ENABLE: [Slot; CHANNELS] = [const { Slot::new() }; CHANNELS];
/// The step outputs again, by the transmitter that drives them.
static STEP_OF_CHANNEL: [Slot; CHANNELS] = [const { Slot::new() }; CHANNELS];
static OTHERS: [Slot; NAMED.len()] = [const { Slot::new() }; NAMED.len()];

/// Tells the pins. Call it once, with a wiring that `provision::wiring::check` has nothing against.
pub(crate) fn wire(wiring: &Wiring, machine: &Machine) {
    for of in wiring.uses(machine) {
        let pin = wiring.pin(of);
        match of {
            PinUse::Step(axis) => {
                let axis = usize::from(axis);
                STEP[axis].put(pin);
                STEP_OF_CHANNEL[LAYOUT.place(axis, wiring.axes()).channel].put(pin);
            }
            PinUse::Direction(axis) => DIRECTION[usize::from(axis)].put(pin),
            PinUse::AxisEnable(axis) => AXIS_ENABLE[usize::from(axis)].put(pin),
            PinUse::Switch { .. } => {}
            named => {
                let slot = NAMED.iter().position(|of| *of == named);
                if let Some(slot) = slot {
                    OTHERS[slot].put(pin);
                }
            }
        }
    }
    AXES.store(wiring.axes() as u8, Ordering::Release);
}

/// Returns how many axes there are; 0 before [`wire`].
#[inline(always)]
pub(crate) fn axes() -> usize {
    usize::from(AXES.load(Ordering::Relaxed))
}

/// Returns the step output of an axis.
#[inline(always)]
pub(crate) fn step_pin(axis: usize) -> Option<u8> {
    STEP.get(axis)?.get()
}

/// Returns the step output that a transmitter drives.
#[inline(always)]
pub(crate) fn step_pin_of(channel: usize) -> Option<u8> {
    STEP_OF_CHANNEL.get(channel)?.get()
}

/// Returns how many axes have a pulse counter: the chip has four, and the last one is C's where there is C.
#[cfg(feature = "counters")]
#[inline(always)]
pub(crate) fn counted_axes() -> usize {
    let for_c = usize::from(other_pin(Other::StepC).is_some());
    axes().min(CHANNELS - for_c)
}

/// Returns the direction output of an axis: high counts up.
#[inline(always)]
pub(crate) fn direction_pin(axis: usize) -> Option<u8> {
    DIRECTION.get(axis)?.get()
}

/// Returns a pin that belongs to no axis.
#[inline(always)]
pub(crate) fn other_pin(of: Other) -> Option<u8> {
    OTHERS[of as usize].get()
}

/// Pins that belong to no axis, by their place in [`NAMED`].
#[derive(Clone, Copy, Debug)]
#[repr(usize)]
pub(crate) enum Other {
    /// Drivers on: high. Hardware gates it with the stop button.
    Enable,
    /// Laser on: high.
    Laser,
    /// The lamp that says how the node is.
    Lamp,
    /// Step output of C.
    #[cfg_attr(
        not(feature = "timers"),
        expect(dead_code, reason = "without timers there is no C")
    )]
    StepC,
    /// Step output of D.
    StepD,
    /// Lines of the shift register; what its pins are for is in `provision::kit`.
    ShiftData,
    /// See above.
    ShiftClock,
    /// See above.
    ShiftLatch,
    /// What comes back.
    ShiftBack,
    /// Stop input with its own pull-up; open, and so a broken wire, is a stop.
    Stop,
    /// Where the lidar's line comes in: a TF-Luna whose pin 5 is open talks unasked.
    Lidar,
}

const _: () =
    assert!(Other::Lidar as usize == NAMED.len() - 1 && Other::StepD as usize == DRIVEN - 1);

/// Gives each enable output of the drivers: the common one, and those of single axes.
pub(crate) fn enable_pins() -> impl Iterator<Item = u8> {
    let axes = AXIS_ENABLE.iter().filter_map(Slot::get);
    other_pin(Other::Enable).into_iter().chain(axes)
}

/// Gives every output that moves or switches something.
#[inline(always)]
pub(crate) fn driven_pins() -> impl Iterator<Item = u8> {
    let others = OTHERS[..DRIVEN].iter().chain(&AXIS_ENABLE);
    let all = others.chain(&STEP).chain(&DIRECTION);
    all.filter_map(Slot::get)
}

/// What the chip's RMT has.
pub(crate) const LAYOUT: Layout = if cfg!(feature = "esp32c6") {
    Layout::TWO
} else {
    Layout::FOUR
};

/// Where the RMT's RAM begins: ESP32-S3 TRM §37.2, ESP32-C6 TRM §34.2, and esp-hal's table for the
/// ESP32-S31, whose manual is not public.
#[cfg(feature = "esp32s3")]
pub(crate) const RMT_RAM: usize = 0x6001_6800;
/// See above.
#[cfg(feature = "esp32c6")]
pub(crate) const RMT_RAM: usize = 0x6000_6400;
/// See above.
#[cfg(feature = "esp32s31")]
pub(crate) const RMT_RAM: usize = 0x2035_5800;

/// How many words the read pointer is ahead of the word that plays. Not in any manual; the `hil`
/// program measures it against the pulse counter. This value is a guess until it has run.
pub(crate) const PREFETCH_WORDS: u8 = 1;

/// RMT clock 80 MHz, so that a tick is 62.5 ns.
pub(crate) const RMT_DIVIDER: u8 = 5;

const _: () = assert!(LAYOUT.place(0, AXES_MAX).words() >= CHANNEL_WORDS);
const _: () = assert!(LAYOUT.transmitters == AXES_MAX);

/// Gives a pin of the table.
pub(crate) fn pin(number: u8) -> AnyPin<'static> {
    // SAFETY: each pin of the table has one owner, and nobody takes pins by another way. The exceptions
    // are what holds the outputs low before anybody owns them, and the panic handler, which comes last.
    unsafe { AnyPin::steal(number) }
}
