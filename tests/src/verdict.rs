//! What must be true after any run: records, commands and pulses tell the same story.
//!
//! Commands of a run must be distinguishable: see [`Book`].

use crate::World;
use emulator::{oracle, record::Life};
use keys::{
    Command, JobId, QueueId,
    record::{JobRecord, JobState},
};
use std::collections::BTreeMap;

/// Jobs whose every command has an interval of its own, so that it is known again at the node.
#[derive(Debug, Default)]
pub struct Book {
    jobs: BTreeMap<JobId, Vec<u32>>,
    next_delay_us: u32,
}

impl Book {
    /// Starts with the shortest interval.
    pub fn new() -> Self {
        Self {
            jobs: BTreeMap::new(),
            next_delay_us: 20,
        }
    }

    /// Makes a job of `steps.len()` moves.
    ///
    /// # Panics
    /// The name is taken.
    pub fn job(&mut self, name: &str, steps: &[(u8, i32)]) -> serde_json::Value {
        let mut delays_us = Vec::new();
        let commands: Vec<_> = steps
            .iter()
            .map(|(axis, steps)| {
                delays_us.push(self.next_delay_us);
                self.next_delay_us += 1;
                serde_json::json!({"move": {
                    "axis": axis, "delay_us": self.next_delay_us - 1, "steps": steps
                }})
            })
            .collect();
        let id = JobId::new(name).expect("legal");
        assert!(
            self.jobs.insert(id, delays_us).is_none(),
            "the name is taken"
        );
        serde_json::json!({"id": name, "commands": commands})
    }

    fn find(&self, command: &Command) -> Option<(JobId, usize)> {
        let Command::Move { delay_us, .. } = command else {
            return None;
        };
        self.jobs.iter().find_map(|(job, delays_us)| {
            let index = delays_us.binary_search(delay_us).ok()?;
            Some((*job, index))
        })
    }
}

impl World {
    /// Judges everything that was told, taken and played. Returns how many commands were taken.
    ///
    /// # Panics
    /// Something is wrong; the message says what.
    pub fn verdict(&self, book: &Book) -> u64 {
        let mut taken: BTreeMap<JobId, usize> = BTreeMap::new();
        let mut executed: BTreeMap<JobId, u64> = BTreeMap::new();
        let mut count = 0;
        for (name, machine) in self.machines() {
            let present = machine.node.life();
            let mut lives: Vec<&Life> = machine.node.past_lives().iter().collect();
            lives.push(&present);
            for life in lives {
                assert!(!life.cut, "the record is too small for this run");
                if let Err(violations) = oracle::check_life(life) {
                    let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
                    panic!("node {name}: {}", lines.join("; "));
                }
                let mut numbers: BTreeMap<QueueId, u64> = BTreeMap::new();
                for command in &life.commands {
                    let number = numbers.entry(command.queue).or_default();
                    assert_eq!(command.number, *number, "node {name}: a gap in the queue");
                    *number += 1;
                    count += 1;
                    let (job, index) = book.find(&command.command).expect("one of ours");
                    let next = taken.entry(job).or_default();
                    assert_eq!(
                        index, *next,
                        "node {name}: job {job}: lost or doubled command"
                    );
                    *next += 1;
                    if command.number < executed_of(life, command.queue) {
                        *executed.entry(job).or_default() += 1;
                    }
                }
            }
        }
        let mut waiting = Vec::new();
        for (job, records) in &self.records {
            // A gateway that starts anew says again what it last said.
            let grows =
                |pair: &[JobRecord]| pair[0].version < pair[1].version || pair[0] == pair[1];
            assert!(records.windows(2).all(grows), "job {job}: {records:?}");
            let last = records.last().expect("a list begins with its first entry");
            let total = book.jobs[job].len() as u64;
            let done = executed.get(job).copied().unwrap_or(0);
            let went = taken.get(job).copied().unwrap_or(0) as u64;
            match last.state {
                JobState::Succeeded => {
                    assert_eq!((went, done), (total, total), "job {job} succeeded");
                    assert_eq!(last.progress.done, total, "job {job} succeeded");
                }
                JobState::Failed | JobState::TimedOut => {
                    assert!(last.error.is_some(), "job {job} failed without a reason");
                    assert!(last.progress.done <= done, "job {job}: more done than was");
                }
                JobState::Canceled => {
                    assert!(last.progress.done <= done, "job {job}: more done than was");
                }
                JobState::Rejected => assert_eq!(went, 0, "job {job} was rejected"),
                JobState::Queued | JobState::Sent | JobState::Running | JobState::Lost => {
                    waiting.push((*job, last.state));
                }
            }
        }
        assert!(waiting.is_empty(), "jobs without an end: {waiting:?}");
        for job in book.jobs.keys() {
            if !self.records.contains_key(job) {
                assert_eq!(taken.get(job), None, "job {job} moved and has no record");
            }
        }
        count
    }
}

/// Returns how many commands of a queue ended in this life.
fn executed_of(life: &Life, queue: QueueId) -> u64 {
    if life.status.queue == queue {
        return life.status.executed_commands;
    }
    let stop = life.stops.iter().find(|stop| stop.queue == queue);
    stop.map_or(0, |stop| stop.executed_commands)
}
