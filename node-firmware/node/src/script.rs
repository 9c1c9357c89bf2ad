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
    around::Around,
    intake::CurrentJob,
    interpreter::ToInterpreter,
    limits::{REPORT_US, SCRIPT_QUIET_US},
    stop::Phase,
    trace::Event,
};
use alloc::{
    boxed::Box,
    string::{String, ToString},
    vec::Vec,
};
use keys::{
    AxisId, Command, JobId, LocalMicros, QueueId, Refusal, ScriptHeader, ScriptOutcome,
    ScriptReport, StopMode, StopReason, Verdict, script::SCRIPT_BYTES_MAX, signed::Proof,
    start::BarrierName, trace::TraceWord,
};
use motion::StepBackend;
use script::{Asked, Desk, End, Script, Step, Told, Wait};

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
    pub(crate) in_group: bool,
    /// Each with the number of its command, once that is in the queue.
    pub(crate) named: Vec<(BarrierName, Option<u64>)>,
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
        script: Runs,
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

/// A script that runs.
#[derive(Debug)]
pub(crate) enum Runs {
    /// Beside the node, in slices between everything else.
    Here(Box<Script>),
    /// On another core: this is its desk, and the number by which its letters are told from those of
    /// scripts before it.
    There {
        /// Never 0.
        run: u32,
        desk: Box<Desk>,
    },
}

impl Runs {
    fn wait(&self) -> Wait {
        match self {
            Self::Here(script) => script.wait(),
            Self::There { desk, .. } => desk.wait(),
        }
    }
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
        let text = match String::from_utf8(text) {
            Ok(text) => text,
            Err(error) => {
                let valid_up_to = error.utf8_error().valid_up_to();
                let message = alloc::format!("{job}: not UTF-8 at byte {valid_up_to}");
                self.fail_script(first_command, job, message, now);
                return Ok(());
            }
        };
        let script = if self.config.scripts_elsewhere {
            let run = self.letters.begin(text, job, &self.config);
            let desk = Box::new(Desk::new(first_command + 1));
            Runs::There { run, desk }
        } else {
            let started = Script::start(
                &text,
                job.as_str(),
                self.config.name.as_str(),
                first_command + 1,
                self.config.script,
                now,
            );
            match started {
                Ok(script) => Runs::Here(Box::new(script)),
                Err(message) => {
                    self.fail_script(first_command, job, message, now);
                    return Ok(());
                }
            }
        };
        self.script = Slot::Running {
            first_command,
            job,
            script,
        };
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
        if let Slot::Running {
            script: Runs::There { .. },
            ..
        } = self.script
        {
            return self.wake_script(now);
        }
        let Slot::Running {
            first_command,
            job,
            script: Runs::Here(mut script),
        } = core::mem::take(&mut self.script)
        else {
            return;
        };
        let step = script.step(&mut Around { node: self, now });
        match step {
            // An emergency stop took the queue with it.
            Step::Waits(_) | Step::Ended(End::Stopped) if self.phase != Phase::Open => {
                self.end_run(&mut Runs::Here(script), now);
            }
            Step::Waits(_) | Step::Ended(End::Stopped) => {
                self.script = Slot::Running {
                    first_command,
                    job,
                    script: Runs::Here(script),
                };
            }
            Step::Ended(End::Returned { json }) => {
                self.return_script(first_command, job, json.unwrap_or_default(), now);
            }
            Step::Ended(End::Failed { message }) => {
                drop(script);
                self.fail_script(first_command, job, message, now);
            }
        }
    }

    /// Notes when what a script on another core waits for is there.
    fn wake_script(&mut self, now: LocalMicros) {
        let Slot::Running {
            first_command,
            job,
            script: Runs::There { run, desk },
        } = core::mem::take(&mut self.script)
        else {
            return;
        };
        if desk.wait() != Wait::Slice && desk.is_due(&Around { node: self, now }) {
            self.letters.due = run;
        }
        self.script = Slot::Running {
            first_command,
            job,
            script: Runs::There { run, desk },
        };
    }

    /// Gives what the interpreter on the other core has to know, `None` if there is nothing. At most
    /// two of them wait.
    pub fn take_script_word(&mut self) -> Option<ToInterpreter> {
        self.letters.pop()
    }

    /// Returns the number of the script on the other core whose wait is over; 0: none.
    pub fn script_due(&self) -> u32 {
        self.letters.due
    }

    /// Takes a letter of the script with this number, and answers it. `None`: it is over, whatever it
    /// does.
    pub fn answer_script(&mut self, now: LocalMicros, run: u32, asked: Asked) -> Option<Told> {
        let now = self.advance_to(now);
        self.run_motion(now);
        let told = self.take_letter(now, run, asked);
        self.run_motion(now);
        self.settle(now);
        told
    }

    fn take_letter(&mut self, now: LocalMicros, run: u32, asked: Asked) -> Option<Told> {
        if let Asked::WasAt { reason, place } = asked {
            self.log_ended(reason, &place, now);
            return None;
        }
        if self.phase != Phase::Open
            || !matches!(&self.script, Slot::Running { script: Runs::There { run: known, .. }, .. } if *known == run)
        {
            return None;
        }
        if let Asked::Print(line) = &asked {
            self.log(now, format_args!("{line}"));
            return Some(Told::HEARD);
        }
        let Slot::Running {
            first_command,
            job,
            script: Runs::There { run, mut desk },
        } = core::mem::take(&mut self.script)
        else {
            return None;
        };
        self.letters.due = 0;
        match asked {
            Asked::Call(call) => {
                let told = desk.answer(&mut Around { node: self, now }, &call);
                let mut script = Runs::There { run, desk };
                if self.phase != Phase::Open {
                    // An emergency stop took the queue with it.
                    self.end_run(&mut script, now);
                    return None;
                }
                self.script = Slot::Running {
                    first_command,
                    job,
                    script,
                };
                return Some(told);
            }
            Asked::Ended(End::Returned { json }) => {
                desk.finish(&mut Around { node: self, now });
                self.return_script(first_command, job, json.unwrap_or_default(), now);
            }
            Asked::Ended(End::Failed { message }) => {
                self.fail_script(first_command, job, message, now);
            }
            // Said above, or by the node itself.
            Asked::Ended(End::Stopped) | Asked::Print(_) | Asked::WasAt { .. } => {}
        }
        None
    }

    fn return_script(&mut self, first_command: u64, job: JobId, json: String, now: LocalMicros) {
        self.trace.note(now, Event::ScriptEnded);
        self.tell_of_job(now, TraceWord::ScriptEnded);
        self.end_endless_drives();
        self.script = Slot::Resting {
            first_command,
            job,
            json,
        };
        self.rest_script(now);
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
            Slot::Running { mut script, .. } => self.end_run(&mut script, now),
            ended @ Slot::Ended { .. } => self.script = ended,
            Slot::None | Slot::Arriving { .. } | Slot::Resting { .. } => {}
        }
    }

    /// Ends a script where it is. One on another core says itself where that was.
    fn end_run(&mut self, script: &mut Runs, now: LocalMicros) {
        let reason = match self.phase {
            Phase::Stopping { reason, .. } | Phase::Latched { reason } => reason.as_str(),
            Phase::Open => "",
        };
        self.trace.note(now, Event::ScriptEnded);
        match script {
            Runs::Here(script) => {
                let place = place_of(&script.traceback(""));
                self.log_ended(reason, &place, now);
            }
            Runs::There { run, .. } => {
                if !self.letters.end(*run, reason) {
                    self.log_ended(reason, UNBEGUN, now);
                }
            }
        }
    }

    fn log_ended(&mut self, reason: &str, place: &str, now: LocalMicros) {
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
            Slot::Running { script, .. } if self.phase == Phase::Open => match script {
                Runs::Here(script) => Some(script.poll_timeout()),
                // Its interpreter looks at the clock, and asks.
                Runs::There { .. } => None,
            },
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

/// Where a script was of which no instruction was executed.
const UNBEGUN: &str = "its first line";

/// Returns the innermost place of the script in a traceback.
pub(crate) fn place_of(traceback: &str) -> String {
    let mut lines = traceback.lines().map(str::trim);
    let place = lines
        .find(|line| !line.is_empty() && !line.starts_with("stack") && !line.starts_with("[C]"));
    place.unwrap_or(UNBEGUN).into()
}

/// What stands for a script in the queue.
const MARK: Command = Command::Pause { pause_ms: 0 };
