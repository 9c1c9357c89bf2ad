//! A job as clients write it: JSON, Lua, or postcard of the same type.
//!
//! Reading checks everything that can be known without a node and names the place of the first
//! error (`commands[3].move.delay_us: …`). A job is taken whole or not at all.

mod barriers;
mod command;
mod json;
mod signature;

pub use command::{
    BarrierFields, CommandError, HomeFields, JobCommand, LaserFields, LidarReadFields, LineFields,
    MoveCFields, MoveDFields, MoveFields, PauseFields, RampFields, RampToFields, SetPositionFields,
    SmoothRampFields, SmoothRampToFields, StatusCdFields, SyncMoveFields, WaitResumeFields,
};
pub use signature::{Hex, JobSignature};

use crate::{
    JobId, NodeId,
    record::{ErrorCode, JobError},
    script::SCRIPT_BYTES_MAX,
};
use json::too_large_bytes;
use serde::{Deserialize, Serialize, de};
use std::{collections::BTreeMap, format, string::String, vec::Vec};

/// Largest payload of a job, bytes.
pub const JOB_BYTES_MAX: usize = 64 << 20;

/// Most commands in a job.
pub const JOB_COMMANDS_MAX: usize = 1_000_000;

/// Longest pause, ms: one day.
pub const PAUSE_MS_MAX: u32 = 86_400_000;

/// Highest speed of a ramp or line, Hz: the one of a move whose steps are 1 µs apart.
pub const SPEED_HZ_MAX: u32 = 1_000_000;

/// Longest move, µs: the longest that a node can count, 9,139 years.
pub const MOVE_US_MAX: u64 = 1 << 58;

/// Most nodes of a synchronized job: each change of a part tells the record of all of them.
pub const GROUP_NODES_MAX: usize = 128;

pub use crate::start::BARRIER_BYTES_MAX;

/// A job as a client asks for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobRequest {
    /// The client's own name for it; makes it idempotent.
    pub id: Option<JobId>,
    /// What to do.
    pub work: Work,
    /// What to do when the node is not there.
    pub offline: Offline,
    /// Longest time from the first command sent to the last pulse, s.
    pub timeout_s: Option<f64>,
    /// The operator's signature, for nodes that ask for one. In JSON only.
    #[serde(skip)]
    pub signature: Option<JobSignature>,
}

/// A synchronized job as a client asks for it: one part for each node, started together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupRequest {
    /// The client's own name for it; makes it idempotent.
    pub id: Option<JobId>,
    /// The parts: 1 to [`GROUP_NODES_MAX`].
    pub nodes: BTreeMap<NodeId, Work>,
    /// How far apart the first edges may be by what is known of the nodes' clocks, µs.
    pub max_skew_us: Option<f64>,
    /// How long the nodes have to become ready once all parts were sent, ms.
    pub ready_timeout_ms: Option<f64>,
    /// What to do when a node is not there. Unlike a plain job, one that says nothing is refused.
    pub offline: Option<Offline>,
    /// Longest time from the last part's first command sent to the last pulse, s.
    pub timeout_s: Option<f64>,
    /// The operator's signature of each part, for nodes that ask for one. In JSON only.
    #[serde(skip)]
    pub signatures: BTreeMap<NodeId, JobSignature>,
}

/// What a job does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Work {
    /// A list of commands.
    Commands(Vec<JobCommand>),
    /// A Lua script.
    Lua(String),
}

/// What to do with a job for a node that is known but not there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Offline {
    /// Keep it until the node returns.
    #[default]
    Queue,
    /// Refuse it.
    Reject,
}

impl JobRequest {
    /// Reads a job from postcard (version byte and message) and checks it.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn from_postcard(payload: &[u8]) -> Result<Self, JobError> {
        let request: Self = from_postcard(payload, "JobRequest")?;
        request.check()?;
        Ok(request)
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first value that is out of range, with its place.
    pub fn check(&self) -> Result<(), JobError> {
        check_time("timeout_s", self.timeout_s)?;
        self.work.check()
    }
}

impl Work {
    fn check(&self) -> Result<(), JobError> {
        let commands = match self {
            Self::Commands(commands) => commands,
            Self::Lua(script) if script.len() > SCRIPT_BYTES_MAX => {
                let message = format!(
                    "lua: {} bytes; a script has at most {SCRIPT_BYTES_MAX}",
                    script.len()
                );
                return Err(JobError::new(ErrorCode::TooLarge, message));
            }
            Self::Lua(_) => return Ok(()),
        };
        if commands.is_empty() {
            return Err(JobError::new(
                ErrorCode::BadCommand,
                "commands: the list is empty",
            ));
        }
        if commands.len() > JOB_COMMANDS_MAX {
            let message = format!(
                "commands: {} of them; a job has at most {JOB_COMMANDS_MAX}",
                commands.len()
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        for (index, command) in commands.iter().enumerate() {
            command.check().map_err(|error| error.at(index))?;
        }
        Ok(())
    }
}

impl GroupRequest {
    /// Reads a synchronized job from postcard (version byte and message) and checks it.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn from_postcard(payload: &[u8]) -> Result<Self, JobError> {
        let request: Self = from_postcard(payload, "GroupRequest")?;
        request.check()?;
        Ok(request)
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first value that is out of range, with its place.
    pub fn check(&self) -> Result<(), JobError> {
        check_time("max_skew_us", self.max_skew_us)?;
        check_time("ready_timeout_ms", self.ready_timeout_ms)?;
        check_time("timeout_s", self.timeout_s)?;
        if self.nodes.is_empty() {
            let message = "nodes: there must be a part for at least one node";
            return Err(JobError::new(ErrorCode::BadJson, message));
        }
        if self.nodes.len() > GROUP_NODES_MAX {
            let message = format!(
                "nodes: {} of them; a synchronized job has at most {GROUP_NODES_MAX}",
                self.nodes.len()
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        for (node, work) in &self.nodes {
            work.check().map_err(|error| {
                JobError::new(error.code, format!("nodes.{node}.{}", error.message))
            })?;
        }
        self.check_barriers()
    }
}

/// Decodes a request of client's postcard, not yet checked; `name` is the message's in the error.
fn from_postcard<T: de::DeserializeOwned>(payload: &[u8], name: &str) -> Result<T, JobError> {
    if payload.len() > JOB_BYTES_MAX {
        return Err(too_large_bytes(payload.len()));
    }
    crate::version::decode(payload).map_err(|error| {
        let message = format!("no postcard {name}: {error}");
        JobError::new(ErrorCode::BadJson, message)
    })
}

fn check_time(field: &str, value: Option<f64>) -> Result<(), JobError> {
    match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => {
            let message = format!("{field}: {value} is not a time; it must be more than 0");
            Err(JobError::new(ErrorCode::BadJson, message))
        }
        _ => Ok(()),
    }
}
