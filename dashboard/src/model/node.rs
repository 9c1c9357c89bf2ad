//! One node: what it said, what the gateway says about it, and the last minutes of both.

use super::{
    history::{Doing, History},
    limits::{CLOCK_EVERY_S, CLOCKS_MAX, SAMPLES_MAX, STALE_AFTER_S},
    ring::Ring,
    setup::SetupState,
};
use crate::{
    message::{Answer, Moment},
    request::Ticket,
};
use keys::{
    AXES_MAX, AxisStatus, JobId, LocalMicros, NodeId, Setup, Status, Vitals,
    record::{ClockRecord, LinkRecord, NodeRecord, NodeWord, PaceRecord},
};

/// Whether a node is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Presence {
    /// There, and heard of lately.
    Alive,
    /// There by its token, but silent for too long.
    Stale,
    /// Gone.
    Offline,
}

/// Why somebody should look at a node; the first of these that holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Concern {
    /// It reports a fault.
    Fault,
    /// It was there and is gone.
    Lost,
    /// Its stop latch is set.
    Stopped,
    /// It is silent for too long.
    Silent,
}

/// What a node said at one moment, for plots.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// When it was heard here.
    pub at: Moment,
    /// The node's own clock.
    pub node_at: LocalMicros,
    /// Its axes.
    pub axes: heapless::Vec<AxisStatus, AXES_MAX>,
    /// Commands that it had and that had not ended.
    pub queue_depth: u32,
    /// Laser power, percent.
    pub laser_percent: u8,
}

/// How long messages travelled to a node at one moment, for plots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TravelSample {
    /// When it was heard here.
    pub at: Moment,
    /// Shortest and longest time there and back in the last minutes, µs.
    pub rtt_us: [f64; 2],
}

/// An estimate of the node's clock at one moment, for plots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockSample {
    /// When it was heard here.
    pub at: Moment,
    /// See [`ClockRecord`].
    pub clock: ClockRecord,
}

/// See the module.
#[derive(Debug)]
pub struct Node {
    id: NodeId,
    token: Option<bool>,
    lost_at: Option<Moment>,
    heard_at: Moment,
    // Before that nobody listened.
    listened_from: Moment,
    record: Option<(Moment, NodeRecord)>,
    status: Option<(Moment, Status)>,
    vitals: Option<(Moment, Vitals)>,
    setup: SetupState,
    samples: Ring<Sample, SAMPLES_MAX>,
    clocks: Ring<ClockSample, CLOCKS_MAX>,
    travels: Ring<TravelSample, CLOCKS_MAX>,
    history: History,
}

impl Node {
    pub(super) fn new(id: NodeId, at: Moment) -> Self {
        Self {
            id,
            token: None,
            lost_at: None,
            heard_at: at,
            listened_from: at,
            record: None,
            status: None,
            vitals: None,
            setup: SetupState::default(),
            samples: Ring::default(),
            clocks: Ring::default(),
            travels: Ring::default(),
            history: History::default(),
        }
    }

    /// Takes the token's coming or going and returns whether that is news.
    pub(super) fn token(&mut self, at: Moment, alive: bool) -> bool {
        let was = self.token.replace(alive);
        if alive {
            (self.lost_at, self.heard_at) = (None, at);
        } else if was != Some(false) {
            self.lost_at = Some(at);
        }
        self.look(at);
        was != Some(alive)
    }

    pub(super) fn record(&mut self, at: Moment, record: NodeRecord) {
        // The gateway tells of nodes that are not there; that is nothing heard from them.
        let was_there = self.is_there();
        if record.alive {
            self.heard_at = at;
        }
        if let Some(clock) = record.clock {
            let last = self.clocks.last().map(|last| last.at);
            if last.is_none_or(|last| at.since_s(last) >= CLOCK_EVERY_S) {
                self.clocks.push(ClockSample { at, clock });
            }
        }
        self.record = Some((at, record));
        if was_there && !self.is_there() {
            self.lost_at = Some(at);
        }
        self.look(at);
    }

    /// Takes how long messages travel to it, if that is known.
    pub(super) fn travels(&mut self, at: Moment, link: LinkRecord) {
        if let (Some(shortest_us), Some(longest_us)) = (link.rtt_us_min, link.rtt_us_max) {
            let rtt_us = [shortest_us, longest_us];
            self.travels.push(TravelSample { at, rtt_us });
        }
    }

    pub(super) fn status(&mut self, at: Moment, status: Status) {
        self.heard_at = at;
        let depth =
            status.accepted_commands - status.executed_commands.min(status.accepted_commands);
        self.samples.push(Sample {
            at,
            node_at: status.at,
            axes: status.axes.clone(),
            queue_depth: u32::try_from(depth).unwrap_or(u32::MAX),
            laser_percent: status.laser_percent,
        });
        let fault = |status: &Status| status.faults.last().map(|fault| (fault.at, fault.code.0));
        let known = self.status.as_ref().and_then(|(_, known)| fault(known));
        if let Some((_, code)) = fault(&status).filter(|new| Some(*new) != known) {
            self.history.fault(at, code);
        }
        self.status = Some((at, status));
        self.look(at);
    }

    /// Notes what it does now.
    pub(super) fn look(&mut self, now: Moment) {
        let doing = match (self.presence(now), self.word()) {
            (Presence::Offline, _) if self.lost_at.is_some() => Doing::Lost,
            (Presence::Stale, _) => Doing::Silent,
            (_, word) => Doing::Word(word),
        };
        let job = self.is_there().then(|| self.job()).flatten();
        self.history.note(now, doing, job);
    }

    /// Takes that there is a link again: it can be heard from now on.
    pub(super) fn listen(&mut self, at: Moment) {
        self.listened_from = at;
    }

    /// Notes that nobody knows what it does.
    pub(super) fn unheard(&mut self, now: Moment) {
        self.history.note(now, Doing::Unknown, None);
    }

    /// Returns its name.
    pub fn id(&self) -> NodeId {
        self.id
    }

    /// Returns whether it is there, by its own token; without one, by the gateway's word.
    pub fn is_there(&self) -> bool {
        let by_gateway = || self.record.as_ref().is_some_and(|(_, record)| record.alive);
        self.token.unwrap_or_else(by_gateway)
    }

    /// Returns whether it is there and speaks.
    pub fn presence(&self, now: Moment) -> Presence {
        let silent_from = self.heard_at.max(self.listened_from);
        match (self.is_there(), now.since_s(silent_from)) {
            (false, _) => Presence::Offline,
            (true, age_s) if age_s > STALE_AFTER_S => Presence::Stale,
            (true, _) => Presence::Alive,
        }
    }

    /// Returns why somebody should look at it. While the link is down nothing new is known, and
    /// silence says nothing about the node.
    pub fn concern(&self, now: Moment, link_up: bool) -> Option<Concern> {
        match (self.word(), self.presence(now)) {
            (NodeWord::Fault, _) => Some(Concern::Fault),
            (_, Presence::Offline) if self.lost_at.is_some() => Some(Concern::Lost),
            (_, Presence::Offline) => None,
            (NodeWord::Stopped, _) => Some(Concern::Stopped),
            (_, Presence::Stale) if link_up => Some(Concern::Silent),
            _ => None,
        }
    }

    /// Returns what it does: by its own latest word, else by the gateway's.
    pub fn word(&self) -> NodeWord {
        if !self.is_there() {
            return NodeWord::Offline;
        }
        match (&self.status, &self.record) {
            // A record may be newer than the last status that was not dropped.
            (Some((at, status)), Some((record_at, record))) if at < record_at => {
                match record.state {
                    NodeWord::Offline => status.state.into(),
                    word => word,
                }
            }
            (Some((_, status)), _) => status.state.into(),
            (None, Some((_, record))) => record.state,
            (None, None) => NodeWord::Idle,
        }
    }

    /// Returns whether anything but its token was ever heard.
    pub fn is_known(&self) -> bool {
        self.status.is_some() || self.record.is_some()
    }

    /// Returns when it was heard of last.
    pub fn heard_at(&self) -> Moment {
        self.heard_at
    }

    /// Returns since when it is gone, if this window saw it go.
    pub fn lost_at(&self) -> Option<Moment> {
        self.lost_at
    }

    /// Returns what the gateway said last.
    pub fn latest_record(&self) -> Option<&NodeRecord> {
        self.record.as_ref().map(|(_, record)| record)
    }

    /// Returns what it said itself last.
    pub fn latest_status(&self) -> Option<&Status> {
        self.status.as_ref().map(|(_, status)| status)
    }

    /// Returns the position of each axis, steps: its own latest word, else the gateway's.
    pub fn positions_steps(&self) -> Vec<i64> {
        match (&self.status, &self.record) {
            (Some((_, status)), _) => status.axes.iter().map(|axis| axis.position_steps).collect(),
            (None, Some((_, record))) => record.position.clone(),
            (None, None) => Vec::new(),
        }
    }

    /// Returns the speed of each axis with sign, steps/s.
    pub fn speeds_hz(&self) -> Vec<f64> {
        let axes = self.latest_status().map(|status| status.axes.iter());
        let speeds = axes.map(|axes| axes.map(|axis| f64::from(axis.speed_mhz) / 1e3));
        speeds.map(Iterator::collect).unwrap_or_default()
    }

    /// Returns commands waiting and commands that still fit.
    pub fn queue(&self) -> Option<(u64, u64)> {
        match (&self.status, &self.record) {
            (Some((_, status)), _) => {
                let depth = status
                    .accepted_commands
                    .saturating_sub(status.executed_commands);
                Some((depth, u64::from(status.credit_commands)))
            }
            (None, Some((_, record))) => Some((record.queue.depth, record.queue.free)),
            (None, None) => None,
        }
    }

    /// Returns the job that it executes.
    pub fn job(&self) -> Option<JobId> {
        match (&self.status, &self.record) {
            (Some((_, status)), _) => status.job,
            (None, Some((_, record))) => record.job,
            (None, None) => None,
        }
    }

    /// Returns what the gateway knows about its clock.
    pub fn clock(&self) -> Option<ClockRecord> {
        self.latest_record().and_then(|record| record.clock)
    }

    /// Returns whether it is held and how fast it goes, unless that is as always.
    pub fn pace(&self) -> Option<PaceRecord> {
        let pace = self.latest_record()?.pace?;
        (self.is_there() && (pace.hold || pace.percent != 100)).then_some(pace)
    }

    /// Returns its signal strength, dBm.
    pub fn rssi_dbm(&self) -> Option<i8> {
        let own = self.latest_status().and_then(|status| status.rssi_dbm);
        own.or_else(|| self.latest_record().and_then(|record| record.rssi_dbm))
    }

    /// Takes how its chip is.
    pub(super) fn set_vitals(&mut self, at: Moment, vitals: Vitals) {
        self.vitals = Some((at, vitals));
    }

    /// Returns how its chip was, and when it said so.
    pub fn vitals(&self) -> Option<&(Moment, Vitals)> {
        self.vitals.as_ref()
    }

    /// Takes how it is set.
    pub(super) fn set_setup(&mut self, at: Moment, setup: Box<Setup>) {
        let boot = self.boot();
        self.setup.tell(at, boot, setup);
    }

    /// Takes that it is asked how it is set.
    pub(super) fn ask_setup(&mut self, ticket: Ticket, at: Moment) {
        let boot = self.boot();
        self.setup.ask(ticket, at, boot);
    }

    /// Takes an answer and returns whether it belongs to that question.
    pub(super) fn answer_setup(&mut self, ticket: Ticket, answer: &Answer) -> bool {
        self.setup.answer(ticket, answer)
    }

    pub(super) fn setup_is_due(&self) -> bool {
        let boot = self.boot().filter(|_| self.is_there());
        boot.is_some_and(|boot| self.setup.is_due(boot, self.listened_from))
    }

    /// Returns how it is set, as far as it was asked.
    pub fn setup(&self) -> &SetupState {
        &self.setup
    }

    /// Returns the number of its present boot, by its own latest word.
    pub fn boot(&self) -> Option<u32> {
        self.latest_status().map(|status| status.queue.boot)
    }

    /// Returns number and words of its last fault.
    pub fn last_fault(&self) -> Option<(u16, String)> {
        let own = self.latest_status().and_then(|status| status.faults.last());
        let told = || {
            let fault = self.latest_record()?.faults.last()?;
            Some((fault.code, fault.message.clone()))
        };
        match own {
            Some(fault) => Some((fault.code.0, fault.code.as_str().to_owned())),
            None => told(),
        }
    }

    /// Returns the number of its last fault.
    pub fn last_fault_code(&self) -> Option<u16> {
        let own = self.latest_status().and_then(|status| status.faults.last());
        let told = || self.latest_record()?.faults.last().map(|fault| fault.code);
        own.map(|fault| fault.code.0).or_else(told)
    }

    /// Returns why it was stopped last, in the words that clients see.
    pub fn stop_reason(&self) -> Option<&'static str> {
        let own = self.latest_status().and_then(|status| status.stop.as_ref());
        let told = || Some(self.latest_record()?.stopped?.reason);
        let reason = own.map(|stop| stop.reason).or_else(told);
        reason.map(keys::StopReason::as_str)
    }

    /// Returns what it said in the last minutes, oldest first.
    pub fn samples(&self) -> &Ring<Sample, SAMPLES_MAX> {
        &self.samples
    }

    /// Returns what it did in the last hours.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// Returns what was known about its clock in the last minutes, oldest first.
    pub fn clocks(&self) -> &Ring<ClockSample, CLOCKS_MAX> {
        &self.clocks
    }

    /// Returns how long messages travelled to it in the last minutes, oldest first.
    pub fn travelled(&self) -> &Ring<TravelSample, CLOCKS_MAX> {
        &self.travels
    }
}
