//! The stop input: a normally closed contact to ground. Open is a stop, and so is a broken wire.
//!
//! The same contact opens the drivers' enable line in hardware (see the wiring in
//! `node-firmware/README.md`): that works with the processor hung. This input only lets the node
//! know, so that its position stays exact and it says why it stopped.

use crate::board::{Other, other_pin, pin};
use esp_hal::gpio::{Input, InputConfig, Pull};

/// Looks that must agree before the contact counts as closed again; opening counts at once.
const CLOSED_LOOKS: u32 = 20;

/// The input.
#[derive(Debug)]
pub(crate) struct StopPin {
    input: Input<'static>,
    active: bool,
    closed_looks: u32,
}

impl StopPin {
    /// Takes the pin.
    ///
    /// # Panics
    /// The board has none, which no record can say.
    pub(crate) fn new() -> Self {
        let number = other_pin(Other::Stop).expect("a wiring that was checked");
        let config = InputConfig::default().with_pull(Pull::Up);
        let input = Input::new(pin(number), config);
        crate::inputs::filter(number);
        Self {
            input,
            active: false,
            closed_looks: 0,
        }
    }

    /// Looks; gives the new state when it has changed.
    pub(crate) fn poll(&mut self) -> Option<bool> {
        if self.input.is_high() {
            self.closed_looks = 0;
            return (!core::mem::replace(&mut self.active, true)).then_some(true);
        }
        self.closed_looks = self.closed_looks.saturating_add(1);
        if self.active && self.closed_looks >= CLOSED_LOOKS {
            self.active = false;
            return Some(false);
        }
        None
    }
}
