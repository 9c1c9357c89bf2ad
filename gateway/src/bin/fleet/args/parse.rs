//! How what is typed is read: names, patterns, times.

use keys::{GroupId, JobId, NodeId, record::JobState};
use std::time::Duration;

pub(crate) fn prefix(text: &str) -> Result<keys::Keys, String> {
    keys::Keys::new(text).map_err(|error| error.to_string())
}

pub(crate) fn node_id(text: &str) -> Result<NodeId, String> {
    NodeId::new(text).map_err(|error| error.to_string())
}

pub(crate) fn group_id(text: &str) -> Result<GroupId, String> {
    GroupId::new(text).map_err(|error| error.to_string())
}

pub(crate) fn job_id(text: &str) -> Result<JobId, String> {
    JobId::new(text).map_err(|error| error.to_string())
}

pub(crate) fn setting(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("NAME=VALUE")?;
    if name.is_empty()
        || !name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    {
        return Err("a name consists of letters, digits and _".to_owned());
    }
    Ok((name.to_owned(), value.to_owned()))
}

pub(crate) fn instant(text: &str) -> Result<keys::FleetMicros, String> {
    keys::FleetMicros::from_rfc3339(text)
        .ok_or_else(|| "a time in UTC: 2026-11-22T03:00:00Z".into())
}

pub(crate) fn job_state() -> impl clap::builder::TypedValueParser<Value = JobState> {
    use clap::builder::TypedValueParser as _;
    let words = JobState::ALL.map(JobState::as_str);
    clap::builder::PossibleValuesParser::new(words)
        .map(|word| word.parse().expect("the words are those of the states"))
}

pub(crate) fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| format!("{text:?} is no number of seconds"))?;
    Duration::try_from_secs_f64(seconds)
        .ok()
        .filter(|duration| !duration.is_zero() && *duration <= Duration::from_secs(86_400))
        .ok_or_else(|| "more than 0 and at most 86400 seconds".to_owned())
}

/// A name, or one chunk of a key expression.
pub(crate) fn pattern(text: &str) -> Result<String, String> {
    let words = "a name of a-z, 0-9, _ and -, or a pattern of such with `*` alone or `$*`";
    let legal =
        |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_-$*".contains(&byte);
    if text.is_empty()
        || !text.bytes().all(legal)
        || zenoh::key_expr::keyexpr::new(text).is_err()
        || text == "**"
        || (!text.contains('*') && NodeId::new(text).is_err())
    {
        return Err(words.to_owned());
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_is_one_chunk_of_a_key() {
        for good in ["left", "*", "cell-$*", "$*-x", "part-0815"] {
            assert_eq!(pattern(good).as_deref(), Ok(good));
        }
        for bad in ["", "**", "a/b", "Left", "a*b", "$", "a?", "-x", "*$*"] {
            assert!(pattern(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn times_are_numbers_of_seconds_above_zero() {
        assert_eq!(seconds("0.5"), Ok(Duration::from_millis(500)));
        for bad in ["0", "-1", "x", "nan", "inf", "1e9"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
    }
}
