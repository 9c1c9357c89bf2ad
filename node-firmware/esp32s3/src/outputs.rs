//! The outputs beside the step pins: drivers' enable line and laser.
//!
//! The laser is on or off: from half power on. Its pulse width follows when it is known which
//! laser. There is no lidar on this board, so a request for a reading stays unanswered, which the
//! node's contract allows.

use crate::{
    board::{ENABLE_PIN, LAMP_PIN, LASER_PIN, pin},
    rmt::set_pin,
};
use esp_hal::gpio::{Level, Output, OutputConfig};
use motion::{Ticks, io::enable::OutputChange};
use node::Outputs;

/// See the module.
#[derive(Debug)]
pub(crate) struct BoardOutputs {
    _pins: [Output<'static>; 3],
}

impl BoardOutputs {
    /// Takes the pins; the drivers are switched on, the laser is off.
    pub(crate) fn new() -> Self {
        let output = |number, level| Output::new(pin(number), level, OutputConfig::default());
        Self {
            _pins: [
                output(ENABLE_PIN, Level::High),
                output(LASER_PIN, Level::Low),
                output(LAMP_PIN, Level::Low),
            ],
        }
    }
}

impl Outputs for BoardOutputs {
    fn set_laser(&mut self, power_percent: u8) {
        set_pin(LASER_PIN, power_percent >= 50);
    }

    fn request_lidar(&mut self) {}

    fn set_enable(&mut self, change: OutputChange, _at: Ticks) {
        // One line for all drivers, high for on; the enable hardware behind it may still say no.
        if change.output == 0 {
            set_pin(ENABLE_PIN, change.levels()[1]);
        }
    }

    fn shift_out(&mut self, _word: u32) {
        // Motion shifts nothing where the configuration has no register, and this board's has none.
    }
}
