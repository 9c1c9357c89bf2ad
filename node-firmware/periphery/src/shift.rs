//! A word out to shift registers, and back from the pins that it has set.
//!
//! ```text
//!            ┌────────── clock ──────────┬──────────────┐
//!   data ──▶ 74HC595 ──▶ 74HC595         │              │
//!            │ 8 outputs │ 8 outputs ──▶ 74HC165 ──▶ 74HC165 ──▶ back
//!            └────────── latch ──────────┴──────────────┘
//! ```
//!
//! The 74HC165 reads what the outputs really show, so a broken driver, a short and a loose chip are
//! found, not only a broken wire. One latch line serves both: its rising edge lets the outputs show
//! what was shifted in; while it is low the 165 looks at them. So it goes down twice, the second time
//! for the look; the outputs take the same word again by that. Bit 0 is output A of the chip nearest
//! to the board; it is read back from input A of the 165 farthest from the end of the chain.
//!
//! The lines are plain pins: 32 bits take some 30 µs, seldom, at task level. Refills come in between
//! at any point, and the registers wait for as long as they must. Their shortest times (74HC at 3.3 V:
//! pulses of 50 ns) are kept by the accesses themselves, 100 ns each.

use motion::io::shift::SHIFT_PINS_MAX;

/// The four lines.
pub trait ShiftLines {
    /// Sets the data line.
    fn set_data(&mut self, high: bool);
    /// Sets the clock line: everything shifts by one at its rising edge.
    fn set_clock(&mut self, high: bool);
    /// Sets the latch line.
    fn set_latch(&mut self, high: bool);
    /// Reads the line that comes back.
    fn back(&self) -> bool;
}

/// Sets the lines as they rest: the outputs keep what they show.
pub fn begin(lines: &mut impl ShiftLines) {
    lines.set_clock(false);
    lines.set_data(false);
    lines.set_latch(true);
}

/// Lets the outputs show `word` and returns what their pins show then.
///
/// # Panics
/// There are more than [`SHIFT_PINS_MAX`] pins.
pub fn exchange(lines: &mut impl ShiftLines, word: u32, pin_count: usize) -> u32 {
    assert!(pin_count <= SHIFT_PINS_MAX, "a word has so many bits");
    shift(lines, word, pin_count);
    latch(lines);
    latch(lines);
    // The same word again, so that what is latched next by mistake is what is shown.
    shift(lines, word, pin_count)
}

/// Shifts a word out, the highest bit first, and gives what came back.
fn shift(lines: &mut impl ShiftLines, word: u32, pin_count: usize) -> u32 {
    (0..pin_count).rev().fold(0, |back, bit| {
        lines.set_data(word >> bit & 1 != 0);
        // Before the clock: the first bit is there without one.
        let level = lines.back();
        lines.set_clock(true);
        lines.set_clock(false);
        back << 1 | u32::from(level)
    })
}

fn latch(lines: &mut impl ShiftLines) {
    lines.set_latch(false);
    lines.set_latch(true);
}
