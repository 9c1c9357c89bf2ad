//! What a node has beside its step pins: a laser, a lidar, enable pins, a shift register. And what it
//! says of itself to whoever judges its pulses.

use crate::{
    pins::{Pin, PinEvent},
    record::TakenCommand,
};
use keys::{AxisId, Command, LocalMicros, QueueId, command::Ramp};
use motion::{Ticks, io::enable::OutputChange};
use node::Outputs;

/// A drive that begins, is changed, or rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DriveNote {
    /// It is driven from now on, by this ramp or by the speed it has.
    Driven(AxisId, Option<Ramp>, LocalMicros),
    /// It rests.
    Rests(AxisId, Ticks),
}

/// The laser and lidar of an emulated node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bench {
    pub(super) laser_percent: u8,
    pub(super) lidar_requested: bool,
    pub(super) enables: Vec<PinEvent>,
    /// What was shifted out and not yet read back.
    pub(super) shifted: Option<u32>,
    /// What a script has queued since the last look.
    pub(super) queued: Vec<TakenCommand>,
    /// What axes were driven to since the last look.
    pub(super) drives: Vec<DriveNote>,
}

impl Bench {
    /// Returns the laser's power, percent.
    pub fn laser_percent(&self) -> u8 {
        self.laser_percent
    }
}

impl Outputs for Bench {
    fn set_laser(&mut self, power_percent: u8) {
        self.laser_percent = power_percent;
    }

    fn request_lidar(&mut self) {
        self.lidar_requested = true;
    }

    fn shift_out(&mut self, word: u32) {
        self.shifted = Some(word);
    }

    fn set_enable(&mut self, change: OutputChange, at: Ticks) {
        self.enables.push(PinEvent {
            at_ticks: at.0,
            pin: Pin::Enable(change.output as u8),
            level: change.levels()[1],
        });
    }

    fn note_drive(&mut self, axis: AxisId, ramp: Option<Ramp>, now: LocalMicros) {
        self.drives.push(DriveNote::Driven(axis, ramp, now));
    }

    fn note_rest(&mut self, axis: AxisId, at: Ticks) {
        self.drives.push(DriveNote::Rests(axis, at));
    }

    fn note_queued(
        &mut self,
        queue: QueueId,
        first_command: u64,
        commands: &[Command],
        now: LocalMicros,
    ) {
        self.queued.extend(
            commands
                .iter()
                .zip(first_command..)
                .map(|(command, number)| TakenCommand {
                    at: now,
                    queue,
                    number,
                    command: *command,
                }),
        );
    }
}
