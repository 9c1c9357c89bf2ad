//! `fleet trace`: the way of one job, by what the gateway has kept of it, what its nodes have told of it,
//! and what is in its record.

use crate::{
    link::{Failure, Link, read},
    show,
    submit::accepted,
};
use keys::{FleetMicros, JobId, NodeId, record::JobRecord};
use serde::Deserialize;

/// What the gateway answers.
#[derive(Deserialize)]
struct Story {
    priority: i16,
    not_before: Option<String>,
    waiting: Option<Vec<JobId>>,
    steps: Vec<(String, String)>,
    /// A gateway of before says nothing of it.
    #[serde(default)]
    told: Vec<Told>,
}

/// What a node has told of it.
#[derive(Deserialize)]
struct Told {
    at: String,
    error_us: Option<f64>,
    node: NodeId,
    event: String,
    missed: u32,
}

/// One line: when, how far that may be wrong, who says it, what.
struct Row {
    at: String,
    error: String,
    who: String,
    event: String,
}

/// `fleet trace`
pub(crate) async fn trace(link: &Link, job: &JobId, json: bool) -> Result<(), Failure> {
    let key = format!("{}/manage/job/{job}", link.keys().prefix());
    let (payloads, refused) = accepted(link.get(&key, None).await?);
    let (Some(payload), false) = (payloads.first(), refused) else {
        return Err(Failure::Failed(None));
    };
    if json {
        show::json_line(payload);
        return Ok(());
    }
    let story: Story = read(payload)?;
    let (records, _) = accepted(link.get(link.keys().job(job).as_str(), None).await?);
    let record: Option<JobRecord> = match records.first() {
        Some(record) => Some(read(record)?),
        None => None,
    };
    let mut rows = Vec::new();
    let first = story
        .steps
        .first()
        .and_then(|(at, _)| FleetMicros::from_rfc3339(at));
    for (at, state) in &story.steps {
        let event = match (state.as_str(), &record) {
            ("queued", Some(record)) => match record.node {
                Some(node) => format!("queued for {node}"),
                None => "queued".to_owned(),
            },
            ("sent", _) => "sent: its first commands left the gateway".to_owned(),
            ("running", _) => "running: the node executes it".to_owned(),
            ("lost", _) => "lost: the node went away".to_owned(),
            (state, Some(record)) if state == record.state.as_str() => {
                format!("{state} {}", show::outcome(record))
                    .trim_end()
                    .to_owned()
            }
            (state, _) => state.to_owned(),
        };
        rows.push(Row {
            at: at.clone(),
            error: String::new(),
            who: "gateway".to_owned(),
            event,
        });
    }
    rows.extend(story.told.iter().map(of_node));
    // All times are of one form, so that their text sorts as they do.
    rows.sort_by(|a, b| a.at.cmp(&b.at));
    let mut table = show::table(&["time", "±", "after", "by", "event"]);
    for row in rows {
        let at = FleetMicros::from_rfc3339(&row.at).zip(first);
        let after = at.map(|(at, first)| match first.since_us(at) {
            0 => format!("+{}", span(at.since_us(first))),
            before => format!("-{}", span(before)),
        });
        table.add_row(vec![
            row.at,
            row.error,
            after.unwrap_or_default(),
            row.who,
            row.event,
        ]);
    }
    show::print(table);
    if let Some(waiting) = &story.waiting {
        let ahead = waiting.iter().take_while(|other| *other != job).count();
        show::line(&format!(
            "{ahead} before it; priority {}",
            priority(story.priority)
        ));
    }
    if let Some(at) = &story.not_before {
        show::line(&format!("not before {at}"));
    }
    if let Some(record) = record.filter(|record| !record.state.is_final()) {
        let progress = record.progress;
        show::line(&format!("{} of {} commands", progress.done, progress.total));
    }
    Ok(())
}

fn priority(priority: i16) -> String {
    if priority == i16::MIN {
        return "behind all others (when idle)".to_owned();
    }
    priority.to_string()
}

fn of_node(told: &Told) -> Row {
    let error = match told.error_us {
        Some(error_us) => span(error_us.ceil() as u64),
        None => "?".to_owned(),
    };
    let missed = match told.missed {
        0 => String::new(),
        1 => " (one event before it was not heard)".to_owned(),
        missed => format!(" ({missed} events before it were not heard)"),
    };
    Row {
        at: told.at.clone(),
        error,
        who: told.node.to_string(),
        event: format!("{}{missed}", told.event),
    }
}

/// A span with as many digits as matter.
fn span(us: u64) -> String {
    match us {
        0..1_000 => format!("{us} µs"),
        1_000..1_000_000 => format!("{:.3} ms", us as f64 / 1e3),
        1_000_000..60_000_000 => format!("{:.3} s", us as f64 / 1e6),
        _ => format!("{}:{:02} min", us / 60_000_000, us / 1_000_000 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_have_the_digits_that_matter() {
        let texts = [0, 999, 1_500, 2_000_500, 61_000_000].map(span);
        assert_eq!(texts, ["0 µs", "999 µs", "1.500 ms", "2.001 s", "1:01 min"]);
    }
}
