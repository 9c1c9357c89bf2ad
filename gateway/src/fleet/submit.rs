//! A job comes in: which nodes it is for, whether they can carry it out, and under which name it
//! is kept. Owns the rules of ids; everything that is accepted here is durable before its receipt
//! leaves.
//!
//! | a client's id is | put and get |
//! |---|---|
//! | free | the job has it |
//! | taken by a job | the receipt of that job, nothing else happens |
//! | taken by a rejected job | the job has it, and the record's version goes on |
//! | on a wild key | each node's job is called ID-NODE |

use super::{
    Fleet, error_reply,
    event::{Effect, ReplyTo},
    pattern::Pattern,
    sizes::cut,
};
use crate::{
    job::{Job, JobEntry, held_of_script, new_record},
    security::signing,
};
use keys::{
    Command, Features, GroupId, JobId, NodeId, NodeTopic,
    job::{JobRequest, JobSignature, Offline, Work},
    record::{ErrorCode, JobError, JobState, PartRecord, Receipt, to_json},
};
use std::{collections::BTreeMap, sync::Arc};

/// A job that is made ready for several nodes.
struct Prepared {
    id: Option<JobId>,
    commands: Arc<[Command]>,
    script: Option<Arc<str>>,
    stored: Vec<u8>,
    offline: Offline,
    timeout_us: Option<u64>,
    signature: Option<JobSignature>,
}

impl Fleet {
    pub(super) fn submit(
        &mut self,
        pattern: &str,
        request: Result<JobRequest, JobError>,
        id_hint: Option<JobId>,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let name = match Pattern::new(pattern) {
            Pattern::Name(name) => Some(name),
            Pattern::Wild(_) | Pattern::Label(_) | Pattern::Malformed(_) => None,
        };
        // A refused job's record names its node even if nobody has ever seen it.
        let node = name.and_then(|name| NodeId::new(name).ok());
        match request {
            Err(error) => self.refuse(error, id_hint, node, None, None, reply, effects),
            Ok(request) => match name {
                Some(_) => self.submit_to_one(pattern, node, &request, reply, effects),
                None => self.submit_to_each(pattern, &request, reply, effects),
            },
        }
        if let Some(to) = reply {
            effects.push(Effect::ReplyEnd { to });
        }
    }

    fn submit_to_one(
        &mut self,
        pattern: &str,
        node: Option<NodeId>,
        request: &JobRequest,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        if let (Some(id), Some(node)) = (request.id, node)
            && self.answer_existing(&id, node, reply, effects)
        {
            return;
        }
        let known = node.filter(|id| self.nodes.contains_key(id));
        let outcome = match known {
            None => Err(self.nobody(pattern)),
            Some(node) => {
                let id = request.id.unwrap_or_else(|| self.make_id());
                self.accept(node, id, &prepare(request), effects)
            }
        };
        self.answer(outcome, request.id, node, reply, effects);
    }

    fn submit_to_each(
        &mut self,
        pattern: &str,
        request: &JobRequest,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let mut alive = self.matching(pattern);
        alive.retain(|id| self.nodes[id].is_alive());
        if alive.is_empty() {
            let error = self.nobody(pattern);
            return self.refuse(error, request.id, None, None, None, reply, effects);
        }
        let prepared = prepare(request);
        for node in alive {
            let named = match prepared.id {
                None => Ok(None),
                Some(id) => {
                    let text = format!("{id}-{node}");
                    JobId::new(&text).map(Some).map_err(|_| {
                        let message = format!(
                            "id: each node's job is called ID-NODE, and `{text}` is too long"
                        );
                        JobError::new(ErrorCode::BadId, message)
                    })
                }
            };
            let id = named.clone().ok().flatten();
            if let Some(id) = id
                && self.answer_existing(&id, node, reply, effects)
            {
                continue;
            }
            let outcome = named.and_then(|named| {
                let id = named.unwrap_or_else(|| self.make_id());
                self.accept(node, id, &prepared, effects)
            });
            self.answer(outcome, id, Some(node), reply, effects);
        }
    }

    /// Takes a job for a node that is known, or says why not.
    fn accept(
        &mut self,
        node: NodeId,
        id: JobId,
        prepared: &Prepared,
        effects: &mut Vec<Effect>,
    ) -> Result<JobId, JobError> {
        let view = &self.nodes[&node];
        if prepared.script.is_some() {
            check_script(view.facts().features)?;
        }
        view.check(&prepared.commands, false)?;
        if let Some(reason) = &view.facts().maintenance {
            let message = format!("node {node} is in maintenance: {reason}");
            return Err(JobError::new(ErrorCode::NotAllowed, message));
        }
        self.check_signature(node, &id, prepared)?;
        if view.is_stopped() {
            let message = format!("node {node} is stopped; release it first");
            return Err(JobError::new(ErrorCode::Stopped, message));
        }
        if !view.is_alive() && prepared.offline == Offline::Reject {
            let message = format!("node {node} is offline");
            return Err(JobError::new(ErrorCode::NodeOffline, message));
        }
        let waiting_count = view.waiting().len();
        if waiting_count >= self.config.waiting_jobs_max {
            let message = format!("{waiting_count} jobs wait for node {node}; no more can");
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        let own = prepared.commands.len() + held_of_script(prepared.script.as_deref());
        let held = self.book.held_commands() + own;
        if held > self.config.held_commands_max {
            let message = format!(
                "all jobs together would hold {held} commands; at most {} can be held",
                self.config.held_commands_max
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        let total = prepared.commands.len() as u64;
        let mut record = new_record(id, Some(node), JobState::Queued, total, self.now);
        record.version += self.version_of_rejected(&id);
        let mut entry = JobEntry::new(record, self.book.take_sequence());
        entry.timeout_us = prepared.timeout_us;
        entry.signature.clone_from(&prepared.signature);
        entry.turn = self.wishes.turnplace();
        let job = Job::new(entry, prepared.commands.clone()).with_script(prepared.script.clone());
        self.book
            .insert(job, Some(prepared.stored.clone()), effects);
        Ok(id)
    }

    fn check_signature(
        &self,
        node: NodeId,
        id: &JobId,
        prepared: &Prepared,
    ) -> Result<(), JobError> {
        let signers = self.config.signers.as_deref();
        let Some(signature) = &prepared.signature else {
            return demand_no_signature(signers);
        };
        let root = signing::root_of(&prepared.commands, prepared.script.as_deref())?;
        let boot = self.nodes[&node].facts().queue.boot;
        let statement = signing::statement(&node, id, signature.boot, signature.number, root);
        signing::check(signers, &statement, signature, boot)
    }

    /// Gives the receipt, starts the job if its node is free, or refuses it.
    fn answer(
        &mut self,
        outcome: Result<JobId, JobError>,
        named: Option<JobId>,
        node: Option<NodeId>,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        match (outcome, node) {
            (Ok(id), Some(node)) => {
                let key = self.config.keys.node(&node, NodeTopic::Job);
                self.receipt(&id, &key, reply, effects);
                self.with_node(node, effects, |node, turn| node.enqueue(id, turn.book));
            }
            (Ok(_), None) => unreachable!("a job is accepted for a node only"),
            (Err(error), _) => self.refuse(error, named, node, None, None, reply, effects),
        }
    }

    fn answer_existing(
        &self,
        id: &JobId,
        asked: NodeId,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) -> bool {
        let exists = self
            .book
            .get(id)
            .is_some_and(|job| job.state() != JobState::Rejected);
        if exists {
            let key = self.config.keys.node(&asked, NodeTopic::Job);
            self.receipt(id, &key, reply, effects);
        }
        exists
    }

    /// Answers a get on `key`, the job key of the node or group that was asked; it need not be the
    /// job's own.
    pub(super) fn receipt(
        &self,
        id: &JobId,
        key: &str,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let (Some(to), Some(job)) = (reply, self.book.get(id)) else {
            return;
        };
        let receipt = Receipt {
            job: *id,
            state: job.state(),
        };
        effects.push(Effect::Reply {
            to,
            key: Some(key.to_owned()),
            payload: to_json(&receipt),
        });
    }

    /// Refuses a job: a get is told, a put leaves a record.
    #[expect(clippy::too_many_arguments, reason = "a record in words")]
    pub(super) fn refuse(
        &mut self,
        error: JobError,
        named: Option<JobId>,
        node: Option<NodeId>,
        group: Option<GroupId>,
        parts: Option<BTreeMap<NodeId, PartRecord>>,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let error = cut(error);
        if let Some(to) = reply {
            effects.push(error_reply(to, error));
            return;
        }
        let free = |id: &JobId| {
            let job = self.book.get(id);
            job.is_none_or(|job| job.state() == JobState::Rejected)
        };
        let id = named.filter(free).unwrap_or_else(|| self.make_id());
        let mut record = new_record(id, node, JobState::Rejected, 0, self.now);
        record.version += self.version_of_rejected(&id);
        record.group = group;
        record.parts = parts;
        record.error = Some(error);
        let entry = JobEntry::new(record, self.book.take_sequence());
        self.book
            .insert(Job::new(entry, Arc::new([])), None, effects);
    }

    pub(super) fn version_of_rejected(&self, id: &JobId) -> u64 {
        self.book.get(id).map_or(0, |job| job.entry.record.version)
    }

    /// Makes a name that sorts by time: 11 digits of microseconds to the base 32, which last for
    /// a thousand years, and 2 by chance, so that two gateways do not make the same.
    pub(super) fn make_id(&mut self) -> JobId {
        const DIGITS: &[u8; 32] = b"0123456789abcdefghijklmnopqrstuv";
        loop {
            self.last_made_us = self.now.0.max(self.last_made_us + 1);
            let mut text = [0; 13];
            for (index, digit) in text[..11].iter_mut().enumerate() {
                *digit = DIGITS[(self.last_made_us >> (5 * (10 - index)) & 31) as usize];
            }
            let chance = splitmix(&mut self.random);
            text[11] = DIGITS[(chance & 31) as usize];
            text[12] = DIGITS[(chance >> 5 & 31) as usize];
            let text = std::str::from_utf8(&text).expect("digits are ASCII");
            let id = JobId::new(text).expect("13 letters and digits are a name");
            if self.book.get(&id).is_none() {
                return id;
            }
        }
    }
}

/// Refuses what is not signed, where signatures are asked for.
pub(super) fn demand_no_signature(signers: Option<&[[u8; 32]]>) -> Result<(), JobError> {
    if signers.is_none() {
        return Ok(());
    }
    let message = "an operator has to sign what is executed here (`fleet submit --sign`)";
    Err(JobError::new(ErrorCode::NotAllowed, message))
}

/// Turns a checked request into commands, and into what is stored.
fn prepare(request: &JobRequest) -> Prepared {
    Prepared {
        id: request.id,
        commands: commands_of(request),
        script: script_of(&request.work),
        stored: stored_request(request),
        offline: request.offline,
        signature: request.signature.clone(),
        // Far beyond any job, and far from the end of the numbers.
        timeout_us: request
            .timeout_s
            .map(|limit_s| (limit_s * 1e6).clamp(1.0, 1e15) as u64),
    }
}

/// Returns the commands of a job in their order. A script has none before it runs.
pub fn commands_of(request: &JobRequest) -> Arc<[Command]> {
    match &request.work {
        // Meeting points have numbers in synchronized jobs only; any other job with one is refused.
        Work::Commands(commands) => commands
            .iter()
            .map(|command| command.to_command(|_| 0))
            .collect(),
        Work::Lua(_) => Arc::new([]),
    }
}

fn stored_request(request: &JobRequest) -> Vec<u8> {
    let mut bytes = vec![keys::version::CURRENT];
    bytes.extend(postcard::to_allocvec(request).expect("a request has no part that cannot be"));
    bytes
}

/// Returns the script of a job, if it has one.
pub(super) fn script_of(work: &Work) -> Option<Arc<str>> {
    match work {
        Work::Commands(_) => None,
        Work::Lua(script) => Some(script.as_str().into()),
    }
}

/// Scripts are run by nodes, by those that can.
pub(super) fn check_script(features: Features) -> Result<(), JobError> {
    if features.has(Features::LUA) {
        return Ok(());
    }
    let message = "lua: not supported by this node's firmware";
    Err(JobError::new(ErrorCode::BadCommand, message))
}

/// The next number of a sequence that only must not be guessed twice (splitmix64).
fn splitmix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut mixed = *state;
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}
