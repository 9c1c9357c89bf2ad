//! One meeting point: who has come, the instant that is planned, and what is said until it is over. The
//! table of times, and what can go wrong, stand in the module above.

use super::{
    ABORT_US, ARM_MARGIN_US, COMMIT_US, CONFIRM_MARGIN_ROUND_TRIPS, CONFIRM_MARGIN_US, CONFIRM_US,
    Edge, LEAD_ROUND_TRIPS, LEAD_US_MIN, Limits, ROUND_TRIP_US_MAX, STARTED_PATIENCE_US, Step,
};
use crate::fleet::clock::ClockTrack;
use keys::{
    FleetMicros, LocalMicros, NodeId, QueueId,
    record::{ErrorCode, JobError, StartRecord},
    start::StartMessage,
};
use std::collections::BTreeMap;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Coming,
    Ready,
    Armed,
    Passed,
}

/// One node's place at the meeting point.
#[derive(Clone, Debug)]
pub(super) struct Seat {
    /// Time from the barrier to the first edge behind it as the commands say, µs.
    pub(super) offset_us: u64,
    /// The queue and the number of the barrier in it, once it is sent.
    pub(super) place: Option<(QueueId, u64)>,
    pub(super) stage: Stage,
    /// The node has told since the gateway's start that it has not passed.
    pub(super) waits: bool,
    /// What a commit says: start_at, confirm_by.
    pub(super) orders: Option<(LocalMicros, LocalMicros)>,
    pub(super) edge: Option<Edge>,
    /// Its part is a script: whether it comes is not known before it does.
    pub(super) script: bool,
    /// The script has ended without coming here.
    pub(super) absent: bool,
}

impl Seat {
    pub(super) fn new(offset_us: u64) -> Self {
        Self {
            offset_us,
            place: None,
            stage: Stage::Coming,
            waits: false,
            orders: None,
            edge: None,
            script: false,
            absent: false,
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    start_at: FleetMicros,
    confirm_by: FleetMicros,
    arm_by: FleetMicros,
    send_at: FleetMicros,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Phase {
    Gathering,
    Committed(Plan),
    Confirmed(Plan),
    /// Planned before the gateway's start: it can only turn out to be over.
    Resumed(FleetMicros),
    Over,
    /// Nobody shall go on; those who are armed are told so until then.
    Broken {
        abort_until: FleetMicros,
        send_at: FleetMicros,
        /// Somebody may go on all the same, or has.
        confirmed: bool,
    },
}

/// One meeting point of one job.
#[derive(Clone, Debug)]
pub(super) struct Meeting {
    pub(super) limits: Limits,
    /// What clients call it; empty where nobody asks.
    pub(super) name: String,
    /// No other part of the job can come.
    pub(super) alone: bool,
    pub(super) seats: BTreeMap<NodeId, Seat>,
    pub(super) phase: Phase,
    /// Until when all must be ready and all clocks known.
    pub(super) give_up_at: Option<FleetMicros>,
    pub(super) planned_at: Option<FleetMicros>,
}

impl Meeting {
    pub(super) fn new(limits: Limits, planned: Option<FleetMicros>) -> Self {
        Self {
            limits,
            name: String::new(),
            alone: false,
            seats: BTreeMap::new(),
            phase: planned.map_or(Phase::Gathering, Phase::Resumed),
            give_up_at: None,
            planned_at: planned,
        }
    }

    pub(super) fn hear(
        &mut self,
        node: NodeId,
        message: &StartMessage,
        edge: Option<Edge>,
        now: FleetMicros,
    ) {
        let Some(seat) = self.seats.get_mut(&node) else {
            return;
        };
        match (message, self.phase) {
            (StartMessage::Started { .. }, _) => {
                seat.stage = Stage::Passed;
                seat.edge = seat.edge.or(edge);
            }
            (_, Phase::Over) => {}
            _ if seat.stage == Stage::Passed => {}
            (StartMessage::Ready { .. } | StartMessage::ReadyAt { .. }, Phase::Confirmed(plan)) => {
                // Before, it can only be a late word from before it was armed.
                let slack_us = self.limits.max_skew_us as u64;
                if now.plus_us(slack_us) >= plan.confirm_by {
                    seat.stage = Stage::Ready;
                }
            }
            (StartMessage::Ready { .. } | StartMessage::ReadyAt { .. }, _) => {
                seat.stage = Stage::Ready;
            }
            (StartMessage::Armed { .. }, Phase::Committed(_) | Phase::Broken { .. }) => {
                seat.stage = Stage::Armed;
            }
            _ => {}
        }
    }

    pub(super) fn note_executed(&mut self, node: NodeId, queue: QueueId, executed: u64) {
        let Some(seat) = self.seats.get_mut(&node) else {
            return;
        };
        let Some((_, command)) = seat.place.filter(|(of, _)| *of == queue) else {
            return;
        };
        if executed > command {
            seat.stage = Stage::Passed;
        } else {
            seat.waits = true;
        }
    }

    /// Says what is due and finds out where the meeting is.
    pub(super) fn poll<'c>(
        &mut self,
        clock: impl Fn(&NodeId) -> Option<&'c ClockTrack>,
        now: FleetMicros,
        mut say: impl FnMut(NodeId, StartMessage),
    ) -> Step {
        if let Some(reasons) = self.take_absent() {
            return self.fail(reasons, now);
        }
        let all = |stage: Stage| {
            let mut seats = self.seats.values();
            seats.all(|seat| seat.stage == stage || seat.stage == Stage::Passed)
        };
        let (all_ready, all_armed) = (all(Stage::Ready), all(Stage::Armed));
        if all(Stage::Passed) && !matches!(self.phase, Phase::Over | Phase::Broken { .. }) {
            self.phase = Phase::Over;
            return Step::Met;
        }
        match self.phase {
            Phase::Gathering => {
                let reasons = if all_ready {
                    let patience_us = self.limits.ready_timeout_us;
                    self.give_up_at.get_or_insert(now.plus_us(patience_us));
                    match self.plan(clock, now) {
                        Ok(at) => return Step::Planned(at),
                        Err(reasons) => reasons,
                    }
                } else {
                    self.not_ready()
                };
                if self.give_up_at.is_some_and(|at| now >= at) {
                    return self.fail(reasons, now);
                }
                Step::Nothing
            }
            Phase::Committed(mut plan) => {
                if now >= plan.arm_by {
                    let words = "the node did not answer the commit in time";
                    return self.fail(self.those(Stage::Armed, words), now);
                }
                if all_armed {
                    plan.send_at = now;
                    self.phase = Phase::Confirmed(plan);
                    return self.poll(clock, now, say);
                }
                if now >= plan.send_at {
                    plan.send_at = now.plus_us(COMMIT_US);
                    self.phase = Phase::Committed(plan);
                    for (node, seat) in &self.seats {
                        if let (Some((queue, command)), Some((start_at, confirm_by))) =
                            (seat.place, seat.orders)
                            && seat.stage == Stage::Ready
                        {
                            let commit = StartMessage::Commit {
                                queue,
                                command,
                                start_at,
                                confirm_by,
                            };
                            say(*node, commit);
                        }
                    }
                }
                Step::Nothing
            }
            Phase::Confirmed(mut plan) => {
                let disarmed = self.seats.values().any(|seat| seat.stage == Stage::Ready);
                let patient = now < plan.start_at.plus_us(STARTED_PATIENCE_US);
                if disarmed {
                    let words = "no confirmation reached the node in time";
                    let disarmed = self.seats.iter();
                    let disarmed = disarmed.filter(|(_, seat)| seat.stage == Stage::Ready);
                    let reasons = disarmed.map(|(node, _)| (*node, offline(words))).collect();
                    return self.fail(reasons, now);
                }
                if !patient {
                    let words = "the node was not heard to start";
                    return self.fail(self.those(Stage::Passed, words), now);
                }
                if now < plan.start_at && now >= plan.send_at {
                    plan.send_at = now.plus_us(CONFIRM_US);
                    self.phase = Phase::Confirmed(plan);
                    for (node, seat) in &self.seats {
                        if let Some((queue, command)) = seat.place
                            && seat.stage != Stage::Passed
                        {
                            say(*node, StartMessage::Confirm { queue, command });
                        }
                    }
                }
                Step::Nothing
            }
            Phase::Resumed(_) => {
                let waits = self.seats.values().any(|seat| seat.waits);
                if !waits {
                    return Step::Nothing;
                }
                let words = "the gateway restarted during the start";
                let mut reasons = self.those(Stage::Passed, words);
                for (_, error) in &mut reasons {
                    error.code = ErrorCode::Internal;
                }
                self.fail(reasons, now)
            }
            Phase::Broken {
                abort_until,
                send_at,
                confirmed,
            } => {
                if now < abort_until && now >= send_at {
                    self.phase = Phase::Broken {
                        abort_until,
                        send_at: now.plus_us(ABORT_US),
                        confirmed,
                    };
                    for (node, seat) in &self.seats {
                        if let Some((queue, command)) = seat.place
                            && matches!(seat.stage, Stage::Coming | Stage::Armed)
                        {
                            say(*node, StartMessage::Abort { queue, command });
                        }
                    }
                }
                Step::Nothing
            }
            Phase::Over => Step::Nothing,
        }
    }

    pub(super) fn poll_timeout(&self) -> Option<FleetMicros> {
        match self.phase {
            Phase::Gathering => self.give_up_at,
            Phase::Committed(plan) => Some(plan.send_at.min(plan.arm_by)),
            Phase::Confirmed(plan) if plan.send_at < plan.start_at => Some(plan.send_at),
            Phase::Confirmed(plan) => Some(plan.start_at.plus_us(STARTED_PATIENCE_US)),
            Phase::Broken {
                abort_until,
                send_at,
                ..
            } => {
                let mut seats = self.seats.values();
                let armed = seats.any(|seat| {
                    seat.place.is_some() && matches!(seat.stage, Stage::Coming | Stage::Armed)
                });
                (armed && send_at < abort_until).then_some(send_at)
            }
            Phase::Resumed(_) | Phase::Over => None,
        }
    }

    /// Chooses the instant.
    ///
    /// # Errors
    /// The clocks that are not known well enough.
    fn plan<'c>(
        &mut self,
        clock: impl Fn(&NodeId) -> Option<&'c ClockTrack>,
        now: FleetMicros,
    ) -> Result<FleetMicros, Vec<(NodeId, JobError)>> {
        let unknown = |node: &NodeId| (*node, not_ready("the node's clock is not known yet"));
        let mut rtt_us: f64 = 0.0;
        for node in self.seats.keys() {
            let slowest_us = clock(node).and_then(ClockTrack::rtt_us_max);
            rtt_us = rtt_us.max(slowest_us.ok_or_else(|| vec![unknown(node)])?);
        }
        let rtt_us = rtt_us.min(ROUND_TRIP_US_MAX);
        let trips = |count: f64, least_us: u64| least_us.max((count * rtt_us) as u64);
        let start_at = now.plus_us(trips(LEAD_ROUND_TRIPS, LEAD_US_MIN));
        let margin_us = trips(CONFIRM_MARGIN_ROUND_TRIPS, CONFIRM_MARGIN_US);
        let confirm_by = FleetMicros(start_at.0 - margin_us);
        let arm_by = FleetMicros(confirm_by.0 - trips(1.0, ARM_MARGIN_US));
        let mut errors = Vec::new();
        let mut orders = Vec::new();
        for node in self.seats.keys() {
            let local = |at: FleetMicros| {
                let estimate = clock(node)?.estimate(at)?;
                let rounded_us = estimate.local.0 + u64::from(estimate.fraction_us >= 0.5);
                Some((LocalMicros(rounded_us), estimate.error_us))
            };
            let times = local(start_at).zip(local(confirm_by));
            let ((start_at, error_us), (confirm_by, _)) =
                times.ok_or_else(|| vec![unknown(node)])?;
            errors.push((error_us, *node));
            orders.push((start_at, confirm_by));
        }
        errors.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let worst: f64 = errors.iter().take(2).map(|(error_us, _)| error_us).sum();
        if worst > self.limits.max_skew_us {
            let allowed_us = self.limits.max_skew_us;
            let reasons = errors.iter().take(2).map(|(error_us, node)| {
                let message = format!(
                    "the node's clock is known to ±{error_us:.1} µs only; max_skew_us is {allowed_us}"
                );
                (*node, not_ready(message))
            });
            return Err(reasons.collect());
        }
        for (seat, orders) in self.seats.values_mut().zip(orders) {
            seat.orders = Some(orders);
        }
        self.planned_at = Some(start_at);
        self.phase = Phase::Committed(Plan {
            start_at,
            confirm_by,
            arm_by,
            send_at: now,
        });
        Ok(start_at)
    }

    fn not_ready(&self) -> Vec<(NodeId, JobError)> {
        let timeout_ms = self.limits.ready_timeout_us as f64 / 1e3;
        let message = format!("the node was not ready within {timeout_ms} ms");
        let late = self.seats.iter();
        let late = late.filter(|(_, seat)| seat.stage == Stage::Coming);
        late.map(|(node, _)| (*node, not_ready(message.as_str())))
            .collect()
    }

    /// Returns everybody who has not come as far as this.
    fn those(&self, below: Stage, words: &str) -> Vec<(NodeId, JobError)> {
        let late = self.seats.iter();
        let late = late.filter(|(_, seat)| seat.stage != below && seat.stage != Stage::Passed);
        late.map(|(node, _)| (*node, offline(words))).collect()
    }

    pub(super) fn fail(&mut self, reasons: Vec<(NodeId, JobError)>, now: FleetMicros) -> Step {
        self.break_off(now);
        Step::Failed(reasons)
    }

    /// Nobody shall go on. Returns whether somebody may do so all the same, or has.
    pub(super) fn break_off(&mut self, now: FleetMicros) -> bool {
        let (abort_until, confirmed) = match self.phase {
            Phase::Over => return false,
            Phase::Broken { confirmed, .. } => return confirmed,
            Phase::Gathering => (now, false),
            Phase::Committed(plan) => (plan.start_at, false),
            Phase::Confirmed(plan) => (plan.start_at, true),
            Phase::Resumed(start_at) => (start_at, true),
        };
        if matches!(self.phase, Phase::Resumed(_) | Phase::Committed(_)) {
            // A commit may be on its way to whoever said that it is ready.
            for seat in self.seats.values_mut() {
                if seat.stage == Stage::Ready {
                    seat.stage = Stage::Coming;
                }
            }
        }
        self.phase = Phase::Broken {
            abort_until,
            send_at: now,
            confirmed,
        };
        confirmed
    }

    /// Returns the start as the nodes measured it, once all have.
    pub(super) fn measured(&self) -> Option<StartRecord> {
        let planned = self.planned_at?;
        let mut late_us = Vec::with_capacity(self.seats.len());
        let mut errors_us = Vec::with_capacity(self.seats.len());
        for (node, seat) in &self.seats {
            let edge = seat.edge?;
            let behind_us = edge.at.0 as i64 - planned.0 as i64 - seat.offset_us as i64;
            late_us.push((*node, behind_us));
            errors_us.push(edge.error_us);
        }
        let first_us = late_us.iter().map(|(_, us)| *us).min()?;
        let last_us = late_us.iter().map(|(_, us)| *us).max()?;
        errors_us.sort_by(|a, b| b.total_cmp(a));
        Some(StartRecord {
            planned,
            skew_us: (last_us - first_us) as f64,
            by_node_us: late_us
                .into_iter()
                .map(|(node, us)| (node, (us - first_us) as f64))
                .collect(),
            uncertainty_us: errors_us.iter().take(2).sum(),
        })
    }
}

pub(super) fn not_ready(message: impl Into<String>) -> JobError {
    JobError::new(ErrorCode::NotAllowed, message)
}

fn offline(message: &str) -> JobError {
    JobError::new(ErrorCode::NodeOffline, message)
}
