//! What goes with the motion: the laser, the drivers' enable pins, and the lidar that is waited for.
//!
//! The laser burns only where something moves on: a hold, a barrier and a queue that has run dry
//! switch it off, and it comes back with the next pulses. The drivers of all axes of the queue are
//! switched on together before the first of them steps, and the queue waits until the last one is
//! ready.

use super::ShiftConfig;
use super::{Motion, MotionEvent};
use crate::{
    StepBackend, Ticks,
    io::{
        enable::{AxisSet, OUTPUTS_MAX, OutputChange, Start},
        shift::{SHIFT_PINS_MAX, ShiftEvent, ShiftPins},
    },
    limits::CHANNELS,
};
use keys::Command;

/// Power that the commands have asked for, and whether it is withheld.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Laser {
    percent: u8,
    withheld: bool,
}

/// The shift register and which of its pins are enable outputs.
#[derive(Clone, Debug)]
pub(super) struct Shift {
    config: ShiftConfig,
    pins: ShiftPins,
}

impl Shift {
    /// All pins are low at first.
    pub(super) fn new(config: ShiftConfig) -> Self {
        let count = usize::from(config.pin_count).min(SHIFT_PINS_MAX);
        Self {
            config,
            pins: ShiftPins::new(count, 0, Ticks(0)),
        }
    }

    /// Turns an axis. Returns whether the pin is known to show it; `None`: it is no pin of this.
    fn turn(&mut self, axis: usize, level: bool, now: Ticks) -> Option<bool> {
        let pin = self.config.direction_pin_of(axis)?;
        let set = self.pins.set(pin, level, now);
        set.expect("the pin is below the count");
        Some(self.pins.is_confirmed(pin) == Ok(true))
    }

    fn of(&mut self, output: usize) -> Option<(&mut ShiftPins, u8)> {
        let pin = self.config.pin_of(output)?;
        Some((&mut self.pins, pin))
    }
}

impl<B: StepBackend> Motion<'_, B> {
    /// A command sets the laser's power. While motion is held, it takes effect when it goes on.
    pub(super) fn set_laser(&mut self, power_percent: u8) -> Option<MotionEvent> {
        self.laser.percent = power_percent;
        if self.rests_on_path() {
            self.laser.withheld = true;
            return None;
        }
        self.laser.withheld = false;
        Some(MotionEvent::Laser { power_percent })
    }

    /// What moved comes to rest although it is not at its end.
    pub(super) fn withhold_laser(&mut self) {
        if !self.laser.withheld {
            self.laser.withheld = true;
            if self.laser.percent > 0 {
                self.tell(MotionEvent::Laser { power_percent: 0 });
            }
        }
    }

    /// The queue goes on.
    pub(super) fn give_laser_back(&mut self) {
        if self.laser.withheld {
            self.laser.withheld = false;
            if self.laser.percent > 0 {
                let power_percent = self.laser.percent;
                self.tell(MotionEvent::Laser { power_percent });
            }
        }
    }

    /// Switches on the drivers of these axes and returns whether they are ready to step by now. If
    /// they are not, [`Motion::poll`] goes on when they are.
    pub(super) fn are_enabled(&mut self, axes: AxisSet, lead_ticks: u64) -> bool {
        let now = self.now;
        self.waits_enable = true;
        match self.enables.wants_motion(axes, now) {
            Start::At(at) if at.0 <= now.0 + lead_ticks => {
                self.enabled_at = None;
                self.waits_enable = false;
                true
            }
            Start::At(at) => {
                self.enabled_at = Some(Ticks(at.0 - lead_ticks));
                false
            }
            // Told by a confirmation, or by somebody who switches it on.
            Start::Unconfirmed | Start::Disabled => false,
        }
    }

    /// The axes of the queue rest: their drivers may go off after a while, unless it waits to go on
    /// at once.
    pub(super) fn rest_enables(&mut self) {
        let waits = matches!(self.ring.peek(), Some(Command::Barrier { .. }));
        if !waits {
            self.enables.rests(AxisSet::QUEUE, self.now);
        }
        self.enabled_at = None;
    }

    /// Switches on the drivers of these axes until [`Motion::disable`], whatever rests.
    pub fn enable(&mut self, axes: AxisSet) {
        self.enables.enable(axes, self.now);
    }

    /// Switches off the drivers of these axes. Returns whether it did: not while one of them moves.
    pub fn disable(&mut self, axes: AxisSet) -> bool {
        self.enables.disable(axes).is_ok()
    }

    /// Gives the direction pin of an axis a level. Returns whether it is known to show it; an axis
    /// that is not behind the shift register always does.
    pub(super) fn turn_pin(&mut self, axis: usize, level: bool) -> bool {
        let now = self.now;
        let shift = self.shift.as_mut();
        let turned = shift.and_then(|shift| shift.turn(axis, level, now));
        turned.unwrap_or(true)
    }

    /// Switches an output: by the shift register if it is behind one. It is `here` that what is told
    /// happens, however late.
    pub(super) fn pass_enables(&mut self, here: Ticks) -> Option<MotionEvent> {
        while let Some(change) = self.enables.poll(self.now) {
            let OutputChange { output, on } = change;
            let Some((shift, pin)) = self.shift.as_mut().and_then(|shift| shift.of(output)) else {
                return Some(MotionEvent::Output(change));
            };
            let set = shift.set(pin, on, self.now);
            set.expect("the pin is below the count");
        }
        let shift = self.shift.as_mut()?;
        match shift.pins.poll(self.now, here)? {
            ShiftEvent::Send(word) => Some(MotionEvent::ShiftOut { word }),
            ShiftEvent::Fault(fault) => Some(MotionEvent::ShiftFault(fault)),
            ShiftEvent::Confirmed => None,
        }
    }

    /// The shift register shows this word now, as it was read back. What it confirms may begin.
    pub fn take_shift(&mut self, word: u32) {
        let now = self.now;
        let Some(shift) = self.shift.as_mut() else {
            return;
        };
        shift.pins.confirm(word, now);
        for output in 0..OUTPUTS_MAX {
            if let Some((pins, pin)) = shift.of(output)
                && pins.is_confirmed(pin) == Ok(true)
                && pins.get(pin) == Ok(true)
            {
                self.enables.confirm(output, now);
            }
        }
    }

    /// After a fault of the shift register: what it should show is sent anew.
    pub fn reset_shift(&mut self) {
        let now = self.now;
        // Nobody knows what the pins show.
        self.turns.headings = [None; CHANNELS];
        if let Some(shift) = self.shift.as_mut() {
            shift.pins.reset(now);
        }
    }

    /// Returns when an enable output changes or lets motion begin, or a reading comes no more.
    pub(super) fn outputs_timeout(&self) -> Option<Ticks> {
        let at = self.enabled_at.map(|at| at.max(self.now));
        let shift = self.shift.as_ref();
        let shift = shift.and_then(|shift| shift.pins.poll_timeout());
        let shift = shift.map(|at| at.max(self.now));
        [at, self.enables.poll_timeout(), shift, self.lidar_until]
            .into_iter()
            .flatten()
            .min()
    }

    /// Asks for a reading and waits for it.
    pub(super) fn begin_lidar(&mut self) {
        let wait_ticks = self.lidar_wait_ticks.unwrap_or(0);
        self.lidar_until = Some(self.now.plus(wait_ticks));
        self.tell(MotionEvent::LidarRequest);
    }

    /// A lidar reading has come: the queue goes on if it waits for one.
    pub fn take_lidar(&mut self) {
        if self.lidar_until.take().is_some() {
            self.end_station();
        }
    }

    /// A reading that is waited for for too long.
    pub(super) fn pass_lidar(&mut self) {
        if self.lidar_until.is_some_and(|until| until <= self.now) {
            self.lidar_until = None;
            self.end_station();
            self.tell(MotionEvent::LidarMissed);
        }
    }
}
