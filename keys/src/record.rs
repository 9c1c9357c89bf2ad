//! What clients read: job records, node records, receipts and errors, as JSON.

use crate::{AxisId, FleetMicros, GroupId, JobId, NodeId, NodeState, StopReason, units::rfc3339};
use serde::{Deserialize, Serialize};
use std::{borrow::ToOwned, boxed::Box, collections::BTreeMap, string::String, vec::Vec};

/// The code of an error. The words are fixed: clients match on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// The payload is no job: not JSON, a missing or unknown field, no known encoding.
    BadJson,
    /// A command is wrong or not supported.
    BadCommand,
    /// The gateway has never seen the node, or there is no such job.
    UnknownNode,
    /// The node is not there, and the job says `"offline":"reject"`.
    NodeOffline,
    /// The node's stop latch is set.
    Stopped,
    /// The payload or the list is too long.
    TooLarge,
    /// The id is no name, or belongs to a job of another node.
    BadId,
    /// The client may not do this, or it cannot be done in this state.
    NotAllowed,
    /// The gateway failed.
    Internal,
}

impl ErrorCode {
    /// Returns the word that clients see.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::BadJson => "bad_json",
            Self::BadCommand => "bad_command",
            Self::UnknownNode => "unknown_node",
            Self::NodeOffline => "node_offline",
            Self::Stopped => "stopped",
            Self::TooLarge => "too_large",
            Self::BadId => "bad_id",
            Self::NotAllowed => "not_allowed",
            Self::Internal => "internal",
        }
    }
}

/// Why something was refused or failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobError {
    /// What kind of error.
    pub code: ErrorCode,
    /// What is wrong and where, for a person.
    pub message: String,
}

impl JobError {
    /// Puts code and words together.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
        }
    }
}

impl core::fmt::Display for JobError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}: {}", self.code.as_str(), self.message)
    }
}

impl core::error::Error for JobError {}

/// An error reply: `{"error":{"code":…,"message":…}}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorReply {
    /// The error.
    pub error: JobError,
}

/// The reply to a job that was got: `{"job":…,"state":…}`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Receipt {
    /// The job's name.
    pub job: JobId,
    /// Its state now.
    pub state: JobState,
}

/// Where a job is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Accepted, kept, waiting for its turn or its node.
    Queued,
    /// Commands are on the way to the node.
    Sent,
    /// The node executes it.
    Running,
    /// The last pulse has left the pin.
    Succeeded,
    /// It ended early, with the reason.
    Failed,
    /// A client canceled it.
    Canceled,
    /// It took too long.
    TimedOut,
    /// It was never accepted.
    Rejected,
    /// The node that had part of it is gone and the outcome unknown.
    Lost,
}

impl JobState {
    /// Every state.
    pub const ALL: [Self; 9] = [
        Self::Queued,
        Self::Sent,
        Self::Running,
        Self::Succeeded,
        Self::Failed,
        Self::Canceled,
        Self::TimedOut,
        Self::Rejected,
        Self::Lost,
    ];

    /// Returns the word that clients see.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Sent => "sent",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Canceled => "canceled",
            Self::TimedOut => "timed_out",
            Self::Rejected => "rejected",
            Self::Lost => "lost",
        }
    }

    /// Returns whether nothing changes any more.
    pub const fn is_final(self) -> bool {
        match self {
            Self::Succeeded | Self::Failed | Self::Canceled | Self::TimedOut | Self::Rejected => {
                true
            }
            Self::Queued | Self::Sent | Self::Running | Self::Lost => false,
        }
    }
}

impl core::fmt::Display for JobState {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.pad(self.as_str())
    }
}

impl core::str::FromStr for JobState {
    type Err = UnknownState;
    fn from_str(word: &str) -> Result<Self, UnknownState> {
        Self::ALL
            .into_iter()
            .find(|state| state.as_str() == word)
            .ok_or(UnknownState)
    }
}

/// The word names no state of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownState;

impl core::fmt::Display for UnknownState {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "no state of a job")
    }
}

impl core::error::Error for UnknownState {}

/// How far a job is, in commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    /// Commands that have ended.
    pub done: u64,
    /// All of them.
    pub total: u64,
}

/// What a job left behind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JobResult {
    /// Final position of each axis, steps.
    pub position: Vec<i64>,
    /// What a Lua script returned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub returned: Option<serde_json::Value>,
}

/// One node's part of a synchronized job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartRecord {
    /// Where it is.
    pub state: JobState,
    /// How far it is.
    pub progress: Progress,
    /// Why it ended early.
    pub error: Option<JobError>,
    /// What it left behind.
    pub result: Option<JobResult>,
}

/// A synchronized start as the nodes measured it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StartRecord {
    /// The planned instant.
    #[serde(with = "rfc3339")]
    pub planned: FleetMicros,
    /// Latest minus earliest first edge, µs.
    pub skew_us: f64,
    /// First edge of each node after the earliest one, µs.
    pub by_node_us: BTreeMap<NodeId, f64>,
    /// How far the skew may be wrong, µs.
    pub uncertainty_us: f64,
}

/// A job's record, on `PREFIX/job/JOB`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobRecord {
    /// The job's name.
    pub job: JobId,
    /// Its node; `None` for a synchronized job or a refused one for many.
    pub node: Option<NodeId>,
    /// Its group, for a synchronized job.
    pub group: Option<GroupId>,
    /// Where it is.
    pub state: JobState,
    /// Grows by one with each change.
    pub version: u64,
    /// When it was accepted.
    #[serde(with = "rfc3339")]
    pub created: FleetMicros,
    /// When it changed last.
    #[serde(with = "rfc3339")]
    pub updated: FleetMicros,
    /// How far it is.
    pub progress: Progress,
    /// Why it was refused or ended early.
    pub error: Option<JobError>,
    /// What it left behind.
    pub result: Option<JobResult>,
    /// The parts of a synchronized job, by node.
    pub parts: Option<BTreeMap<NodeId, PartRecord>>,
    /// The start of a synchronized job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<Box<StartRecord>>,
}

/// What a node does, as clients see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeWord {
    /// Not there.
    Offline,
    /// Nothing to do.
    Idle,
    /// Waits for a synchronized start.
    Ready,
    /// Executes commands.
    Running,
    /// Held on its path.
    Paused,
    /// The stop latch is set.
    Stopped,
    /// Something is broken.
    Fault,
}

impl NodeWord {
    /// Every word.
    pub const ALL: [Self; 7] = [
        Self::Offline,
        Self::Idle,
        Self::Ready,
        Self::Running,
        Self::Paused,
        Self::Stopped,
        Self::Fault,
    ];

    /// Returns the word that clients see.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Offline => "offline",
            Self::Idle => "idle",
            Self::Ready => "ready",
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
        }
    }
}

impl From<NodeState> for NodeWord {
    fn from(state: NodeState) -> Self {
        match state {
            NodeState::Idle => Self::Idle,
            NodeState::Ready => Self::Ready,
            NodeState::Running => Self::Running,
            NodeState::Paused => Self::Paused,
            NodeState::Stopped => Self::Stopped,
            NodeState::Fault => Self::Fault,
        }
    }
}

/// A node's queue, in commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueueRecord {
    /// Commands that it has and that have not ended.
    pub depth: u64,
    /// Commands that still fit.
    pub free: u64,
}

/// Why and when a node was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoppedRecord {
    /// Why.
    pub reason: StopReason,
    /// When.
    #[serde(with = "rfc3339")]
    pub at: FleetMicros,
}

/// What the gateway knows about a node's clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockRecord {
    /// The node's clock minus the gateway's, µs, less the node's boot time.
    pub offset_us: f64,
    /// How far the offset may be wrong, µs.
    pub error_us: f64,
    /// How much faster than the gateway's it runs, parts per million.
    pub drift_ppm: f64,
}

/// The plan of a synchronized start, put on `PREFIX/manage/start/JOB` when the instant is fixed. The
/// record of the job has `start` when it is measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StartPlan {
    /// The job.
    pub job: JobId,
    /// When this was written, by the gateway's clock.
    #[serde(with = "rfc3339")]
    pub told: FleetMicros,
    /// The instant, by the same clock.
    #[serde(with = "rfc3339")]
    pub starts_at: FleetMicros,
    /// The largest skew that the job is promised, µs.
    pub max_skew_us: f64,
}

/// How long messages travel between the gateway and a node, there and back, on
/// `PREFIX/manage/link/NODE`. As measured by the clock's probes of the last minutes; `None` until the
/// clock is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkRecord {
    /// The node.
    pub node: NodeId,
    /// The shortest, µs.
    pub rtt_us_min: Option<f64>,
    /// The longest, µs.
    pub rtt_us_max: Option<f64>,
}

/// A fault, as clients see it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultRecord {
    /// Its number.
    pub code: u16,
    /// What it means.
    pub message: String,
    /// When it was seen.
    #[serde(with = "rfc3339")]
    pub at: FleetMicros,
}

/// Whether a node is held, and how fast it executes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PaceRecord {
    /// It rests on its path, or is about to.
    pub hold: bool,
    /// Speed, percent of what the commands ask for.
    pub percent: u16,
}

/// The reply to a hold, a resume or a speed that was got: `{"node":…,"hold":…,"percent":…}`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PaceReceipt {
    /// The node.
    pub node: NodeId,
    /// How it is now.
    #[serde(flatten)]
    pub pace: PaceRecord,
}

/// A node's record, on `PREFIX/node/NODE/state`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeRecord {
    /// Its name.
    pub node: NodeId,
    /// Whether it is there.
    pub alive: bool,
    /// What it does.
    pub state: NodeWord,
    /// Position of each axis, steps.
    pub position: Vec<i64>,
    /// Its queue.
    pub queue: QueueRecord,
    /// The job that it executes.
    pub job: Option<JobId>,
    /// Its stop latch.
    pub stopped: Option<StoppedRecord>,
    /// Its clock, when it is known.
    pub clock: Option<ClockRecord>,
    /// Version of its firmware.
    pub firmware: String,
    /// Time since its boot, s.
    pub uptime_s: u64,
    /// Signal strength, dBm.
    pub rssi_dbm: Option<i8>,
    /// Its last faults, oldest first.
    pub faults: Vec<FaultRecord>,
    /// Whether it is held, and its speed, when it has said so; in JSON only while it is held or at
    /// another speed than 100 %.
    #[serde(default, skip_serializing_if = "is_plain")]
    pub pace: Option<PaceRecord>,
}

/// Nobody holds it or slows it down: its record is the one that every client knows.
fn is_plain(pace: &Option<PaceRecord>) -> bool {
    pace.is_none_or(|pace| !pace.hold && pace.percent == 100)
}

/// Writes a record as JSON.
pub fn to_json<R: Serialize>(record: &R) -> Vec<u8> {
    serde_json::to_vec(record).expect("records hold nothing that JSON cannot")
}

/// Returns the words for an axis that a node does not have.
pub fn no_such_axis(axis: AxisId, axis_count: usize) -> String {
    match axis_count {
        0 => "the node has no axes".to_owned(),
        1 => std::format!("axis {} does not exist; the node has axis 0 only", axis.0),
        _ => std::format!(
            "axis {} does not exist; the node has axes 0 to {}",
            axis.0,
            axis_count - 1
        ),
    }
}
