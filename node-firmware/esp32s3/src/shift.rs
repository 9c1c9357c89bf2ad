//! The lines of the shift register.

use crate::{
    board::{Other, other_pin, pin},
    rmt::set_pin,
};
use esp_hal::gpio::{Input, InputConfig, Level, Output, OutputConfig, Pull};
use periphery::{ShiftLines, shift};

/// See the module.
#[derive(Debug)]
pub(crate) struct ShiftRegister {
    back: Input<'static>,
    lines: [u8; 3],
    _outputs: [Output<'static>; 3],
}

impl ShiftRegister {
    /// Takes the lines; the outputs keep what they show.
    ///
    /// # Panics
    /// The board has no such lines.
    pub(crate) fn new() -> Self {
        let lines = [
            Other::ShiftData,
            Other::ShiftClock,
            Other::ShiftLatch,
            Other::ShiftBack,
        ];
        let lines = lines.map(|of| other_pin(of).expect("a wiring that was checked"));
        let [data, clock, latch, back] = lines;
        let output = |number, level| Output::new(pin(number), level, OutputConfig::default());
        // Without a register it reads low, which no word with a bit set is confirmed by.
        let config = InputConfig::default().with_pull(Pull::Down);
        let mut register = Self {
            back: Input::new(pin(back), config),
            lines: [data, clock, latch],
            _outputs: [
                output(data, Level::Low),
                output(clock, Level::Low),
                output(latch, Level::High),
            ],
        };
        shift::begin(&mut register);
        register
    }

    /// Lets the outputs show a word and returns what they show.
    pub(crate) fn exchange(&mut self, word: u32) -> u32 {
        shift::exchange(self, word, usize::from(provision::kit::SHIFT.pin_count))
    }
}

impl ShiftLines for ShiftRegister {
    fn set_data(&mut self, high: bool) {
        set_pin(self.lines[0], high);
    }

    fn set_clock(&mut self, high: bool) {
        set_pin(self.lines[1], high);
    }

    fn set_latch(&mut self, high: bool) {
        set_pin(self.lines[2], high);
    }

    fn back(&self) -> bool {
        self.back.is_high()
    }
}
