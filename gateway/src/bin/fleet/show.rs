//! Records as a person reads them, and as a script does.

use comfy_table::{Attribute, Cell, Color, ContentArrangement, Table, presets};
use keys::{
    FleetMicros,
    record::{JobRecord, JobState, NodeRecord, NodeWord},
};
use std::io::{IsTerminal, Write};

/// Tables are fitted to terminals from this width on.
const NARROW_COLUMNS: u16 = 60;

/// Prints one line; a reader that has left ends the program's interest in printing.
pub(crate) fn line(text: &str) {
    // `fleet jobs | head` closes the pipe: no reason to panic.
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Prints JSON as it came, on one line.
pub(crate) fn json_line(payload: &[u8]) {
    line(&String::from_utf8_lossy(payload));
}

/// Returns an empty table with these heads.
pub(crate) fn table(heads: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(
        heads
            .iter()
            .map(|head| Cell::new(head.to_uppercase()).add_attribute(Attribute::Bold)),
    );
    if std::io::stdout().is_terminal() {
        // A terminal that does not tell its width is better left to wrap lines itself.
        if table
            .width()
            .is_some_and(|columns| columns >= NARROW_COLUMNS)
        {
            table.set_content_arrangement(ContentArrangement::Dynamic);
        }
    } else {
        table.force_no_tty();
    }
    table
}

/// Returns the table's text without margins.
pub(crate) fn text(mut table: Table) -> String {
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table.trim_fmt()
}

/// Prints a table.
pub(crate) fn print(table: Table) {
    line(&text(table));
}

/// Returns the table of nodes.
pub(crate) fn nodes_table<'r>(records: impl IntoIterator<Item = &'r NodeRecord>) -> Table {
    let mut table = table(&[
        "node", "state", "position", "queue", "job", "clock", "up", "firmware", "remarks",
    ]);
    for record in records {
        let queue = format!(
            "{}/{}",
            record.queue.depth,
            record.queue.depth + record.queue.free
        );
        let clock = record
            .clock
            .map_or(String::new(), |clock| format!("±{:.0} µs", clock.error_us));
        table.add_row(vec![
            Cell::new(record.node),
            Cell::new(record.state.as_str()).fg(node_color(record.state)),
            Cell::new(positions(&record.position)),
            Cell::new(queue),
            Cell::new(record.job.map_or(String::new(), |job| job.to_string())),
            Cell::new(clock),
            Cell::new(span(record.uptime_s)),
            Cell::new(&record.firmware),
            Cell::new(remarks(record)),
        ]);
    }
    table
}

fn remarks(record: &NodeRecord) -> String {
    let stopped = record.stopped.map(|stopped| {
        format!(
            "stopped ({}) {}",
            stopped.reason.as_str(),
            clock_time(stopped.at)
        )
    });
    let fault = record
        .faults
        .last()
        .map(|fault| format!("{} {}", fault.code, fault.message));
    let parts: Vec<String> = [stopped, fault].into_iter().flatten().collect();
    parts.join("; ")
}

/// Returns the table of jobs.
pub(crate) fn jobs_table<'r>(records: impl IntoIterator<Item = &'r JobRecord>) -> Table {
    let mut table = table(&["job", "node", "state", "done", "created", "result"]);
    for record in records {
        table.add_row(vec![
            Cell::new(record.job),
            Cell::new(whose(record)),
            Cell::new(record.state.as_str()).fg(job_color(record.state)),
            Cell::new(format!(
                "{}/{}",
                record.progress.done, record.progress.total
            )),
            Cell::new(clock_time(record.created)),
            Cell::new(outcome(record)),
        ]);
    }
    table
}

/// Prints records as comma-separated values.
pub(crate) fn csv(records: &[JobRecord]) {
    line("job,node,group,state,created,updated,done,total,error,position");
    for record in records {
        let error = record.error.as_ref().map(ToString::to_string);
        let result = record.result.as_ref();
        let position = result.map(|result| positions(&result.position));
        let fields = [
            record.job.to_string(),
            record.node.map(|node| node.to_string()).unwrap_or_default(),
            record
                .group
                .map(|group| group.to_string())
                .unwrap_or_default(),
            record.state.to_string(),
            record.created.to_string(),
            record.updated.to_string(),
            record.progress.done.to_string(),
            record.progress.total.to_string(),
            error.unwrap_or_default(),
            position.unwrap_or_default(),
        ];
        line(&fields.map(|field| csv_field(&field)).join(","));
    }
}

/// Quotes what a reader would take for more than one field (RFC 4180).
fn csv_field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}

fn whose(record: &JobRecord) -> String {
    match (record.node, record.group) {
        (Some(node), _) => node.to_string(),
        (None, Some(group)) => format!("group {group}"),
        (None, None) => String::new(),
    }
}

/// Returns why it ended early, or where it left the axes.
pub(crate) fn outcome(record: &JobRecord) -> String {
    match (&record.error, &record.result, &record.start) {
        (Some(error), _, _) => error.to_string(),
        (None, Some(result), _) => positions(&result.position),
        (None, None, Some(start)) => format!(
            "started {:.0} µs apart, ± {:.0}",
            start.skew_us, start.uncertainty_us
        ),
        (None, None, None) => String::new(),
    }
}

/// Returns `[2000, -50]`.
pub(crate) fn positions(steps: &[i64]) -> String {
    let texts: Vec<String> = steps.iter().map(i64::to_string).collect();
    format!("[{}]", texts.join(", "))
}

/// Returns the time of day; the date is in `--json`.
fn clock_time(at: FleetMicros) -> String {
    let text = at.to_string();
    text.get(11..19)
        .map_or_else(|| text.clone(), |time| format!("{time}Z"))
}

fn span(seconds: u64) -> String {
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3_600 => format!("{} min", seconds / 60),
        3_600..172_800 => format!("{} h", seconds / 3_600),
        _ => format!("{} d", seconds / 86_400),
    }
}

/// Returns the colour of a state of a job.
pub(crate) fn job_color(state: JobState) -> Color {
    match state {
        JobState::Succeeded => Color::Green,
        JobState::Failed | JobState::Rejected | JobState::Lost | JobState::TimedOut => Color::Red,
        JobState::Canceled => Color::Yellow,
        JobState::Running | JobState::Sent => Color::Cyan,
        JobState::Queued => Color::Reset,
    }
}

fn node_color(state: NodeWord) -> Color {
    match state {
        NodeWord::Running => Color::Cyan,
        NodeWord::Stopped | NodeWord::Fault => Color::Red,
        NodeWord::Offline => Color::DarkGrey,
        NodeWord::Ready | NodeWord::Paused => Color::Yellow,
        NodeWord::Idle => Color::Green,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_told_in_one_unit() {
        let texts = [0, 59, 60, 3_599, 3_600, 172_799, 172_800].map(span);
        assert_eq!(
            texts,
            ["0 s", "59 s", "1 min", "59 min", "1 h", "47 h", "2 d"]
        );
    }

    #[test]
    fn a_field_that_looks_like_several_is_quoted() {
        assert_eq!(csv_field("plain text"), "plain text");
        assert_eq!(csv_field("[1, 2]"), "\"[1, 2]\"");
        assert_eq!(csv_field("say \"no\"\n"), "\"say \"\"no\"\"\n\"");
    }

    #[test]
    fn positions_read_like_those_in_json() {
        assert_eq!(positions(&[]), "[]");
        assert_eq!(positions(&[2_000, -50]), "[2000, -50]");
    }
}
