//! A gateway that runs until somebody or something ends it, and begins anew when the wall clock was set.

use super::{Observer, Service, ServiceError};
use crate::{
    config::GatewayConfig,
    fleet::{Fleet, owner::Resignation},
    http,
    job::gcode::Machines,
    standby::Taken,
};
use keys::record::JobState;
use std::net::SocketAddr;
use tokio::sync::mpsc;

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
    pub(super) fn of(fleet: &Fleet) -> Self {
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
