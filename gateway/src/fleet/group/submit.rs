//! A synchronized job comes in: what is wrong with it is refused, for each part by its node's name;
//! that a node is away or stopped just now makes it fail before anything has moved.

use super::{Group, new_part, parts_of};
use crate::{
    fleet::{
        Fleet,
        event::{Effect, ReplyTo},
        submit::{check_script, demand_no_signature, script_of},
    },
    job::{Ending, Job, JobEntry, held_of_script, new_record},
    security::signing,
};
use keys::{
    Command, GroupId, JobId, NodeId,
    job::{GroupRequest, Offline, Work},
    record::{ErrorCode, JobError, JobState, PartRecord},
};
use std::{collections::BTreeMap, sync::Arc};

impl Fleet {
    pub(in crate::fleet) fn submit_group(
        &mut self,
        pattern: &str,
        request: Result<GroupRequest, JobError>,
        id_hint: Option<JobId>,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let group = GroupId::new(pattern).map_err(|error| {
            let message = format!("`{pattern}` is no name of a group: {error}");
            JobError::new(ErrorCode::BadId, message)
        });
        let name = group.clone().ok();
        match group.and_then(|group| Ok((group, request?))) {
            Err(error) => self.refuse(error, id_hint, None, name, None, reply, effects),
            Ok((group, request)) => self.submit_parts(group, &request, reply, effects),
        }
        if let Some(to) = reply {
            effects.push(Effect::ReplyEnd { to });
        }
    }

    fn submit_parts(
        &mut self,
        group: GroupId,
        request: &GroupRequest,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let key = self.config.keys.group_job(&group);
        let exists = |id: &JobId| {
            let job = self.book.get(id);
            job.is_some_and(|job| job.state() != JobState::Rejected)
        };
        if let Some(id) = request.id.filter(exists) {
            return self.receipt(&id, &key, reply, effects);
        }
        let parts = parts_of(request);
        let mut refusals = self.refusals(request, &parts);
        // What is wrong with the job is refused. That a node is away or stopped just now is not the
        // job's fault: it is taken, and has failed before anything moved.
        let passing = |error: &JobError| match error.code {
            ErrorCode::NodeOffline => request.offline != Some(Offline::Reject),
            ErrorCode::Stopped => true,
            _ => false,
        };
        let mut away = BTreeMap::new();
        if refusals.values().all(passing) {
            away = std::mem::take(&mut refusals);
        }
        if let Some(error) = refusal(&refusals) {
            let parts = request.nodes.keys().map(|node| {
                let part = PartRecord {
                    state: JobState::Rejected,
                    progress: keys::record::Progress::default(),
                    error: refusals.get(node).cloned(),
                    result: None,
                };
                (*node, part)
            });
            let parts = Some(parts.collect());
            return self.refuse(error, request.id, None, Some(group), parts, reply, effects);
        }
        let id = request.id.unwrap_or_else(|| self.make_id());
        let mut record = new_record(id, None, JobState::Queued, 0, self.now);
        record.version += self.version_of_rejected(&id);
        record.group = Some(group);
        let mut entry = JobEntry::new(record, self.book.take_sequence());
        entry.group = Some(Box::default());
        let mut job = Job::new(entry, Arc::new([]));
        for (node, commands) in parts {
            let script = request.nodes.get(&node).and_then(script_of);
            let mut part = new_part(&job.entry, node, commands, script);
            part.entry.signature = request.signatures.get(&node).cloned();
            job.parts.insert(node, part);
        }
        job.measuring = true;
        job.begin();
        let nodes: Vec<NodeId> = job.parts.keys().copied().collect();
        let mut stored = vec![keys::version::CURRENT];
        stored
            .extend(postcard::to_allocvec(request).expect("a request has no part that cannot be"));
        self.book.insert(job, Some(stored), effects);
        self.groups.insert(id, Group::new(request));
        self.receipt(&id, &key, reply, effects);
        if let Some(error) = refusal(&away) {
            return self.end_group(&id, Ending::Fail(error), away, effects);
        }
        for node in nodes {
            self.with_node(node, effects, |node, turn| node.enqueue(id, turn.book));
        }
    }

    /// Returns why each node cannot take its part.
    fn refusals(
        &self,
        request: &GroupRequest,
        parts: &BTreeMap<NodeId, Arc<[Command]>>,
    ) -> BTreeMap<NodeId, JobError> {
        let mut refusals = BTreeMap::new();
        let mut held = self.book.held_commands();
        for (node, commands) in parts {
            let script = request.nodes.get(node).and_then(script_of);
            held += commands.len() + held_of_script(script.as_deref());
            if let Err(error) = self.refusal_of(*node, request, commands, held) {
                refusals.insert(*node, error);
            }
        }
        refusals
    }

    /// Says why a node would refuse its part as not signed.
    fn check_part_signature(
        &self,
        node: NodeId,
        boot: u32,
        request: &GroupRequest,
        commands: &[Command],
    ) -> Result<(), JobError> {
        let signers = self.config.signers.as_deref();
        let Some(signature) = request.signatures.get(&node) else {
            return demand_no_signature(signers);
        };
        let Some(id) = &request.id else {
            let message = "signature: what is signed has a name; `id` is missing";
            return Err(JobError::new(ErrorCode::NotAllowed, message));
        };
        let script = request.nodes.get(&node).and_then(script_of);
        let root = signing::root_of(commands, script.as_deref())?;
        let statement = signing::statement(&node, id, signature.boot, signature.number, root);
        signing::check(signers, &statement, signature, boot)
    }

    fn refusal_of(
        &self,
        node: NodeId,
        request: &GroupRequest,
        commands: &[Command],
        held: usize,
    ) -> Result<(), JobError> {
        let (offline, work, own) = (request.offline, &request.nodes[&node], &commands[1..]);
        let refuse = |code, message: String| Err(JobError::new(code, message));
        let placed = |separator: &'static str| {
            move |error: JobError| {
                let message = format!("nodes.{node}{separator}{}", error.message);
                JobError::new(error.code, message)
            }
        };
        let Some(view) = self.nodes.get(&node) else {
            let message = format!("no node `{node}` has ever been seen");
            return refuse(ErrorCode::UnknownNode, message);
        };
        view.check(&[], true).map_err(placed(": "))?;
        if let Work::Lua(_) = work {
            check_script(view.facts().features).map_err(placed("."))?;
        }
        view.check(own, true).map_err(placed("."))?;
        if let Some(reason) = &view.facts().maintenance {
            let message = format!("node {node} is in maintenance: {reason}");
            return refuse(ErrorCode::NotAllowed, message);
        }
        let boot = view.facts().queue.boot;
        self.check_part_signature(node, boot, request, commands)
            .map_err(placed(": "))?;
        if view.is_stopped() {
            let message = format!("node {node} is stopped; release it first");
            return refuse(ErrorCode::Stopped, message);
        }
        // Unlike a plain job it does not wait for a node that is away unless it says so: the
        // other nodes would be held up.
        if !view.is_alive() && offline != Some(Offline::Queue) {
            return refuse(ErrorCode::NodeOffline, format!("node {node} is offline"));
        }
        let waiting_count = view.waiting().len();
        if waiting_count >= self.config.waiting_jobs_max {
            let message = format!("{waiting_count} jobs wait for node {node}; no more can");
            return refuse(ErrorCode::TooLarge, message);
        }
        if held > self.config.held_commands_max {
            let message = format!(
                "all jobs together would hold {held} commands; at most {} can be held",
                self.config.held_commands_max
            );
            return refuse(ErrorCode::TooLarge, message);
        }
        Ok(())
    }
}

/// Puts refusals together; the first one gives the code. Each names its node already.
fn refusal(refusals: &BTreeMap<NodeId, JobError>) -> Option<JobError> {
    let first = refusals.values().next()?;
    let messages: Vec<&str> = refusals
        .values()
        .map(|error| error.message.as_str())
        .collect();
    Some(JobError::new(first.code, messages.join("; ")))
}
