//! What clients want of nodes and jobs by a name or a pattern: releases, holds, speeds, records, cancels.
//!
//! Owns whom a pattern means, and who is still owed an answer.

use super::{
    Fleet, Wish, error_reply,
    event::{Effect, ReplyTo},
    node::Node,
    pattern::Pattern,
};
use crate::job::{Ending, Job};
use keys::{
    JobId, NodeId, NodeTopic, StopMode,
    record::{ErrorCode, JobError, to_json},
};

impl Fleet {
    /// Returns the nodes that a chunk means, by name.
    pub(super) fn matching(&self, pattern: &str) -> Vec<NodeId> {
        match Pattern::new(pattern) {
            Pattern::Name(name) => NodeId::new(name)
                .ok()
                .filter(|id| self.nodes.contains_key(id))
                .into_iter()
                .collect(),
            Pattern::Label(label) => self
                .nodes
                .values()
                .filter(|node| node.has_label(label))
                .map(Node::id)
                .collect(),
            pattern => self
                .nodes
                .keys()
                .filter(|id| pattern.matches(id.as_str()))
                .copied()
                .collect(),
        }
    }

    /// Returns why a chunk means no node that is there.
    pub(super) fn nobody(&self, pattern: &str) -> JobError {
        let matching = self.matching(pattern);
        match (Pattern::new(pattern), matching.as_slice()) {
            (Pattern::Name(name), []) => JobError::new(
                ErrorCode::UnknownNode,
                format!("no node `{name}` has ever been seen"),
            ),
            (Pattern::Name(name), _) => {
                JobError::new(ErrorCode::NodeOffline, format!("node {name} is offline"))
            }
            (Pattern::Label(label), []) => JobError::new(
                ErrorCode::UnknownNode,
                format!("no node has the label `{label}`"),
            ),
            (Pattern::Label(label), _) => JobError::new(
                ErrorCode::NodeOffline,
                format!("every node with the label `{label}` is offline"),
            ),
            (_, []) => JobError::new(
                ErrorCode::UnknownNode,
                format!("no node that has been seen matches `{pattern}`"),
            ),
            (_, _) => JobError::new(
                ErrorCode::NodeOffline,
                format!("every node that matches `{pattern}` is offline"),
            ),
        }
    }

    pub(super) fn release(
        &mut self,
        pattern: &str,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        for id in self.begin_release(pattern, reply, effects) {
            self.with_node(id, effects, |node, turn| node.handle_release(reply, turn));
        }
    }

    pub(super) fn pace(
        &mut self,
        pattern: &str,
        wish: Result<Wish, JobError>,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        match wish {
            Ok(wish) => {
                for id in self.begin_release(pattern, reply, effects) {
                    self.with_node(id, effects, |node, turn| {
                        node.handle_wish(wish, reply, turn)
                    });
                }
            }
            Err(error) => {
                if let Some(to) = reply {
                    effects.push(error_reply(to, error));
                    effects.push(Effect::ReplyEnd { to });
                }
            }
        }
    }

    /// Returns the nodes that are there and are meant; each of them answers once. Without any, the
    /// answer is that.
    fn begin_release(
        &mut self,
        pattern: &str,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) -> Vec<NodeId> {
        let mut alive = self.matching(pattern);
        alive.retain(|id| self.nodes[id].is_alive());
        if let Some(to) = reply {
            if alive.is_empty() {
                effects.push(error_reply(to, self.nobody(pattern)));
                effects.push(Effect::ReplyEnd { to });
            } else {
                self.releases.insert(to, alive.len());
            }
        }
        alive
    }

    pub(super) fn end_release(&mut self, to: ReplyTo, effects: &mut Vec<Effect>) {
        let Some(open) = self.releases.get_mut(&to) else {
            return;
        };
        *open -= 1;
        if *open == 0 {
            self.releases.remove(&to);
            effects.push(Effect::ReplyEnd { to });
        }
    }

    pub(super) fn get_nodes(&mut self, pattern: &str, to: ReplyTo, effects: &mut Vec<Effect>) {
        let found = self.matching(pattern);
        if found.is_empty() && matches!(Pattern::new(pattern), Pattern::Name(_)) {
            effects.push(error_reply(to, self.nobody(pattern)));
        }
        for id in &found {
            effects.extend(self.node_reply(id, to));
        }
        effects.push(Effect::ReplyEnd { to });
    }

    pub(super) fn node_reply(&self, id: &NodeId, to: ReplyTo) -> Option<Effect> {
        let key = self.config.keys.node(id, NodeTopic::State);
        Some(Effect::Reply {
            to,
            key: Some(key.as_str().to_owned()),
            payload: to_json(&self.node_record(id)?),
        })
    }

    pub(super) fn cancel(
        &mut self,
        pattern: &str,
        reply: Option<ReplyTo>,
        effects: &mut Vec<Effect>,
    ) {
        let jobs: Vec<JobId> = match Pattern::new(pattern) {
            Pattern::Name(name) => {
                let found = JobId::new(name).ok().filter(|id| self.job(id).is_some());
                if found.is_none()
                    && let Some(to) = reply
                {
                    effects.push(error_reply(to, no_job(name)));
                }
                found.into_iter().collect()
            }
            wild => self
                .book
                .newest_first()
                .filter(|job| !job.state().is_final() && wild.matches(job.id().as_str()))
                .map(Job::id)
                .collect(),
        };
        for id in jobs {
            match self.book.get(&id) {
                Some(job) if job.is_group() => self.cancel_group(&id, effects),
                Some(job) => {
                    if let Some(node) = job.node() {
                        self.with_node(node, effects, |node, turn| {
                            node.end_job(&id, Ending::Cancel, StopMode::Decelerate, turn);
                        });
                    }
                }
                None => {}
            }
            if let Some(to) = reply {
                effects.extend(self.job_reply(&id, to));
            }
        }
        if let Some(to) = reply {
            effects.push(Effect::ReplyEnd { to });
        }
    }

    pub(super) fn job_reply(&self, id: &JobId, to: ReplyTo) -> Option<Effect> {
        let job = self.book.get(id)?;
        Some(Effect::Reply {
            to,
            key: Some(self.config.keys.job(id).as_str().to_owned()),
            payload: to_json(&job.entry.record),
        })
    }
}

/// Returns the error of who names a job that there is not.
pub(super) fn no_job(name: &str) -> JobError {
    JobError::new(ErrorCode::BadId, format!("no job `{name}`"))
}
