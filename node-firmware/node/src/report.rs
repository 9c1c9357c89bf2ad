//! What the node says about itself: the status, the faults in it, and log lines.
//!
//! A status is made at the moment it leaves, complete each time. It is due 10 times a second
//! while commands are executed, once a second otherwise, and at once when the state changes, a
//! job begins or ends, a stop begins or ends, a latch is lifted, a fault is noted, or the link comes.

use crate::{
    Node, Outputs,
    limits::{STATUS_ACTIVE_US, STATUS_IDLE_US},
    start::Start,
    trace::Event,
};
use core::fmt;
use keys::{
    AxisId, AxisStatus, Fault, Features, LocalMicros, NodeState, Status, StopReason,
    status::FaultCode, trace::TraceWord,
};
use motion::StepBackend;

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Returns what the node does, as of the last `now`.
    pub fn state(&self) -> NodeState {
        match self.phase.latch() {
            Some(StopReason::Fault) => NodeState::Fault,
            Some(_) => NodeState::Stopped,
            None if self.motion.is_paused() || self.pace.waits() => NodeState::Paused,
            None if self.start != Start::Open => NodeState::Ready,
            None if self.motion.is_active() || self.script.is_running() => NodeState::Running,
            None => NodeState::Idle,
        }
    }

    /// Returns the status as of the last `now`.
    pub fn status(&self) -> Status {
        let axes = (0..self.motion.axis_count()).map(|axis| {
            let axis = AxisId(axis as u8);
            AxisStatus {
                position_steps: self.motion.position_steps(axis),
                speed_mhz: self.motion.speed_mhz(axis),
            }
        });
        Status {
            at: self.now,
            queue: self.queue,
            state: self.state(),
            stop: self.last_stop.clone(),
            job: self.job.map(|job| job.id),
            accepted_commands: self.motion.accepted_commands(),
            executed_commands: self.motion.executed_commands(),
            credit_commands: u32::try_from(self.motion.credit_commands()).unwrap_or(u32::MAX),
            axes: axes.collect(),
            faults: self.faults.clone(),
            features: self
                .motion
                .features()
                .with(Features::LUA)
                .with(Features::PACE)
                .with(Features::JOG)
                .with(Features::EPOCH),
            firmware: self.config.firmware,
            rssi_dbm: self.rssi_dbm,
            laser_percent: self.laser_percent,
            lidar_mm: self.lidar_mm,
        }
    }

    /// Returns when the next status is due by the clock, `None` without a link or when one is
    /// waiting already.
    pub(crate) fn status_timeout(&self) -> Option<LocalMicros> {
        let period_us = if self.motion.is_active() {
            STATUS_ACTIVE_US
        } else {
            STATUS_IDLE_US
        };
        (self.link_up() && !self.status_due).then(|| self.status_told_at.plus_us(period_us))
    }

    /// Notes a fault in the status. One that repeats itself keeps a single place, so that it
    /// cannot push out the others.
    pub(crate) fn note_fault(&mut self, code: FaultCode, now: LocalMicros) {
        self.trace.note(now, Event::Fault(code));
        self.tell_of_job(now, TraceWord::Fault(code));
        let fault = Fault { code, at: now };
        match self.faults.last_mut() {
            Some(last) if last.code == code => *last = fault,
            _ => {
                if self.faults.is_full() {
                    self.faults.remove(0);
                }
                // Cannot fail: there is room for one.
                let _ = self.faults.push(fault);
            }
        }
        self.status_due = true;
        self.log(now, format_args!("fault {}: {}", code.0, code.as_str()));
    }

    /// Queues one line for the topic `log`: what the node's hardware has to tell.
    pub fn tell(&mut self, now: LocalMicros, text: fmt::Arguments<'_>) {
        self.log(now, text);
    }

    /// Queues one line for the topic `log`.
    pub(crate) fn log(&mut self, now: LocalMicros, text: fmt::Arguments<'_>) {
        if !self.outbox.push_line(text) {
            self.trace.note(now, Event::LogDropped);
        }
    }
}
