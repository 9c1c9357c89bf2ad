//! What the named kit has behind its pins, and so what motion is told of a board with a record: the
//! same for the board and for its emulation.

use crate::record::Record;
use motion::{
    AxisProfile, MotionConfig, ShiftConfig,
    io::enable::{AxisSet, EnableConfig},
};

/// Pins of one 74HC595, A to H: direction and enable of C, then of D; E to H are free. To turn X and
/// Y by it too, name a pin for them here.
pub const SHIFT: ShiftConfig = ShiftConfig {
    pin_count: 8,
    enable_pins: [None, Some(1), Some(3), None, None, None],
    direction_pins: [None, None, None, None, Some(0), Some(2)],
};

/// The enable outputs of a board with C and D: the line of the queue's axes, on from boot on, and
/// those of C and D behind the register.
pub const ENABLES: [EnableConfig; 3] = [
    EnableConfig {
        auto: false,
        ..EnableConfig::auto(AxisSet::QUEUE)
    },
    EnableConfig {
        external: true,
        ..EnableConfig::auto(AxisSet::C)
    },
    EnableConfig {
        external: true,
        ..EnableConfig::auto(AxisSet::D)
    },
];

/// Returns what motion is told of a board with this record and so many axes. Call
/// [`MotionConfig::check`] behind it: it names what does not fit.
pub fn motion_of(record: &Record, axis_count: usize) -> MotionConfig {
    let mut config = MotionConfig {
        axis_count,
        ..MotionConfig::default()
    };
    for (to, from) in config.axes.iter_mut().zip(&record.axes) {
        *to = AxisProfile::from(*from);
    }
    record.machine.tell(&mut config);
    record.tuning.tell(&mut config);
    if config.cd.is_some() {
        config.shift = Some(SHIFT);
        config.enables = ENABLES.into_iter().collect();
    }
    config
}
