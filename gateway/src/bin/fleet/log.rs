//! The log on standard error, and with the feature `otel` the spans of jobs to a collector.

use crate::link::Failure;
use gateway::collector::Collector;
#[cfg(feature = "otel")]
use gateway::otel::Exporter;
use std::io::IsTerminal;
use tracing_subscriber::{EnvFilter, Layer, layer::SubscriberExt, util::SubscriberInitExt};

/// What [`start`] began. Dropped without [`Log::end`] it loses the last spans.
#[must_use]
pub(crate) struct Log {
    #[cfg(feature = "otel")]
    exporter: Option<Exporter>,
}

/// Begins the log; `what` is logged unless `RUST_LOG` says otherwise.
pub(crate) fn start(what: &str, spans_to: Option<&Collector>) -> Result<Log, Failure> {
    let lines = tracing_subscriber::fmt::layer()
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    // The same variable for every command, so that a unit file sets it once.
    let lines = match std::env::var("FLEET_LOG").as_deref() {
        Ok("json") => lines.json().boxed(),
        _ => lines.boxed(),
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(what));
    let log = tracing_subscriber::registry().with(lines.with_filter(filter));
    #[cfg(feature = "otel")]
    let log = {
        let exporter = spans_to.map(Exporter::start).transpose();
        let exporter = exporter.map_err(|error| Failure::Usage(format!("--otlp: {error}")))?;
        log.with(exporter.as_ref().map(Exporter::layer)).init();
        Log { exporter }
    };
    #[cfg(not(feature = "otel"))]
    let log = {
        log.init();
        Log {}
    };
    if let Some(collector) = spans_to {
        tracing::info!(%collector, "spans of jobs are sent");
    }
    Ok(log)
}

impl Log {
    /// Ends what [`start`] began.
    pub(crate) fn end(self) {
        #[cfg(feature = "otel")]
        if let Some(Err(error)) = self.exporter.map(Exporter::end) {
            tracing::warn!("the last spans are lost: {error}");
        }
    }
}
