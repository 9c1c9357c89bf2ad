//! What is recorded of one boot, and how it becomes a [`Life`].

use super::{EmulatedNode, InnerNode, outputs::DriveNote};
use crate::{
    config::{EmulatorConfig, Recording},
    pins::PinEvent,
    record::{Driven, Held, InputEdge, Life, Speed, TakenCommand},
};
use keys::{AxisId, BatchReader, LocalMicros, Order, QueueId, StopReport, epoch, signed::Proof};
use motion::{TICKS_PER_US, io::input::PinLevel};
use std::mem;

/// All of its speed.
pub(super) const SHARE_AT_BOOT: u32 = 1 << 16;

/// See the module; [`Life`] says what each of them is.
#[derive(Clone, Debug, Default)]
pub(super) struct Recorded {
    pub(super) commands: Vec<TakenCommand>,
    pub(super) stops: Vec<StopReport>,
    pub(super) stopping: Option<(QueueId, LocalMicros)>,
    pub(super) cancels: Vec<(QueueId, LocalMicros)>,
    pub(super) edges: Vec<PinEvent>,
    pub(super) inputs: Vec<InputEdge>,
    pub(super) holds: Vec<Held>,
    pub(super) speeds: Vec<Speed>,
    pub(super) drives: Vec<Driven>,
    pub(super) paced: bool,
    pub(super) cut: bool,
}

impl Recorded {
    fn into_life(self, node: &InnerNode, config: &EmulatorConfig) -> Life {
        let axis_count = node.motion().axis_count();
        let axes = (0..axis_count).map(|axis| AxisId(axis as u8));
        Life {
            boot: node.queue().boot,
            axis_count,
            commands: self.commands,
            stops: self.stops,
            stopping: self.stopping,
            cancels: self.cancels,
            edges: self.edges,
            inputs: self.inputs,
            holds: self.holds,
            speeds: self.speeds,
            drives: self.drives,
            homes: config.home_facts(),
            beside: config.beside_facts(),
            inverted: config.inverted(),
            external: config.external(),
            lidar_waits: config.motion.lidar_wait_ms.is_some(),
            paced: self.paced,
            cut: self.cut,
            counted_steps: axes
                .map(|axis| node.motion().backend().step_count(axis))
                .collect(),
            status: node.status(),
        }
    }
}

impl EmulatedNode {
    /// Returns the record of this boot so far. Copies it.
    pub fn life(&self) -> Life {
        self.recorded.clone().into_life(&self.node, &self.config)
    }

    pub(super) fn take_life(&mut self) -> Life {
        mem::take(&mut self.recorded).into_life(&self.node, &self.config)
    }

    /// Notes the commands that went into the ring, if it has more than `accepted_before` now, and a
    /// cancel that has not come to its end.
    pub(super) fn record_taken(&mut self, payload: &[u8], accepted_before: u64, now: LocalMicros) {
        let Recording::Edges { max } = self.config.record else {
            return;
        };
        if self.recorded.cut {
            return;
        }
        // Who says it and who signs it is not for the judge of pulses.
        let Ok(mut reader) = epoch::split(payload)
            .and_then(|(_, order)| Proof::split(order))
            .and_then(|(_, order)| BatchReader::new(order))
        else {
            return;
        };
        let header = match *reader.order() {
            Order::Batch(header) => header,
            Order::Cancel { queue, .. } if queue == self.node.queue() => {
                self.recorded.cancels.push((queue, now));
                self.recorded.cut |= self.recorded.cancels.len() > max;
                return;
            }
            _ => return,
        };
        if self.node.motion().accepted_commands() == accepted_before {
            return;
        }
        if self.recorded.commands.len() + usize::from(header.command_count) > max {
            self.recorded.cut = true;
            return;
        }
        let mut number = header.first_command;
        while let Ok(Some(command)) = reader.next_command() {
            self.recorded.commands.push(TakenCommand {
                at: now,
                queue: header.queue,
                number,
                command,
            });
            number += 1;
        }
    }

    /// Notes whether motion is held or stopping now, and its speed.
    pub(super) fn record_hold(&mut self) {
        let motion = self.node.motion();
        let at = motion.now().0;
        let since = LocalMicros(at / TICKS_PER_US);
        self.recorded.stopping = match self.recorded.stopping {
            _ if !motion.is_stopping() => None,
            Some(stopping) => Some(stopping),
            None => Some((self.node.queue(), since)),
        };
        let share = motion.speed_share();
        let before = self.recorded.speeds.last();
        if let Recording::Edges { max } = self.config.record
            && share != before.map_or(SHARE_AT_BOOT, |speed| speed.share)
            && !self.recorded.cut
        {
            self.recorded.speeds.push(Speed {
                at_ticks: at,
                share,
            });
            self.recorded.cut |= self.recorded.speeds.len() > max;
        }
        let open = self.recorded.holds.last_mut();
        let open = open.filter(|held| held.until_ticks.is_none());
        match (open, motion.is_held(), self.config.record) {
            (Some(held), false, _) => held.until_ticks = Some(at),
            (None, true, Recording::Edges { max }) if !self.recorded.cut => {
                self.recorded.holds.push(Held {
                    from_ticks: at,
                    until_ticks: None,
                });
                self.recorded.cut |= self.recorded.holds.len() > max;
            }
            _ => {}
        }
    }

    /// Notes which axes are driven now.
    pub(super) fn record_drives(&mut self) {
        let notes = mem::take(&mut self.node.outputs_mut().drives);
        let Recording::Edges { max } = self.config.record else {
            return;
        };
        if self.recorded.cut {
            return;
        }
        let drives = &mut self.recorded.drives;
        for note in notes {
            let (DriveNote::Driven(axis, ..) | DriveNote::Rests(axis, _)) = note;
            let open = drives.iter_mut().rfind(|driven| driven.axis == axis);
            let open = open.filter(|driven| driven.until_ticks.is_none());
            match (note, open) {
                (DriveNote::Rests(_, at), Some(driven)) => driven.until_ticks = Some(at.0),
                (DriveNote::Driven(_, ramp, _), Some(driven)) => driven.orders.extend(ramp),
                (DriveNote::Driven(axis, ramp, now), None) => drives.push(Driven {
                    axis,
                    from_ticks: now.0 * TICKS_PER_US,
                    until_ticks: None,
                    orders: ramp.into_iter().collect(),
                }),
                (DriveNote::Rests(..), None) => {}
            }
        }
        // A stop ends them without a word.
        let motion = self.node.motion();
        let open = drives
            .iter_mut()
            .filter(|driven| driven.until_ticks.is_none());
        for driven in open.filter(|driven| !motion.is_driven(driven.axis)) {
            driven.until_ticks = Some(motion.now().0);
        }
        let orders: usize = drives.iter().map(|driven| driven.orders.len()).sum();
        self.recorded.cut |= orders > max;
    }

    /// Takes the changes of pins since the last call, in order of time.
    pub(super) fn take_edges(&mut self) {
        let from = self.recorded.edges.len();
        self.recorded
            .edges
            .extend(self.node.motion_mut().backend_mut().take_edges());
        if self.watches_pins() {
            self.recorded
                .edges
                .append(&mut self.node.outputs_mut().enables);
        } else {
            self.node.outputs_mut().enables.clear();
        }
        // Axes play one after the other within one call.
        self.recorded.edges[from..].sort_by_key(|event| event.at_ticks);
    }

    /// Keeps what is recorded of them.
    pub(super) fn keep_edges(&mut self, from: usize) {
        if let Some(vcd) = self.vcd.as_mut() {
            for event in &self.recorded.edges[from..] {
                if let Err(error) = vcd.write(event) {
                    self.vcd_error.get_or_insert(error);
                    self.vcd = None;
                    break;
                }
            }
        }
        let edges_max = self.recorded_max();
        if self.recorded.cut || edges_max == 0 {
            self.recorded.edges.truncate(from);
        } else if self.recorded.edges.len() > edges_max {
            self.recorded.edges.truncate(edges_max);
            self.recorded.cut = true;
        }
    }

    pub(super) fn record_input(&mut self, level: PinLevel) {
        if self.recorded.inputs.len() < self.recorded_max() {
            self.recorded.inputs.push(InputEdge {
                at_ticks: level.at.0,
                index: level.index,
                level: level.level,
                counted_steps: level.counted_steps,
            });
        }
    }

    pub(super) fn watches_pins(&self) -> bool {
        self.vcd.is_some() || self.recorded_max() > 0
    }

    pub(super) fn recorded_max(&self) -> usize {
        match self.config.record {
            Recording::Off => 0,
            Recording::Edges { max } => max,
        }
    }
}
