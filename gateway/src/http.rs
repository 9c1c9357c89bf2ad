//! `/metrics` for Prometheus and `/healthz` for whoever restarts what hangs: a small HTTP server,
//! meant for this machine or a network of operators. It says nothing secret and takes no orders.

use crate::{
    observe::{STORE_COMMIT, describe},
    service::Observer,
};
use axum::{
    Router, extract::State, http::StatusCode, http::header, response::IntoResponse, routing,
};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::net::SocketAddr;
use tokio::net::TcpListener;

/// Bounds of the durations of a commit, s: a fast disk, an ordinary one, one that is in trouble.
const COMMIT_BOUNDS_S: [f64; 8] = [0.0005, 0.001, 0.003, 0.01, 0.03, 0.1, 1.0, 5.0];

/// Why the server is not there.
#[derive(Debug, thiserror::Error)]
pub enum HttpError {
    /// The address is taken, or not of this machine.
    #[error("cannot listen on http {address}: {source}")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// Something else records metrics in this process.
    #[error("metrics: {0}")]
    Recorder(String),
}

/// Installs this process' recorder of metrics.
///
/// # Errors
/// There is one already.
pub fn install() -> Result<PrometheusHandle, HttpError> {
    let recorder = |error: String| HttpError::Recorder(error);
    let builder = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Full(STORE_COMMIT.to_owned()), &COMMIT_BOUNDS_S)
        .map_err(|error| recorder(error.to_string()))?;
    let handle = builder.install_recorder();
    let handle = handle.map_err(|error| recorder(error.to_string()))?;
    describe();
    Ok(handle)
}

/// Listens; with port 0 the system chooses one.
///
/// # Errors
/// The address cannot be had.
pub async fn listen(address: SocketAddr) -> Result<TcpListener, HttpError> {
    let listener = TcpListener::bind(address).await;
    listener.map_err(|source| HttpError::Listen { address, source })
}

/// Serves until dropped.
///
/// # Cancellation safety
/// May be dropped at any time; answers under way are cut off.
pub async fn serve(listener: TcpListener, observer: Observer, metrics: PrometheusHandle) {
    let app = Router::new()
        .route("/healthz", routing::get(health))
        .route("/metrics", routing::get(scrape))
        .with_state((observer, metrics));
    if let Err(error) = axum::serve(listener, app).await {
        tracing::error!("http: {error}");
    }
}

type Shared = State<(Observer, PrometheusHandle)>;

async fn health(State((observer, _)): Shared) -> impl IntoResponse {
    match observer.snapshot().await {
        Some(snapshot) => {
            let nodes = snapshot.nodes.len();
            (StatusCode::OK, format!("ok, {nodes} nodes known\n"))
        }
        None => {
            let words = "the fleet task does not answer, or the store has failed\n";
            (StatusCode::SERVICE_UNAVAILABLE, words.to_owned())
        }
    }
}

async fn scrape(State((observer, metrics)): Shared) -> impl IntoResponse {
    if let Some(snapshot) = observer.snapshot().await {
        snapshot.record();
    }
    metrics.run_upkeep();
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], metrics.render())
}
