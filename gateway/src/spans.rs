//! One span of the log for each job, from its acceptance to its last pulse.
//!
//! The fleet is pure and logs nothing. What it has published of a job is read here on its way out: a
//! record that is new opens a span, each other state is an event in it, a final one closes it. A
//! collector of spans so sees how long each job took, and in which states.

use keys::{Keys, Topic, record::JobState};
use serde::Deserialize;
use std::collections::HashMap;
use tracing::{Span, field::Empty, info, info_span};

/// The target of all that is said here, for filters.
pub const TARGET: &str = module_path!();

/// Open spans at most; a job beyond them is logged without one.
const SPANS_MAX: usize = 100_000;

/// What is read of a record.
#[derive(Deserialize)]
struct Seen<'r> {
    job: &'r str,
    node: Option<&'r str>,
    group: Option<&'r str>,
    state: &'r str,
    error: Option<serde_json::Value>,
}

/// The spans of jobs that have not ended.
#[derive(Debug, Default)]
pub struct JobSpans {
    open: HashMap<String, (Span, String)>,
}

impl JobSpans {
    /// Reads what is published on this key, if it is a job's record.
    pub fn published(&mut self, keys: &Keys, key: &str, payload: &[u8]) {
        if !matches!(keys.parse(key), Some(Topic::Job { .. })) {
            return;
        }
        // Texts with escapes are not borrowed; names and states have none.
        let Ok(seen) = serde_json::from_slice::<Seen<'_>>(payload) else {
            return;
        };
        let known = self.open.get(seen.job).map(|(_, state)| state.as_str());
        if known == Some(seen.state) {
            return;
        }
        let is_final = seen.state.parse::<JobState>().is_ok_and(JobState::is_final);
        let span = match self.open.remove(seen.job) {
            Some((span, _)) => span,
            None => info_span!(
                "job",
                job = seen.job,
                node = seen.node,
                group = seen.group,
                otel.status_code = Empty,
                otel.status_description = Empty,
            ),
        };
        {
            let _inside = span.enter();
            match &seen.error {
                Some(error) => info!(state = seen.state, %error, "job"),
                None => info!(state = seen.state, "job"),
            }
        }
        if is_final {
            // What collectors colour, in OpenTelemetry's words. A cancel is neither good nor bad.
            match seen.state.parse() {
                Ok(JobState::Canceled) => {}
                Ok(JobState::Succeeded) => {
                    span.record("otel.status_code", "ok");
                }
                _ => {
                    let why = seen.error.as_ref().map_or(seen.state, |error| {
                        error["message"].as_str().unwrap_or(seen.state)
                    });
                    span.record("otel.status_code", "error");
                    span.record("otel.status_description", why);
                }
            }
        } else if self.open.len() < SPANS_MAX {
            let state = seen.state.to_owned();
            self.open.insert(seen.job.to_owned(), (span, state));
        }
    }

    /// Returns how many jobs have not ended.
    pub fn open_count(&self) -> usize {
        self.open.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{
        io::Write,
        sync::{Arc, Mutex},
    };

    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<u8>>>);

    impl Write for Log {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().expect("alone").write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_job_is_one_span_from_its_acceptance_to_its_end() {
        let log = Log::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt()
            .json()
            .with_span_events(tracing_subscriber::fmt::format::FmtSpan::CLOSE)
            .with_writer(move || writer.clone())
            .finish();
        let keys = Keys::default();
        let mut spans = JobSpans::default();
        tracing::subscriber::with_default(subscriber, || {
            let mut publish = |state: &str, error: &str| {
                let record = format!(
                    r#"{{"job":"a","node":"left","group":null,"state":"{state}","error":{error}}}"#
                );
                spans.published(&keys, "fleet/job/a", record.as_bytes());
                spans.open_count()
            };
            assert_eq!(publish("queued", "null"), 1);
            assert_eq!(publish("running", "null"), 1);
            assert_eq!(publish("running", "null"), 1, "progress is no news");
            assert_eq!(publish("failed", r#"{"code":"stopped","message":"m"}"#), 0);
            spans.published(&keys, "fleet/node/left/state", b"{}");
        });
        let bytes = log.0.lock().expect("alone").clone();
        let lines: Vec<serde_json::Value> = String::from_utf8(bytes)
            .expect("UTF-8")
            .lines()
            .map(|line| serde_json::from_str(line).expect("each line is JSON"))
            .collect();
        let states: Vec<&serde_json::Value> =
            lines.iter().map(|line| &line["fields"]["state"]).collect();
        assert_eq!(states[..3], ["queued", "running", "failed"]);
        assert_eq!(lines.len(), 4, "{lines:?}");
        assert!(
            lines
                .iter()
                .all(|line| line["span"]["job"] == "a" && line["span"]["node"] == "left")
        );
        assert_eq!(
            lines[3]["fields"]["message"], "close",
            "with the time that it took"
        );
    }
}
