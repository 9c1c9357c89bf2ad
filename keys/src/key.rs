//! Build and parse `PREFIX/node/NODE/…`, `PREFIX/group/GROUP/job` and `PREFIX/job/JOB` without
//! allocation.
//!
//! Parsing knows exact keys and keys whose name chunk is wild (`*`, `cell-$*`): what a client may
//! publish on. Whether a wild chunk matches a name is the business of a key-expression library.

use crate::{GroupId, JobId, NodeId, NodeTopic};
use core::fmt::Write;

/// The prefix when none is set.
pub const PREFIX_DEFAULT: &str = "fleet";

/// Longest prefix.
pub const PREFIX_BYTES_MAX: usize = 64;

/// Longest key that is built here: prefix, `/node/`, a name, `/release`.
pub const KEY_BYTES_MAX: usize = PREFIX_BYTES_MAX + 6 + crate::ids::NAME_BYTES_MAX + 8;

/// A key's text.
pub type KeyText = heapless::String<KEY_BYTES_MAX>;

/// Builds and parses keys below one prefix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Keys {
    prefix: heapless::String<PREFIX_BYTES_MAX>,
}

/// Why a text cannot be the prefix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PrefixError;

impl core::fmt::Display for PrefixError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "a prefix has 1 to {PREFIX_BYTES_MAX} characters in chunks of a-z, 0-9, _, - and . between single slashes"
        )
    }
}

impl core::error::Error for PrefixError {}

/// What a key names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic<'k> {
    /// `PREFIX/node/NODE/…`
    Node {
        /// A node's name, or a wild chunk.
        node: &'k str,
        /// The last chunk.
        topic: NodeTopic,
    },
    /// `PREFIX/group/GROUP/job`
    GroupJob {
        /// A group's name, or a wild chunk.
        group: &'k str,
    },
    /// `PREFIX/job/JOB`
    Job {
        /// A job's name, or a wild chunk.
        job: &'k str,
    },
    /// `PREFIX/job/JOB/cancel`
    JobCancel {
        /// A job's name, or a wild chunk.
        job: &'k str,
    },
    /// `PREFIX/manage/start/JOB`
    StartPlan {
        /// A job's name, or a wild chunk.
        job: &'k str,
    },
}

impl Default for Keys {
    fn default() -> Self {
        Self::new(PREFIX_DEFAULT).expect("the default prefix is legal")
    }
}

impl Keys {
    /// Takes the prefix below which everything lies.
    ///
    /// # Errors
    /// The prefix is empty, too long, wild or malformed.
    pub fn new(prefix: &str) -> Result<Self, PrefixError> {
        let legal_chunk = |chunk: &str| {
            !chunk.is_empty()
                && chunk.bytes().all(|byte| {
                    byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_-.".contains(&byte)
                })
        };
        if !prefix.split('/').all(legal_chunk) {
            return Err(PrefixError);
        }
        let prefix = heapless::String::try_from(prefix).map_err(|_| PrefixError)?;
        Ok(Self { prefix })
    }

    /// Returns the prefix.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Returns `PREFIX/node/NODE/TOPIC`.
    pub fn node(&self, node: &NodeId, topic: NodeTopic) -> KeyText {
        self.build(&["node", node.as_str(), topic.suffix()])
    }

    /// Returns `PREFIX/node/*/TOPIC`.
    pub fn every_node(&self, topic: NodeTopic) -> KeyText {
        self.build(&["node", "*", topic.suffix()])
    }

    /// Returns `PREFIX/group/GROUP/job`.
    pub fn group_job(&self, group: &GroupId) -> KeyText {
        self.build(&["group", group.as_str(), "job"])
    }

    /// Returns `PREFIX/group/*/job`.
    pub fn every_group_job(&self) -> KeyText {
        self.build(&["group", "*", "job"])
    }

    /// Returns `PREFIX/job/JOB`.
    pub fn job(&self, job: &JobId) -> KeyText {
        self.build(&["job", job.as_str()])
    }

    /// Returns `PREFIX/job/*`.
    pub fn every_job(&self) -> KeyText {
        self.build(&["job", "*"])
    }

    /// Returns `PREFIX/manage/start/JOB`.
    pub fn start_plan(&self, job: &JobId) -> KeyText {
        self.build(&["manage", "start", job.as_str()])
    }

    /// Returns `PREFIX/manage/start/*`.
    pub fn every_start_plan(&self) -> KeyText {
        self.build(&["manage", "start", "*"])
    }

    /// Returns `PREFIX/job/JOB/cancel`.
    pub fn job_cancel(&self, job: &JobId) -> KeyText {
        self.build(&["job", job.as_str(), "cancel"])
    }

    /// Returns `PREFIX/job/*/cancel`.
    pub fn every_job_cancel(&self) -> KeyText {
        self.build(&["job", "*", "cancel"])
    }

    fn build(&self, chunks: &[&str]) -> KeyText {
        let mut key = KeyText::new();
        key.push_str(&self.prefix)
            .expect("KEY_BYTES_MAX counts the prefix");
        for chunk in chunks {
            write!(key, "/{chunk}").expect("KEY_BYTES_MAX counts the longest key");
        }
        key
    }

    /// Returns what the key names, `None` if it is none of ours.
    pub fn parse<'k>(&self, key: &'k str) -> Option<Topic<'k>> {
        let rest = key.strip_prefix(self.prefix.as_str())?.strip_prefix('/')?;
        let mut chunks = rest.split('/');
        let chunks = (chunks.next()?, chunks.next()?, chunks.next(), chunks.next());
        match chunks {
            ("node", node, Some(suffix), None) => Some(Topic::Node {
                node,
                topic: NodeTopic::from_suffix(suffix)?,
            }),
            ("group", group, Some("job"), None) => Some(Topic::GroupJob { group }),
            ("job", job, None, None) => Some(Topic::Job { job }),
            ("job", job, Some("cancel"), None) => Some(Topic::JobCancel { job }),
            ("manage", "start", Some(job), None) => Some(Topic::StartPlan { job }),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_that_is_built_parses_to_what_it_was_built_from() {
        let keys = Keys::new("plant-1/fleet").expect("legal");
        let node = NodeId::new("01234567890123456789012345678901").expect("legal");
        for topic in NodeTopic::ALL {
            let key = keys.node(&node, topic);
            assert_eq!(
                keys.parse(&key),
                Some(Topic::Node {
                    node: node.as_str(),
                    topic
                })
            );
            assert_eq!(
                keys.parse(&keys.every_node(topic)),
                Some(Topic::Node { node: "*", topic })
            );
        }
        let job = JobId::new("part-0815").expect("legal");
        assert_eq!(
            keys.parse(&keys.start_plan(&job)),
            Some(Topic::StartPlan { job: "part-0815" })
        );
        assert_eq!(
            keys.parse(&keys.every_start_plan()),
            Some(Topic::StartPlan { job: "*" })
        );
        assert_eq!(keys.job(&job).as_str(), "plant-1/fleet/job/part-0815");
        assert_eq!(
            keys.parse(&keys.job(&job)),
            Some(Topic::Job { job: "part-0815" })
        );
        assert_eq!(
            keys.parse(&keys.job_cancel(&job)),
            Some(Topic::JobCancel { job: "part-0815" })
        );
        let group = GroupId::new("g1").expect("legal");
        assert_eq!(
            keys.parse(&keys.group_job(&group)),
            Some(Topic::GroupJob { group: "g1" })
        );
    }

    #[test]
    fn keys_of_others_are_not_ours() {
        let keys = Keys::default();
        for key in [
            "",
            "fleet",
            "fleet/",
            "fleets/node/a/stop",
            "fleet/node/a",
            "fleet/node/a/b",
            "fleet/node/a/stop/b",
            "other/node/a/stop",
        ] {
            assert_eq!(keys.parse(key), None, "{key}");
        }
    }

    #[test]
    fn a_prefix_that_would_be_wild_or_malformed_is_refused() {
        for prefix in [
            "", "/", "a/", "/a", "a//b", "*", "a/**", "a$*", "A", "a#b", "a?b",
        ] {
            assert_eq!(Keys::new(prefix), Err(PrefixError), "{prefix}");
        }
        let longest = [b'a'; PREFIX_BYTES_MAX];
        let longest = core::str::from_utf8(&longest).expect("ASCII");
        let keys = Keys::new(longest).expect("legal");
        let node = NodeId::new("01234567890123456789012345678901").expect("legal");
        assert_eq!(keys.node(&node, NodeTopic::Release).len(), KEY_BYTES_MAX);
        let job = JobId::new(node.as_str()).expect("legal");
        assert!(keys.start_plan(&job).len() <= KEY_BYTES_MAX);
    }
}
