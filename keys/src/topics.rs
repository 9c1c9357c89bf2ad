//! The topic table: every key below `PREFIX/node/NODE/`, what travels on it, who says it.
//!
//! | topic | payload | direction | priority | when the way is full |
//! |---|---|---|---|---|
//! | `job` | job text (JSON, Lua, postcard) | client → gateway | data | block |
//! | `state` | node record, JSON | gateway → client | data | drop (the next is complete) |
//! | `stop` | empty or `{"mode":…}` | client → node and gateway | real-time | block |
//! | `release` | empty | client → gateway | data | block |
//! | `log` | one line of text | node → client | background | drop |
//! | `status` | [`Status`](crate::Status) | node → all | data-high | drop (the next is complete) |
//! | `batch` | [`Order`](crate::Order) | gateway → node | data | block; bounded by credit |
//! | `ack` | [`BatchAck`](crate::BatchAck) | node → gateway | data-high | block |
//! | `clock` | [`ClockMessage`](crate::clock::ClockMessage) | both | real-time | drop |
//! | `start` | [`StartMessage`](crate::start::StartMessage) | both | real-time | block |
//! | `report` | [`ScriptReport`](crate::ScriptReport) | node → gateway | data-high | block; said again until it is seen |
//! | `data` | JSON, on `data/SUFFIX`: what a script publishes | node → client | data | drop |
//! | `pace` | [`PaceMessage`](crate::pace::PaceMessage) | both | real-time | block; said again until it is seen |
//! | `hold`, `resume` | empty | client → gateway | real-time | block |
//! | `speed` | `{"percent":…}` | client → gateway | real-time | block |
//! | `trace` | [`TraceEvent`](crate::trace::TraceEvent) | node → gateway | data-high | drop; missed by its number |
//! | `vitals` | [`Vitals`](crate::Vitals) | node → all | background | drop (the next is complete) |
//! | `jog` | [`JogRequest`](crate::jog::JogRequest), JSON, answered by a [`JogReceipt`](crate::jog::JogReceipt) | client → node, by get | real-time | block |
//! | `alive` | none | node → all, liveliness token | – | – |
//! | `setup` | [`Setup`](crate::Setup), JSON: the node's answer to a get | node → client | background | drop |
//! | `update` | [`UpdateMessage`](crate::update::UpdateMessage), answered by an [`UpdateReply`](crate::update::UpdateReply) | client → node, by get | data | block |

/// What is said below one node's key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NodeTopic {
    /// A job for the node.
    Job,
    /// The node record, JSON.
    State,
    /// The stop.
    Stop,
    /// Lifts the stop latch.
    Release,
    /// One line of text.
    Log,
    /// What the node knows about itself.
    Status,
    /// Orders of the gateway.
    Batch,
    /// The node's answer to an order.
    Ack,
    /// Clock probes and replies.
    Clock,
    /// Synchronized starts.
    Start,
    /// The liveliness token.
    Alive,
    /// How a script ended.
    Report,
    /// What a script publishes.
    Data,
    /// Another firmware.
    Update,
    /// Hold and speed of what the node executes.
    Pace,
    /// Comes to rest on the path, to go on later.
    Hold,
    /// Goes on after a hold.
    Resume,
    /// Another speed.
    Speed,
    /// What happens to a job.
    Trace,
    /// Moves of single axes by hand.
    Jog,
    /// How its chip is.
    Vitals,
    /// What it was told and is made of.
    Setup,
}

impl NodeTopic {
    /// Every topic, in the order of the table.
    pub const ALL: [Self; 22] = [
        Self::Job,
        Self::State,
        Self::Stop,
        Self::Release,
        Self::Log,
        Self::Status,
        Self::Batch,
        Self::Ack,
        Self::Clock,
        Self::Start,
        Self::Alive,
        Self::Report,
        Self::Data,
        Self::Update,
        Self::Pace,
        Self::Hold,
        Self::Resume,
        Self::Speed,
        Self::Trace,
        Self::Jog,
        Self::Vitals,
        Self::Setup,
    ];

    /// Returns the last chunk of the key.
    pub const fn suffix(self) -> &'static str {
        match self {
            Self::Job => "job",
            Self::State => "state",
            Self::Stop => "stop",
            Self::Release => "release",
            Self::Log => "log",
            Self::Status => "status",
            Self::Batch => "batch",
            Self::Ack => "ack",
            Self::Clock => "clock",
            Self::Start => "start",
            Self::Alive => "alive",
            Self::Report => "report",
            Self::Data => "data",
            Self::Update => "update",
            Self::Pace => "pace",
            Self::Hold => "hold",
            Self::Resume => "resume",
            Self::Speed => "speed",
            Self::Trace => "trace",
            Self::Jog => "jog",
            Self::Vitals => "vitals",
            Self::Setup => "setup",
        }
    }

    /// Returns the topic with this last chunk.
    pub fn from_suffix(suffix: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.suffix() == suffix)
    }
}
