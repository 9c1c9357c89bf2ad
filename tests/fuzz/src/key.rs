//! A key that is one of ours is built from what it names; a name that is legal is a chunk of a key.

use keys::{GroupId, JobId, Keys, NodeId, Topic};

/// See the module.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let keys = Keys::default();
    match keys.parse(text) {
        Some(Topic::Node { node, topic }) => {
            if let Ok(node) = NodeId::new(node) {
                assert_eq!(keys.node(&node, topic).as_str(), text);
            }
        }
        Some(Topic::GroupJob { group }) => {
            if let Ok(group) = GroupId::new(group) {
                assert_eq!(keys.group_job(&group).as_str(), text);
            }
        }
        Some(Topic::Job { job }) => {
            if let Ok(job) = JobId::new(job) {
                assert_eq!(keys.job(&job).as_str(), text);
            }
        }
        Some(Topic::JobCancel { job }) => {
            if let Ok(job) = JobId::new(job) {
                assert_eq!(keys.job_cancel(&job).as_str(), text);
            }
        }
        Some(Topic::StartPlan { job }) => {
            if let Ok(job) = JobId::new(job) {
                assert_eq!(keys.start_plan(&job).as_str(), text);
            }
        }
        None => {}
    }
    if let Ok(name) = NodeId::new(text) {
        assert_eq!(name.as_str(), text);
        assert!(!text.is_empty() && text.len() <= keys::ids::NAME_BYTES_MAX);
        assert!(!text.contains(['/', '*', '$', '#', '?']));
    }
    if let Ok(keys) = Keys::new(text) {
        assert_eq!(keys.prefix(), text);
        let node = NodeId::new("left").expect("legal");
        let key = keys.node(&node, keys::NodeTopic::Stop);
        let stop = Topic::Node {
            node: "left",
            topic: keys::NodeTopic::Stop,
        };
        assert_eq!(keys.parse(&key), Some(stop));
    }
}

/// One of each.
pub fn seeds() -> Vec<Vec<u8>> {
    [
        "fleet/node/left/stop",
        "fleet/node/*/job",
        "fleet/group/table/job",
        "fleet/job/part-0815",
        "fleet/job/part-0815/cancel",
        "fleet/node/cell-$*/release",
        "plant.1/fleet",
        "left",
    ]
    .map(|key| key.as_bytes().to_vec())
    .to_vec()
}
