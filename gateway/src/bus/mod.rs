//! What comes from the network before the fleet sees it, and the clock that stamps it.
//!
//! ```text
//!  zenoh callbacks ──▶ Inbox ──┬─ urgent: stop, release, gone ──────────────────▶ fleet task
//!   (ear.rs)                   ├─ events: status, ack, clock, get, cancel, … ───▶   "
//!                              └─ jobs ──▶ read and checked in order (service.rs) ─▶ "
//! ```
//!
//! Callbacks run on the threads that read the sockets and carry other people's stops, so nothing
//! here waits. Every queue is bounded, and "full" is answered at once:
//!
//! | queue | bound | when full |
//! |---|---|---|
//! | urgent | stops: [`urgent::STOPS_WAITING_MAX`] | they become one stop of all |
//! | | releases: [`urgent::RELEASES_WAITING_MAX`] | as other events |
//! | | nodes that are gone: [`urgent::GONE_WAITING_MAX`] | dropped and logged: it shows by its silence |
//! | events | [`EVENTS_MAX`] | a get is answered `internal`, "busy"; a put is dropped and logged: status, ack and start are said again |
//! | jobs | [`JOBS_WAITING_MAX`], [`JOBS_WAITING_KIB_MAX`] | refused as `internal`, "busy": an error reply, or a record with state `rejected` |
//! | open gets | [`GETS_OPEN_MAX`] | answered `internal`, "busy" |
//!
//! Before any of that, what one client or one node may send is bounded: see [`limits`].
//!
//! Deliberately absent: anything that knows what a job or a node is.

pub mod backup;
mod door;
mod ear;
mod gets;
pub mod limits;
pub mod owners;
mod sessions;
pub mod sizes;
mod states;
pub mod urgent;
pub mod zenoh;

use crate::{
    clock_watch::Wall,
    fleet::event::{Event, ReplyTo},
};
use keys::{
    FleetMicros, NodeId, StopMode,
    record::{ErrorCode, JobError},
};
use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use urgent::{Intake, Urgent};

/// Other events that wait for the fleet: ten seconds of a hundred nodes at ten statuses a second.
pub const EVENTS_MAX: usize = 10_000;

/// Jobs that wait to be read.
pub const JOBS_WAITING_MAX: usize = 1_024;

/// Their payloads together, KiB: four of the largest jobs.
pub const JOBS_WAITING_KIB_MAX: usize = 4 * keys::job::JOB_BYTES_MAX / 1_024;

/// Gets that wait for their last reply.
pub const GETS_OPEN_MAX: usize = 4_096;

/// The gateway's clock: UTC at the start, and from there on time that never goes back. What becomes of it
/// when the wall is set: see [`clock_watch`](crate::clock_watch).
#[derive(Clone, Copy, Debug)]
pub struct WallClock {
    started_at_us: u64,
    started: Instant,
}

impl WallClock {
    /// Reads the wall once.
    pub fn start(wall: &Wall) -> Self {
        Self {
            started_at_us: wall.now_us(),
            started: Instant::now(),
        }
    }

    /// Returns how far the wall is ahead now, µs; negative: behind. Not zero after it was set, or after
    /// a sleep of the machine.
    pub fn wall_ahead_us(&self, wall: &Wall) -> i64 {
        wall.now_us().cast_signed() - self.now().0.cast_signed()
    }

    /// Returns the time now.
    pub fn now(&self) -> FleetMicros {
        FleetMicros(self.started_at_us + self.started.elapsed().as_micros() as u64)
    }
}

/// An event and, where it matters, when it came off the socket.
#[derive(Debug)]
pub struct Arrived {
    /// What happened.
    pub event: Event,
    /// When; `None`: when the fleet takes it.
    pub at: Option<FleetMicros>,
}

impl From<Event> for Arrived {
    fn from(event: Event) -> Self {
        Self { event, at: None }
    }
}

/// Whom a job is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Addressee {
    /// A node's name, or a wild chunk.
    Node(String),
    /// A group's name, or a wild chunk.
    Group(String),
    /// A label's name, or a wild chunk, which none is.
    Label(String),
}

/// A job as it came, unread.
#[derive(Debug)]
pub struct PostedJob {
    /// Whom it is for.
    pub to: Addressee,
    /// What the payload is, in zenoh's words.
    pub encoding: String,
    /// The bytes.
    pub payload: zenoh::Payload,
    /// How important it is and when it may begin, in JSON; nothing: as usual.
    pub wishes: Option<zenoh::Payload>,
    /// Who waits for a receipt.
    pub reply: Option<ReplyTo>,
    /// Its part of [`JOBS_WAITING_KIB_MAX`], given back when it has been read.
    pub room: OwnedSemaphorePermit,
}

/// The queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// Where callbacks put what came. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Inbox {
    urgent: Urgent,
    events: mpsc::Sender<Arrived>,
    jobs: mpsc::Sender<PostedJob>,
    jobs_room_kib: Arc<Semaphore>,
    dropped_count: Arc<AtomicU64>,
}

/// The other ends of an [`Inbox`].
#[derive(Debug)]
pub struct Outlets {
    /// Everything but jobs.
    pub events: Intake,
    /// Where jobs go on when they have been read.
    pub events_sender: mpsc::Sender<Arrived>,
    /// Jobs.
    pub jobs: mpsc::Receiver<PostedJob>,
}

impl Inbox {
    /// Makes the queues.
    pub fn new() -> (Self, Outlets) {
        let urgent = Urgent::default();
        let (events, events_outlet) = mpsc::channel(EVENTS_MAX);
        let (jobs, jobs_outlet) = mpsc::channel(JOBS_WAITING_MAX);
        let outlets = Outlets {
            events: Intake::new(urgent.clone(), events_outlet),
            events_sender: events.clone(),
            jobs: jobs_outlet,
        };
        let inbox = Self {
            urgent,
            events,
            jobs,
            jobs_room_kib: Arc::new(Semaphore::new(JOBS_WAITING_KIB_MAX)),
            dropped_count: Arc::default(),
        };
        (inbox, outlets)
    }

    /// Takes a stop.
    pub fn stop(&self, pattern: String, mode: StopMode) {
        self.urgent.stop(pattern, mode);
    }

    /// Takes a release, behind the stops that came before it.
    ///
    /// # Errors
    /// [`Full`]: whoever waits for a reply has to be told.
    pub fn release(&self, release: Event) -> Result<(), Full> {
        let taken = self.urgent.release(release);
        taken.inspect_err(|Full| self.note_dropped(&"too many releases wait"))
    }

    /// Takes a node whose token is gone.
    pub fn gone(&self, node: NodeId) {
        if let Err(Full) = self.urgent.gone(node) {
            self.note_dropped(&"too many nodes are gone");
        }
    }

    /// Takes an event.
    ///
    /// # Errors
    /// [`Full`]: whoever waits for a reply has to be told.
    pub fn event(&self, event: impl Into<Arrived>) -> Result<(), Full> {
        self.events.try_send(event.into()).map_err(|error| {
            self.note_dropped(&error);
            Full
        })
    }

    /// Takes a job. If there is no room for it, the fleet gets its refusal instead.
    ///
    /// # Errors
    /// [`Full`]: not even for that; whoever waits for a receipt has to be told.
    pub fn job(
        &self,
        to: Addressee,
        encoding: String,
        payload: zenoh::Payload,
        wishes: Option<zenoh::Payload>,
        reply: Option<ReplyTo>,
    ) -> Result<(), Full> {
        let kib = payload.len().div_ceil(1_024).min(JOBS_WAITING_KIB_MAX);
        let room = Arc::clone(&self.jobs_room_kib).try_acquire_many_owned(kib as u32);
        let refused = match room {
            Ok(room) => {
                let posted = PostedJob {
                    to,
                    encoding,
                    payload,
                    wishes,
                    reply,
                    room,
                };
                match self.jobs.try_send(posted) {
                    Ok(()) => return Ok(()),
                    Err(error) => error.into_inner().to,
                }
            }
            Err(_) => to,
        };
        self.event(refusal_event(refused, busy(), reply))
    }

    /// Counts, and logs at 1, 2, 4, 8, …: a flood must not become one of log lines.
    fn note_dropped(&self, what: &dyn std::fmt::Display) {
        let count = self.dropped_count.fetch_add(1, Ordering::Relaxed) + 1;
        if count.is_power_of_two() {
            tracing::error!(count, "events dropped: {what}");
        }
    }
}

/// Returns the event for a job that was not read.
pub fn refusal_event(to: Addressee, error: JobError, reply: Option<ReplyTo>) -> Event {
    match to {
        Addressee::Node(_) | Addressee::Label(_) => Event::Submit {
            pattern: match to {
                Addressee::Label(label) => format!("@{label}"),
                Addressee::Node(pattern) | Addressee::Group(pattern) => pattern,
            },
            request: Err(error),
            id_hint: None,
            reply,
        },
        Addressee::Group(pattern) => Event::SubmitGroup {
            pattern,
            request: Err(error),
            id_hint: None,
            reply,
        },
    }
}

/// The refusal when a queue is full.
pub fn busy() -> JobError {
    JobError::new(
        ErrorCode::Internal,
        "the gateway is busy: too much waits to be read; nothing was taken, try again",
    )
}

/// The refusal of a client that asks for too much.
pub fn too_often() -> JobError {
    JobError::new(
        ErrorCode::NotAllowed,
        "this client asks for too much at a time; nothing was taken, try again more slowly",
    )
}

/// The refusal of a question that is longer than any of its kind.
pub fn too_large() -> JobError {
    JobError::new(
        ErrorCode::TooLarge,
        format!(
            "at most {} bytes may be asked with here",
            sizes::SCRIPT_MESSAGE_BYTES_MAX
        ),
    )
}

/// The refusal when the store has failed.
pub fn store_failed() -> JobError {
    JobError::new(
        ErrorCode::Internal,
        "the gateway's store failed; it takes nothing more and ends",
    )
}
