//! The outputs beside the step pins: drivers' enable line, laser, shift register, the lidar's request.

#[cfg(feature = "timers")]
use crate::pwm::PwmChip;
use crate::{
    board::{driven_pins, enable_pins, pin},
    lidar,
    rmt::set_pin,
    shift::ShiftRegister,
};
use esp_hal::gpio::{Level, Output, OutputConfig};
use motion::{Ticks, io::enable::OutputChange};
use node::Outputs;
#[cfg(feature = "timers")]
use periphery::Laser;

/// Drives every output low: drivers and laser off, nothing steps. From reset to here they float; what
/// must be low then needs a resistor. What takes a pin later takes it as it is. The board is wired: nobody
/// drives a pin that may be something else.
pub(crate) fn hold_low() {
    for number in driven_pins() {
        let output = Output::new(pin(number), Level::Low, OutputConfig::default());
        // It stays an output for as long as nobody makes something else of the pin.
        core::mem::forget(output);
    }
}

/// See the module.
#[derive(Debug)]
pub(crate) struct BoardOutputs {
    #[cfg(feature = "timers")]
    laser: Laser,
    shift: Option<ShiftRegister>,
    /// What the register has shown since the last look.
    shown: Option<u32>,
}

impl BoardOutputs {
    /// Takes the pins; the drivers are switched on, the laser is off.
    pub(crate) fn new(
        #[cfg(feature = "timers")] mut pwm: PwmChip,
        shift: Option<ShiftRegister>,
    ) -> Self {
        // They are outputs since `hold_low`.
        for number in enable_pins() {
            set_pin(number, true);
        }
        Self {
            #[cfg(feature = "timers")]
            laser: Laser::new(&mut pwm, 0, 0),
            shift,
            shown: None,
        }
    }

    /// Takes what the shift register has shown since the last call.
    pub(crate) fn take_shown(&mut self) -> Option<u32> {
        self.shown.take()
    }
}

impl Outputs for BoardOutputs {
    #[cfg(feature = "timers")]
    fn set_laser(&mut self, power_percent: u8) {
        self.laser.set(&mut PwmChip, power_percent);
    }

    /// The HAL of this chip has no pulse widths: on from half power on.
    #[cfg(not(feature = "timers"))]
    fn set_laser(&mut self, power_percent: u8) {
        if let Some(number) = crate::board::other_pin(crate::board::Other::Laser) {
            set_pin(number, power_percent >= 50);
        }
    }

    fn request_lidar(&mut self) {
        lidar::ASKED.signal(());
    }

    fn set_enable(&mut self, change: OutputChange, _at: Ticks) {
        // One level for all drivers of the queue, high for on; the enable hardware behind it may still
        // say no. Those of C and D are behind the shift register.
        if change.output == 0 {
            for number in enable_pins() {
                set_pin(number, change.levels()[1]);
            }
        }
    }

    fn shift_out(&mut self, word: u32) {
        // Motion shifts nothing where the configuration has no register.
        self.shown = self.shift.as_mut().map(|shift| shift.exchange(word));
    }
}
