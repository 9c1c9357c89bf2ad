//! Everything that can happen to the model, as the link heard it or the operator asked it.

use crate::request::{Language, Order, Scope, Ticket};
use keys::{
    JobId, NodeId, Setup, Status, StopMode, Vitals,
    record::{JobError, JobRecord, LinkRecord, NodeRecord, Receipt, StartPlan},
};
use serde::{Deserialize, Serialize};

/// A moment on this computer: UTC in µs as it was told when the program started, moved on by the
/// monotone clock since, and set forward after a sleep of the computer. It never goes back, so ages
/// and durations are differences of two of them.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Moment(pub u64);

impl Moment {
    /// Returns the time since `earlier` in s, zero if that lies ahead.
    pub fn since_s(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 / 1e6
    }

    /// Returns this moment moved later by `delay_us`.
    #[must_use]
    pub const fn plus_us(self, delay_us: u64) -> Self {
        Self(self.0.saturating_add(delay_us))
    }
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// The link's own state changed.
    Link(LinkEvent),
    /// A node's liveliness token came or went.
    Alive {
        /// The node.
        node: NodeId,
        /// Whether the token is there.
        alive: bool,
    },
    /// What the gateway says about a node.
    Node(Box<NodeRecord>),
    /// What a node says about itself.
    Status {
        /// The node.
        node: NodeId,
        /// Its own words.
        status: Box<Status>,
    },
    /// How a node's chip is.
    Vitals {
        /// The node.
        node: NodeId,
        /// Its own words.
        vitals: Vitals,
    },
    /// How a node is set.
    Setup {
        /// The node.
        node: NodeId,
        /// Its own words.
        setup: Box<Setup>,
    },
    /// A job changed, or is told for the first time.
    Job(Box<JobRecord>),
    /// When a synchronized job starts.
    StartPlan(StartPlan),
    /// A node wrote a line.
    Log {
        /// The node.
        node: NodeId,
        /// The line.
        text: String,
    },
    /// A message that is none: another version, or broken.
    Unreadable {
        /// The key it came on.
        key: String,
        /// Why it cannot be read.
        why: String,
    },
    /// Messages were dropped because the window did not take them in time.
    Missed {
        /// How many.
        messages: u64,
    },
    /// The operator asked for a stop; the link is about to send it.
    StopAsked {
        /// Identifies the request.
        ticket: Ticket,
        /// Who shall stop.
        scope: Scope,
        /// How.
        mode: StopMode,
    },
    /// The operator asked to lift the latch.
    ReleaseAsked {
        /// Identifies the request.
        ticket: Ticket,
        /// Whose.
        scope: Scope,
    },
    /// The operator sent a job.
    JobAsked {
        /// Identifies the request.
        ticket: Ticket,
        /// The key's words, for a person: `node-1`, `cell-$*`, `group cut`.
        target: String,
        /// What was sent.
        payload: String,
        /// In which language.
        language: Language,
    },
    /// The operator asked for the end of a job.
    CancelAsked {
        /// Identifies the request.
        ticket: Ticket,
        /// Which.
        job: JobId,
    },
    /// The operator asked for a change of a node's motion.
    OrderAsked {
        /// Identifies the request.
        ticket: Ticket,
        /// Whose.
        node: NodeId,
        /// What.
        order: Order,
    },
    /// A node was asked how it is set.
    SetupAsked {
        /// Identifies the request.
        ticket: Ticket,
        /// The node.
        node: NodeId,
    },
    /// What became of a request about a file.
    File {
        /// The request.
        ticket: Ticket,
        /// What became of it.
        outcome: FileOutcome,
    },
    /// The operator has seen an alarm.
    Acknowledged {
        /// Which; all if `None`.
        alarm: Option<u64>,
    },
    /// How long messages travel between the gateway and each node.
    Travels(Vec<LinkRecord>),
    /// What became of a request.
    Answer {
        /// The request.
        ticket: Ticket,
        /// What became of it.
        answer: Answer,
    },
}

/// What became of a request about a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FileOutcome {
    /// It was read.
    Read {
        /// Which.
        path: String,
        /// What is in it.
        text: String,
    },
    /// It was written.
    Written {
        /// Which, in full.
        path: String,
    },
    /// It could not be read or written; the words name it.
    Failed(String),
}

/// What became of the link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LinkEvent {
    /// It tries to connect.
    Connecting {
        /// Where: a locator, or words for scouting.
        to: String,
    },
    /// A zenoh router answers.
    Connected {
        /// Where.
        to: String,
    },
    /// Connected, and the question for a gateway was answered so.
    Gateway {
        /// Whether a gateway serves the prefix.
        present: bool,
    },
    /// It could not connect, or was cut.
    Down {
        /// Why, for a person.
        why: String,
    },
}

/// What became of a request. What nodes do because of it they say themselves.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Answer {
    /// It was handed to zenoh; no reply belongs to it.
    Sent,
    /// The gateway's receipts and refusals.
    Receipts(Vec<Result<Receipt, JobError>>),
    /// The gateway did it for so many; the rest it refused.
    Done {
        /// For how many nodes or jobs.
        count: usize,
        /// The refusals.
        refused: Vec<JobError>,
    },
    /// It was never sent, or nobody answered.
    Failed(String),
}

impl Answer {
    /// Returns the job that a single receipt names.
    pub fn jobs(&self) -> Vec<JobId> {
        match self {
            Self::Receipts(receipts) => {
                let taken = receipts.iter().filter_map(|receipt| receipt.as_ref().ok());
                taken.map(|receipt| receipt.job).collect()
            }
            Self::Sent | Self::Done { .. } | Self::Failed(_) => Vec::new(),
        }
    }
}
