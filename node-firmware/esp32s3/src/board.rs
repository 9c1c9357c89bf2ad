//! The pin table: ESP32-S3-DevKitC-1 with the N8R8 module.
//!
//! GPIO 26 to 37 belong to flash and octal PSRAM, 19 and 20 to USB, 43 and 44 to the kit's serial
//! bridge, 0, 45 and 46 to the boot mode; 3 too, but only with a fuse that nobody burns by accident.
//! 38 or 48, by the kit's revision, is also its coloured lamp, which then flickers with D. The
//! wiring diagram is in `node-firmware/README.md`.

use esp_hal::gpio::AnyPin;
use keys::AxisId;
use motion::{
    io::input::{Role, Switch},
    limits::CHANNEL_WORDS,
};
use rmt::{Layout, Place};

/// Axes of this board.
pub(crate) const AXES: usize = 2;

/// Step outputs, by axis.
pub(crate) const STEP_PINS: [u8; AXES] = [4, 6];

/// Direction outputs, by axis: high counts up.
pub(crate) const DIRECTION_PINS: [u8; AXES] = [5, 7];

/// Enable output, high: the drivers are on. Hardware gates it with the stop button.
pub(crate) const ENABLE_PIN: u8 = 15;

/// Laser output, high: on. Not GPIO 18, 19 or 20, which are driven high for some 60 µs as the chip is
/// switched on (data sheet of the ESP32-S3, *power-up glitches on pins*; this one is driven low).
pub(crate) const LASER_PIN: u8 = 11;

/// Stop input with its own pull-up; open, and so a broken wire, is a stop.
pub(crate) const STOP_PIN: u8 = 10;

/// A lamp that says how the node is.
pub(crate) const LAMP_PIN: u8 = 18;

/// The input of each switch that there can be. `fleet provision --switch` says which there are; the
/// others are not looked at.
pub(crate) const INPUT_PINS: [(Role, u8); 11] = [
    (of(0, Switch::Min), 1),
    (of(0, Switch::Max), 2),
    (of(0, Switch::Home), 8),
    (of(1, Switch::Min), 9),
    (of(1, Switch::Max), 12),
    (of(1, Switch::Home), 13),
    (Role::Probe, 14),
    (Role::C(Switch::Min), 16),
    (Role::C(Switch::Max), 17),
    (Role::D(Switch::Min), 21),
    (Role::D(Switch::Max), 47),
];

const fn of(axis: u8, switch: Switch) -> Role {
    Role::Axis {
        axis: AxisId(axis),
        switch,
    }
}

/// Returns the pin of an input.
pub(crate) fn input_pin(role: Role) -> Option<u8> {
    let known = INPUT_PINS.iter().find(|(known, _)| *known == role);
    known.map(|(_, pin)| *pin)
}

/// Step output of C.
pub(crate) const STEP_PIN_C: u8 = 38;

/// Step output of D.
pub(crate) const STEP_PIN_D: u8 = 48;

/// Lines of the shift register: data, clock, latch, and what comes back. What its pins are for is in
/// `provision::kit`.
pub(crate) const SHIFT_PINS: [u8; 4] = [39, 40, 41, 42];

/// Where the lidar's line comes in: a TF-Luna whose pin 5 is open talks unasked. 43 and 44 are the
/// kit's own serial bridge, which would drive against it.
pub(crate) const LIDAR_PIN: u8 = 3;

/// What the chip's RMT has.
#[cfg(not(feature = "esp32c6"))]
pub(crate) const LAYOUT: Layout = Layout::FOUR;
/// What the chip's RMT has.
#[cfg(feature = "esp32c6")]
pub(crate) const LAYOUT: Layout = Layout::TWO;

/// The transmitter of each axis.
pub(crate) const PLACES: [Place; AXES] = LAYOUT.places::<AXES>();

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

const _: () = assert!(PLACES[0].words() >= CHANNEL_WORDS);

/// Gives a pin of the table.
pub(crate) fn pin(number: u8) -> AnyPin<'static> {
    // SAFETY: each pin of the table has one owner, and nobody takes pins by another way. The exceptions
    // are what holds the outputs low before anybody owns them, and the panic handler, which comes last.
    unsafe { AnyPin::steal(number) }
}
