//! The parts of a synchronized job: what each node is to execute, which is what an operator signs.

use crate::job::{Job, JobEntry, new_record};
use keys::{
    Command, NodeId,
    job::{GroupRequest, Work},
    record::JobState,
};
use std::{collections::BTreeMap, sync::Arc};

/// Returns the commands of each part, the barrier of the start in front.
pub fn parts_of(request: &GroupRequest) -> BTreeMap<NodeId, Arc<[Command]>> {
    let numbers = request.barrier_numbers();
    let number = |name: &str| numbers.get(name).copied().unwrap_or_default();
    let part = |work: &Work| -> Arc<[Command]> {
        let own = match work {
            Work::Commands(commands) => commands.as_slice(),
            Work::Lua(_) => &[],
        };
        let head = Command::Barrier { barrier: 0 };
        std::iter::once(head)
            .chain(own.iter().map(|command| command.to_command(number)))
            .collect()
    };
    request
        .nodes
        .iter()
        .map(|(node, work)| (*node, part(work)))
        .collect()
}

/// Makes a part of a job, without a barrier in its count.
pub(in crate::fleet) fn new_part(
    whole: &JobEntry,
    node: NodeId,
    commands: Arc<[Command]>,
    script: Option<Arc<str>>,
) -> Job {
    let total = (commands.len() as u64).saturating_sub(1);
    let created = whole.record.created;
    let mut record = new_record(
        whole.record.job,
        Some(node),
        JobState::Queued,
        total,
        created,
    );
    record.group = whole.record.group;
    record.updated = whole.record.updated;
    let mut part = Job::new(JobEntry::new(record, whole.sequence), commands);
    part.head_commands = 1;
    part.with_script(script)
}
