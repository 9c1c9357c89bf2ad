//! Everything that is known, and how it changes: messages in, nothing out.
//!
//! ```text
//!  Message ──apply──▶ Model { link · nodes · jobs · log · stops · alarms }  ──read──▶ panels
//! ```
//!
//! The model never asks for the time: [`Model::now`] is the latest moment that a message or
//! [`Model::tick`] brought. It knows no egui and no zenoh. Every collection has a bound, in
//! [`limits`].

pub mod alarms;
pub mod capture;
pub mod effort;
pub mod history;
pub mod jobs;
pub mod limits;
pub mod link;
pub mod log;
pub mod node;
pub mod orders;
pub mod ring;
pub mod select;
pub mod setup;

use crate::{
    message::{Answer, FileOutcome, LinkEvent, Message, Moment},
    request::{Scope, Ticket},
};
use alarms::Alarms;
use effort::{Effort, Kind};
use jobs::Jobs;
use keys::{
    NodeId, Status,
    record::{NodeRecord, NodeWord},
};
use link::LinkState;
use log::{Log, Source};
use node::{Concern, Node, Presence};
use orders::Orders;
use select::Pattern;
use std::collections::{BTreeMap, VecDeque};

/// See the module.
#[derive(Debug, Default)]
pub struct Model {
    now: Moment,
    link: LinkState,
    nodes: BTreeMap<NodeId, Node>,
    nodes_refused: u64,
    jobs: Jobs,
    log: Log,
    efforts: VecDeque<Effort>,
    orders: Orders,
    file: Option<(Ticket, FileOutcome)>,
    alarms: Alarms,
    alarms_checked: Moment,
    missed: u64,
    unreadable: u64,
}

/// The fleet in a few numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Nodes that this window has heard of.
    pub known: usize,
    /// Nothing is known about them now: there is no link. Then all other counts are zero.
    pub unknown: usize,
    /// There, and heard of lately.
    pub alive: usize,
    /// There by their token, but silent for longer than [`limits::STALE_AFTER_S`].
    pub stale: usize,
    /// Gone.
    pub offline: usize,
    /// Executing commands.
    pub running: usize,
    /// With the stop latch set.
    pub stopped: usize,
    /// That report a fault.
    pub faults: usize,
    /// The largest clock error of the nodes that are there, µs; `None` if none is known.
    pub worst_clock_error_us: Option<f64>,
    /// Nodes that are there and whose clock is not known.
    pub clocks_unknown: usize,
}

impl Model {
    /// Takes what happened at this moment.
    pub fn apply(&mut self, at: Moment, message: Message) {
        self.tick(at);
        match message {
            Message::Link(event) => self.link_event(at, event),
            Message::Alive { node, alive } => {
                if let Some(known) = self.node_mut(node, at)
                    && known.token(at, alive)
                {
                    let word = if alive { "is there" } else { "is gone" };
                    self.log.push(at, Source::Node(node), word.to_owned());
                }
                self.check_alarms_of(at, node);
            }
            Message::Node(record) => self.record(at, *record),
            Message::Status { node, status } => self.status(at, node, *status),
            Message::Vitals { node, vitals } => {
                if let Some(known) = self.node_mut(node, at) {
                    known.set_vitals(at, vitals);
                }
            }
            Message::Setup { node, setup } => {
                if let Some(known) = self.node_mut(node, at) {
                    known.set_setup(at, setup);
                }
            }
            Message::SetupAsked { ticket, node } => {
                if let Some(known) = self.nodes.get_mut(&node) {
                    known.ask_setup(ticket, at);
                }
            }
            Message::Job(record) => {
                if let Some(promised_us) = self.jobs.promised_skew_us(&record) {
                    self.alarms.job(at, &record, promised_us);
                }
                self.jobs.record(*record);
            }
            Message::Log { node, text } => self.log.push(at, Source::Node(node), text),
            Message::Unreadable { key, why } => {
                self.unreadable += 1;
                self.log
                    .push(at, Source::Window, format!("cannot read {key}: {why}"));
            }
            Message::Missed { messages } => {
                self.missed += messages;
                let words = format!("{messages} messages were dropped: this window was too slow");
                self.log.push(at, Source::Window, words);
            }
            Message::StopAsked {
                ticket,
                scope,
                mode,
            } => self.begin(Effort::new(
                ticket,
                Kind::Stop(mode),
                scope.clone(),
                at,
                self.expected(&scope, Node::is_there),
            )),
            Message::ReleaseAsked { ticket, scope } => {
                let stopped = |node: &Node| node.word() == NodeWord::Stopped;
                let expected = self.expected(&scope, stopped);
                self.begin(Effort::new(ticket, Kind::Release, scope, at, expected));
            }
            Message::JobAsked {
                ticket,
                target,
                payload,
                language,
            } => self.jobs.asked(ticket, target, payload, language, at),
            Message::CancelAsked { ticket, job } => {
                let words = format!("cancel of {job} asked for");
                self.log.push(at, Source::Window, words);
                self.jobs.cancel_asked(at, ticket, job);
            }
            Message::OrderAsked {
                ticket,
                node,
                order,
            } => {
                let words = format!("{order} asked for {node}");
                self.log.push(at, Source::Window, words);
                if self.nodes.contains_key(&node) {
                    self.orders.asked(at, ticket, node, order);
                }
            }
            Message::StartPlan(plan) => self.jobs.plan(at, &plan),
            Message::Answer { ticket, answer } => self.answer(at, ticket, answer),
            Message::File { ticket, outcome } => self.file = Some((ticket, outcome)),
            Message::Travels(links) => {
                for link in links {
                    if let Some(node) = self.nodes.get_mut(&link.node) {
                        node.travels(at, link);
                    }
                }
            }
            Message::Acknowledged { alarm } => self.alarms.acknowledge(at, alarm),
        }
    }

    /// Moves the present on. An earlier moment is ignored.
    pub fn tick(&mut self, now: Moment) {
        self.now = self.now.max(now);
        // Silence and clocks that stay unknown come without a message.
        if self.now.since_s(self.alarms_checked) >= limits::ALARMS_EVERY_S {
            self.alarms_checked = self.now;
            if self.link.is_up() {
                for node in self.nodes.values_mut() {
                    node.look(self.now);
                    self.alarms.check(self.now, node);
                }
            }
        }
    }

    /// Returns the present.
    pub fn now(&self) -> Moment {
        self.now
    }

    /// Returns the link's state.
    pub fn link(&self) -> &LinkState {
        &self.link
    }

    /// Returns the nodes, by name.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.nodes.values()
    }

    /// Returns a node that was heard of.
    pub fn node(&self, node: &NodeId) -> Option<&Node> {
        self.nodes.get(node)
    }

    /// Returns how many nodes were heard of and not kept: there are more than
    /// [`limits::NODES_MAX`].
    pub fn nodes_refused(&self) -> u64 {
        self.nodes_refused
    }

    /// Returns the jobs.
    pub fn jobs(&self) -> &Jobs {
        &self.jobs
    }

    /// Returns the log.
    pub fn log(&self) -> &Log {
        &self.log
    }

    /// Returns stops and releases, the latest first.
    pub fn efforts(&self) -> impl Iterator<Item = &Effort> {
        self.efforts.iter().rev()
    }

    /// Returns what was asked of the nodes' motion.
    pub fn orders(&self) -> &Orders {
        &self.orders
    }

    /// Returns what became of a request about a file, if it was the last of them.
    pub fn file(&self, ticket: Ticket) -> Option<&FileOutcome> {
        let (of, outcome) = self.file.as_ref()?;
        (*of == ticket).then_some(outcome)
    }

    /// Returns what needed somebody.
    pub fn alarms(&self) -> &Alarms {
        &self.alarms
    }

    /// Returns how many messages were dropped since the start.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Returns how many messages could not be read since the start.
    pub fn unreadable(&self) -> u64 {
        self.unreadable
    }

    /// Returns whether what is known of a node is what it says now: there is a link, and it was heard of
    /// lately.
    pub fn is_fresh(&self, node: &Node) -> bool {
        self.link.is_up() && node.presence(self.now) == Presence::Alive
    }

    /// Returns whether somebody tells what becomes of jobs: there is a link, and a gateway behind it.
    pub fn follows_jobs(&self) -> bool {
        self.link.is_up() && self.link.gateway() != Some(false)
    }

    /// Returns the present concern of a node, see [`Node::concern`].
    pub fn concern(&self, node: &Node) -> Option<Concern> {
        node.concern(self.now, self.link.is_up())
    }

    /// Returns whether a node is to be asked how it is set, for whoever wants to see that.
    pub fn setup_is_due(&self, node: &NodeId) -> bool {
        self.link.is_up() && self.node(node).is_some_and(Node::setup_is_due)
    }

    /// Counts the fleet.
    pub fn totals(&self) -> Totals {
        let mut totals = Totals {
            known: self.nodes.len(),
            ..Totals::default()
        };
        if !self.link.is_up() {
            totals.unknown = totals.known;
            return totals;
        }
        for node in self.nodes.values() {
            match node.presence(self.now) {
                Presence::Alive => totals.alive += 1,
                Presence::Stale => totals.stale += 1,
                Presence::Offline => totals.offline += 1,
            }
            totals.running += usize::from(node.word() == NodeWord::Running);
            totals.stopped += usize::from(node.word() == NodeWord::Stopped);
            totals.faults += usize::from(node.word() == NodeWord::Fault);
            if node.is_there() {
                match node.clock() {
                    Some(clock) => {
                        let worst = totals.worst_clock_error_us.unwrap_or(0.0);
                        totals.worst_clock_error_us = Some(worst.max(clock.error_us));
                    }
                    None => totals.clocks_unknown += 1,
                }
            }
        }
        totals
    }

    /// Returns the nodes that a job for this key chunk would reach now: those that are there.
    pub fn matching<'m>(&'m self, pattern: &'m Pattern) -> impl Iterator<Item = &'m Node> {
        let there = self.nodes.values().filter(|node| node.is_there());
        there.filter(|node| pattern.matches(node.id().as_str()))
    }

    fn node_mut(&mut self, node: NodeId, at: Moment) -> Option<&mut Node> {
        if self.nodes.len() >= limits::NODES_MAX && !self.nodes.contains_key(&node) {
            self.nodes_refused += 1;
            return None;
        }
        Some(
            self.nodes
                .entry(node)
                .or_insert_with(|| Node::new(node, at)),
        )
    }

    fn link_event(&mut self, at: Moment, event: LinkEvent) {
        for node in self.nodes.values_mut() {
            match event {
                LinkEvent::Down { .. } => node.unheard(at),
                LinkEvent::Connected { .. } => node.listen(at),
                LinkEvent::Connecting { .. } | LinkEvent::Gateway { .. } => {}
            }
        }
        let was_up = self.link.is_up();
        if let Some(words) = self.link.apply(at, event) {
            self.log.push(at, Source::Window, words);
        }
        self.alarms.link(at, was_up, &self.link);
    }

    fn record(&mut self, at: Moment, record: NodeRecord) {
        let id = record.node;
        if let Some(node) = self.node_mut(id, at) {
            node.record(at, record);
        }
        self.check_alarms_of(at, id);
    }

    fn check_alarms_of(&mut self, at: Moment, id: NodeId) {
        if let Some(node) = self.nodes.get(&id)
            && self.link.is_up()
        {
            self.alarms.check(at, node);
        }
    }

    fn status(&mut self, at: Moment, node: NodeId, status: Status) {
        for effort in &mut self.efforts {
            effort.heard(at, node, &status);
        }
        if let Some(known) = self.node_mut(node, at) {
            known.status(at, status);
        }
        self.check_alarms_of(at, node);
    }

    fn expected(&self, scope: &Scope, wanted: impl Fn(&Node) -> bool) -> Vec<NodeId> {
        let in_scope = |node: &&Node| match scope {
            Scope::All => true,
            Scope::Pattern(pattern) => {
                Pattern::new(pattern).is_ok_and(|pattern| pattern.matches(node.id().as_str()))
            }
            Scope::Nodes(nodes) => nodes.contains(&node.id()),
        };
        let nodes = self.nodes.values().filter(in_scope);
        nodes
            .filter(|node| wanted(node))
            .map(|node| node.id())
            .collect()
    }

    fn begin(&mut self, effort: Effort) {
        let words = format!("{} asked for {}", effort.verb(), effort.scope());
        self.log.push(effort.asked(), Source::Window, words);
        if self.efforts.len() == limits::EFFORTS_MAX {
            self.efforts.pop_front();
        }
        self.efforts.push_back(effort);
    }

    fn answer(&mut self, at: Moment, ticket: Ticket, answer: Answer) {
        let mut efforts = self.efforts.iter_mut();
        if let Some(effort) = efforts.find(|effort| effort.ticket() == ticket) {
            effort.answer(at, &answer);
            if let Answer::Failed(why) = &answer {
                let words = format!("{} of {}: {why}", effort.verb(), effort.scope());
                self.log.push(at, Source::Window, words);
            }
            return;
        }
        let mut nodes = self.nodes.values_mut();
        if nodes.any(|node| node.answer_setup(ticket, &answer)) {
            return;
        }
        let refusals = match &answer {
            Answer::Receipts(receipts) => receipts
                .iter()
                .filter_map(|receipt| receipt.as_ref().err().map(ToString::to_string))
                .collect(),
            Answer::Done { refused, .. } => refused.iter().map(ToString::to_string).collect(),
            Answer::Failed(why) => vec![why.clone()],
            Answer::Sent => Vec::new(),
        };
        for refusal in refusals {
            self.log
                .push(at, Source::Window, format!("refused: {refusal}"));
        }
        if !self.orders.answer(ticket, &answer) {
            self.jobs.answer(ticket, answer);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
