//! The tokens of owners on the network: who declares one, and who watches them. See
//! [`crate::fleet::owner`].

use super::{
    sessions::{close, open_client},
    zenoh::{BusError, zenoh_error},
};
use crate::config::GatewayConfig;
use keys::Keys;
use std::collections::BTreeSet;
use tokio::sync::watch;
use zenoh::{
    Session,
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};

/// The epochs of the owners that are there.
pub type Owners = BTreeSet<u32>;

fn key_of(keys: &Keys, epoch: &str) -> String {
    format!("{}/gateway/{epoch}", keys.prefix())
}

/// Tells the network that this gateway is the owner, until the token is dropped.
pub(super) async fn declare(
    session: &Session,
    keys: &Keys,
    epoch: u32,
) -> Result<LivelinessToken, BusError> {
    let key = key_of(keys, &epoch.to_string());
    let token = session.liveliness().declare_token(key).await;
    token.map_err(zenoh_error)
}

/// Keeps `owners` as the network knows them, until the subscriber is dropped.
pub(super) async fn watch_owners(
    session: &Session,
    keys: &Keys,
    owners: watch::Sender<Owners>,
) -> Result<Subscriber<()>, BusError> {
    let note = move |sample: Sample| {
        let chunk = sample.key_expr().as_str().rsplit('/').next();
        let Some(epoch) = chunk.and_then(|chunk| chunk.parse().ok()) else {
            return;
        };
        owners.send_if_modified(|owners| match sample.kind() {
            SampleKind::Put => owners.insert(epoch),
            SampleKind::Delete => owners.remove(&epoch),
        });
    };
    session
        .liveliness()
        .declare_subscriber(key_of(keys, "*"))
        .history(true)
        .callback(note)
        .await
        .map_err(zenoh_error)
}

/// Sees who owns the fleet, and nothing else: the eyes of a gateway that stands by.
pub(crate) struct Watcher {
    session: Session,
    _subscriber: Subscriber<()>,
}

impl Watcher {
    /// Joins the network and keeps `owners` as it knows them.
    pub(crate) async fn open(
        config: &GatewayConfig,
        owners: watch::Sender<Owners>,
    ) -> Result<Self, BusError> {
        let session = open_client(&config.connect, config.credentials.as_ref()).await?;
        let subscriber = watch_owners(&session, &config.keys, owners).await?;
        Ok(Self {
            session,
            _subscriber: subscriber,
        })
    }

    pub(crate) async fn close(&self) {
        close(&self.session).await;
    }
}
