//! The address of a collector of OpenTelemetry, to which the spans of jobs go.
//!
//! The setting is the same in every build; one without the feature `otel` refuses it, so that nobody
//! waits for spans that no one sends.

use axum::http::Uri;
use std::{fmt, str::FromStr};

/// Where collectors take spans, below their address.
const PATH: &str = "/v1/traces";

/// See the module.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Collector {
    base: String,
}

impl Collector {
    /// Returns where spans are posted.
    pub fn url(&self) -> String {
        format!("{}{PATH}", self.base)
    }
}

impl FromStr for Collector {
    type Err = String;

    /// Reads `http://HOST:PORT`, behind which a path may stand. There is no TLS: a collector elsewhere
    /// than in a network of one's own is reached through one on this machine.
    fn from_str(text: &str) -> Result<Self, String> {
        if cfg!(not(feature = "otel")) {
            let words = "this build sends no spans: it lacks the feature `otel`";
            return Err(words.to_owned());
        }
        let uri: Option<Uri> = text.parse().ok();
        let uri = uri.filter(|uri| {
            let port = uri.port_u16().is_some_and(|port| port > 0);
            uri.scheme_str() == Some("http") && port && uri.query().is_none()
        });
        if uri.is_none() {
            let words =
                "an address of the form http://HOST:PORT is wanted, the collector's for OTLP";
            return Err(format!("{text:?}: {words}"));
        }
        let base = text.trim_end_matches('/');
        let base = base.strip_suffix(PATH).unwrap_or(base).to_owned();
        Ok(Self { base })
    }
}

impl fmt::Display for Collector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.base)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(feature = "otel")]
    #[test]
    fn an_address_may_be_that_of_the_collector_or_of_its_spans() {
        for (text, url) in [
            ("http://127.0.0.1:4318", "http://127.0.0.1:4318/v1/traces"),
            ("http://tempo.plant:80/", "http://tempo.plant:80/v1/traces"),
            ("http://[::1]:4318/v1/traces", "http://[::1]:4318/v1/traces"),
            ("http://a:1/otlp", "http://a:1/otlp/v1/traces"),
        ] {
            let collector: Collector = text.parse().expect(text);
            assert_eq!(collector.url(), url);
        }
        for text in [
            "",
            "127.0.0.1:4318",
            "https://a:4318",
            "http://a",
            "http://a:0",
            "http://a:70000",
            "http://a:1?x=1",
            "http://a b:1",
        ] {
            let error = text.parse::<Collector>().expect_err(text);
            assert!(error.contains("http://HOST:PORT"), "{text}: {error}");
        }
    }

    #[cfg(not(feature = "otel"))]
    #[test]
    fn a_build_without_the_feature_says_so() {
        let error = "http://127.0.0.1:4318".parse::<Collector>();
        assert!(error.expect_err("no feature").contains("`otel`"));
    }
}
