//! The script of a job: arrives in parts, runs between everything else, fills the queue, reports.
//!
//! ```text
//!   Order::Script ─▶ Arriving ─ last part ─▶ Running ─ returned ─▶ Ended ─ ScriptSeen ─▶ None
//!                                    │          ├──── failed ────▶ Ended, queue dropped
//!                                    │          └──── stop ──────▶ None, a line in the log
//!                                    └ does not compile ─────────▶ Ended, queue dropped
//! ```
//!
//! A script takes one number in the queue, as a pause of 0 ms; what it queues comes behind. Until it
//! ends, no batch is taken: the queue is its own. Every stop ends it, with the queue; nothing of it
//! is resumed. One that fails drops the queue and lets the axes come to rest on their ramps, without
//! a latch, like a cancel.

use crate::{
    LinkLoss, Node, Outputs,
    intake::CurrentJob,
    limits::{BARRIERS_MAX, PUBLICATIONS_MAX, REPORT_US, SCRIPT_QUIET_US},
    stop::Phase,
    trace::Event,
};
use alloc::{
    boxed::Box,
    string::{String, ToString},
    vec::Vec,
};
use keys::{
    AxisId, Command, JobId, LocalMicros, NodeState, QueueId, Refusal, ScriptHeader, ScriptOutcome,
    ScriptReport, StopMode, StopReason, Verdict, command::Ramp, script::SCRIPT_BYTES_MAX,
    signed::Proof, start::BarrierName, trace::TraceWord,
};
use motion::{CommandError, DriveError, StepBackend, Target};
use script::{BarrierError, End, Full, Host, LidarReading, Script, Step, Wait};

/// What a script has published and the link has not taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Publication {
    pub(crate) suffix: heapless::String<32>,
    pub(crate) json: String,
}

/// The meeting points that a script has named.
#[derive(Debug, Default)]
pub(crate) struct Barriers {
    /// It is a part of a synchronized job.
    in_group: bool,
    /// Each with the number of its command, once that is in the queue.
    named: Vec<(BarrierName, Option<u64>)>,
}

/// Where the script of the queue is.
#[derive(Debug, Default)]
pub(crate) enum Slot {
    /// There is none.
    #[default]
    None,
    /// Not all of its text is here.
    Arriving {
        first_command: u64,
        job: JobId,
        text: Vec<u8>,
    },
    /// It runs.
    Running {
        first_command: u64,
        job: JobId,
        script: Box<Script>,
    },
    /// It has returned, and what it drives has not come to rest.
    Resting {
        first_command: u64,
        job: JobId,
        json: String,
    },
    /// It is over, and the gateway may not know.
    Ended {
        report: ScriptReport,
        text: String,
        say_at: LocalMicros,
    },
}

impl Slot {
    pub(crate) fn is_running(&self) -> bool {
        matches!(self, Self::Running { .. } | Self::Resting { .. })
    }

    /// Returns whether it runs and will add no command before something else has happened.
    fn rests(&self) -> bool {
        match self {
            Self::Running { script, .. } => script.wait() != Wait::Slice,
            _ => true,
        }
    }
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes a part of a script.
    pub(crate) fn take_script(
        &mut self,
        header: ScriptHeader,
        part: &[u8],
        proof: Option<&Proof>,
        now: LocalMicros,
    ) -> Result<Verdict, Refusal> {
        let total = header.total_bytes as usize;
        let offset = header.offset_bytes as usize;
        if part.is_empty() || total > SCRIPT_BYTES_MAX || offset + part.len() > total {
            return Err(Refusal::Malformed);
        }
        self.demand_open(header.queue)?;
        let accepted = self.motion.accepted_commands();
        if header.first_command < accepted {
            return Ok(Verdict::Duplicate);
        }
        if header.first_command > accepted {
            return Err(Refusal::Gap);
        }
        if self.script.is_running() {
            return Err(Refusal::ScriptRuns);
        }
        let same = matches!(
            &self.script,
            Slot::Arriving { first_command, job, .. }
                if (*first_command, *job) == (header.first_command, header.job)
        );
        if !same {
            if offset > 0 {
                return Err(Refusal::Gap);
            }
            self.script = Slot::Arriving {
                first_command: header.first_command,
                job: header.job,
                text: Vec::with_capacity(total),
            };
        }
        let Slot::Arriving { text, .. } = &mut self.script else {
            return Err(Refusal::Gap);
        };
        if offset > text.len() {
            return Err(Refusal::Gap);
        }
        if let Some(news) = part.get(text.len() - offset..) {
            text.extend_from_slice(news);
        }
        if text.len() >= total {
            let (signers, name) = (&self.config.signers, &self.config.name);
            let place = (header.queue, header.first_command);
            let checked = self
                .signed
                .check_script(signers, name, proof, place, &header.job, text);
            let signed = checked.inspect_err(|_| self.script = Slot::None)?;
            self.begin_script(now)?;
            self.signed.advance(&self.config.signers, signed);
        }
        Ok(Verdict::Accepted)
    }

    /// All of the text is here.
    fn begin_script(&mut self, now: LocalMicros) -> Result<(), Refusal> {
        let reserved = self.motion.reserve(1);
        let mut reservation = reserved.map_err(|_| Refusal::QueueShort)?;
        reservation.push(&MARK);
        reservation.commit();
        let Slot::Arriving {
            first_command,
            job,
            text,
        } = core::mem::take(&mut self.script)
        else {
            return Err(Refusal::Gap);
        };
        self.outputs
            .note_queued(self.queue, first_command, &[MARK], now);
        self.motion.expect_more(0);
        // A part of a synchronized job has the barrier of its start before it.
        self.barriers = Barriers {
            in_group: self.job.is_some_and(|current| current.id == job),
            named: Vec::new(),
        };
        self.script_queued_at = now;
        self.job = Some(CurrentJob {
            id: job,
            end: u64::MAX,
        });
        self.status_due = true;
        self.trace.note(now, Event::ScriptBegun);
        self.begin_job(first_command, u64::MAX, now);
        let started = match core::str::from_utf8(&text) {
            Ok(text) => Script::start(
                text,
                job.as_str(),
                self.config.name.as_str(),
                first_command + 1,
                self.config.script,
                now,
            ),
            Err(error) => Err(alloc::format!(
                "{job}: not UTF-8 at byte {}",
                error.valid_up_to()
            )),
        };
        match started {
            Ok(script) => {
                self.script = Slot::Running {
                    first_command,
                    job,
                    script: Box::new(script),
                };
            }
            Err(message) => self.fail_script(first_command, job, message, now),
        }
        Ok(())
    }

    /// Begins the stored script `boot`, if the configuration allows it and there is one. Whoever has
    /// put the stored scripts back after a start calls this once.
    pub fn run_boot_script(&mut self, now: LocalMicros) {
        let now = self.advance_to(now);
        let text = self.stored.runnable(BOOT.as_str()).map(String::from);
        let Some(text) = text.filter(|_| self.config.boot_script && !self.script.is_running())
        else {
            return;
        };
        self.script = Slot::Arriving {
            first_command: self.motion.accepted_commands(),
            job: BOOT,
            text: text.into_bytes(),
        };
        // A ring has room for one at least when a node starts.
        if self.begin_script(now).is_err() {
            self.script = Slot::None;
        }
        self.settle(now);
    }

    /// Lets the script go on, if there is one and it can.
    pub(crate) fn run_script(&mut self, now: LocalMicros) {
        if !self.script.is_running() {
            return self.say_report(now);
        }
        if self.phase != Phase::Open {
            return;
        }
        if let Slot::Resting { .. } = self.script {
            return self.rest_script(now);
        }
        let Slot::Running {
            first_command,
            job,
            mut script,
        } = core::mem::take(&mut self.script)
        else {
            return;
        };
        let step = script.step(&mut Around { node: self, now });
        match step {
            // An emergency stop took the queue with it.
            Step::Waits(_) | Step::Ended(End::Stopped) if self.phase != Phase::Open => {
                self.log_ended(&mut script, now);
            }
            Step::Waits(_) | Step::Ended(End::Stopped) => {
                self.script = Slot::Running {
                    first_command,
                    job,
                    script,
                };
            }
            Step::Ended(End::Returned { json }) => {
                self.trace.note(now, Event::ScriptEnded);
                self.tell_of_job(now, TraceWord::ScriptEnded);
                self.end_endless_drives();
                self.script = Slot::Resting {
                    first_command,
                    job,
                    json: json.unwrap_or_default(),
                };
                self.rest_script(now);
            }
            Step::Ended(End::Failed { message }) => {
                drop(script);
                self.fail_script(first_command, job, message, now);
            }
        }
    }

    /// What runs without an end comes to rest with the script, what has a target arrives.
    fn end_endless_drives(&mut self) {
        for axis in (0..self.motion.axis_count()).map(|axis| AxisId(axis as u8)) {
            if self.motion.is_endless(axis) {
                self.motion.end_drive_of(axis);
            }
        }
    }

    /// A script that has returned is over when nothing is driven.
    fn rest_script(&mut self, now: LocalMicros) {
        if self.motion.is_driving() {
            return;
        }
        if let Slot::Resting {
            first_command,
            job,
            json,
        } = core::mem::take(&mut self.script)
        {
            let end_command = self.motion.accepted_commands();
            self.job = Some(CurrentJob {
                id: job,
                end: end_command,
            });
            let outcome = ScriptOutcome::Returned;
            self.report_script(first_command, end_command, job, outcome, json, now);
        }
    }

    fn fail_script(&mut self, first_command: u64, job: JobId, message: String, now: LocalMicros) {
        self.trace.note(now, Event::ScriptFailed);
        self.tell_of_job(now, TraceWord::ScriptFailed);
        let first_line = message.lines().next().unwrap_or_default().to_string();
        self.log(now, format_args!("script failed: {first_line}"));
        let end_command = self.motion.accepted_commands();
        let outcome = ScriptOutcome::Failed;
        self.report_script(first_command, end_command, job, outcome, message, now);
        self.begin_stop(StopReason::Cancel, StopMode::Decelerate, now);
    }

    fn report_script(
        &mut self,
        first_command: u64,
        end_command: u64,
        job: JobId,
        outcome: ScriptOutcome,
        text: String,
        now: LocalMicros,
    ) {
        self.script = Slot::Ended {
            report: ScriptReport {
                queue: self.queue,
                first_command,
                end_command,
                job,
                outcome,
            },
            text,
            say_at: now,
        };
        self.status_due = true;
        self.say_report(now);
    }

    /// Says how the last script ended, until somebody has heard it.
    pub(crate) fn say_report(&mut self, now: LocalMicros) {
        if let Slot::Ended { say_at, .. } = &mut self.script
            && *say_at <= now
            && self.link_gone_at.is_none()
        {
            *say_at = now.plus_us(REPORT_US);
            self.report_due = true;
        }
    }

    /// Somebody has heard it.
    pub(crate) fn take_script_seen(&mut self, queue: QueueId, first_command: u64) -> Verdict {
        if let Slot::Ended { report, .. } = &self.script
            && (report.queue, report.first_command) == (queue, first_command)
        {
            self.script = Slot::None;
            self.report_due = false;
        }
        Verdict::Duplicate
    }

    /// A stop, a cancel or a fault drops the queue, and the script with it.
    pub(crate) fn drop_script(&mut self, now: LocalMicros) {
        self.barriers = Barriers::default();
        match core::mem::take(&mut self.script) {
            Slot::Running { mut script, .. } => self.log_ended(&mut script, now),
            ended @ Slot::Ended { .. } => self.script = ended,
            Slot::None | Slot::Arriving { .. } | Slot::Resting { .. } => {}
        }
    }

    fn log_ended(&mut self, script: &mut Script, now: LocalMicros) {
        let reason = match self.phase {
            Phase::Stopping { reason, .. } | Phase::Latched { reason } => reason.as_str(),
            Phase::Open => "",
        };
        let place = script.traceback("");
        let place = place.lines().map(str::trim).find(|line| {
            !line.is_empty() && !line.starts_with("stack") && !line.starts_with("[C]")
        });
        let place = place.unwrap_or("its first line");
        self.trace.note(now, Event::ScriptEnded);
        self.log(
            now,
            format_args!("script ended: {reason}; it was at {place}"),
        );
    }

    /// Returns whether a start need not wait for the script: it has queued what it could.
    pub(crate) fn script_rests(&self, now: LocalMicros) -> bool {
        self.script.rests() || now.since_us(self.script_queued_at) >= SCRIPT_QUIET_US
    }

    /// Returns the name of the barrier that is this command of the queue, if a script has named it.
    pub(crate) fn barrier_name(&self, command: u64) -> Option<BarrierName> {
        let mut named = self.barriers.named.iter();
        let found = named.find(|(_, number)| *number == Some(command));
        found.map(|(name, _)| *name)
    }

    /// Returns when [`Node::run_script`] has something to do by the clock.
    pub(crate) fn script_timeout(&self) -> Option<LocalMicros> {
        match &self.script {
            Slot::Running { script, .. } if self.phase == Phase::Open => {
                Some(script.poll_timeout())
            }
            Slot::Ended { say_at, .. } if self.link_up() => Some(*say_at),
            _ => None,
        }
    }

    /// Returns whether the loss of the link ends something: a motion, or a script that may begin one.
    pub(crate) fn is_busy(&self) -> bool {
        self.motion.is_active()
            || (self.script.is_running() && self.config.link_loss != LinkLoss::Finish)
    }
}

/// The name of the script that may run at the start, and of its job.
const BOOT: JobId = match JobId::new("boot") {
    Ok(name) => name,
    Err(_) => panic!("a name"),
};

/// What stands for a script in the queue.
const MARK: Command = Command::Pause { pause_ms: 0 };

/// The node as its script sees it.
struct Around<'a, 'm, B: StepBackend, O: Outputs> {
    node: &'a mut Node<'m, B, O>,
    now: LocalMicros,
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

    fn drive(&mut self, axis: AxisId, target: Target, ramp: Ramp) -> Result<(), DriveError> {
        self.node.motion.drive(axis, target, ramp.into())?;
        self.node.outputs.note_drive(axis, Some(ramp), self.now);
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
