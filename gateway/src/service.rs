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

mod observer;
mod run;
mod task;
mod writer;

pub use observer::{ANSWER_PATIENCE, Observer};
pub use run::{Ready, Remaining, run};

use crate::{
    bus::{
        Inbox, Outlets, WallClock,
        owners::Owners,
        zenoh::{Bus, BusError},
    },
    clock_watch::{Advice, ClockWatch, Wall, disagree},
    config::GatewayConfig,
    fleet::{Fleet, FleetConfig, RestoreError, owner::Resignation},
    http::HttpError,
    job::gcode::Machines,
    journal::JournalError,
    reading::{READERS_MAX, forward_jobs, read_jobs},
    security::Home,
    spans::JobSpans,
    standby::{self, Taken},
};
use observer::QUESTIONS_MAX;
use std::{
    hash::{BuildHasher, RandomState},
    sync::{Arc, atomic::AtomicBool},
};
use task::FleetTask;
use thiserror::Error;
use tokio::{
    sync::{mpsc, watch},
    task::JoinHandle,
};
use writer::Writer;

/// Handled events whose effects wait for the writer.
pub const EFFECT_BATCHES_MAX: usize = 256;

/// Handled events whose writes are committed together.
pub const BATCHES_PER_COMMIT_MAX: usize = 100;

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
    wall: Wall,
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
        let clock = WallClock::start(&config.wall);
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
            wall: config.wall.clone(),
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
            tokio::time::sleep(self.wall.look_every()).await;
            let ahead_us = self.clock.wall_ahead_us(&self.wall);
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
