//! One node as the gateway sees it: what it said last, which job it has, what it still must hear.
//!
//! ```text
//!   Status ─▶ fresh? ─▶ numbers, latch, facts ─▶ outcome of the active job ─▶ next job ─▶ batches
//!   Ack ────▶ same queue? ─▶ numbers ──────────────────────────────────────────────────▶ batches
//!   Stop ───▶ waiting jobs fail; the latch is awaited, and the stop repeated until it is seen
//! ```
//!
//! Promises
//! - Of one queue, `accepted` and `executed` never fall; a status that is older than the last one,
//!   a queue that is over and a boot that was replaced are not believed.
//! - One job at a time has commands on the node. The next one goes only into a queue in which
//!   nothing is outstanding and to which no cancel was ever sent: a late cancel cannot hit it.
//! - A job's outcome comes from the node's own words only: its counters, or its stop report.
//! - What must be heard (a cancel, a remembered stop, a release) is repeated until its effect is
//!   seen; all three are named by the queue that they are for, so a late one does nothing.
//!
//! Here: what is known and what clients want. `hear`: what the node says. `latch`: stops and releases.
//! `act`: what is due. `show`: what clients see.
//!
//! Absent on purpose: how a node executes; whose job it is; UTC on a node (only stamps that a
//! client reads are converted, here).

mod act;
mod facts;
mod hear;
mod latch;
mod pace;
mod show;
mod sizes;
mod turn;

pub use facts::{Facts, Latch};
pub use pace::Wish;
pub(super) use turn::{Released, Turn};

use super::{
    clock::ClockTrack,
    event::ReplyTo,
    manage::{self, MaintenanceWish, NodeWishes},
    route::{RoundTrip, Route},
};
use crate::job::{Change, Ending, Job, book::Book, group::Passed};
use keys::{
    Fault, Features, FleetMicros, GroupId, JobId, LocalMicros, NodeId, QueueId, Status, StopMode,
    command::BARRIER_RESUME,
    record::{ErrorCode, JobError, JobState, NodeRecord, no_such_axis},
};
use std::collections::VecDeque;

/// Boots that are remembered as over.
const REPLACED_BOOTS_MAX: usize = 8;

/// Clock probes that may be unanswered; the oldest is given up for a new one.
pub const PROBES_MAX: usize = 16;

/// A boot that was replaced and speaks on: another controller has the same name.
#[derive(Clone, Copy, Debug)]
struct Twin {
    boot: u32,
    /// Its first word after it was replaced: when, and its own clock then.
    first_at: FleetMicros,
    first_local: LocalMicros,
    last_at: FleetMicros,
    /// It was no late word: time passes for it.
    certain: bool,
}

/// How long a replaced boot must speak on, by our clock and for the most part by its own, before it is
/// a controller and not what a slow way kept, µs.
const TWIN_US: u64 = 2_000_000;

/// A client's wish to lift the latch.
#[derive(Clone, Debug)]
struct ReleaseWish {
    give_up_at: FleetMicros,
    send_at: FleetMicros,
    waiters: Vec<ReplyTo>,
}

/// Something that is repeated until its effect is seen.
#[derive(Clone, Copy, Debug, Default)]
struct Repeat {
    send_at: Option<FleetMicros>,
    sent_count: u32,
}

impl Repeat {
    /// Returns whether it is due, and when not before the next time.
    fn take(&mut self, now: FleetMicros, period_us: u64) -> bool {
        if self.send_at.is_some_and(|at| now < at) {
            return false;
        }
        let wait_us = (period_us << self.sent_count.min(4)).min(REPEAT_US_MAX);
        self.sent_count = self.sent_count.saturating_add(1);
        self.send_at = Some(now.plus_us(wait_us));
        true
    }
}

/// Longest time between two repetitions, µs.
const REPEAT_US_MAX: u64 = 2_000_000;

/// How a fault was first seen, so that its time does not tremble with the clock's estimate.
#[derive(Clone, Debug)]
struct SeenFault {
    fault: Fault,
    at: FleetMicros,
}

/// One node.
#[derive(Clone, Debug)]
pub struct Node {
    id: NodeId,
    facts: Facts,
    /// What of the facts is in the store.
    stored: Option<Facts>,
    alive: bool,
    /// The last fresh word, or when the gateway began to listen.
    heard_at: FleetMicros,
    /// The last fresh status of the present boot.
    status: Option<Status>,
    accepted: u64,
    executed: u64,
    /// Number up to which the node has told room.
    limit: u64,
    active: Option<JobId>,
    waiting: VecDeque<JobId>,
    /// When the first of those that wait may begin, if none may yet.
    next_at: Option<FleetMicros>,
    route: Option<Route>,
    round_trip: RoundTrip,
    /// The latch was seen closing over a queue that is still the same: it comes to rest.
    coming_to_rest: bool,
    cancel: Repeat,
    stop: Repeat,
    release: Option<ReleaseWish>,
    pace: pace::Pace,
    /// Its boot and the number of the next event that it tells.
    next_event: Option<(u32, u32)>,
    clock: ClockTrack,
    probe_at: Option<FleetMicros>,
    next_probe: u32,
    probes: VecDeque<(u32, FleetMicros)>,
    faults: Vec<SeenFault>,
    twin: Option<Twin>,
    /// Since when it is known to obey another gateway.
    disobeys_at: Option<FleetMicros>,
    told: Option<NodeRecord>,
    told_at: FleetMicros,
    /// Something that the record shows may have changed.
    stale_record: bool,
}

impl Node {
    /// A node that is heard for the first time, or read from the store.
    pub(super) fn new(id: NodeId, facts: Option<Facts>, now: FleetMicros) -> Self {
        Self {
            id,
            stored: facts.clone(),
            facts: facts.unwrap_or_default(),
            alive: false,
            heard_at: now,
            status: None,
            accepted: 0,
            executed: 0,
            limit: 0,
            active: None,
            waiting: VecDeque::new(),
            next_at: None,
            route: None,
            round_trip: RoundTrip::default(),
            coming_to_rest: false,
            cancel: Repeat::default(),
            stop: Repeat::default(),
            release: None,
            pace: pace::Pace::default(),
            next_event: None,
            clock: ClockTrack::new(),
            probe_at: None,
            next_probe: 1,
            probes: VecDeque::new(),
            faults: Vec::new(),
            twin: None,
            disobeys_at: None,
            told: None,
            told_at: FleetMicros(0),
            stale_record: true,
        }
    }

    /// Returns its name.
    pub fn id(&self) -> NodeId {
        self.id
    }

    /// Returns whether it is there.
    pub fn is_alive(&self) -> bool {
        self.alive
    }

    /// Returns what stays true of it while it is away.
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// Returns the job whose commands it has.
    pub fn active(&self) -> Option<JobId> {
        self.active
    }

    /// Returns the jobs that wait for it, in their order.
    pub fn waiting(&self) -> impl ExactSizeIterator<Item = JobId> + '_ {
        self.waiting.iter().copied()
    }

    /// Returns what is known of its clock.
    pub fn clock(&self) -> &ClockTrack {
        &self.clock
    }

    /// Returns whether another controller speaks under its name.
    pub fn has_twin(&self) -> bool {
        self.twin.is_some_and(|twin| twin.certain)
    }

    /// Returns whether it obeys another gateway.
    pub fn is_disobedient(&self) -> bool {
        self.disobeys_at.is_some()
    }

    /// Returns whether a stop holds it, as far as is known.
    pub fn is_stopped(&self) -> bool {
        self.facts.latch.is_some() || self.facts.pending_stop.is_some()
    }

    fn axis_count(&self) -> usize {
        self.facts.position_steps.len()
    }

    /// Returns whether it has this label.
    pub(super) fn has_label(&self, label: &str) -> bool {
        GroupId::new(label).is_ok_and(|label| self.facts.labels.contains(&label))
    }

    /// Puts a job among those that wait, which are in their order, behind those of its rank.
    pub(super) fn enqueue(&mut self, job: JobId, book: &Book) {
        let own = self.rank(&job, book);
        let behind = |other: &JobId| self.rank(other, book) <= own;
        let index = self.waiting.partition_point(behind);
        self.waiting.insert(index, job);
    }

    /// Puts a job behind all that wait; [`Node::sort_waiting`] follows.
    pub(super) fn enqueue_last(&mut self, job: JobId) {
        self.waiting.push_back(job);
    }

    /// Puts the jobs that wait in their order.
    pub(super) fn sort_waiting(&mut self, book: &Book) {
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting
            .make_contiguous()
            .sort_by_cached_key(|id| self.rank(id, book));
        self.waiting = waiting;
    }

    /// What waiting jobs are sorted by.
    fn rank(&self, id: &JobId, book: &Book) -> Option<impl Ord + use<>> {
        book.part(id, self.id).map(|job| manage::rank(&job.entry))
    }

    /// Changes labels and maintenance.
    pub(super) fn arrange(&mut self, wishes: &NodeWishes, turn: &mut Turn<'_>) {
        self.facts.labels.extend(wishes.label.iter().copied());
        for label in &wishes.unlabel {
            self.facts.labels.remove(label);
        }
        match &wishes.maintenance {
            None | Some(MaintenanceWish::On(true)) => {}
            Some(MaintenanceWish::On(false)) => self.facts.maintenance = None,
            Some(MaintenanceWish::Because { reason }) => {
                self.facts.maintenance = Some(reason.clone());
            }
        }
        if let Some(held) = wishes.hold_queue {
            self.facts.queue_held = held;
        }
        self.store(turn);
    }

    /// Takes the job that was on its way when the gateway went.
    ///
    /// # Errors
    /// There is one already: two jobs cannot be.
    pub(super) fn resume(&mut self, job: &Job) -> Result<(), JobId> {
        if let Some(other) = self.active {
            return Err(other);
        }
        self.active = Some(job.id());
        if let (Some(_), Some(activation)) = (&job.entry.ending, job.entry.activation) {
            self.facts.drop_halts &= self.facts.drop_queue == Some(activation.queue);
            self.facts.drop_queue = Some(activation.queue);
        }
        Ok(())
    }

    /// Returns its queue and how many of that queue's commands have ended; `None` while it is
    /// not there.
    pub(super) fn numbers(&self) -> Option<(QueueId, u64)> {
        let known = self.alive && self.status.is_some();
        known.then_some((self.facts.queue, self.executed))
    }

    /// Returns why these commands are not for this node, as a part of a synchronized job or as a
    /// job of its own.
    ///
    /// # Errors
    /// The first command that it cannot carry out, with its place.
    pub(super) fn check(
        &self,
        commands: &[keys::Command],
        synchronized: bool,
    ) -> Result<(), JobError> {
        let axis_count = self.axis_count();
        if synchronized && !self.facts.features.has(Features::BARRIERS) {
            let message = "synchronized jobs are not supported by this node's firmware";
            return Err(JobError::new(ErrorCode::BadCommand, message));
        }
        for (index, command) in commands.iter().enumerate() {
            let word = word_of(command);
            if !self.facts.features.has(command.feature())
                && !matches!(command, keys::Command::Home { .. })
            {
                let message =
                    format!("commands[{index}].{word}: not supported by this node's firmware");
                return Err(JobError::new(ErrorCode::BadCommand, message));
            }
            if let keys::Command::Barrier { barrier } = command
                && *barrier == BARRIER_RESUME
            {
                if synchronized {
                    let message = format!(
                        "commands[{index}].wait_resume: not in a synchronized job: the others would go on"
                    );
                    return Err(JobError::new(ErrorCode::BadCommand, message));
                }
            } else if let keys::Command::Barrier { .. } = command
                && !synchronized
            {
                let message =
                    format!("commands[{index}].{word}: only a synchronized job can have one");
                return Err(JobError::new(ErrorCode::BadCommand, message));
            }
            if let Some(axis) = command.axis_max()
                && axis.index() >= axis_count
            {
                let field = match command {
                    keys::Command::SyncMove { .. } | keys::Command::Line { .. } => "steps",
                    _ => "axis",
                };
                let message = format!(
                    "commands[{index}].{word}.{field}: {}",
                    no_such_axis(axis, axis_count)
                );
                return Err(JobError::new(ErrorCode::BadCommand, message));
            }
            if let keys::Command::Home { axis } = command
                && !self.facts.features.has(command.feature())
            {
                let axis = axis.0;
                let message = format!(
                    "commands[{index}].{word}.axis: axis {axis} of this node has no reference switch"
                );
                return Err(JobError::new(ErrorCode::BadCommand, message));
            }
        }
        Ok(())
    }

    /// Ends a job of this node, or its part of one, that is not final. `mode`: how a node that
    /// moves comes to rest.
    pub(super) fn end_job(
        &mut self,
        id: &JobId,
        ending: Ending,
        mode: StopMode,
        turn: &mut Turn<'_>,
    ) {
        let Some(job) = turn.book.part(id, self.id) else {
            return;
        };
        let (state, activation) = (job.state(), job.entry.activation);
        match state {
            JobState::Queued => {
                self.waiting.retain(|waiting| waiting != id);
                let change = ending.change();
                turn.book
                    .change(id, self.id, change, turn.now, turn.effects);
            }
            JobState::Lost => {
                // The node may still have commands of it: they must be dropped before it gets
                // others. That is written down before the job is called over.
                if let Some(activation) = activation {
                    self.drop_queue(activation.queue, mode, turn);
                }
                turn.book.prepare(id, self.id, |part| {
                    if part.passed == Passed::No {
                        part.passed = Passed::Unknown;
                    }
                });
                self.finish_active(ending.change(), turn);
            }
            JobState::Sent | JobState::Running => self.end_active(ending, mode, turn),
            _ => {}
        }
    }

    /// Makes the active job end: the node drops its queue, and its report is the outcome.
    fn end_active(&mut self, ending: Ending, mode: StopMode, turn: &mut Turn<'_>) {
        let Some(id) = self.active else { return };
        let Some(job) = turn.book.part(&id, self.id) else {
            return;
        };
        let Some(activation) = job.entry.activation else {
            return;
        };
        if job.entry.ending.is_none() {
            let edit = |part: &mut Job| part.entry.ending = Some(ending);
            turn.book.edit(&id, self.id, edit, turn.effects);
        }
        self.stop_route();
        self.drop_queue(activation.queue, mode, turn);
    }

    fn drop_queue(&mut self, queue: QueueId, mode: StopMode, turn: &mut Turn<'_>) {
        let halts = mode == StopMode::Halt;
        let known = self.facts.drop_queue == Some(queue);
        if !known || (halts && !self.facts.drop_halts) {
            self.facts.drop_queue = Some(queue);
            self.facts.drop_halts = halts;
            self.cancel = Repeat::default();
            self.store(turn);
        }
    }

    fn finish_active(&mut self, change: Change, turn: &mut Turn<'_>) {
        let Some(id) = self.active.take() else { return };
        self.stop_route();
        turn.book
            .change(&id, self.id, change, turn.now, turn.effects);
        self.stale_record = true;
    }

    fn stop_route(&mut self) {
        if let Some(route) = self.route.take() {
            self.round_trip = route.round_trip();
        }
    }

    fn fail_waiting(&mut self, error: &JobError, turn: &mut Turn<'_>) {
        while let Some(id) = self.waiting.pop_front() {
            let change = Change::to(JobState::Failed).error(error.clone());
            turn.book
                .change(&id, self.id, change, turn.now, turn.effects);
        }
    }
}

/// Returns the word of a command in a job's text.
fn word_of(command: &keys::Command) -> &'static str {
    use keys::{
        Command,
        command::{Ramp, RampShape},
    };
    let is_smooth = |ramp: &Ramp| matches!(ramp.shape, RampShape::Smooth { .. });
    match command {
        Command::Move { .. } => "move",
        Command::SyncMove { .. } => "sync_move",
        Command::Pause { .. } => "pause",
        Command::Laser { .. } => "laser",
        Command::LidarRead => "lidar_read",
        Command::SetPosition { .. } => "set_position",
        Command::Ramp { ramp, .. } if is_smooth(ramp) => "smooth_ramp",
        Command::RampTo { ramp, .. } if is_smooth(ramp) => "smooth_ramp_to",
        Command::Ramp { .. } => "ramp",
        Command::RampTo { .. } => "ramp_to",
        Command::Line { .. } => "line",
        Command::Home { .. } => "home",
        Command::Barrier { .. } => "barrier",
        Command::MoveC { .. } => "movc",
        Command::MoveD { .. } => "movd",
        Command::StatusCd => "statcd",
    }
}
