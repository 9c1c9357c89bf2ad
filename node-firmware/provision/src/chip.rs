//! What the pins of a chip are good for.
//!
//! | chip | module | from |
//! |---|---|---|
//! | ESP32-S3 | N8R8: octal PSRAM | its data sheet, *pin overview*, *strapping pins*, *power-up glitches on pins* |
//! | ESP32-C6 | WROOM-1 | its data sheet, the same tables |
//! | ESP32-S31 | any | numbers only: its manual is not public |
//!
//! None of them has pins that are inputs only.

use crate::wiring::PinUse;
use core::fmt;
use motion::limits::CHANNELS;
use serde::{Deserialize, Serialize};

/// A chip on its module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// The product's.
    Esp32S3,
    /// A relative that the firmware links for.
    Esp32C6,
    /// Another one.
    Esp32S31,
}

/// Why a pin cannot be what it was told to be. Appended to, never changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PinWhy {
    /// The chip has none of this number.
    NoSuchPin,
    /// The module's flash is there.
    Flash,
    /// The module's octal PSRAM is there.
    Psram,
    /// USB is there, by which the node is flashed and told who it is.
    Usb,
    /// Its level at the reset says how the chip boots.
    Strapping,
    /// The kit's serial bridge drives it, or the ROM writes on it.
    Bridge,
    /// It is driven high for some 60 µs at power on.
    PowerUp,
    /// It is something else already.
    Taken(PinUse),
    /// No pin was told, and the kit has none.
    Missing,
    /// More axes than the chip has transmitters.
    Axes {
        /// Most that it has.
        max: u8,
    },
    /// The board has fewer axes.
    NoAxis {
        /// So many.
        axes: u8,
    },
}

impl fmt::Display for PinWhy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSuchPin => f.write_str("the chip has no such pin"),
            Self::Flash => f.write_str("the module's flash is there"),
            Self::Psram => f.write_str("the module's octal PSRAM is there"),
            Self::Usb => f.write_str("USB is there"),
            Self::Strapping => f.write_str("its level at the reset says how the chip boots"),
            Self::Bridge => f.write_str("the kit's serial bridge is there"),
            Self::PowerUp => f.write_str("it is driven high for 60 µs at power on"),
            Self::Taken(other) => write!(f, "it is {other}"),
            Self::Missing => write!(f, "it has no pin (--pin)"),
            Self::Axes { max } => write!(f, "the chip drives at most {max} axes"),
            Self::NoAxis { axes } => {
                write!(
                    f,
                    "there are {axes} axes (--axes, or --no-pins to forget it)"
                )
            }
        }
    }
}

impl Chip {
    /// Returns how many axes it drives: one for each transmitter of its RMT.
    pub const fn axes_max(self) -> usize {
        match self {
            Self::Esp32S3 | Self::Esp32S31 => CHANNELS,
            Self::Esp32C6 => 2,
        }
    }

    /// Returns why a pin is not good for this.
    pub const fn refuses(self, gpio: u8, of: PinUse) -> Option<PinWhy> {
        match self {
            Self::Esp32S3 => match gpio {
                22..=25 | 49.. => Some(PinWhy::NoSuchPin),
                26..=32 => Some(PinWhy::Flash),
                33..=37 => Some(PinWhy::Psram),
                19 | 20 => Some(PinWhy::Usb),
                0 | 45 | 46 => Some(PinWhy::Strapping),
                43 | 44 => Some(PinWhy::Bridge),
                18 if of.must_start_low() => Some(PinWhy::PowerUp),
                _ => None,
            },
            Self::Esp32C6 => match gpio {
                31.. => Some(PinWhy::NoSuchPin),
                24..=30 => Some(PinWhy::Flash),
                12 | 13 => Some(PinWhy::Usb),
                8 | 9 => Some(PinWhy::Strapping),
                16 | 17 => Some(PinWhy::Bridge),
                _ => None,
            },
            Self::Esp32S31 => match gpio {
                62.. => Some(PinWhy::NoSuchPin),
                _ => None,
            },
        }
    }
}
