//! What clients see of a node: its record, and when it is told. Owns the conversion of a node's
//! stamps to UTC.

use super::{Node, Turn};
use crate::fleet::event::Lane;
use keys::{
    FleetMicros, LocalMicros, NodeTopic,
    record::{
        ClockRecord, FaultRecord, LinkRecord, NodeRecord, NodeWord, QueueRecord, StoppedRecord,
        to_json,
    },
    status::FaultCode,
};

/// Time between two records of a node of which only clock and uptime change, µs.
const CALM_US: u64 = 1_000_000;

impl Node {
    pub(super) fn tell(&mut self, turn: &mut Turn<'_>) {
        if !self.stale_record || turn.now.since_us(self.told_at) < turn.config.node_record_us {
            return;
        }
        let record = self.record(turn.now, turn.started_at);
        let same = self.told.as_ref().is_some_and(|told| {
            // The clock's estimate and the uptime change all the time; once a second is enough.
            let calm = turn.now.since_us(self.told_at) < CALM_US;
            let quiet = NodeRecord {
                clock: told.clock,
                uptime_s: told.uptime_s,
                rssi_dbm: told.rssi_dbm,
                ..record.clone()
            };
            record == *told || (calm && quiet == *told)
        });
        self.stale_record = false;
        if same {
            return;
        }
        let payload = to_json(&record);
        turn.publish(&self.id, NodeTopic::State, payload, Lane::Record);
        self.told = Some(record);
        self.told_at = turn.now;
    }

    /// Returns the record as clients see it.
    pub fn record(&self, now: FleetMicros, started_at: FleetMicros) -> NodeRecord {
        let facts = &self.facts;
        let status = self.status.as_ref();
        let state = match (self.alive, status) {
            (true, Some(status)) => NodeWord::from(status.state),
            _ => NodeWord::Offline,
        };
        let depth = self.accepted.saturating_sub(self.executed);
        let [major, minor, patch] = facts.firmware;
        NodeRecord {
            node: self.id,
            alive: self.alive,
            state,
            position: match status {
                Some(status) => status.axes.iter().map(|axis| axis.position_steps).collect(),
                None => facts.position_steps.clone(),
            },
            queue: QueueRecord {
                depth,
                free: self.limit.saturating_sub(self.accepted),
            },
            job: self
                .active
                .or_else(|| status.filter(|_| self.alive).and_then(|status| status.job)),
            stopped: facts.latch.and_then(|latch| {
                Some(StoppedRecord {
                    reason: latch.reason?,
                    at: latch.at,
                })
            }),
            clock: self.clock_record(now, started_at),
            firmware: format!("{major}.{minor}.{patch}"),
            uptime_s: status.map_or(0, |status| status.at.0 / 1_000_000),
            rssi_dbm: status.and_then(|status| status.rssi_dbm),
            pace: self.pace_record(),
            faults: self.fault_records(),
        }
    }

    /// Its own faults, and what this gateway sees of it.
    fn fault_records(&self) -> Vec<FaultRecord> {
        let own = self.faults.iter().map(|seen| (seen.fault.code, seen.at));
        let twin = self.twin.filter(|twin| twin.certain);
        let twin = twin.map(|twin| (FaultCode::TWIN, twin.first_at));
        let other = self.disobeys_at.map(|at| (FaultCode::OTHER_GATEWAY, at));
        own.chain(twin)
            .chain(other)
            .map(|(code, at)| FaultRecord {
                code: code.0,
                message: code.as_str().to_owned(),
                at,
            })
            .collect()
    }

    /// A node's clock counts from its boot and ours from 1970, so their plain difference says
    /// nothing to anybody. What is shown is the node's clock minus the time since this gateway's
    /// start.
    fn clock_record(&self, now: FleetMicros, started_at: FleetMicros) -> Option<ClockRecord> {
        let estimate = self.clock.estimate(now)?;
        let ours_us = now.since_us(started_at) as i64;
        Some(ClockRecord {
            offset_us: (estimate.local.0 as i64 - ours_us) as f64 + estimate.fraction_us,
            error_us: estimate.error_us,
            drift_ppm: estimate.drift_ppm,
        })
    }

    /// Returns how long messages travel to it and back.
    pub fn link_record(&self, now: FleetMicros) -> LinkRecord {
        LinkRecord {
            node: self.id,
            rtt_us_min: self.clock.estimate(now).map(|known| known.rtt_us_min),
            rtt_us_max: self.clock.rtt_us_max(),
        }
    }

    /// UTC of a stamp by the node: by its clock's estimate, or else by how long ago it was when
    /// the status was written.
    pub(super) fn fleet_from_local(
        &self,
        stamp: LocalMicros,
        status_at: LocalMicros,
        now: FleetMicros,
    ) -> FleetMicros {
        let by_clock = self.clock.fleet_from_local(stamp);
        by_clock.unwrap_or(FleetMicros(now.0.saturating_sub(status_at.since_us(stamp))))
    }
}
