//! What happens to a fleet and what it wants done: the whole border between the pure middle and
//! the shell.
//!
//! [`Fleet::handle`](super::Fleet::handle) takes one [`Event`] and appends [`Effect`]s. The shell
//! carries effects out strictly in order, with one rule: nothing behind a [`Effect::Persist`]
//! leaves before that write is on disk. [`Lane::RealTime`] is the exception that proves it: stops,
//! clock probes, and what is said of a start whose plan is durable depend on no write and overtake
//! everything.

use super::{
    kept::Kind,
    manage::{JobWishes, NodeWishes, OrderWishes},
    node::Wish,
};
use keys::{
    JobId, NodeId, NodeTopic, StopMode,
    job::{GroupRequest, JobRequest},
    record::JobError,
};

/// Names a client's get until its last reply; given by the shell, never used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ReplyTo(pub u64);

/// What happened.
#[derive(Clone, Debug)]
pub enum Event {
    /// A job on `PREFIX/node/PATTERN/job`, by put or (`reply`) by get.
    Submit {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// The job, read and checked by [`crate::job::parse`], or why it is none.
        request: Result<JobRequest, JobError>,
        /// The id that a refused job gives, if it can be found.
        id_hint: Option<JobId>,
        /// Who waits for a receipt.
        reply: Option<ReplyTo>,
    },
    /// A job on `PREFIX/group/PATTERN/job`.
    SubmitGroup {
        /// A group's name, or a wild chunk.
        pattern: String,
        /// The job, read and checked by [`crate::job::parse`], or why it is none.
        request: Result<GroupRequest, JobError>,
        /// The id that a refused job gives, if it can be found.
        id_hint: Option<JobId>,
        /// Who waits for a receipt.
        reply: Option<ReplyTo>,
    },
    /// A job that came with wishes, see [`super::manage`].
    SubmitWith {
        /// The wishes.
        wishes: JobWishes,
        /// The job.
        submit: Box<Self>,
    },
    /// A get on `PREFIX/manage/node/PATTERN`.
    ManageNodes {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// What to change.
        request: Result<NodeWishes, JobError>,
        /// Who waits.
        reply: ReplyTo,
    },
    /// A get on `PREFIX/manage/job/JOB`.
    ManageJob {
        /// The job.
        job: String,
        /// What to change.
        request: Result<OrderWishes, JobError>,
        /// Who waits.
        reply: ReplyTo,
    },
    /// A get on `PREFIX/manage/template/PATTERN` or `…/schedule/PATTERN`.
    Keep {
        /// Which of both.
        kind: Kind,
        /// A name, or a wild chunk.
        pattern: String,
        /// What to keep, or what to do with it.
        payload: Vec<u8>,
        /// Who waits.
        reply: ReplyTo,
    },
    /// `PREFIX/job/PATTERN/cancel`.
    Cancel {
        /// A job's id, or a wild chunk.
        pattern: String,
        /// Who waits for the record.
        reply: Option<ReplyTo>,
    },
    /// `PREFIX/node/PATTERN/release`.
    Release {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// Who waits for the node record.
        reply: Option<ReplyTo>,
    },
    /// `PREFIX/node/PATTERN/hold`, `…/resume` and `…/speed`.
    Pace {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// What is wanted, or what is wrong with it.
        wish: Result<Wish, JobError>,
        /// Who waits for a receipt.
        reply: Option<ReplyTo>,
    },
    /// `PREFIX/node/PATTERN/stop`: the nodes hear it themselves, the fleet draws its conclusions.
    Stop {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// How.
        mode: StopMode,
    },
    /// A get on `PREFIX/job/PATTERN`.
    GetJobs {
        /// A job's id, or a wild chunk.
        pattern: String,
        /// The selector's parameters: `limit`, `state`, `node`.
        parameters: Vec<(String, String)>,
        /// Who waits.
        reply: ReplyTo,
    },
    /// A get on `PREFIX/node/PATTERN/state`.
    GetNodes {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// Who waits.
        reply: ReplyTo,
    },
    /// A get on `PREFIX/manage/link/PATTERN`.
    GetLinks {
        /// A node's name, or a wild chunk.
        pattern: String,
        /// Who waits.
        reply: ReplyTo,
    },
    /// A node's liveliness token came (`true`) or went.
    Alive {
        /// The node.
        node: NodeId,
        /// Whether the token is there.
        alive: bool,
    },
    /// Bytes from a node on its `status`, `ack`, `clock` or `start` key. What the gateway itself
    /// said on the last two, the shell drops.
    FromNode {
        /// The node.
        node: NodeId,
        /// Which key.
        topic: NodeTopic,
        /// The payload.
        payload: Vec<u8>,
    },
    /// Time has passed: see [`Fleet::poll_timeout`](super::Fleet::poll_timeout).
    Tick,
}

/// Which way a message to a node or a client takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Lane {
    /// Stop, clock and start: a session of their own, real-time priority, express, never behind a
    /// write.
    RealTime,
    /// The commit of a start: the same way, but behind the write of its plan.
    Commit,
    /// Orders to nodes: blocking congestion control, bounded by credit.
    Order,
    /// Records and states for clients.
    Record,
}

/// What the fleet wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Write this before anything that follows.
    Persist(Write),
    /// Put these bytes on this key.
    Publish {
        /// The whole key.
        key: String,
        /// The payload.
        payload: Vec<u8>,
        /// `application/json` when true, postcard otherwise.
        json: bool,
        /// The way.
        lane: Lane,
    },
    /// One reply to a get.
    Reply {
        /// Whose get.
        to: ReplyTo,
        /// The key of the reply; `None`: the error reply of the query.
        key: Option<String>,
        /// JSON.
        payload: Vec<u8>,
    },
    /// The get has all its replies.
    ReplyEnd {
        /// Whose get.
        to: ReplyTo,
    },
}

/// One change of the store. Values are opaque to it.
#[derive(Clone, Debug, PartialEq)]
pub enum Write {
    /// Inserts or replaces.
    Put {
        /// Which table.
        table: Table,
        /// The key in it.
        key: String,
        /// The value.
        value: Vec<u8>,
    },
    /// Removes; an absent key is no error.
    Remove {
        /// Which table.
        table: Table,
        /// The key in it.
        key: String,
    },
}

/// The tables of the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Table {
    /// Job id → what a client asked for (postcard), removed when the job is final.
    Requests,
    /// Job id → the record as clients see it and where its commands are (postcard or JSON).
    Jobs,
    /// Node name → what stays true of a node while it is away.
    Nodes,
    /// `template/NAME` and `schedule/NAME` → see [`super::kept`].
    Kept,
}
