//! The gateway as a running service: the one place where things wait.
//!
//! ```text
//!  Inbox ─ jobs ──▶ reader ──▶ forwarder ─┐                     ┌─ RealTime ─▶ network, at once
//!        ─ events ───────────────────────▶├─▶ fleet task ───────┤
//!        ─ urgent ───────────────────────▶┘  (owns Fleet)       └─▶ writer thread (owns Journal):
//!                                                                   commit, then publish and reply
//! ```
//!
//! - Jobs are read on blocking threads, [`READERS_MAX`] at a time, and go on in the order in which
//!   they came; a large one holds up those behind it, and nothing else.
//! - The writer takes what has gathered, up to [`BATCHES_PER_COMMIT_MAX`] handled events, commits all
//!   their writes in one transaction, and only then lets anything out, in order.
//! - If the store fails nothing more is taken, every get is answered `internal`, and
//!   [`Service::failed`] tells.
//! - Full: the fleet task waits for the writer, the inbox fills and answers for itself
//!   (see [`crate::bus`]).

use crate::{
    bus::{
        Arrived, Inbox, Outlets, WallClock,
        owners::Owners,
        store_failed,
        urgent::Intake,
        zenoh::{Bus, BusError},
    },
    clock_watch::{Advice, ClockWatch, LOOK_EVERY_US, disagree},
    config::GatewayConfig,
    fleet::{
        Fleet, FleetConfig, RestoreError,
        event::{Effect, Event, Lane, ReplyTo},
        owner::Resignation,
    },
    http::{self, HttpError},
    job::gcode::Machines,
    journal::{Journal, JournalError},
    observe::{self, Snapshot},
    reading::{READERS_MAX, forward_jobs, read_jobs},
    security::Home,
    spans::JobSpans,
    standby::{self, Taken},
};
use keys::{FleetMicros, Keys, record::JobState};
use metrics::{counter, gauge, histogram};
use std::{
    hash::{BuildHasher, RandomState},
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};
use thiserror::Error;
use tokio::{
    sync::{mpsc, oneshot, watch},
    task::JoinHandle,
};

/// Handled events whose effects wait for the writer.
pub const EFFECT_BATCHES_MAX: usize = 256;

/// Handled events whose writes are committed together.
pub const BATCHES_PER_COMMIT_MAX: usize = 100;

/// Questions about the fleet that wait for their answer.
const QUESTIONS_MAX: usize = 8;

/// How long the fleet may take for an answer; one that takes longer hangs.
pub const ANSWER_PATIENCE: Duration = Duration::from_secs(2);

/// Why the service cannot start or go on.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// The store cannot be opened or written.
    #[error("store: {0}")]
    Store(#[from] JournalError),
    /// What the store holds cannot be taken up.
    #[error("store: {0}")]
    Restore(#[from] RestoreError),
    /// The network is not there.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Metrics and health cannot be served.
    #[error(transparent)]
    Http(#[from] HttpError),
    /// A part of the service panicked.
    #[error("the service's {0} ended by a panic")]
    Panicked(&'static str),
    /// Another gateway serves the fleet now, or shall.
    #[error("{0}; nothing was lost, all of it is in the store")]
    Resigned(Resignation),
    /// The system gives no thread.
    #[error("no thread for the writer: {0}")]
    Thread(std::io::Error),
}

/// A running gateway. Dropped without [`Service::shutdown`] it loses what is not yet written.
#[derive(Debug)]
pub struct Service {
    clock: WallClock,
    bus: Arc<Bus>,
    stop_jobs: watch::Sender<bool>,
    stop_fleet: watch::Sender<bool>,
    failed: watch::Receiver<bool>,
    resigned: watch::Receiver<Option<Resignation>>,
    place: JoinHandle<()>,
    observer: Observer,
    machines: watch::Sender<Arc<Machines>>,
    reader: JoinHandle<()>,
    forwarder: JoinHandle<()>,
    fleet: JoinHandle<Remaining>,
    writer: std::thread::JoinHandle<Result<(), JournalError>>,
}

/// Where a gateway that is ready can be reached.
#[derive(Clone, Copy, Debug)]
pub struct Ready<'s> {
    /// See [`Service::locators`].
    pub locators: &'s [String],
    /// Where `/metrics` and `/healthz` are.
    pub http: Option<SocketAddr>,
    /// What answers questions about the fleet.
    pub observer: &'s Observer,
}

/// What is left undone when a service has ended. All of it is in the store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Remaining {
    /// Jobs that wait for their turn, their time or their node.
    pub waiting: usize,
    /// Jobs of which a node has commands: it goes on by itself until it misses its gateway.
    pub on_nodes: usize,
}

impl Remaining {
    fn of(fleet: &Fleet) -> Self {
        let mut remaining = Self::default();
        for job in fleet.jobs() {
            match job.state() {
                JobState::Queued => remaining.waiting += 1,
                JobState::Sent | JobState::Running | JobState::Lost => remaining.on_nodes += 1,
                _ => {}
            }
        }
        remaining
    }
}

/// Runs a gateway until `shutdown` resolves, the store fails or another gateway takes over. `taken` is
/// its store if it stood by. When the wall clock was set it begins anew by itself, see
/// [`clock_watch`](crate::clock_watch). `ready` is called whenever it has begun; machines that come by `reloads` are for the jobs
/// that come after them.
///
/// # Errors
/// See [`ServiceError`].
///
/// # Cancellation safety
/// None: cancel by `shutdown`.
pub async fn run(
    mut config: GatewayConfig,
    mut taken: Option<Taken>,
    mut ready: impl FnMut(Ready<'_>),
    shutdown: impl Future<Output = ()>,
    mut reloads: mpsc::Receiver<Machines>,
) -> Result<Remaining, ServiceError> {
    let mut shutdown = std::pin::pin!(shutdown);
    // First of all: an address that is taken is told before anything has begun.
    let mut listener = match config.http {
        Some(address) => Some(http::listen(address).await?),
        None => None,
    };
    let metrics = match listener {
        Some(_) => Some(http::install()?),
        None => None,
    };
    loop {
        let service = Service::start_with(config.clone(), taken.take()).await?;
        if config.connect.is_empty() {
            // Whoever knows where it is finds it there again.
            config.listen = service.locators().to_vec();
        }
        let address = listener
            .as_ref()
            .and_then(|socket| socket.local_addr().ok());
        let serve = listener
            .take()
            .zip(metrics.clone())
            .map(|(listener, metrics)| {
                let serve = http::serve(listener, service.observer(), metrics);
                tokio::spawn(serve)
            });
        ready(Ready {
            locators: service.locators(),
            http: address,
            observer: &service.observer,
        });
        let reload = async {
            while let Some(machines) = reloads.recv().await {
                config.machines = machines.clone();
                service.set_machines(machines);
            }
            std::future::pending::<()>().await;
        };
        let ended = tokio::select! {
            () = &mut shutdown => Ended::Asked,
            () = service.failed() => Ended::Asked,
            why = service.resigned() => Ended::Resigned(why),
            () = service.clock_was_set() => Ended::ClockSet,
            () = reload => Ended::Asked,
        };
        if let Some(serve) = serve {
            serve.abort();
            // So that the address is free again; it was aborted, and that is no news.
            let _ = serve.await;
        }
        let remaining = service.shutdown().await?;
        match ended {
            Ended::Asked => return Ok(remaining),
            Ended::Resigned(why) => return Err(ServiceError::Resigned(why)),
            Ended::ClockSet => {}
        }
        if let Some(address) = address {
            listener = Some(http::listen(address).await?);
        }
    }
}

/// Why a service ends that is run.
enum Ended {
    /// Somebody wants it, or the store has failed.
    Asked,
    Resigned(Resignation),
    /// To begin anew.
    ClockSet,
}

impl Service {
    /// Opens the store, takes up what it holds, opens the network and begins to accept.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub async fn start(config: GatewayConfig) -> Result<Self, ServiceError> {
        Self::start_with(config, None).await
    }

    /// The same with a store that is open already.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub async fn start_with(
        config: GatewayConfig,
        taken: Option<Taken>,
    ) -> Result<Self, ServiceError> {
        // Before anything is written: an address that cannot be meant.
        for locator in config.listen().iter().chain(&config.connect) {
            crate::bus::zenoh::host_and_port(locator)?;
        }
        let clock = WallClock::start();
        let taken = match taken {
            Some(taken) => taken,
            None => Taken::open(&config, clock).await?,
        };
        let Taken {
            journal,
            stored,
            epoch,
        } = taken;
        let mut effects = Vec::new();
        let fleet_config = FleetConfig {
            keys: config.keys.clone(),
            epoch,
            signers: signers(&config)?,
            ..config.fleet.clone()
        };
        // Any number: it only makes the names of jobs of two runs differ.
        let seed = RandomState::new().hash_one(clock.now().0);
        let fleet = Fleet::restore(fleet_config, seed, stored, clock.now(), &mut effects)?;
        let bus = Arc::new(Bus::open(&config).await?);

        let (inbox, outlets) = Inbox::new();
        let (batches, batches_outlet) = mpsc::channel(EFFECT_BATCHES_MAX);
        let (failed_sender, failed) = watch::channel(false);
        let (questions, asked) = mpsc::channel(QUESTIONS_MAX);
        let (stop_jobs, jobs_stopping) = watch::channel(false);
        let (stop_fleet, fleet_stopping) = watch::channel(false);
        let store_failed = Arc::new(AtomicBool::new(false));
        let Outlets {
            events,
            events_sender,
            jobs,
        } = outlets;

        let copier = journal.copier();
        let writer = Writer {
            journal,
            bus: Arc::clone(&bus),
            batches: batches_outlet,
            store_failed: Arc::clone(&store_failed),
            failed: failed_sender,
        };
        let writer = std::thread::Builder::new()
            .name("gateway-writer".to_owned())
            .spawn(move || writer.run())
            .map_err(ServiceError::Thread)?;
        let mut task = FleetTask {
            fleet,
            clock,
            bus: Arc::clone(&bus),
            batches,
            store_failed,
            spans: JobSpans::default(),
            keys: config.keys.clone(),
        };
        task.carry_out(effects).await;
        let fleet = tokio::spawn(task.run(events, asked, fleet_stopping));
        let (reading, read) = mpsc::channel(READERS_MAX);
        let (machines, known_machines) = watch::channel(Arc::new(config.machines.clone()));
        let reader = tokio::spawn(read_jobs(jobs, reading, known_machines, jobs_stopping));
        let forwarder = tokio::spawn(forward_jobs(read, events_sender, Arc::clone(&bus)));

        let (resigned_sender, resigned) = watch::channel(None);
        let (owners, known_owners) = watch::channel(Owners::new());
        let keep = standby::keep(epoch, config.standby, known_owners, clock);
        let joined = !config.connect.is_empty();
        let place = tokio::spawn(async move {
            if !joined {
                return;
            }
            let why = keep.await;
            tracing::error!("{why}: it stops serving");
            resigned_sender.send_replace(Some(why));
        });

        let service = Self {
            clock,
            bus,
            resigned,
            place,
            stop_jobs,
            stop_fleet,
            observer: Observer {
                questions,
                failed: failed.clone(),
            },
            failed,
            machines,
            reader,
            forwarder,
            fleet,
            writer,
        };
        let declared = async {
            service.bus.declare(&inbox, clock).await?;
            service.bus.declare_owner(epoch, owners).await?;
            service.bus.declare_backup(copier).await
        };
        if let Err(error) = declared.await {
            // The first error is the one to tell.
            let _ = service.shutdown().await;
            return Err(error.into());
        }
        tracing::info!(
            listen = %service.locators().join(", "),
            store = %config.store.display(),
            prefix = config.keys.prefix(),
            epoch,
            "the gateway is ready"
        );
        Ok(service)
    }

    /// Returns where clients and nodes connect: where the own router listens, with the ports that
    /// the system chose for port 0, or the routers of the network that was joined.
    pub fn locators(&self) -> &[String] {
        self.bus.locators()
    }

    /// Jobs in G-code that come from now on are for these machines.
    pub fn set_machines(&self, machines: Machines) {
        self.machines.send_replace(Arc::new(machines));
    }

    /// Returns what answers questions about the fleet, also from other tasks.
    pub fn observer(&self) -> Observer {
        self.observer.clone()
    }

    /// Resolves when the store has failed; [`Service::shutdown`] then gives the reason.
    ///
    /// # Cancellation safety
    /// May be dropped and called again.
    pub async fn failed(&self) {
        let mut failed = self.failed.clone();
        // A writer that is gone has failed too.
        let _ = failed.wait_for(|failed| *failed).await;
    }

    /// Resolves when another gateway serves the fleet, or shall: this one must end.
    ///
    /// # Cancellation safety
    /// May be dropped and called again.
    pub async fn resigned(&self) -> Resignation {
        let mut resigned = self.resigned.clone();
        let why = resigned.wait_for(Option::is_some).await.map(|why| *why);
        match why {
            Ok(Some(why)) => why,
            // Nobody watches any more: the service is ending.
            _ => std::future::pending().await,
        }
    }

    /// Resolves when the wall clock was set and no node has anything to do: the service should begin
    /// anew, see [`clock_watch`](crate::clock_watch).
    ///
    /// # Cancellation safety
    /// May be dropped and called again.
    pub async fn clock_was_set(&self) {
        let mut watch = ClockWatch::default();
        loop {
            tokio::time::sleep(Duration::from_micros(LOOK_EVERY_US)).await;
            let ahead_us = self.clock.wall_ahead_us();
            let at_rest = disagree(ahead_us)
                && self
                    .observer
                    .snapshot()
                    .await
                    .is_some_and(|fleet| fleet.is_at_rest());
            let ahead_s = ahead_us / 1_000_000;
            match watch.look(ahead_us, at_rest) {
                Advice::GoOn => {}
                Advice::Tell => tracing::warn!(
                    ahead_s,
                    "the clock of this machine was set: times in records and schedules are wrong by \
                     that until no node has anything to do"
                ),
                Advice::BeginAnew => {
                    tracing::warn!(ahead_s, "the clock of this machine was set: beginning anew");
                    return;
                }
            }
        }
    }

    /// Takes nothing more, carries out what was taken, and closes the network. Returns what is left.
    ///
    /// # Errors
    /// What made the store fail.
    pub async fn shutdown(self) -> Result<Remaining, ServiceError> {
        self.place.abort();
        self.bus.undeclare();
        self.stop_jobs.send_replace(true);
        let reader = self.reader.await;
        let forwarder = self.forwarder.await;
        self.stop_fleet.send_replace(true);
        let fleet = self.fleet.await;
        let writer = tokio::task::spawn_blocking(|| self.writer.join()).await;
        self.bus.close().await;
        match writer {
            Ok(Ok(result)) => result?,
            _ => return Err(ServiceError::Panicked("writer")),
        }
        for result in [reader, forwarder] {
            result.map_err(|_| ServiceError::Panicked("reader"))?;
        }
        fleet.map_err(|_| ServiceError::Panicked("fleet task"))
    }
}

/// Returns whose signatures count: those that the configuration names, and those of the secured
/// fleet; `None`: jobs need none.
fn signers(config: &GatewayConfig) -> Result<Option<Vec<[u8; 32]>>, BusError> {
    let mut signers = config.fleet.signers.clone();
    if let Some(folder) = &config.secure
        && let Some(of_home) = Home::open(folder)?.signing()?
    {
        let of_home = of_home.iter().map(|signer| signer.key.0);
        signers.get_or_insert_default().extend(of_home);
    }
    match signers.as_ref().map(Vec::len) {
        None => {}
        Some(0) => tracing::warn!(
            "nobody's signature counts, so no job is taken: `fleet keys DIR new NAME` makes a key, \
             `fleet keys DIR off` lets jobs without signature in again"
        ),
        Some(keys) => tracing::info!(keys, "only jobs that an operator has signed are taken"),
    }
    Ok(signers)
}

/// Asks the fleet what it is like.
#[derive(Clone, Debug)]
pub struct Observer {
    questions: mpsc::Sender<oneshot::Sender<Snapshot>>,
    failed: watch::Receiver<bool>,
}

impl Observer {
    /// Returns whether the service that it asked has ended.
    pub fn is_gone(&self) -> bool {
        self.questions.is_closed()
    }

    /// Returns what the fleet is like now; `None` if it does not answer within
    /// [`ANSWER_PATIENCE`] or the store has failed.
    ///
    /// # Cancellation safety
    /// May be dropped; the answer is lost.
    pub async fn snapshot(&self) -> Option<Snapshot> {
        if *self.failed.borrow() {
            return None;
        }
        let (answer, answered) = oneshot::channel();
        let ask = async {
            self.questions.send(answer).await.ok()?;
            answered.await.ok()
        };
        tokio::time::timeout(ANSWER_PATIENCE, ask).await.ok()?
    }
}

/// The effects of one handled event that go through the writer.
type EffectBatch = Vec<Effect>;

struct FleetTask {
    fleet: Fleet,
    clock: WallClock,
    bus: Arc<Bus>,
    batches: mpsc::Sender<EffectBatch>,
    store_failed: Arc<AtomicBool>,
    spans: JobSpans,
    keys: Keys,
}

impl FleetTask {
    async fn run(
        mut self,
        mut events: Intake,
        mut asked: mpsc::Receiver<oneshot::Sender<Snapshot>>,
        mut stopping: watch::Receiver<bool>,
    ) -> Remaining {
        loop {
            // First, so that a flood of events cannot keep time from passing.
            let due_in = self.due_in();
            if due_in == Some(Duration::ZERO) {
                self.handle(Event::Tick.into()).await;
                tokio::task::consume_budget().await;
            }
            let due = async {
                match self.due_in() {
                    Some(due_in) => tokio::time::sleep(due_in).await,
                    None => std::future::pending().await,
                }
            };
            let arrived = tokio::select! {
                biased;
                arrived = events.next() => arrived,
                _ = stopping.wait_for(|stop| *stop) => return Remaining::of(&self.fleet),
                Some(answer) = asked.recv() => {
                    // Whoever asked may have left.
                    let _ = answer.send(Snapshot::of(&self.fleet));
                    continue;
                }
                () = due => Event::Tick.into(),
            };
            self.handle(arrived).await;
        }
    }

    /// Returns how long nothing has to be done; zero: something is due.
    fn due_in(&self) -> Option<Duration> {
        let due = self.fleet.poll_timeout()?;
        Some(Duration::from_micros(due.since_us(self.clock.now())))
    }

    async fn handle(&mut self, arrived: Arrived) {
        if self.store_failed.load(Ordering::Acquire) {
            if let Some(reply) = reply_of(&arrived.event) {
                self.bus.refuse(reply, store_failed());
            }
            return;
        }
        let now: FleetMicros = arrived.at.unwrap_or_else(|| self.clock.now());
        let mut effects = Vec::new();
        self.fleet.handle(arrived.event, now, &mut effects);
        counter!(observe::EVENTS).increment(1);
        self.carry_out(effects).await;
    }

    /// Sends what overtakes everything and hands the rest to the writer.
    async fn carry_out(&mut self, mut effects: Vec<Effect>) {
        effects.retain_mut(|effect| match effect {
            Effect::Publish {
                key,
                payload,
                lane: Lane::Record,
                ..
            } => {
                self.spans.published(&self.keys, key, payload);
                true
            }
            Effect::Publish {
                key,
                payload,
                json,
                lane: lane @ Lane::RealTime,
            } => {
                let payload = std::mem::take(payload);
                self.bus.publish(key, payload, *json, *lane);
                false
            }
            _ => true,
        });
        if !effects.is_empty() && self.batches.send(effects).await.is_err() {
            tracing::error!("the writer is gone");
        }
    }
}

/// Returns who waits for an answer to this.
fn reply_of(event: &Event) -> Option<ReplyTo> {
    match event {
        Event::Submit { reply, .. }
        | Event::SubmitGroup { reply, .. }
        | Event::Cancel { reply, .. }
        | Event::Release { reply, .. }
        | Event::Pace { reply, .. } => *reply,
        Event::GetJobs { reply, .. }
        | Event::GetNodes { reply, .. }
        | Event::GetLinks { reply, .. }
        | Event::ManageNodes { reply, .. }
        | Event::Keep { reply, .. }
        | Event::ManageJob { reply, .. } => Some(*reply),
        Event::SubmitWith { submit, .. } => reply_of(submit),
        Event::Stop { .. } | Event::Alive { .. } | Event::FromNode { .. } | Event::Tick => None,
    }
}

struct Writer {
    journal: Journal,
    bus: Arc<Bus>,
    batches: mpsc::Receiver<EffectBatch>,
    store_failed: Arc<AtomicBool>,
    failed: watch::Sender<bool>,
}

impl Writer {
    /// Works until all who give effects are gone.
    fn run(mut self) -> Result<(), JournalError> {
        let mut first_error = None;
        let mut writes = Vec::new();
        let mut others = Vec::new();
        while let Some(mut batch) = self.batches.blocking_recv() {
            let mut batch_count = 1;
            loop {
                for effect in batch {
                    match effect {
                        Effect::Persist(write) => writes.push(write),
                        other => others.push(other),
                    }
                }
                if batch_count == BATCHES_PER_COMMIT_MAX {
                    break;
                }
                match self.batches.try_recv() {
                    Ok(next) => batch = next,
                    Err(_) => break,
                }
                batch_count += 1;
            }
            gauge!(observe::STORE_WAITING).set(self.batches.len() as f64);
            counter!(observe::STORE_WRITES).increment(writes.len() as u64);
            let begun = Instant::now();
            if first_error.is_none()
                && !writes.is_empty()
                && let Err(error) = self.journal.commit(&writes)
            {
                tracing::error!("the store failed: {error}");
                self.store_failed.store(true, Ordering::Release);
                self.failed.send_replace(true);
                first_error = Some(error);
            }
            if !writes.is_empty() {
                histogram!(observe::STORE_COMMIT).record(begun.elapsed());
            }
            writes.clear();
            for effect in others.drain(..) {
                self.carry_out(effect, first_error.is_some());
            }
        }
        first_error.map_or(Ok(()), Err)
    }

    /// Lets one effect out. After a failure of the store: none, and each get gets the refusal.
    fn carry_out(&self, effect: Effect, failed: bool) {
        match effect {
            Effect::Persist(_) => unreachable!("writes are set apart before"),
            Effect::Publish {
                key,
                payload,
                json,
                lane,
            } => {
                if !failed {
                    self.bus.publish(&key, payload, json, lane);
                }
            }
            Effect::Reply { to, .. } if failed => self.bus.refuse(to, store_failed()),
            Effect::Reply { to, key, payload } => self.bus.reply(to, key.as_deref(), payload),
            Effect::ReplyEnd { to } => self.bus.end(to),
        }
    }
}
