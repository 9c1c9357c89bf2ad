//! A session in a file: everything that was heard and asked, with its moment, to be shown again.
//!
//! One JSON object a line. The first is the [`Head`]; each other is a [`Line`]. JSON, because the
//! records of `keys` are JSON already and a person can look into the file with any tool; lines,
//! because what was written before a crash stays readable.
//!
//! The rate has a bound: [`Thinner`] leaves out statuses above [`STATUSES_PER_S`] of a node, which
//! are complete each time, and everything above [`BYTES_PER_S`]; what is left out is counted in the
//! file. A file has one too, [`BYTES_MAX`], and a recording as many as [`PARTS_MAX`].

pub mod recorder;
pub mod replay;
pub mod session;

use crate::{
    message::{LinkEvent, Message, Moment},
    model::Model,
};
use keys::NodeId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version that this program writes, and the only one that it reads.
pub const VERSION: u32 = 1;

/// Statuses of one node in a second that are kept.
pub const STATUSES_PER_S: f64 = 10.0;

/// Bytes in a second that are written, over a second.
pub const BYTES_PER_S: f64 = 4e6;

/// Largest file that is written or read: 256 MiB, an hour of 50 nodes at 4 statuses a second, and
/// a little more than a minute of the highest rate. A recording goes on in a next file, which begins
/// with all that is known then and so can be shown alone.
pub const BYTES_MAX: u64 = 256 << 20;

/// Files of one recording: 16 GiB, more than an hour of the highest rate.
pub const PARTS_MAX: u32 = 64;

/// Lines that cannot be read and are skipped; after more the file is refused.
const BROKEN_MAX: usize = 100;

/// The first line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    /// [`VERSION`].
    pub stepfleet_recording: u32,
    /// When it began.
    pub began: Moment,
}

/// Each other line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// When it was heard or asked.
    pub at: Moment,
    /// What.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<Message>,
    /// Messages that were left out since the line before.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub left_out: u64,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// A file that was read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// When it began.
    pub began: Moment,
    /// The last moment in it.
    pub ended: Moment,
    /// What was heard and asked, in order.
    pub messages: Vec<(Moment, Message)>,
    /// Messages that were left out when it was written.
    pub left_out: u64,
    /// Lines that could not be read, the last one of a crash for instance.
    pub broken: usize,
}

impl Recording {
    /// Reads a file's text.
    ///
    /// # Errors
    /// Words that name the line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut lines = text.lines().enumerate();
        let head: Head = lines
            .next()
            .and_then(|(_, head)| serde_json::from_str(head).ok())
            .ok_or("this is no recording: the first line is no head of one")?;
        if head.stepfleet_recording != VERSION {
            let version = head.stepfleet_recording;
            return Err(format!(
                "a recording of version {version}; this program reads version {VERSION}"
            ));
        }
        let mut recording = Self {
            began: head.began,
            ended: head.began,
            ..Self::default()
        };
        for (index, text) in lines {
            let line: Line = match serde_json::from_str(text) {
                Ok(line) => line,
                Err(error) => {
                    recording.broken += 1;
                    if recording.broken > BROKEN_MAX {
                        let number = index + 1;
                        return Err(format!(
                            "line {number} is the {BROKEN_MAX}th broken: {error}"
                        ));
                    }
                    continue;
                }
            };
            // What is told out of order was heard together.
            let at = line.at.max(recording.ended);
            recording.ended = at;
            recording.left_out += line.left_out;
            recording
                .messages
                .extend(line.message.map(|message| (at, message)));
        }
        Ok(recording)
    }
}

/// Returns the text of a line with its end.
fn to_line(line: &impl Serialize) -> String {
    // Numbers that JSON cannot hold become null, and that line is skipped when it is read.
    let mut text = serde_json::to_string(line).unwrap_or_default();
    text.push('\n');
    text
}

/// Returns what has to be told to a new model so that it shows the same: a recording begins in the
/// middle of things.
pub fn picture(model: &Model) -> Vec<Message> {
    let mut messages = Vec::new();
    let link = model.link();
    if link.is_up() {
        let to = link.to().to_owned();
        messages.push(Message::Link(LinkEvent::Connected { to }));
        let gateway = link.gateway();
        let gateway = gateway.map(|present| Message::Link(LinkEvent::Gateway { present }));
        messages.extend(gateway);
    }
    for node in model.nodes() {
        let (id, alive) = (node.id(), node.is_there());
        // One that this window saw go is lost, and that begins with its being there.
        if alive || node.lost_at().is_some() {
            messages.push(Message::Alive {
                node: id,
                alive: true,
            });
        }
        let record = node.latest_record().cloned();
        messages.extend(record.map(|record| Message::Node(Box::new(record))));
        if let Some(status) = node.latest_status().cloned() {
            let status = Box::new(status);
            messages.push(Message::Status { node: id, status });
        }
        if let Some((_, vitals)) = node.vitals().copied() {
            messages.push(Message::Vitals { node: id, vitals });
        }
        // What it told before another boot would be taken for this one's.
        let told = node.setup().told().filter(|told| told.boot == node.boot());
        if let Some(setup) = told.map(|told| told.setup.clone()) {
            messages.push(Message::Setup { node: id, setup });
        }
        if !alive {
            messages.push(Message::Alive { node: id, alive });
        }
    }
    let jobs = model.jobs().newest_first().cloned();
    messages.extend(jobs.map(|job| Message::Job(Box::new(job))));
    messages
}

/// Decides what is left out.
#[derive(Debug, Default)]
pub struct Thinner {
    statuses: BTreeMap<NodeId, Moment>,
    budget: f64,
    filled: Moment,
}

impl Thinner {
    /// Returns whether a message of so many bytes is kept.
    pub fn keeps(&mut self, at: Moment, message: &Message, bytes: usize) -> bool {
        if let Message::Status { node, .. } = message {
            // A little less than the period, because statuses come with jitter.
            let too_soon = |last: &Moment| at.since_s(*last) < 0.9 / STATUSES_PER_S;
            if self.statuses.get(node).is_some_and(too_soon) {
                return false;
            }
        }
        let refill = at.since_s(self.filled) * BYTES_PER_S;
        self.budget = (self.budget + refill).min(BYTES_PER_S);
        self.filled = self.filled.max(at);
        if bytes as f64 > self.budget {
            return false;
        }
        self.budget -= bytes as f64;
        if let Message::Status { node, .. } = message {
            self.statuses.insert(*node, at);
        }
        true
    }
}

#[cfg(test)]
mod tests;
