//! What every verb of a node needs besides the node, and what it leaves behind.

use super::Facts;
use crate::{
    fleet::{
        FleetConfig,
        event::{Effect, Lane, ReplyTo},
    },
    job::book::Book,
};
use keys::{FleetMicros, Keys, NodeId, NodeTopic, record::JobError};

/// One instant of the fleet: what every verb needs besides the node.
pub(in crate::fleet) struct Turn<'t> {
    pub(in crate::fleet) now: FleetMicros,
    pub(in crate::fleet) started_at: FleetMicros,
    pub(in crate::fleet) config: &'t FleetConfig,
    pub(in crate::fleet) book: &'t mut Book,
    pub(in crate::fleet) effects: &'t mut Vec<Effect>,
    /// Releases that are over.
    pub(in crate::fleet) released: Vec<Released>,
    /// A clock probe may leave: its stamp is `now`, and a second one would leave later.
    pub(in crate::fleet) may_probe: bool,
    /// Shortest time from one probe of a node to the next, so that all together do not flood the gateway,
    /// µs.
    pub(in crate::fleet) probe_us_min: u64,
}

/// What became of a get on `release`, `hold`, `resume` or `speed`.
pub(in crate::fleet) struct Released {
    pub(in crate::fleet) to: ReplyTo,
    /// Why it is not as wished; `Ok`: it is.
    pub(in crate::fleet) outcome: Result<(), JobError>,
    /// What the reply says; `None`: the node's record.
    pub(in crate::fleet) receipt: Option<Vec<u8>>,
}

impl Released {
    pub(super) fn done(to: ReplyTo) -> Self {
        Self {
            to,
            outcome: Ok(()),
            receipt: None,
        }
    }

    pub(super) fn refused(to: ReplyTo, error: JobError) -> Self {
        Self {
            to,
            outcome: Err(error),
            receipt: None,
        }
    }
}

impl Turn<'_> {
    pub(super) fn keys(&self) -> &Keys {
        &self.config.keys
    }

    /// Says something to a node behind this gateway's epoch, if it knows of such.
    pub(super) fn tell(
        &mut self,
        facts: &Facts,
        node: &NodeId,
        topic: NodeTopic,
        bytes: &[u8],
        lane: Lane,
    ) {
        let payload = facts.with_epoch(self.config.epoch, bytes);
        self.publish(node, topic, payload, lane);
    }

    pub(super) fn publish(
        &mut self,
        node: &NodeId,
        topic: NodeTopic,
        payload: Vec<u8>,
        lane: Lane,
    ) {
        let key = self.keys().node(node, topic).as_str().to_owned();
        self.effects.push(Effect::Publish {
            key,
            payload,
            json: matches!(topic, NodeTopic::State | NodeTopic::Stop),
            lane,
        });
    }
}
