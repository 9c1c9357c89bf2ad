//! Enable outputs: on before the first step, off when nothing has moved for a while.
//!
//! ```text
//!            wants_motion             delay_on              rest of all axes       delay_off
//!   off ──────────────────▶ on, early ────────▶ on, ready ────────────────▶ idle ──────────▶ off
//!                                                   ▲───── wants_motion ──────┘
//! ```
//!
//! Owns which axes share an output and whether each output is on. An output is up to two pins, one
//! low-active and one high-active, both driven. While it is on because somebody asked for it, or
//! because an axis moves, it does not go off by itself. An output behind a shift register is on
//! when that confirms it.
//!
//! Absent: the pins. [`Enables::poll`] tells which output changes.

use crate::{
    Ticks,
    limits::{CHANNELS, TICKS_PER_US},
};
use core::mem;

/// Most enable outputs: one for each axis of the queue, C and D.
pub const OUTPUTS_MAX: usize = CHANNELS + 2;

/// Axes that an output can serve: those of the queue by number, then C, then D.
pub const ENABLED_AXES: usize = CHANNELS + 2;

/// Longest time from on to the first step: 120 ms.
pub const DELAY_ON_US_MAX: u32 = 120_000;

/// Longest time from rest to off: one hour.
pub const DELAY_OFF_MS_MAX: u32 = 3_600_000;

/// A set of axes, a bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisSet(u8);

impl AxisSet {
    /// None.
    pub const NONE: Self = Self(0);
    /// C alone.
    pub const C: Self = Self(1 << CHANNELS);
    /// D alone.
    pub const D: Self = Self(2 << CHANNELS);
    /// Those of the queue.
    pub const QUEUE: Self = Self((1 << CHANNELS) - 1);

    /// One axis of the queue.
    ///
    /// # Panics
    /// There is no such axis in any node.
    pub const fn axis(axis: keys::AxisId) -> Self {
        assert!((axis.0 as usize) < CHANNELS, "an axis of the queue");
        Self(1 << axis.0)
    }

    /// Those of both.
    #[must_use]
    pub const fn with(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }

    /// Those that are not in the other.
    #[must_use]
    pub const fn without(self, others: Self) -> Self {
        Self(self.0 & !others.0)
    }

    /// Those that are in both.
    #[must_use]
    pub const fn common(self, others: Self) -> Self {
        Self(self.0 & others.0)
    }

    /// Returns whether both have one in common.
    pub const fn meets(self, others: Self) -> bool {
        self.0 & others.0 != 0
    }

    /// Returns whether there is none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// One enable output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnableConfig {
    /// Whose drivers it enables.
    pub axes: AxisSet,
    /// Whether motion switches it on, and rest off.
    pub auto: bool,
    /// From on to the first step, µs, 1 to [`DELAY_ON_US_MAX`].
    pub delay_on_us: u32,
    /// From rest to off, ms, at most [`DELAY_OFF_MS_MAX`].
    pub delay_off_ms: u32,
    /// Whether it counts as on only when [`Enables::confirm`] tells: it is behind a shift register.
    pub external: bool,
}

impl EnableConfig {
    /// On 2 ms before motion, off after a second of rest.
    pub const fn auto(axes: AxisSet) -> Self {
        Self {
            axes,
            auto: true,
            delay_on_us: 2_000,
            delay_off_ms: 1_000,
            external: false,
        }
    }
}

/// Why outputs cannot be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnableError {
    /// More than [`OUTPUTS_MAX`].
    TooMany,
    /// `delay_on_us` is 0.
    DelayOnTooLow,
    /// `delay_on_us` is more than [`DELAY_ON_US_MAX`].
    DelayOnTooHigh,
    /// `delay_off_ms` is more than [`DELAY_OFF_MS_MAX`].
    DelayOffTooHigh,
}

impl core::fmt::Display for EnableError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooMany => write!(f, "more than {OUTPUTS_MAX} enable outputs"),
            Self::DelayOnTooLow => write!(f, "the delay after on is at least 1 µs"),
            Self::DelayOnTooHigh => {
                write!(f, "the delay after on is at most {DELAY_ON_US_MAX} µs")
            }
            Self::DelayOffTooHigh => {
                write!(f, "the delay before off is at most {DELAY_OFF_MS_MAX} ms")
            }
        }
    }
}

impl core::error::Error for EnableError {}

/// When motion may begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// From then on.
    At(Ticks),
    /// When an output behind a shift register is confirmed: ask again then.
    Unconfirmed,
    /// Not before somebody switches on an output that is not automatic.
    Disabled,
}

/// Why an output stays on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moving;

/// An output switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputChange {
    /// Index of the output.
    pub output: usize,
    /// Whether it is on now.
    pub on: bool,
}

impl OutputChange {
    /// Returns the levels of its low-active and its high-active pin.
    pub const fn levels(self) -> [bool; 2] {
        [!self.on, self.on]
    }
}

/// Whether an output is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off,
    /// Switched on, not confirmed.
    Rising,
    /// On; steps may come from `ready_at` on.
    On {
        ready_at: Ticks,
    },
}

#[derive(Clone, Copy, Debug)]
struct Output {
    config: EnableConfig,
    state: State,
    /// Somebody asked for it.
    held: bool,
    /// What moves or wants to.
    moving: AxisSet,
    /// When it goes off if nothing moves.
    off_at: Option<Ticks>,
    /// What the pins show.
    shown: Option<bool>,
    /// They have to show off first, whatever was asked for since.
    drops: bool,
}

/// The enable outputs of a node. All are off at first, and told so.
#[derive(Clone, Debug)]
pub struct Enables {
    outputs: [Option<Output>; OUTPUTS_MAX],
}

impl Enables {
    /// No output: motion may begin at once.
    pub const NONE: Self = Self {
        outputs: [None; OUTPUTS_MAX],
    };

    /// Takes the outputs by index.
    ///
    /// # Errors
    /// The first that cannot be.
    pub fn new(configs: &[EnableConfig]) -> Result<Self, EnableError> {
        if configs.len() > OUTPUTS_MAX {
            return Err(EnableError::TooMany);
        }
        let mut enables = Self::NONE;
        for (output, config) in enables.outputs.iter_mut().zip(configs) {
            match config.delay_on_us {
                0 => return Err(EnableError::DelayOnTooLow),
                1..=DELAY_ON_US_MAX => {}
                _ => return Err(EnableError::DelayOnTooHigh),
            }
            if config.delay_off_ms > DELAY_OFF_MS_MAX {
                return Err(EnableError::DelayOffTooHigh);
            }
            *output = Some(Output {
                config: *config,
                state: State::Off,
                held: false,
                moving: AxisSet::NONE,
                off_at: None,
                shown: None,
                drops: false,
            });
        }
        Ok(enables)
    }

    /// These axes are to move. Gives the earliest start: that of the last of their outputs. With
    /// [`Start::Disabled`] nothing was switched on.
    pub fn wants_motion(&mut self, axes: AxisSet, now: Ticks) -> Start {
        let disabled = |output: &Output| {
            output.config.axes.meets(axes) && !output.config.auto && output.state == State::Off
        };
        if self.outputs.iter().flatten().any(disabled) {
            return Start::Disabled;
        }
        let mut start = Start::At(now);
        for output in self.outputs.iter_mut().flatten() {
            if !output.config.axes.meets(axes) {
                continue;
            }
            output.moving = output.moving.with(output.config.axes.common(axes));
            output.off_at = None;
            output.switch_on(now);
            start = match (start, output.state) {
                (Start::At(start_at), State::On { ready_at }) => Start::At(start_at.max(ready_at)),
                _ => Start::Unconfirmed,
            };
        }
        start
    }

    /// These axes have come to rest, or will not move after all.
    pub fn rests(&mut self, axes: AxisSet, now: Ticks) {
        for output in self.outputs.iter_mut().flatten() {
            if output.moving.meets(axes) {
                output.moving = output.moving.without(axes);
                output.wait_for_off(now);
            }
        }
    }

    /// Switches on the outputs of these axes, to stay on until [`Enables::disable`].
    pub fn enable(&mut self, axes: AxisSet, now: Ticks) {
        for output in self.outputs.iter_mut().flatten() {
            if output.config.axes.meets(axes) {
                output.held = true;
                output.off_at = None;
                output.switch_on(now);
            }
        }
    }

    /// Switches off the outputs of these axes, now.
    ///
    /// # Errors
    /// An axis of one of them moves; nothing was switched.
    pub fn disable(&mut self, axes: AxisSet) -> Result<(), Moving> {
        let mut outputs = self.outputs.iter().flatten();
        if outputs.any(|output| output.config.axes.meets(axes) && !output.moving.is_empty()) {
            return Err(Moving);
        }
        for output in self.outputs.iter_mut().flatten() {
            if output.config.axes.meets(axes) {
                output.switch_off();
            }
        }
        Ok(())
    }

    /// Switches everything off, whatever moves. Motors lose their place.
    pub fn disable_all(&mut self) {
        for output in self.outputs.iter_mut().flatten() {
            output.switch_off();
        }
    }

    /// An output behind a shift register is on, as it was last told.
    pub fn confirm(&mut self, output: usize, now: Ticks) {
        if let Some(Some(output)) = self.outputs.get_mut(output)
            && output.state == State::Rising
            && output.shown == Some(true)
            && !output.drops
        {
            output.is_on_from(now);
        }
    }

    /// Gives the next output that switches; call it until it gives `None`, and again before steps
    /// that [`Enables::wants_motion`] allowed.
    pub fn poll(&mut self, now: Ticks) -> Option<OutputChange> {
        for (index, output) in self.outputs.iter_mut().enumerate() {
            let Some(output) = output else { continue };
            if output.off_at.is_some_and(|off_at| off_at <= now) {
                output.switch_off();
            }
            let drops = mem::take(&mut output.drops) && output.shown == Some(true);
            let on = output.state != State::Off && !drops;
            if output.shown != Some(on) {
                output.shown = Some(on);
                return Some(OutputChange { output: index, on });
            }
        }
        None
    }

    /// Returns when an output goes off by itself.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        let outputs = self.outputs.iter().flatten();
        outputs.filter_map(|output| output.off_at).min()
    }

    /// Returns whether an output is switched on.
    pub fn is_on(&self, output: usize) -> bool {
        let output = self.outputs.get(output).and_then(Option::as_ref);
        output.is_some_and(|output| output.state != State::Off)
    }
}

impl Output {
    fn switch_on(&mut self, now: Ticks) {
        if self.state != State::Off {
            return;
        }
        if self.config.external {
            self.state = State::Rising;
        } else {
            self.is_on_from(now);
        }
    }

    fn is_on_from(&mut self, now: Ticks) {
        let ticks = u64::from(self.config.delay_on_us) * TICKS_PER_US;
        let ready_at = now.plus(ticks);
        self.state = State::On { ready_at };
    }

    fn switch_off(&mut self) {
        self.drops |= self.state != State::Off;
        self.state = State::Off;
        self.held = false;
        self.moving = AxisSet::NONE;
        self.off_at = None;
    }

    fn wait_for_off(&mut self, now: Ticks) {
        if self.config.auto && !self.held && self.moving.is_empty() {
            let ticks = u64::from(self.config.delay_off_ms) * 1_000 * TICKS_PER_US;
            self.off_at = Some(now.plus(ticks));
        }
    }
}

#[cfg(test)]
mod tests;
