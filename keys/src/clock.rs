//! Clock probes: two-way stamps t1…t4 on the key `clock`.
//!
//! The gateway stamps t1 when it sends, the node t2 when the probe arrives and t3 when the reply
//! leaves, the gateway t4 when it comes back.

use crate::{FleetMicros, LocalMicros};
use serde::{Deserialize, Serialize};

/// Both directions share the key, so the message says which one it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClockMessage {
    /// Gateway → node.
    Probe(ClockProbe),
    /// Node → gateway.
    Reply(ClockReply),
}

/// Asks for the node's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockProbe {
    /// Number of the probe.
    pub probe: u32,
    /// t1, when it was sent.
    pub sent_at: FleetMicros,
}

/// Tells the node's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockReply {
    /// Number of the probe that is answered.
    pub probe: u32,
    /// The node's boot: another one means another clock.
    pub boot: u32,
    /// t1, as the probe said.
    pub sent_at: FleetMicros,
    /// t2, when the probe arrived.
    pub received_at: LocalMicros,
    /// t3, when the reply left.
    pub replied_at: LocalMicros,
}
