//! Gets on job keys: one record, or many, newest first. Owns the meaning of a selector's parameters:
//! `limit`, `state` and `node`. What is not one of them is an error, so that nobody takes an
//! unfiltered list for a filtered one.

use super::{
    Fleet, error_reply,
    event::{Effect, ReplyTo},
    no_job,
    pattern::Pattern,
};
use crate::job::Job;
use keys::{
    JobId, NodeId,
    record::{ErrorCode, JobError, JobState},
};

/// Replies of a history when a client names no limit.
pub const LIMIT_DEFAULT: usize = 100;

/// Most replies of a history.
pub const LIMIT_MAX: usize = 1_000;

impl Fleet {
    pub(super) fn get_jobs(
        &mut self,
        pattern: &str,
        parameters: &[(String, String)],
        to: ReplyTo,
        effects: &mut Vec<Effect>,
    ) {
        let replies = Filter::new(parameters).and_then(|filter| {
            let name = match Pattern::new(pattern) {
                Pattern::Name(name) => name,
                wild => {
                    let jobs = self.book.newest_first();
                    return Ok(jobs
                        .filter(|job| filter.takes(job) && wild.matches(job.id().as_str()))
                        .take(filter.limit)
                        .map(Job::id)
                        .collect::<Vec<_>>());
                }
            };
            let job = JobId::new(name).ok().and_then(|id| self.book.get(&id));
            let job = job.ok_or_else(|| no_job(name))?;
            Ok(Some(job)
                .filter(|job| filter.takes(job))
                .map(Job::id)
                .into_iter()
                .collect())
        });
        match replies {
            Ok(jobs) => effects.extend(jobs.iter().filter_map(|id| self.job_reply(id, to))),
            Err(error) => effects.push(error_reply(to, error)),
        }
        effects.push(Effect::ReplyEnd { to });
    }
}

/// Which jobs a client wants to see.
struct Filter<'p> {
    limit: usize,
    state: Option<JobState>,
    node: Option<Pattern<'p>>,
}

impl<'p> Filter<'p> {
    fn new(parameters: &'p [(String, String)]) -> Result<Self, JobError> {
        let bad = |name: &str, message: String| {
            Err(JobError::new(
                ErrorCode::BadJson,
                format!("{name}: {message}"),
            ))
        };
        let mut filter = Self {
            limit: LIMIT_DEFAULT,
            state: None,
            node: None,
        };
        for (name, value) in parameters {
            match name.as_str() {
                // Who asks for more than there may be gets as many as there may be.
                "limit" => match value.parse::<u64>() {
                    Ok(limit @ 1..) => {
                        filter.limit =
                            usize::try_from(limit).map_or(LIMIT_MAX, |limit| limit.min(LIMIT_MAX));
                    }
                    _ => return bad(name, format!("`{value}` is not a number from 1")),
                },
                "state" => match value.parse() {
                    Ok(state) => filter.state = Some(state),
                    Err(_) => return bad(name, format!("`{value}` is no state of a job")),
                },
                "node" => match Pattern::new(value) {
                    Pattern::Name(text) if NodeId::new(text).is_err() => {
                        return bad(name, format!("`{value}` is no name of a node"));
                    }
                    Pattern::Malformed(_) | Pattern::Label(_) => {
                        return bad(name, format!("`{value}` is no name of a node"));
                    }
                    pattern => filter.node = Some(pattern),
                },
                // zenoh's own parameters begin so.
                name if name.starts_with('_') || name.is_empty() => {}
                name => {
                    return bad(
                        name,
                        "no such parameter; there are limit, state and node".into(),
                    );
                }
            }
        }
        Ok(filter)
    }

    fn takes(&self, job: &Job) -> bool {
        let parts = job.entry.record.parts.iter().flat_map(|parts| parts.keys());
        let mut nodes = job.entry.record.node.iter().chain(parts);
        self.state.is_none_or(|state| state == job.state())
            && self
                .node
                .is_none_or(|pattern| nodes.any(|id| pattern.matches(id.as_str())))
    }
}
