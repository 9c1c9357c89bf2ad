//! Everything that the operator can ask the fleet for.

use keys::{GroupId, JobId, NodeId, StopMode};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Identifies one request of this window.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Ticket(pub u64);

/// Which nodes a stop or a release is for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Scope {
    /// All of the fleet, also those that this window has never heard of.
    All,
    /// Those whose name matches a wild chunk such as `cell-a-$*`.
    Pattern(String),
    /// Exactly these.
    Nodes(BTreeSet<NodeId>),
}

impl Scope {
    /// Returns the scope of one node.
    pub fn node(node: NodeId) -> Self {
        Self::Nodes(BTreeSet::from([node]))
    }

    /// Returns the chunks of the keys that reach the scope.
    pub fn chunks(&self) -> Vec<String> {
        match self {
            Self::All => vec!["*".to_owned()],
            Self::Pattern(pattern) => vec![pattern.clone()],
            Self::Nodes(nodes) => nodes.iter().map(|node| node.as_str().to_owned()).collect(),
        }
    }
}

impl std::fmt::Display for Scope {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::All => write!(f, "all nodes"),
            Self::Pattern(pattern) => write!(f, "{pattern}"),
            Self::Nodes(nodes) => match (nodes.first(), nodes.len()) {
                (Some(node), 1) => write!(f, "{node}"),
                (_, count) => write!(f, "{count} nodes"),
            },
        }
    }
}

/// Where a job goes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Target {
    /// A node, or every node of a wild chunk: not synchronized.
    Node(String),
    /// Exactly these nodes: a job for each, not synchronized.
    Nodes(BTreeSet<NodeId>),
    /// A synchronized job.
    Group(GroupId),
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Node(chunk) => write!(f, "{chunk}"),
            Self::Nodes(nodes) => write!(f, "{} selected nodes", nodes.len()),
            Self::Group(group) => write!(f, "group {group}"),
        }
    }
}

/// What a job's text is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Language {
    /// JSON: commands, or a script in a string.
    #[default]
    Json,
    /// The script itself.
    Lua,
}

/// What a node's motion shall do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// Come to rest on the path, and keep the place in it.
    Hold,
    /// Go on from there.
    Resume,
    /// Run ramps and lines at this share of their speed, percent: [`Order::PERCENT`].
    Speed(u16),
}

impl Order {
    /// What a speed may be, percent. The drivers' own limits hold too.
    pub const PERCENT: std::ops::RangeInclusive<u16> = 1..=400;

    /// Returns the end of the key and the payload.
    pub fn message(self) -> (&'static str, String) {
        match self {
            Self::Hold => ("hold", String::new()),
            Self::Resume => ("resume", String::new()),
            Self::Speed(percent) => ("speed", format!("{{\"percent\":{percent}}}")),
        }
    }
}

impl std::fmt::Display for Order {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hold => f.write_str("hold"),
            Self::Resume => f.write_str("resume"),
            Self::Speed(percent) => write!(f, "speed {percent} %"),
        }
    }
}

/// What the operator asks for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Request {
    /// Bring nodes to rest; goes straight to them, ahead of everything.
    Stop {
        /// Who.
        scope: Scope,
        /// How.
        mode: StopMode,
    },
    /// Lift the latch of stopped nodes.
    Release {
        /// Whose.
        scope: Scope,
    },
    /// Send a job.
    Submit {
        /// Where it goes.
        target: Target,
        /// What the text is.
        language: Language,
        /// The text.
        text: String,
    },
    /// Cancel a job.
    Cancel {
        /// Which.
        job: JobId,
    },
    /// Change a node's motion.
    Order {
        /// Whose.
        node: NodeId,
        /// How.
        order: Order,
    },
    /// Ask a node how it is set.
    Setup {
        /// Which.
        node: NodeId,
    },
    /// Read a job's text from a file of this computer.
    ReadFile {
        /// Which.
        path: String,
    },
    /// Write a new file on this computer.
    WriteFile {
        /// Which.
        path: String,
        /// What.
        text: String,
    },
    /// Note that an alarm was seen; stays in this window.
    Acknowledge {
        /// Which; all if `None`.
        alarm: Option<u64>,
    },
    /// Ask the gateway for everything again.
    Refresh,
    /// Connect to somewhere else.
    Connect {
        /// A locator such as `tcp/localhost:7447`; `None` is found by scouting.
        to: Option<String>,
    },
}

impl Request {
    /// Returns whether it never leaves this computer.
    pub const fn is_local(&self) -> bool {
        matches!(
            self,
            Self::Acknowledge { .. } | Self::ReadFile { .. } | Self::WriteFile { .. }
        )
    }
}

/// The requests of one frame, in order.
#[derive(Debug, Default)]
pub struct Requests {
    next: u64,
    asked: Vec<(Ticket, Request)>,
}

impl Requests {
    /// Takes a request and returns its ticket.
    pub fn push(&mut self, request: Request) -> Ticket {
        self.next += 1;
        let ticket = Ticket(self.next);
        self.asked.push((ticket, request));
        ticket
    }

    /// Returns whether this was asked and not yet taken.
    pub fn holds(&self, request: &Request) -> bool {
        self.asked.iter().any(|(_, asked)| asked == request)
    }

    /// Returns what was asked since the last call.
    pub fn take(&mut self) -> Vec<(Ticket, Request)> {
        std::mem::take(&mut self.asked)
    }
}
