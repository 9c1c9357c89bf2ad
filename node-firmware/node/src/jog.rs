//! Jogging: moves of single axes by hand, while nothing else is to be done.
//!
//! Owns who may begin one, the numbers by which they are renewed, and the leases: an axis whose lease
//! runs out comes to rest by its own ramp, whatever has become of whoever held the button. Motion does
//! the work: targets and speeds change in flight, soft limits hold an axis inside, switches stop it. The
//! queue waits while an axis is driven: a job that arrives meanwhile begins when all of them rest.
//!
//! A request is a question with a number before it (4 bytes, low byte first), by which the answer finds
//! back: on the board the two are on different cores.

use crate::{
    Node, Outbound, Outputs,
    limits::{JOG_ANSWERS_MAX, OUTBOUND_BYTES_MAX},
    stop::Phase,
    trace::Event,
};
use alloc::{
    collections::VecDeque,
    string::{String, ToString},
};
use core::fmt::Write;
use keys::{
    AxisId, LocalMicros, NodeTopic,
    jog::{
        JogOrder, JogReceipt, JogRefusal, JogRefusalError, JogRequest, JogTarget, JogWay,
        LEASE_MS_DEFAULT, REQUEST_BYTES_MAX,
    },
};
use motion::{Course, Direction, DriveError, StepBackend, Target, limits::CHANNELS};

/// One axis that is jogged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Jog {
    number: u32,
    lease: Option<Lease>,
}

/// How long it goes on by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Lease {
    ms: u32,
    until: LocalMicros,
}

impl Lease {
    fn from(now: LocalMicros, ms: u32) -> Self {
        let until = now.plus_us(u64::from(ms) * 1_000);
        Self { ms, until }
    }
}

/// What stands before the number of an answer that refuses.
pub(crate) const REFUSED: char = '!';

/// What a request is answered.
type Answer = Result<String, String>;

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Jogs {
    last_number: u32,
    axes: [Option<Jog>; CHANNELS],
    /// Answers that wait for the link.
    /// At most [`JOG_ANSWERS_MAX`].
    answers: VecDeque<(u32, Answer)>,
}

impl Jogs {
    /// Nothing goes on: whatever comes next is another jog.
    pub(crate) fn forget(&mut self) {
        self.axes = [None; CHANNELS];
    }

    /// An axis rests.
    pub(crate) fn forget_axis(&mut self, axis: AxisId) {
        if let Some(jog) = self.axes.get_mut(usize::from(axis.0)) {
            *jog = None;
        }
    }

    /// Returns when the first lease runs out.
    pub(crate) fn timeout(&self) -> Option<LocalMicros> {
        let leases = self.axes.iter().flatten().filter_map(|jog| jog.lease);
        leases.map(|lease| lease.until).min()
    }

    /// Without a link nobody waits for an answer.
    pub(crate) fn link_down(&mut self) {
        self.answers.clear();
    }

    /// Gives the next answer.
    pub(crate) fn pop_answer(&mut self) -> Option<Outbound> {
        let (number, answer) = self.answers.pop_front()?;
        let mut suffix = heapless::String::new();
        let (mark, json) = match &answer {
            Ok(json) => (None, json),
            Err(json) => (Some(REFUSED), json),
        };
        // Cannot fail: a mark and ten digits.
        let _ = mark.map_or(Ok(()), |mark| suffix.push(mark));
        let _ = write!(suffix, "{number}");
        Some(Outbound {
            topic: NodeTopic::Jog,
            suffix,
            payload: json.bytes().take(OUTBOUND_BYTES_MAX).collect(),
        })
    }

    fn of(&self, axis: AxisId) -> Option<Jog> {
        self.axes.get(usize::from(axis.0)).copied().flatten()
    }
}

/// Why a request has no effect: the code that clients know, and words.
struct Refused(&'static str, String);

impl Refused {
    fn new(code: &'static str, message: &str) -> Self {
        Self(code, message.to_string())
    }
}

impl From<DriveError> for Refused {
    fn from(error: DriveError) -> Self {
        let code = match error {
            DriveError::Command(_) => "bad_command",
            DriveError::Busy | DriveError::Limit(_) | DriveError::Still => "not_allowed",
        };
        Self(code, error.to_string())
    }
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes a question: a number, and a request.
    pub(crate) fn ask_jog(&mut self, payload: &[u8], now: LocalMicros) {
        let Some((number, request)) = payload.split_first_chunk() else {
            self.trace.note(now, Event::MessageDropped);
            return;
        };
        let answer = self.jog(now, request);
        if self.jogs.answers.len() >= JOG_ANSWERS_MAX {
            self.jogs.answers.pop_front();
            self.trace.note(now, Event::ReplyDropped);
        }
        let number = u32::from_le_bytes(*number);
        self.jogs.answers.push_back((number, answer));
    }

    /// Takes a request for a jog, JSON ([`JogRequest`]), and gives the answer, JSON too.
    ///
    /// # Errors
    /// The answer says why nothing has happened: [`JogRefusal`].
    pub fn jog(&mut self, now: LocalMicros, payload: &[u8]) -> Result<String, String> {
        let now = self.advance_to(now);
        self.run_motion(now);
        let answer = self.take_jog(payload, now);
        let event = if answer.is_ok() {
            Event::JogTaken
        } else {
            Event::JogRefused
        };
        self.trace.note(now, event);
        self.run_motion(now);
        self.settle(now);
        let (axis, jog) = answer.map_err(|Refused(code, message)| {
            let message = message.as_str();
            let error = JogRefusalError { code, message };
            json_of(&JogRefusal { error })
        })?;
        let moving = match axis {
            Some(axis) => self.motion.is_driven(axis),
            None => self.motion.is_driving(),
        };
        Ok(json_of(&JogReceipt {
            node: self.config.name.as_str(),
            axis: axis.map(|axis| axis.0),
            jog: jog.map(|jog| jog.number),
            lease_ms: jog.and_then(|jog| jog.lease).map(|lease| lease.ms),
            position: self.motion.position_steps(axis.unwrap_or(AxisId(0))),
            moving,
        }))
    }

    fn take_jog(
        &mut self,
        payload: &[u8],
        now: LocalMicros,
    ) -> Result<(Option<AxisId>, Option<Jog>), Refused> {
        if payload.len() > REQUEST_BYTES_MAX {
            return Err(Refused::new("bad_json", "more than 1024 bytes"));
        }
        // serde alone would take an array, too.
        if payload.trim_ascii_start().first() != Some(&b'{') {
            return Err(Refused::new("bad_json", "not a JSON object"));
        }
        let request: JogRequest = serde_json::from_slice(payload)
            .map_err(|error| Refused("bad_json", error.to_string()))?;
        let order = request.order();
        match order.map_err(|error| Refused("bad_command", error.to_string()))? {
            JogOrder::Stop { axis } => {
                self.stop_jog(axis)?;
                Ok((axis, None))
            }
            JogOrder::Renew { jog } => {
                let (axis, jog) = self.renew_jog(jog, now)?;
                Ok((Some(axis), Some(jog)))
            }
            JogOrder::Coast { axis, lease_ms } => {
                self.demand_free()?;
                self.motion.coast(axis)?;
                self.outputs.note_drive(axis, None, now);
                let ms = lease_ms.unwrap_or(LEASE_MS_DEFAULT);
                let jog = self.note_jog(axis, Some(Lease::from(now, ms)));
                Ok((Some(axis), Some(jog)))
            }
            JogOrder::Move {
                axis,
                target,
                ramp,
                lease_ms,
            } => {
                self.demand_free()?;
                let (target, runs) = match target {
                    JogTarget::To(position) => (Target::To(position), false),
                    JogTarget::By(steps) => (Target::By(steps), false),
                    JogTarget::Run(JogWay::Forward) => (Target::Forever(Direction::Positive), true),
                    JogTarget::Run(JogWay::Backward) => {
                        (Target::Forever(Direction::Negative), true)
                    }
                };
                let before = self.jogs.of(axis).and_then(|jog| jog.lease);
                self.motion.drive(axis, target, Course::from(ramp))?;
                self.outputs.note_drive(axis, Some(ramp), now);
                // What is relative to a run has no end either.
                let inherited = before.filter(|_| matches!(target, Target::By(_)));
                let usual = runs.then_some(LEASE_MS_DEFAULT);
                let ms = lease_ms.or(inherited.map(|lease| lease.ms)).or(usual);
                let jog = self.note_jog(axis, ms.map(|ms| Lease::from(now, ms)));
                Ok((Some(axis), Some(jog)))
            }
        }
    }

    /// Jogging is for a node that nobody else moves.
    fn demand_free(&self) -> Result<(), Refused> {
        let refused = |message: &str| Err(Refused::new("not_allowed", message));
        if !self.config.signers.is_empty() {
            return refused("the node executes only what an operator has signed");
        }
        match self.phase {
            Phase::Open => {}
            Phase::Stopping { .. } if self.phase.latch().is_none() => {
                return refused("a job is being canceled");
            }
            Phase::Stopping { .. } | Phase::Latched { .. } => {
                return Err(Refused::new(
                    "stopped",
                    "the node is stopped; release it first",
                ));
            }
        }
        if self.job.is_some()
            || self.script.is_running()
            || self.motion.accepted_commands() > self.motion.executed_commands()
        {
            return refused("a job runs");
        }
        if self.is_held() {
            return refused("the node is held; resume it first");
        }
        Ok(())
    }

    fn note_jog(&mut self, axis: AxisId, lease: Option<Lease>) -> Jog {
        self.jogs.last_number = self.jogs.last_number.wrapping_add(1);
        let number = self.jogs.last_number;
        let jog = Jog { number, lease };
        if let Some(of_axis) = self.jogs.axes.get_mut(usize::from(axis.0)) {
            // One that was there already, as a target, is over with the call.
            *of_axis = self.motion.is_driven(axis).then_some(jog);
        }
        self.status_due = true;
        jog
    }

    /// A stop is never refused but for a jog that is not there: then there is nothing to stop.
    fn stop_jog(&mut self, axis: Option<AxisId>) -> Result<(), Refused> {
        if let Some(axis) = axis
            && usize::from(axis.0) >= self.motion.axis_count()
        {
            let message = alloc::format!("axis: the node has no axis {}", axis.0);
            return Err(Refused("bad_command", message));
        }
        for index in 0..self.motion.axis_count() {
            let this = AxisId(index as u8);
            if axis.is_none_or(|axis| axis == this) && self.jogs.of(this).is_some() {
                self.motion.end_drive_of(this);
                self.jogs.forget_axis(this);
            }
        }
        Ok(())
    }

    fn renew_jog(&mut self, number: u32, now: LocalMicros) -> Result<(AxisId, Jog), Refused> {
        let mut axes = self.jogs.axes.iter_mut().enumerate();
        let found = axes.find_map(|(index, jog)| {
            let jog = jog.as_mut().filter(|jog| jog.number == number)?;
            Some((AxisId(index as u8), jog))
        });
        let Some((axis, jog)) = found else {
            let message = alloc::format!("jog {number} is over");
            return Err(Refused("not_allowed", message));
        };
        jog.lease = jog.lease.map(|lease| Lease::from(now, lease.ms));
        Ok((axis, *jog))
    }

    /// Brings to rest whose lease has run out.
    pub(crate) fn watch_jogs(&mut self, now: LocalMicros) {
        for index in 0..self.motion.axis_count() {
            let axis = AxisId(index as u8);
            let Some(jog) = self.jogs.of(axis) else {
                continue;
            };
            if jog.lease.is_some_and(|lease| lease.until <= now) {
                self.motion.end_drive_of(axis);
                self.jogs.forget_axis(axis);
                self.log(
                    now,
                    format_args!(
                        "axis {index}: nobody has renewed jog {}: it comes to rest",
                        jog.number
                    ),
                );
            }
        }
    }
}

fn json_of<T: serde::Serialize>(answer: &T) -> String {
    serde_json::to_string(answer).expect("numbers and texts, nothing that JSON has no words for")
}
