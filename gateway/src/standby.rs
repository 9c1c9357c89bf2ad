//! A gateway that waits until it is needed, and the store as it then takes it. The decisions are in
//! [`crate::fleet::owner`]; here is what it decides about: tokens, store, time.

use crate::{
    bus::{
        WallClock,
        owners::{Owners, Watcher},
    },
    config::GatewayConfig,
    fleet::{
        Stored,
        owner::{OwnerEvent, OwnerStep, Ownership, Resignation},
    },
    journal::{Journal, JournalError},
    service::ServiceError,
};
use std::time::Duration;
use tokio::sync::watch;

/// The store of a fleet, taken by its owner: nobody else has it, and its epoch is the newest.
#[derive(Debug)]
pub struct Taken {
    pub(crate) journal: Journal,
    pub(crate) stored: Stored,
    pub(crate) epoch: u32,
}

impl Taken {
    /// Opens the store and raises its epoch.
    ///
    /// # Errors
    /// See [`Journal::open`].
    pub(crate) async fn open(
        config: &GatewayConfig,
        clock: WallClock,
    ) -> Result<Self, ServiceError> {
        let store = config.store.clone();
        let open = move || -> Result<Self, JournalError> {
            let (mut journal, stored) = Journal::open(&store)?;
            let epoch = journal.claim(clock.now())?;
            Ok(Self {
                journal,
                stored,
                epoch,
            })
        };
        let opened = tokio::task::spawn_blocking(open).await;
        Ok(opened.map_err(|_| ServiceError::Panicked("journal"))??)
    }
}

/// Waits until no other gateway owns the fleet, and takes its store.
///
/// # Errors
/// There is no network, or the store cannot be used although nobody has it.
///
/// # Cancellation safety
/// May be dropped at any time; a store that was just taken is free again.
pub async fn stand_by(config: &GatewayConfig) -> Result<Taken, ServiceError> {
    let clock = WallClock::start(&config.wall);
    let (sender, mut owners) = watch::channel(Owners::new());
    let watcher = Watcher::open(config, sender).await?;
    let mut ownership = Ownership::standby();
    tracing::info!(store = %config.store.display(), "standing by");
    let taken = loop {
        let event = next(&mut owners, &ownership, clock).await;
        if ownership.handle(event, clock.now()) != OwnerStep::Take {
            continue;
        }
        match Taken::open(config, clock).await {
            Ok(taken) => break taken,
            Err(ServiceError::Store(JournalError::InUse { .. })) => {
                ownership.handle(OwnerEvent::InUse, clock.now());
            }
            Err(error) => {
                watcher.close().await;
                return Err(error);
            }
        }
    };
    watcher.close().await;
    tracing::warn!(
        epoch = taken.epoch,
        "no other gateway is there: taking the fleet over"
    );
    Ok(taken)
}

/// Watches an owner's place; resolves when it has lost it. Being cut off counts for one that has
/// somebody beside it.
pub(crate) async fn keep(
    epoch: u32,
    has_standby: bool,
    mut owners: watch::Receiver<Owners>,
    clock: WallClock,
) -> Resignation {
    let mut ownership = Ownership::standby();
    ownership.handle(OwnerEvent::Taken(epoch), clock.now());
    loop {
        let event = next(&mut owners, &ownership, clock).await;
        match ownership.handle(event, clock.now()) {
            OwnerStep::Resign(Resignation::CutOff) if !has_standby => {
                ownership.handle(OwnerEvent::Taken(epoch), clock.now());
            }
            OwnerStep::Resign(why) => return why,
            OwnerStep::Nothing | OwnerStep::Take => {}
        }
    }
}

async fn next(
    owners: &mut watch::Receiver<Owners>,
    ownership: &Ownership,
    clock: WallClock,
) -> OwnerEvent {
    let due = async {
        match ownership.poll_timeout() {
            Some(due) => {
                let due_us = due.since_us(clock.now());
                tokio::time::sleep(Duration::from_micros(due_us)).await;
            }
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        Ok(()) = owners.changed() => OwnerEvent::Tokens(owners.borrow_and_update().clone()),
        () = due => OwnerEvent::Tick,
    }
}
