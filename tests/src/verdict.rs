//! What must be true after any run: records, commands and pulses tell the same story.
//!
//! Commands of a run must be distinguishable: see [`Book`].

use crate::World;
use emulator::{
    oracle,
    record::{Life, TakenCommand},
};
use keys::{
    AxisId, Command, JobId, NodeId, QueueId,
    command::RampShape,
    record::{JobRecord, JobResult, JobState},
};
use std::collections::{BTreeMap, BTreeSet};

/// Numbers of commands are below this: a ramp carries its own in the remainder of its acceleration.
const NUMBERS: u32 = 4_096;

/// A smooth ramp has two steps at least.
const RAMP_STEPS_MIN: u32 = 2;

/// The work of one node: a job, or a node's part of a synchronized job.
type Work = (JobId, Option<NodeId>);

/// Jobs whose every command has a number of its own, so that it is known again at the node: the
/// interval of a move, the remainder of the acceleration of a ramp or line, the position that is
/// set.
#[derive(Debug, Default)]
pub struct Book {
    jobs: BTreeMap<Work, Vec<u32>>,
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
        make: impl FnMut(usize, u32) -> serde_json::Value,
    ) -> serde_json::Value {
        let id = JobId::new(name).expect("legal");
        let commands = self.work_of((id, None), count, make);
        serde_json::json!({"id": name, "commands": commands})
    }

    /// Makes a synchronized job: a part of moves for each of the nodes.
    ///
    /// # Panics
    /// The name is taken, or there are no more numbers.
    pub fn group(&mut self, name: &str, parts: &[(&str, Vec<(u8, i32)>)]) -> serde_json::Value {
        let id = JobId::new(name).expect("legal");
        let mut nodes = serde_json::Map::new();
        for (node, steps) in parts {
            let work = (id, Some(NodeId::new(node).expect("legal")));
            let commands = self.work_of(work, steps.len(), |index, number| {
                let (axis, steps) = steps[index];
                serde_json::json!({"move": {"axis": axis, "delay_us": number, "steps": steps}})
            });
            nodes.insert(
                (*node).to_owned(),
                serde_json::json!({"commands": commands}),
            );
        }
        serde_json::json!({"id": name, "nodes": nodes, "max_skew_us": 100_000})
    }

    fn work_of(
        &mut self,
        work: Work,
        count: usize,
        mut make: impl FnMut(usize, u32) -> serde_json::Value,
    ) -> Vec<serde_json::Value> {
        let numbers: Vec<u32> = (self.next_number..).take(count).collect();
        self.next_number += count as u32;
        assert!(self.next_number <= NUMBERS, "too many commands");
        let commands = numbers
            .iter()
            .enumerate()
            .map(|(index, number)| make(index, *number))
            .collect();
        let before = self.jobs.insert(work, numbers);
        assert!(before.is_none(), "the name is taken");
        commands
    }

    /// Returns an acceleration of about `accel_hz_per_s` that carries this number.
    pub fn accel_of(number: u32, accel_hz_per_s: u32) -> u32 {
        accel_hz_per_s / NUMBERS * NUMBERS + number
    }

    /// Returns the steps of a smooth ramp that carry this number.
    pub fn ramp_steps_of(number: u32) -> u32 {
        RAMP_STEPS_MIN + number
    }

    fn find(&self, command: &Command) -> Option<(Work, usize)> {
        let number = match *command {
            Command::Move { delay_us, .. } => delay_us,
            Command::Ramp { ramp, .. } | Command::RampTo { ramp, .. } => match ramp.shape {
                RampShape::Smooth { ramp_steps, .. } => ramp_steps - RAMP_STEPS_MIN,
                RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => {
                    ramp.accel_hz_per_s % NUMBERS
                }
            },
            Command::Line { accel_hz_per_s, .. } => accel_hz_per_s % NUMBERS,
            Command::SetPosition { position_steps, .. } => u32::try_from(position_steps).ok()?,
            _ => return None,
        };
        self.jobs.iter().find_map(|(work, numbers)| {
            let index = numbers.binary_search(&number).ok()?;
            Some((*work, index))
        })
    }
}

impl World {
    /// Judges everything that was told, taken and played. Returns how many commands were taken.
    ///
    /// # Panics
    /// Something is wrong; the message says what.
    pub fn verdict(&self, book: &Book) -> u64 {
        let mut went: BTreeMap<Work, Went> = BTreeMap::new();
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
                    let end = place.after(command);
                    if matches!(command.command, Command::Barrier { .. }) {
                        // The start of a part, which its client did not write.
                        continue;
                    }
                    let (work, index) = book.find(&command.command).expect("one of ours");
                    let (job, part_of) = work;
                    assert!(
                        part_of.is_none_or(|node| node == *name),
                        "node {name}: job {job}: a part of another node"
                    );
                    let went = went.entry(work).or_default();
                    assert_eq!(
                        index as u64, went.taken,
                        "node {name}: job {job}: lost or doubled command"
                    );
                    went.taken += 1;
                    went.end = end;
                    if command.number < executed_of(life, command.queue) {
                        went.executed += 1;
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
            let ends: BTreeSet<&str> = records
                .iter()
                .filter(|record| record.state.is_final())
                .map(|record| record.state.as_str())
                .collect();
            assert!(ends.len() <= 1, "job {job} has two ends: {records:?}");
            let first_end = records.iter().position(|record| record.state.is_final());
            let behind = records.iter().skip(first_end.unwrap_or(records.len()));
            assert!(
                behind.clone().all(|record| record.state.is_final()),
                "job {job} goes on behind its end: {records:?}"
            );
            let last = records.last().expect("a list begins with its first entry");
            if !last.state.is_final() {
                waiting.push((*job, last.state));
            }
            let whole = Told {
                state: last.state,
                done: last.progress.done,
                has_error: last.error.is_some(),
                result: last.result.as_ref(),
            };
            if last.group.is_none() {
                check_end(book, &went, (*job, None), &whole);
                continue;
            }
            for (node, part) in last.parts.iter().flatten() {
                assert!(
                    part.state.is_final() || !last.state.is_final(),
                    "job {job} has ended and its part on {node} has not: {last:?}"
                );
                assert!(
                    part.state == JobState::Succeeded || last.state != JobState::Succeeded,
                    "job {job} succeeded and its part on {node} did not: {last:?}"
                );
                let part = Told {
                    state: part.state,
                    done: part.progress.done,
                    // A part may end with the whole, whose error it is then.
                    has_error: part.error.is_some() || last.error.is_some(),
                    result: part.result.as_ref(),
                };
                check_end(book, &went, (*job, Some(*node)), &part);
            }
        }
        assert!(waiting.is_empty(), "jobs without an end: {waiting:?}");
        for work in book.jobs.keys() {
            let (job, _) = work;
            if !self.records.contains_key(job) {
                assert_eq!(went.get(work), None, "job {job} moved and has no record");
            }
        }
        count
    }
}

/// What became of some work, as the nodes saw it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Went {
    taken: u64,
    executed: u64,
    /// Where the last command that was taken leads.
    end: Vec<i64>,
}

/// What a client was told of some work.
struct Told<'r> {
    state: JobState,
    done: u64,
    has_error: bool,
    result: Option<&'r JobResult>,
}

fn check_end(book: &Book, went: &BTreeMap<Work, Went>, work: Work, told: &Told<'_>) {
    let total = book.jobs[&work].len() as u64;
    let none = Went::default();
    let went = went.get(&work).unwrap_or(&none);
    let (job, _) = work;
    match told.state {
        JobState::Succeeded => {
            let counts = (went.taken, went.executed, told.done);
            assert_eq!(counts, (total, total, total), "job {job} succeeded");
            let result = told.result.expect("what succeeded has a result");
            assert_eq!(result.position, went.end, "job {job} succeeded");
        }
        JobState::Failed | JobState::TimedOut | JobState::Canceled => {
            assert!(
                told.has_error || told.state == JobState::Canceled,
                "job {job} failed without a reason"
            );
            assert!(
                told.done <= went.executed,
                "job {job}: {} done, it says; {} were",
                told.done,
                went.executed
            );
        }
        JobState::Rejected => assert_eq!(went.taken, 0, "job {job} was rejected"),
        JobState::Queued | JobState::Sent | JobState::Running | JobState::Lost => {}
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
