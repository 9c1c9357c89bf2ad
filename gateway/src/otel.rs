//! Spans of jobs to a collector of OpenTelemetry, by OTLP over HTTP; the feature `otel`.
//!
//! ```text
//!  spans.rs ─ tracing ─▶ layer ─▶ queue of 2,048 ─▶ a thread of its own ─ POST /v1/traces ─▶ collector
//! ```
//!
//! Nothing here can hold the gateway up: a span that finds the queue full is dropped, a collector that
//! does not answer costs the sending thread [`ANSWER_MAX`], and what it does not take is gone, with a
//! line in the log. The end of the gateway waits [`FAREWELL_MAX`] for what is still to be sent.
//!
//! Sizes and pauses of the queue, and headers for the collector, are the variables that OpenTelemetry
//! itself defines (`OTEL_BSP_…`, `OTEL_EXPORTER_OTLP_HEADERS`); the address is not.

use crate::collector::Collector;
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
use opentelemetry_otlp::{Protocol, WithExportConfig as _, WithHttpConfig as _};
use opentelemetry_sdk::{Resource, trace::SdkTracerProvider};
use std::time::Duration;
use tracing::{Metadata, Subscriber};
use tracing_subscriber::{Layer, filter::filter_fn, registry::LookupSpan};
use ureq::Agent;

/// How long a collector may take for an answer: the default of OTLP.
pub const ANSWER_MAX: Duration = Duration::from_secs(10);

/// How long an ending gateway waits for the last spans.
pub const FAREWELL_MAX: Duration = Duration::from_secs(5);

/// Longest answer that is read, bytes: how many spans were refused, and why.
const ANSWER_BYTES_MAX: u64 = 64 << 10;

/// Sends spans until it is [ended](Exporter::end).
#[derive(Debug)]
pub struct Exporter {
    provider: SdkTracerProvider,
}

impl Exporter {
    /// Starts the thread that sends; connects to nobody yet.
    ///
    /// # Errors
    /// A variable of OpenTelemetry that is none.
    pub fn start(to: &Collector) -> Result<Self, String> {
        let config = Agent::config_builder()
            .timeout_global(Some(ANSWER_MAX))
            // The exporter reads the status itself.
            .http_status_as_error(false)
            .max_redirects(0)
            // The address is the collector's: nothing stands between.
            .proxy(None)
            .build();
        let exporter = opentelemetry_otlp::SpanExporter::builder()
            .with_http()
            .with_http_client(Client(Agent::new_with_config(config)))
            .with_endpoint(to.url())
            .with_protocol(Protocol::HttpBinary)
            .with_timeout(ANSWER_MAX)
            .build()
            .map_err(|error| error.to_string())?;
        let resource = Resource::builder().with_service_name("stepfleet");
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_resource(resource.build())
            .build();
        Ok(Self { provider })
    }

    /// Returns the layer of the log that takes the spans of jobs, and nothing else.
    pub fn layer<S>(&self) -> impl Layer<S> + Send + Sync + 'static
    where
        S: Subscriber + for<'s> LookupSpan<'s> + Send + Sync,
    {
        let tracer = self.provider.tracer("gateway");
        let of_jobs = |data: &Metadata<'_>| data.target() == crate::spans::TARGET;
        tracing_opentelemetry::layer()
            .with_tracer(tracer)
            .with_location(false)
            .with_target(false)
            .with_threads(false)
            .with_tracked_inactivity(false)
            .with_filter(filter_fn(of_jobs))
    }

    /// Sends what is left, and ends.
    ///
    /// # Errors
    /// The collector does not take it.
    pub fn end(self) -> Result<(), String> {
        let ended = self.provider.shutdown_with_timeout(FAREWELL_MAX);
        ended.map_err(|error| error.to_string())
    }
}

/// The HTTP client of the sending thread.
#[derive(Debug)]
struct Client(Agent);

#[async_trait::async_trait]
impl HttpClient for Client {
    /// Blocks: it runs on a thread that does nothing else.
    async fn send_bytes(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let answer = self.0.run(request.map(Vec::from))?;
        let (head, mut body) = answer.into_parts();
        let bytes = body.with_config().limit(ANSWER_BYTES_MAX).read_to_vec()?;
        Ok(Response::from_parts(head, bytes.into()))
    }
}
