//! The node as its script sees it, for the time of one step or of one call.

use crate::{
    Node, Outputs,
    limits::{BARRIERS_MAX, PUBLICATIONS_MAX},
    script::Publication,
};
use keys::{AxisId, Command, LocalMicros, NodeState, StopMode, StopReason, start::BarrierName};
use motion::{CommandError, Course, DriveError, StepBackend, Target};
use script::{BarrierError, Full, Host, LidarReading};

/// See the module.
pub(crate) struct Around<'a, 'm, B: StepBackend, O: Outputs> {
    pub(crate) node: &'a mut Node<'m, B, O>,
    pub(crate) now: LocalMicros,
}

impl<B: StepBackend, O: Outputs> Host for Around<'_, '_, B, O> {
    fn now(&self) -> LocalMicros {
        self.now
    }

    fn axis_count(&self) -> usize {
        self.node.motion.axis_count()
    }

    fn check(&self, command: &Command) -> Result<(), CommandError> {
        self.node.motion.check(command)
    }

    fn credit_commands(&self) -> usize {
        self.node.motion.credit_commands()
    }

    fn barrier(&mut self, name: BarrierName) -> Result<u16, BarrierError> {
        let barriers = &mut self.node.barriers;
        if !barriers.in_group {
            return Err(BarrierError::Alone);
        }
        let known = barriers.named.iter().position(|(known, _)| *known == name);
        let number = known.unwrap_or(barriers.named.len());
        if number >= BARRIERS_MAX {
            return Err(BarrierError::Many);
        }
        if known.is_none() {
            barriers.named.push((name, None));
        }
        Ok(number as u16)
    }

    fn push(&mut self, commands: &[Command]) {
        let node = &mut *self.node;
        let first = node.motion.accepted_commands();
        node.script_queued_at = self.now;
        for (command, number) in commands.iter().zip(first..) {
            if let Command::Barrier { barrier } = command
                && let Some(named) = node.barriers.named.get_mut(usize::from(*barrier))
            {
                named.1 = Some(number);
            }
        }
        // The script never has more than the credit it was told.
        if let Ok(mut reservation) = node.motion.reserve(commands.len()) {
            for command in commands {
                reservation.push(command);
            }
            reservation.commit();
            node.outputs
                .note_queued(node.queue, first, commands, self.now);
        }
    }

    fn accepted_commands(&self) -> u64 {
        self.node.motion.accepted_commands()
    }

    fn executed_commands(&self) -> u64 {
        self.node.motion.executed_commands()
    }

    fn position_steps(&self, axis: AxisId) -> i64 {
        self.node.motion.position_steps(axis)
    }

    fn speed_mhz(&self, axis: AxisId) -> i32 {
        self.node.motion.speed_mhz(axis)
    }

    fn is_active(&self) -> bool {
        self.node.motion.is_active()
    }

    fn state(&self) -> NodeState {
        self.node.state()
    }

    fn hold(&mut self) {
        self.node.hold(self.now);
    }

    fn resume(&mut self) {
        self.node.resume(self.now);
    }

    fn set_speed_percent(&mut self, percent: u16) -> Result<(), CommandError> {
        if self.node.change_speed(percent) {
            Ok(())
        } else {
            Err(CommandError::Range)
        }
    }

    fn drive(&mut self, axis: AxisId, target: Target, course: Course) -> Result<(), DriveError> {
        self.node.motion.drive(axis, target, course)?;
        let ramp = Some(course.ramp());
        self.node.outputs.note_drive(axis, ramp, self.now);
        Ok(())
    }

    fn end_drive(&mut self, axis: Option<AxisId>) {
        match axis {
            Some(axis) => self.node.motion.end_drive_of(axis),
            None => self.node.motion.end_drive(StopMode::Decelerate),
        }
    }

    fn is_driven(&self, axis: AxisId) -> bool {
        self.node.motion.is_driven(axis)
    }

    fn emergency_stop(&mut self) {
        let now = self.now;
        self.node
            .begin_stop(StopReason::Client, StopMode::Halt, now);
    }

    fn laser_percent(&self) -> u8 {
        self.node.laser_percent
    }

    fn lidar(&self) -> LidarReading {
        LidarReading {
            count: self.node.lidar_count,
            mm: self.node.lidar_mm,
        }
    }

    fn input(&self, name: &str) -> Option<bool> {
        self.node.input_named(name)
    }

    fn print(&mut self, line: &str) {
        let now = self.now;
        self.node.log(now, format_args!("{line}"));
    }

    fn publish(&mut self, suffix: &str, json: &str) -> Result<(), Full> {
        let node = &mut *self.node;
        if node.publications.len() >= PUBLICATIONS_MAX {
            // Without a link nobody would hear it, and a script must not wait for one.
            return if node.link_gone_at.is_some() {
                Ok(())
            } else {
                Err(Full)
            };
        }
        let suffix = suffix.chars().collect();
        let json = json.into();
        let publication = Publication { suffix, json };
        node.publications.push_back(publication).map_err(|_| Full)
    }

    fn stored(&self, name: &str) -> Option<&str> {
        self.node.stored.runnable(name)
    }
}
