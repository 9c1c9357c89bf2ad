//! Steps by number alone, for a boot in which the node was homed, and was held or ran at another speed:
//! then only the node's operator knows when a step was due.

use super::{Judge, positions_after};
use crate::record::Life;
use keys::Command;

impl Judge<'_> {
    /// Compares the edges with the counters, and the positions with what the commands add up to if
    /// all of them have ended.
    pub(super) fn count(&mut self, life: &Life) {
        for axis in 0..self.axes.len() {
            let counted: i64 = self.axes[axis].steps.iter().map(|step| step.sign).sum();
            let counted = counted + self.axes[axis].driven_steps;
            if counted != life.counted_steps[axis] {
                let counter = life.counted_steps[axis];
                self.wrong(
                    None,
                    format!("axis {axis}: {counted} edges, {counter} counted"),
                );
            }
        }
        let homes = |command: &Command| matches!(command, Command::Home { .. });
        let mut commands = life.commands.iter().map(|taken| &taken.command);
        let status = &life.status;
        let ended = status.executed_commands == life.commands.len() as u64;
        let driven = !life.drives.is_empty();
        if driven || life.cut || !life.stops.is_empty() || !ended || commands.any(homes) {
            return;
        }
        let commands = life.commands.iter().map(|taken| &taken.command);
        let expected = positions_after(commands, self.axes.len());
        for (axis, (expected, told)) in expected.iter().zip(&status.axes).enumerate() {
            let told = told.position_steps;
            if *expected != told {
                let message = format!("axis {axis}: at {told}, its commands lead to {expected}");
                self.wrong(None, message);
            }
        }
        self.summary.commands = life.commands.len() as u64;
    }
}
