//! Job records as files: CSV for a spreadsheet (RFC 4180), JSON as the gateway tells them.

use keys::record::JobRecord;

/// The columns of the CSV.
const COLUMNS: [&str; 12] = [
    "job", "node", "group", "state", "version", "created", "updated", "done", "total", "position",
    "skew_us", "error",
];

/// Returns one line for each record, after a line of names. Lines end in CR LF.
pub fn csv(records: &[&JobRecord]) -> String {
    let mut text = line(&COLUMNS.map(str::to_owned));
    for record in records {
        let positions = record.result.as_ref().map(|result| {
            let steps: Vec<String> = result.position.iter().map(i64::to_string).collect();
            steps.join(" ")
        });
        let skew = record.start.as_ref().map(|start| start.skew_us.to_string());
        text += &line(&[
            record.job.to_string(),
            record.node.map_or(String::new(), |node| node.to_string()),
            record
                .group
                .map_or(String::new(), |group| group.to_string()),
            record.state.to_string(),
            record.version.to_string(),
            record.created.to_string(),
            record.updated.to_string(),
            record.progress.done.to_string(),
            record.progress.total.to_string(),
            positions.unwrap_or_default(),
            skew.unwrap_or_default(),
            record
                .error
                .as_ref()
                .map_or(String::new(), ToString::to_string),
        ]);
    }
    text
}

fn line(fields: &[String; 12]) -> String {
    let fields: Vec<String> = fields.iter().map(|text| field(text)).collect();
    fields.join(",") + "\r\n"
}

fn field(text: &str) -> String {
    // A spreadsheet would take such a text for a formula.
    let formula = text.starts_with(['=', '+', '@']);
    let text = if formula {
        format!("'{text}")
    } else {
        text.to_owned()
    };
    if text.contains(['"', ',', '\r', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text
    }
}

/// Returns the records as a JSON list.
pub fn json(records: &[&JobRecord]) -> String {
    serde_json::to_string_pretty(records).expect("records hold nothing that JSON cannot")
}
