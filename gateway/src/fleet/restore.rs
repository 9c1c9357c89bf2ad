//! The fleet as the store knows it, after a start of the gateway.
//!
//! Promises: a job that waits keeps its place. A job that was on its way is neither called lost
//! nor sent again by the start alone: its node's next status decides (it goes on, or it is over,
//! and how), or its silence does (lost). What the store holds too much of because the power failed
//! between two writes is removed: requests of jobs that are final or unknown.

use super::{
    Fleet, FleetConfig, LIMIT_DEFAULT,
    event::{Effect, Table, Write},
    group::{Group, new_part, parts_of},
    node::{Facts, Node},
    submit::{commands_of, script_of},
};
use crate::job::{Job, JobEntry};
use keys::{
    FleetMicros, JobId, NodeId,
    job::{GroupRequest, JobRequest},
};
use std::{collections::HashMap, sync::Arc};

/// Everything that is in the store: key and value of each table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// [`Table::Requests`].
    pub requests: Vec<(String, Vec<u8>)>,
    /// [`Table::Jobs`].
    pub jobs: Vec<(String, Vec<u8>)>,
    /// [`Table::Nodes`].
    pub nodes: Vec<(String, Vec<u8>)>,
    /// [`Table::Kept`].
    pub kept: Vec<(String, Vec<u8>)>,
}

/// The store holds something that this gateway did not write.
#[derive(Debug, thiserror::Error)]
pub enum RestoreError {
    /// A job's entry cannot be read.
    #[error("the store's entry of job `{job}` cannot be read: {why}")]
    Job {
        /// The key in the table.
        job: String,
        /// What is wrong with it.
        why: String,
    },
    /// A job is not final, but what it shall do is missing or cannot be read.
    #[error("the store's request of job `{job}` cannot be read: {why}")]
    Request {
        /// The job.
        job: String,
        /// What is wrong with it.
        why: String,
    },
    /// A node's facts cannot be read.
    #[error("the store's entry of node `{node}` cannot be read: {why}")]
    Node {
        /// The key in the table.
        node: String,
        /// What is wrong with it.
        why: String,
    },
    /// A template or a schedule cannot be read.
    #[error("the store's entry `{name}` cannot be read: {why}")]
    Kept {
        /// The key in the table.
        name: String,
        /// What is wrong with it.
        why: String,
    },
}

impl Fleet {
    /// Takes up the fleet where the store left it.
    ///
    /// # Errors
    /// Something in the store cannot be read. Nothing is guessed and nothing is dropped: a job
    /// that was accepted must not vanish.
    pub fn restore(
        config: FleetConfig,
        seed: u64,
        stored: Stored,
        now: FleetMicros,
        effects: &mut Vec<Effect>,
    ) -> Result<Self, RestoreError> {
        let mut fleet = Self::new(config, seed);
        let now = fleet.begin(now);
        for (name, value) in stored.nodes {
            let (id, facts) =
                read_node(&name, &value).map_err(|why| RestoreError::Node { node: name, why })?;
            fleet.nodes.insert(id, Node::new(id, Some(facts), now));
        }
        for (name, value) in stored.kept {
            fleet
                .restore_kept(&name, &value, effects)
                .map_err(|why| RestoreError::Kept { name, why })?;
        }
        let mut requests: HashMap<String, Vec<u8>> = stored.requests.into_iter().collect();
        let mut entries = Vec::with_capacity(stored.jobs.len());
        for (name, value) in stored.jobs {
            let entry =
                read_entry(&name, &value).map_err(|why| RestoreError::Job { job: name, why })?;
            entries.push(entry);
        }
        entries.sort_by_key(|entry| entry.sequence);
        for entry in entries {
            fleet.restore_job(entry, &mut requests, now)?;
        }
        let mut orphans: Vec<String> = requests.into_keys().collect();
        orphans.sort();
        for key in orphans {
            effects.push(Effect::Persist(Write::Remove {
                table: Table::Requests,
                key,
            }));
        }
        fleet.book.prune(now, effects);
        fleet.book.tell_again(LIMIT_DEFAULT, effects);
        let nodes: Vec<NodeId> = fleet.nodes.keys().copied().collect();
        for id in nodes {
            fleet.with_node(id, effects, |node, turn| node.sort_waiting(turn.book));
        }
        fleet.settle(effects);
        Ok(fleet)
    }

    fn restore_job(
        &mut self,
        entry: JobEntry,
        requests: &mut HashMap<String, Vec<u8>>,
        now: FleetMicros,
    ) -> Result<(), RestoreError> {
        let id = entry.record.job;
        let name = || id.to_string();
        if entry.record.state.is_final() {
            self.book.restore(Job::new(entry, Arc::new([])));
            return Ok(());
        }
        let bytes = requests
            .remove(&name())
            .ok_or_else(|| RestoreError::Request {
                job: name(),
                why: "there is none".into(),
            })?;
        let bad_request = |error: keys::status::DecodeError| RestoreError::Request {
            job: id.to_string(),
            why: error.to_string(),
        };
        if entry.group.is_some() {
            let request = keys::version::decode::<GroupRequest>(&bytes).map_err(bad_request)?;
            return self.restore_group(entry, &request, now);
        }
        let node = entry.record.node.ok_or_else(|| RestoreError::Job {
            job: name(),
            why: "it is not final and names no node".into(),
        })?;
        let request = keys::version::decode::<JobRequest>(&bytes).map_err(bad_request)?;
        let commands = commands_of(&request);
        let script = script_of(&request.work);
        if script.is_none() && commands.len() as u64 != entry.record.progress.total {
            return Err(RestoreError::Request {
                job: name(),
                why: format!(
                    "it has {} commands, the record says {}",
                    commands.len(),
                    entry.record.progress.total
                ),
            });
        }
        let job = Job::new(entry, commands).with_script(script);
        self.restore_on(node, &job, now)?;
        self.book.restore(job);
        Ok(())
    }

    /// Gives a job or a part back to its node.
    fn restore_on(
        &mut self,
        node: NodeId,
        job: &Job,
        now: FleetMicros,
    ) -> Result<(), RestoreError> {
        let view = self
            .nodes
            .entry(node)
            .or_insert_with(|| Node::new(node, None, now));
        if job.entry.activation.is_some() {
            view.resume(job).map_err(|other| RestoreError::Job {
                job: job.id().to_string(),
                why: format!("node {node} has job {other} already"),
            })?;
        } else {
            view.enqueue_last(job.id());
        }
        Ok(())
    }

    fn restore_group(
        &mut self,
        entry: JobEntry,
        request: &GroupRequest,
        now: FleetMicros,
    ) -> Result<(), RestoreError> {
        let id = entry.record.job;
        let mut job = Job::new(entry, Arc::new([]));
        for (node, commands) in parts_of(request) {
            let group = job.entry.group.as_ref();
            let stored = group.and_then(|group| group.parts.get(&node)).cloned();
            let parts = job.entry.record.parts.as_ref();
            let record = parts.and_then(|parts| parts.get(&node)).cloned();
            let (Some(stored), Some(record)) = (stored, record) else {
                return Err(RestoreError::Job {
                    job: id.to_string(),
                    why: format!("its entry lacks the part of node {node}"),
                });
            };
            let script = request.nodes.get(&node).and_then(script_of);
            let mut part = new_part(&job.entry, node, commands, script);
            part.passed = stored.passed;
            part.entry.activation = stored.activation;
            part.entry.ending = stored.ending;
            part.entry.script_end = stored.script_end;
            part.entry.signature = stored.signature;
            part.entry.record.state = record.state;
            part.entry.record.progress = record.progress;
            part.entry.record.error = record.error;
            part.entry.record.result = record.result;
            if record.state.is_final() {
                part.commands = Arc::new([]);
                part.script = None;
            } else {
                self.restore_on(node, &part, now)?;
            }
            job.parts.insert(node, part);
        }
        // A start that was under way is not measured any more: its words may have been missed.
        let group = job.entry.group.as_ref();
        job.measuring = group.is_some_and(|group| !group.started && group.planned.is_empty());
        self.groups.insert(id, Group::new(request));
        self.book.restore(job);
        self.book.touch(&id);
        Ok(())
    }
}

fn read_node(name: &str, value: &[u8]) -> Result<(NodeId, Facts), String> {
    let id = NodeId::new(name).map_err(|error| error.to_string())?;
    let facts = serde_json::from_slice(value).map_err(|error| error.to_string())?;
    Ok((id, facts))
}

fn read_entry(name: &str, value: &[u8]) -> Result<JobEntry, String> {
    let id = JobId::new(name).map_err(|error| error.to_string())?;
    let entry: JobEntry = serde_json::from_slice(value).map_err(|error| error.to_string())?;
    if entry.record.job != id {
        return Err(format!("it is the entry of job {}", entry.record.job));
    }
    Ok(entry)
}
