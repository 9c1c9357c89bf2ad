//! Sequence numbers of what comes in, and messages put together from fragments.
//!
//! ```text
//!  Fragment(first, more) ▒▒▒  Fragment(more) ▒▒▒  Fragment ▒▒  ─▶ one message
//! ```
//!
//! Owns a sequence and at most one chain for each priority and reliability. Between frames it
//! demands only that numbers rise: a router skips one after each fragmented message and more when
//! it drops. Inside a chain numbers must be contiguous. What does not fit the bounds is dropped
//! and counted, never a reason to end the connection.

use alloc::vec::Vec;

use zenoh_protocol::{
    core::{Priority as WirePriority, Reliability},
    transport::{FragmentHeader, TransportSn},
};

use crate::{
    event::{Counters, SessionError},
    limits::FRAGMENT_CHAINS_MAX,
    transmit::LANES,
};

#[derive(Debug, Default)]
struct Lane {
    last_sn: TransportSn,
    chain: Option<Chain>,
    /// Fragments of a chain that was dropped are skipped without counting again.
    skipping: bool,
    /// The last message was the end of a chain, after which the router skips a number.
    after_chain: bool,
}

#[derive(Debug)]
struct Chain {
    bytes: Vec<u8>,
    next_sn: TransportSn,
}

/// What was agreed with the peer about the way from it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms {
    pub(crate) qos: bool,
    pub(crate) sn_mask: TransportSn,
    pub(crate) initial_sn: TransportSn,
    pub(crate) markers: bool,
}

#[derive(Debug)]
pub(crate) struct Receiver {
    lanes: [[Lane; 2]; LANES],
    terms: Terms,
    chain_bytes: usize,
    message_bytes_max: usize,
}

impl Receiver {
    pub(crate) fn new(message_bytes_max: usize) -> Self {
        Self {
            lanes: Default::default(),
            terms: Terms {
                qos: false,
                sn_mask: 0,
                initial_sn: 0,
                markers: false,
            },
            chain_bytes: 0,
            message_bytes_max,
        }
    }

    /// Starts a connection: no chain, every sequence at its beginning.
    pub(crate) fn open(&mut self, terms: Terms) {
        self.clear();
        self.terms = terms;
        for lane in self.lanes.iter_mut().flatten() {
            lane.last_sn = terms.initial_sn.wrapping_sub(1) & terms.sn_mask;
        }
    }

    /// Gives all memory back.
    pub(crate) fn clear(&mut self) {
        self.lanes = Default::default();
        self.chain_bytes = 0;
    }

    /// Takes the number of a frame; `false` if its messages must be dropped.
    pub(crate) fn frame(
        &mut self,
        reliability: Reliability,
        priority: WirePriority,
        sn: TransportSn,
        counters: &mut Counters,
    ) -> Result<bool, SessionError> {
        self.advance(reliability, priority, sn, counters)
    }

    /// Takes a fragment and gives the message that it completes.
    pub(crate) fn fragment(
        &mut self,
        header: &FragmentHeader,
        payload: &[u8],
        counters: &mut Counters,
    ) -> Result<Option<Vec<u8>>, SessionError> {
        let priority = header.ext_qos.priority();
        if !self.advance(header.reliability, priority, header.sn, counters)? {
            return Ok(None);
        }
        let Terms {
            sn_mask, markers, ..
        } = self.terms;
        let bytes_max = self.message_bytes_max;
        let chains_bytes_max = bytes_max.saturating_mul(FRAGMENT_CHAINS_MAX);
        let lane = &mut self.lanes[self.terms.lane(priority)][index(header.reliability)];
        lane.after_chain = !header.more;

        let first =
            header.ext_first.is_some() || (!markers && lane.chain.is_none() && !lane.skipping);
        if first {
            if let Some(chain) = lane.chain.take() {
                self.chain_bytes -= chain.bytes.len();
                counters.reassembly_drops = counters.reassembly_drops.wrapping_add(1);
            }
            lane.skipping = false;
            lane.chain = Some(Chain {
                bytes: Vec::new(),
                next_sn: header.sn,
            });
        }
        let Some(mut chain) = lane.chain.take() else {
            // The beginning is lost, or was dropped here.
            if !lane.skipping {
                counters.reassembly_drops = counters.reassembly_drops.wrapping_add(1);
            }
            lane.skipping = header.more && header.ext_drop.is_none();
            return Ok(None);
        };
        let held_bytes = chain.bytes.len();
        let dropped = header.ext_drop.is_some()
            || header.sn != chain.next_sn
            || held_bytes + payload.len() > bytes_max
            || self.chain_bytes + payload.len() > chains_bytes_max;
        if dropped {
            self.chain_bytes -= held_bytes;
            counters.reassembly_drops = counters.reassembly_drops.wrapping_add(1);
            lane.skipping = header.more && header.ext_drop.is_none();
            return Ok(None);
        }
        chain.bytes.extend_from_slice(payload);
        if header.more {
            self.chain_bytes += payload.len();
            chain.next_sn = header.sn.wrapping_add(1) & sn_mask;
            lane.chain = Some(chain);
            Ok(None)
        } else {
            self.chain_bytes -= held_bytes;
            Ok(Some(chain.bytes))
        }
    }

    fn advance(
        &mut self,
        reliability: Reliability,
        priority: WirePriority,
        sn: TransportSn,
        counters: &mut Counters,
    ) -> Result<bool, SessionError> {
        let Terms { qos, sn_mask, .. } = self.terms;
        if !qos && priority != WirePriority::DEFAULT {
            return Err(SessionError::Priority);
        }
        if sn & !sn_mask != 0 {
            return Err(SessionError::SequenceNumber);
        }
        let lane = &mut self.lanes[self.terms.lane(priority)][index(reliability)];
        let step = sn.wrapping_sub(lane.last_sn) & sn_mask;
        if step == 0 || step > sn_mask >> 1 {
            counters.stale = counters.stale.wrapping_add(1);
            return Ok(false);
        }
        let skipped = step - 1;
        if skipped > u32::from(lane.after_chain) {
            counters.gaps = counters.gaps.wrapping_add(skipped);
        }
        lane.after_chain = false;
        lane.last_sn = sn;
        Ok(true)
    }
}

impl Terms {
    fn lane(&self, priority: WirePriority) -> usize {
        if self.qos { priority as usize } else { 0 }
    }
}

fn index(reliability: Reliability) -> usize {
    usize::from(reliability == Reliability::Reliable)
}
