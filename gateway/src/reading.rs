//! Jobs are read and checked here, several at a time, on their way from the inbox to the fleet; they
//! go on in the order of their coming. Owns nothing that lasts.

use crate::{
    bus::{Addressee, Arrived, PostedJob, zenoh::Bus},
    fleet::{
        event::{Event, ReplyTo},
        manage::JobWishes,
    },
    job::{
        gcode::Machines,
        parse::{Parsed, parse_for, parse_group_for},
    },
};
use keys::{
    JobId,
    record::{ErrorCode, JobError},
};
use std::sync::Arc;
use tokio::{
    sync::{mpsc, watch},
    task::JoinHandle,
};

/// Jobs that are read at the same time. One core is enough for 100,000 commands a second.
pub const READERS_MAX: usize = 2;

/// Payloads up to this size are read without changing the thread, bytes: a few hundred commands,
/// some tens of microseconds.
pub const READ_INLINE_BYTES_MAX: usize = 16 * 1_024;

/// A job that is being read, and who waits for its receipt.
pub(crate) struct BeingRead {
    event: JoinHandle<Event>,
    reply: Option<ReplyTo>,
}

/// Reads jobs, several at a time, and passes them on in order of their coming.
pub(crate) async fn read_jobs(
    mut jobs: mpsc::Receiver<PostedJob>,
    reading: mpsc::Sender<BeingRead>,
    machines: watch::Receiver<Arc<Machines>>,
    mut stopping: watch::Receiver<bool>,
) {
    loop {
        let job = tokio::select! {
            biased;
            job = jobs.recv() => job,
            _ = stopping.wait_for(|stop| *stop) => None,
        };
        let Some(job) = job else { return };
        // The place in the order first: it bounds how many are read at a time.
        let Ok(place) = reading.reserve().await else {
            return;
        };
        let reply = job.reply;
        let machines = Arc::clone(&machines.borrow());
        // A few arcs in G-code can be a million commands.
        let short = job.payload.len() <= READ_INLINE_BYTES_MAX && !job.encoding.contains("gcode");
        let event = if short {
            tokio::spawn(async move { read_job(job, &machines) })
        } else {
            tokio::task::spawn_blocking(move || read_job(job, &machines))
        };
        place.send(BeingRead { event, reply });
    }
}

fn read_job(job: PostedJob, machines: &Machines) -> Event {
    let (payload, reply) = (job.payload.to_bytes(), job.reply);
    let event = read_addressed(job.to, &job.encoding, &payload, reply, machines);
    match job
        .wishes
        .map(|wishes| JobWishes::from_json(&wishes.to_bytes()))
    {
        None => event,
        Some(Ok(wishes)) if wishes == JobWishes::default() => event,
        Some(Ok(_)) if matches!(event, Event::SubmitGroup { .. }) => {
            let message = "attachment: a synchronized job has neither priority nor time: two in another order on another node would wait for each other";
            refused(event, JobError::new(ErrorCode::BadJson, message))
        }
        Some(Ok(wishes)) => Event::SubmitWith {
            wishes,
            submit: Box::new(event),
        },
        Some(Err(error)) => refused(event, error),
    }
}

/// Returns the same job with this as its error.
fn refused(event: Event, error: JobError) -> Event {
    let id_of = |id_hint: Option<JobId>, id: Option<JobId>| id_hint.or(id);
    match event {
        Event::Submit {
            pattern,
            request,
            id_hint,
            reply,
        } => Event::Submit {
            id_hint: id_of(id_hint, request.ok().and_then(|request| request.id)),
            pattern,
            request: Err(error),
            reply,
        },
        Event::SubmitGroup {
            pattern,
            request,
            id_hint,
            reply,
        } => Event::SubmitGroup {
            id_hint: id_of(id_hint, request.ok().and_then(|request| request.id)),
            pattern,
            request: Err(error),
            reply,
        },
        other => other,
    }
}

fn read_addressed(
    to: Addressee,
    encoding: &str,
    payload: &[u8],
    reply: Option<ReplyTo>,
    machines: &Machines,
) -> Event {
    let pattern = match to {
        Addressee::Node(pattern) => pattern,
        Addressee::Label(label) => format!("@{label}"),
        Addressee::Group(pattern) => {
            let Parsed { request, id_hint } = parse_group_for(encoding, payload, machines);
            return Event::SubmitGroup {
                pattern,
                request,
                id_hint,
                reply,
            };
        }
    };
    let Parsed { request, id_hint } = parse_for(&pattern, encoding, payload, machines);
    Event::Submit {
        pattern,
        request,
        id_hint,
        reply,
    }
}

/// Waits for each job in turn and for room in the fleet's queue.
pub(crate) async fn forward_jobs(
    mut read: mpsc::Receiver<BeingRead>,
    events: mpsc::Sender<Arrived>,
    bus: Arc<Bus>,
) {
    while let Some(job) = read.recv().await {
        match job.event.await {
            Ok(event) => {
                if events.send(event.into()).await.is_err() {
                    return;
                }
            }
            Err(error) => {
                tracing::error!("a job was not taken, reading it panicked: {error}");
                if let Some(reply) = job.reply {
                    let message = "the gateway failed in reading this job";
                    bus.refuse(reply, JobError::new(ErrorCode::Internal, message));
                }
            }
        }
    }
}
