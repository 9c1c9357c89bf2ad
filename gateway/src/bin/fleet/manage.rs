//! `fleet label`, `fleet maintenance`, `fleet queue`, `fleet move`: how nodes and their queues are arranged.

use crate::{
    args::{Label, Maintenance, Move, Queue, QueueWish},
    link::{Failure, Link, read},
    show,
    submit::{accepted, verdict},
};
use keys::{GroupId, JobId, NodeId};
use serde::Deserialize;
use serde_json::{Value, json};
use zenoh::bytes::Encoding;

/// Fields of a synchronized job beside its parts.
const OF_WHOLE: [&str; 5] = [
    "id",
    "max_skew_us",
    "ready_timeout_ms",
    "offline",
    "timeout_s",
];

/// What the gateway answers.
#[derive(Deserialize)]
struct Arrangement {
    node: NodeId,
    labels: Vec<GroupId>,
    maintenance: Option<String>,
    #[serde(default)]
    queue_held: bool,
    waiting: Vec<JobId>,
}

/// What it answers about the order of jobs.
#[derive(Deserialize)]
struct Order {
    waiting: Option<Vec<JobId>>,
}

/// `fleet label`
pub(crate) async fn label(link: &Link, line: &Label, json: bool) -> Result<(), Failure> {
    let wishes = json!({ "label": line.labels, "unlabel": line.remove });
    ask(link, &format!("node/{}", line.node), &wishes, json).await
}

/// `fleet maintenance`
pub(crate) async fn maintenance(
    link: &Link,
    line: &Maintenance,
    json: bool,
) -> Result<(), Failure> {
    let wish = match &line.reason {
        Some(reason) => json!({ "reason": reason }),
        None => json!(false),
    };
    let wishes = json!({ "maintenance": wish });
    ask(link, &format!("node/{}", line.node), &wishes, json).await
}

/// `fleet queue`
pub(crate) async fn queue(link: &Link, line: &Queue, json: bool) -> Result<(), Failure> {
    let wishes = json!({ "hold_queue": line.wish == QueueWish::Hold });
    ask(link, &format!("node/{}", line.node), &wishes, json).await
}

/// `fleet move`
pub(crate) async fn reorder(link: &Link, line: &Move, json: bool) -> Result<(), Failure> {
    let wishes = match (line.before, line.priority) {
        (Some(before), _) => json!({ "before": before }),
        (None, priority) => json!({ "priority": priority }),
    };
    let key = format!("{}/manage/job/{}", link.keys().prefix(), line.job);
    let payload = (wishes.to_string().into_bytes(), Encoding::APPLICATION_JSON);
    let (payloads, refused) = accepted(link.get(&key, Some(payload)).await?);
    for payload in &payloads {
        if json {
            show::json_line(payload);
            continue;
        }
        let order: Order = read(payload)?;
        let names = order.waiting.unwrap_or_default();
        let names: Vec<&str> = names.iter().map(JobId::as_str).collect();
        show::line(&format!("waiting: {}", names.join(" ")));
    }
    verdict(refused)
}

async fn ask(link: &Link, key: &str, wishes: &Value, json: bool) -> Result<(), Failure> {
    let key = format!("{}/manage/{key}", link.keys().prefix());
    let payload = (wishes.to_string().into_bytes(), Encoding::APPLICATION_JSON);
    let (payloads, refused) = accepted(link.get(&key, Some(payload)).await?);
    if json {
        payloads.iter().for_each(|payload| show::json_line(payload));
        return verdict(refused);
    }
    if payloads.is_empty() && !refused {
        return Err(Failure::Failed(Some("no node matches".to_owned())));
    }
    let mut table = show::table(&["node", "labels", "maintenance", "queue", "waiting"]);
    let mut rows: Vec<Arrangement> = payloads
        .iter()
        .map(|payload| read(payload))
        .collect::<Result<_, _>>()?;
    rows.sort_by_key(|row| row.node);
    for row in &rows {
        let words = |names: Vec<&str>| names.join(" ");
        table.add_row(vec![
            row.node.to_string(),
            words(row.labels.iter().map(GroupId::as_str).collect()),
            row.maintenance.clone().unwrap_or_default(),
            if row.queue_held { "held" } else { "open" }.to_owned(),
            words(row.waiting.iter().map(JobId::as_str).collect()),
        ]);
    }
    if !rows.is_empty() {
        show::print(table);
    }
    verdict(refused)
}

/// Makes a synchronized job: the same part for each node that has the label.
pub(crate) async fn together(
    link: &Link,
    label: Option<GroupId>,
    name: &str,
    payload: &[u8],
    encoding: &Encoding,
) -> Result<Vec<u8>, Failure> {
    let Some(label) = label else {
        return Err(Failure::Usage("--together needs --label".to_owned()));
    };
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(format!("{name}: {error}"));
    // What is of the whole job and not of its parts.
    let mut whole = serde_json::Map::new();
    let part = match encoding.to_string().as_str() {
        "text/x-lua" | "zenoh/bytes;text/x-lua" => {
            let script = std::str::from_utf8(payload).map_err(|error| usage(&error))?;
            json!({ "lua": script })
        }
        "application/json" => {
            let mut job: serde_json::Map<String, Value> =
                serde_json::from_slice(payload).map_err(|error| usage(&error))?;
            for name in OF_WHOLE {
                if let Some(value) = job.remove(name) {
                    whole.insert(name.to_owned(), value);
                }
            }
            Value::from(job)
        }
        _ => {
            let words =
                "G-code is for one node: `fleet check --commands` makes a job in JSON of it";
            return Err(usage(&words));
        }
    };
    let key = format!("{}/manage/node/*", link.keys().prefix());
    let (answers, refused) = accepted(link.get(&key, None).await?);
    verdict(refused)?;
    let mut nodes = serde_json::Map::new();
    for answer in &answers {
        let row: Arrangement = read(answer)?;
        if row.labels.contains(&label) {
            nodes.insert(row.node.to_string(), part.clone());
        }
    }
    if nodes.is_empty() {
        return Err(Failure::Failed(Some(format!(
            "no node has the label `{label}`"
        ))));
    }
    whole.insert("nodes".to_owned(), nodes.into());
    Ok(Value::from(whole).to_string().into_bytes())
}
