//! What must be true after any run: records, commands and pulses tell the same story.
//!
//! Commands of a run must be distinguishable: see [`Book`].

use crate::World;
use emulator::{
    oracle,
    record::{Life, TakenCommand},
};
use keys::{
    AxisId, Command, JobId, QueueId,
    record::{JobRecord, JobState},
};
use std::collections::BTreeMap;

/// Numbers of commands are below this: a ramp carries its own in the remainder of its acceleration.
const NUMBERS: u32 = 4_096;

/// Jobs whose every command has a number of its own, so that it is known again at the node: the
/// interval of a move, the remainder of the acceleration of a ramp or line, the position that is
/// set.
#[derive(Debug, Default)]
pub struct Book {
    jobs: BTreeMap<JobId, Vec<u32>>,
    next_number: u32,
}

impl Book {
    /// Starts with the shortest interval.
    pub fn new() -> Self {
        Self {
            jobs: BTreeMap::new(),
            next_number: 20,
        }
    }

    /// Makes a job of `steps.len()` moves.
    ///
    /// # Panics
    /// The name is taken.
    pub fn job(&mut self, name: &str, steps: &[(u8, i32)]) -> serde_json::Value {
        self.job_of(name, steps.len(), |index, number| {
            let (axis, steps) = steps[index];
            serde_json::json!({"move": {"axis": axis, "delay_us": number, "steps": steps}})
        })
    }

    /// Makes a job of `count` commands, each from its index and its number.
    ///
    /// # Panics
    /// The name is taken, or there are no more numbers.
    pub fn job_of(
        &mut self,
        name: &str,
        count: usize,
        mut make: impl FnMut(usize, u32) -> serde_json::Value,
    ) -> serde_json::Value {
        let numbers: Vec<u32> = (self.next_number..).take(count).collect();
        self.next_number += count as u32;
        assert!(self.next_number <= NUMBERS, "too many commands");
        let commands: Vec<_> = numbers
            .iter()
            .enumerate()
            .map(|(index, number)| make(index, *number))
            .collect();
        let id = JobId::new(name).expect("legal");
        assert!(self.jobs.insert(id, numbers).is_none(), "the name is taken");
        serde_json::json!({"id": name, "commands": commands})
    }

    /// Returns an acceleration of about `accel_hz_per_s` that carries this number.
    pub fn accel_of(number: u32, accel_hz_per_s: u32) -> u32 {
        accel_hz_per_s / NUMBERS * NUMBERS + number
    }

    fn find(&self, command: &Command) -> Option<(JobId, usize)> {
        let number = match *command {
            Command::Move { delay_us, .. } => delay_us,
            Command::Ramp { ramp, .. } | Command::RampTo { ramp, .. } => {
                ramp.accel_hz_per_s % NUMBERS
            }
            Command::Line { accel_hz_per_s, .. } => accel_hz_per_s % NUMBERS,
            Command::SetPosition { position_steps, .. } => u32::try_from(position_steps).ok()?,
            _ => return None,
        };
        self.jobs.iter().find_map(|(job, numbers)| {
            let index = numbers.binary_search(&number).ok()?;
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
        let mut ends: BTreeMap<JobId, Vec<i64>> = BTreeMap::new();
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
                let mut place = Place::new(life);
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
                    ends.insert(job, place.after(command));
                    if command.number < executed_of(life, command.queue) {
                        *executed.entry(job).or_default() += 1;
                    }
                }
                place.check(name.as_str());
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
                    let result = last.result.as_ref().expect("what succeeded has a result");
                    assert_eq!(Some(&result.position), ends.get(job), "job {job} succeeded");
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

/// Where the commands of a life lead, by addition alone. A stop may cut a command short: a queue
/// behind one begins where the report says that the axes are.
struct Place<'l> {
    life: &'l Life,
    queue: Option<QueueId>,
    positions: Vec<i64>,
}

impl<'l> Place<'l> {
    fn new(life: &'l Life) -> Self {
        let positions = vec![0; life.axis_count];
        Self {
            life,
            queue: None,
            positions,
        }
    }

    /// Goes on by the next command; returns where the axes are then.
    fn after(&mut self, taken: &TakenCommand) -> Vec<i64> {
        if let Some(queue) = self
            .queue
            .replace(taken.queue)
            .filter(|q| *q != taken.queue)
        {
            self.take_report(queue);
        }
        let here = (0..).zip(&self.positions);
        let mut commands: Vec<Command> = here
            .map(|(axis, position)| Command::SetPosition {
                axis: AxisId(axis),
                position_steps: *position,
            })
            .collect();
        commands.push(taken.command);
        self.positions = oracle::positions_after(&commands, self.life.axis_count);
        self.positions.clone()
    }

    fn take_report(&mut self, queue: QueueId) {
        let stop = self.life.stops.iter().find(|stop| stop.queue == queue);
        let stop = stop.expect("a queue ends with a report");
        if stop.executed_commands == stop.accepted_commands {
            let said = stop.positions_steps.as_slice();
            assert_eq!(said, self.positions, "{queue:?} was executed to its end");
        }
        self.positions = stop.positions_steps.to_vec();
    }

    /// At the end of the life. If it was cut off, a command may be under way.
    fn check(mut self, node: &str) {
        let status = &self.life.status;
        if let Some(queue) = self.queue.filter(|queue| *queue != status.queue) {
            self.take_report(queue);
        } else if status.executed_commands < status.accepted_commands {
            return;
        }
        let axes = status.axes.iter().map(|axis| axis.position_steps);
        assert_eq!(axes.collect::<Vec<_>>(), self.positions, "node {node}");
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
