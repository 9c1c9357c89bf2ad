//! Meeting points of a synchronized job: which there are, and whether each can be met.

use super::{GroupRequest, JobCommand, Work};
use crate::{
    NodeId,
    command::BARRIER_RESUME,
    record::{ErrorCode, JobError},
};
use std::{collections::BTreeMap, format, vec::Vec};

impl Work {
    /// Returns the names of its meeting points and the indices of their commands, in order.
    fn barriers(&self) -> impl Iterator<Item = (&str, usize)> {
        let commands = match self {
            Self::Commands(commands) => commands.as_slice(),
            Self::Lua(_) => &[],
        };
        commands
            .iter()
            .enumerate()
            .filter_map(|(index, command)| match command {
                JobCommand::Barrier(fields) => Some((fields.name.as_str(), index)),
                _ => None,
            })
    }
}

impl GroupRequest {
    /// Meeting points that could never be lifted: met by one part only, twice in one part, or in
    /// an order in which two parts wait for each other. Where a script will go is not known: another
    /// part may be one that comes to it.
    pub(super) fn check_barriers(&self) -> Result<(), JobError> {
        let bad = |node: &NodeId, index: usize, words: &str| {
            let message = format!("nodes.{node}.commands[{index}].barrier: {words}");
            Err(JobError::new(ErrorCode::BadCommand, message))
        };
        let mut parts_of: BTreeMap<&str, usize> = BTreeMap::new();
        let mut lists: Vec<(&NodeId, Vec<(&str, usize)>)> = Vec::new();
        for (node, work) in &self.nodes {
            let list: Vec<_> = work.barriers().collect();
            let mut here: BTreeMap<&str, usize> = BTreeMap::new();
            for (name, index) in &list {
                if let Some(first) = here.insert(name, *index) {
                    let words = format!("`{name}` is met in commands[{first}] already");
                    return bad(node, *index, &words);
                }
                *parts_of.entry(name).or_default() += 1;
            }
            lists.push((node, list));
        }
        // The last number is another one's.
        if parts_of.len() >= usize::from(BARRIER_RESUME) {
            let message = format!(
                "nodes: {} meeting points; there can be at most {}",
                parts_of.len(),
                BARRIER_RESUME - 1
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        let scripts = self.nodes.values().any(|work| matches!(work, Work::Lua(_)));
        for (node, list) in lists.iter().filter(|_| !scripts) {
            for (name, index) in list {
                if parts_of[name] == 1 {
                    return bad(node, *index, &format!("no other part meets at `{name}`"));
                }
            }
        }
        // Meets what can be met until nothing is left, or nothing can be.
        let mut fronts = std::vec![0; lists.len()];
        let mut waiting: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        let mut arriving: Vec<usize> = (0..lists.len()).collect();
        while let Some(part) = arriving.pop() {
            let Some((name, _)) = lists[part].1.get(fronts[part]) else {
                continue;
            };
            let here = waiting.entry(name).or_default();
            here.push(part);
            if here.len() == parts_of[name] {
                for part in waiting.remove(name).unwrap_or_default() {
                    fronts[part] += 1;
                    arriving.push(part);
                }
            }
        }
        for (part, (node, list)) in lists.iter().enumerate() {
            if let Some((name, index)) = list.get(fronts[part]) {
                let words = format!(
                    "`{name}` is never met: another part waits for this one somewhere else"
                );
                return bad(node, *index, &words);
            }
        }
        Ok(())
    }

    /// Returns the number of each meeting point: 1, 2, … by first appearance, parts in the order
    /// of their nodes' names. 0 is the start.
    pub fn barrier_numbers(&self) -> BTreeMap<&str, u16> {
        let mut numbers = BTreeMap::new();
        for (name, _) in self.nodes.values().flat_map(Work::barriers) {
            let next = numbers.len() as u16 + 1;
            numbers.entry(name).or_insert(next);
        }
        numbers
    }
}
