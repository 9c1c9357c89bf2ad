//! `fleet stop` and `fleet release`: say it, then listen to the nodes themselves.

use crate::{
    link::{Failure, Link, Samples, read},
    show,
};
use comfy_table::{Cell, Color};
use keys::{NodeId, NodeState, Status, Stop, StopMode, Topic, record::NodeRecord, version};
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// What a node confirmed, and how long after the request.
struct Confirmed {
    after: Duration,
    status: Status,
}

type Confirmations = BTreeMap<NodeId, Option<Confirmed>>;

/// `fleet stop`
pub(crate) async fn stop(
    link: &Link,
    pattern: &str,
    mode: StopMode,
    json: bool,
) -> Result<(), Failure> {
    let prefix = link.keys().prefix();
    let statuses = link
        .subscribe(&format!("{prefix}/node/{pattern}/status"))
        .await?;
    let asked = Instant::now();
    // First of all: whom to wait for can be found out afterwards.
    link.put_now(
        &format!("{prefix}/node/{pattern}/stop"),
        Stop { mode }.to_payload(),
    )
    .await?;
    let nodes = link.alive(pattern).await?;
    if nodes.is_empty() {
        let message = format!("the stop was sent, but no node that is there matches {pattern}");
        return Err(Failure::Failed(Some(message)));
    }
    let stopped = |status: &Status| matches!(status.state, NodeState::Stopped | NodeState::Fault);
    let confirmations = confirm(link, &statuses, &nodes, asked, stopped).await?;
    show_confirmations(link, &confirmations, "stopped", json)
}

/// `fleet release`
pub(crate) async fn release(link: &Link, pattern: &str, json: bool) -> Result<(), Failure> {
    let prefix = link.keys().prefix();
    let statuses = link
        .subscribe(&format!("{prefix}/node/{pattern}/status"))
        .await?;
    let asked = Instant::now();
    let answers = link
        .get(&format!("{prefix}/node/{pattern}/release"), None)
        .await?;
    if answers.is_empty() {
        return Err(Failure::Failed(Some(format!("no node matches {pattern}"))));
    }
    let mut refused = false;
    let mut nodes = Vec::new();
    for answer in answers {
        match answer {
            Ok(payload) => nodes.push(read::<NodeRecord>(&payload)?.node),
            Err(error) => {
                refused = true;
                eprintln!("fleet: refused: {error}");
            }
        }
    }
    if !nodes.is_empty() {
        let released = |status: &Status| status.state != NodeState::Stopped;
        let confirmations = confirm(link, &statuses, &nodes, asked, released).await?;
        show_confirmations(link, &confirmations, "released", json)?;
    }
    if refused {
        return Err(Failure::Failed(None));
    }
    Ok(())
}

/// Listens until each of the nodes has said what is wanted, or the time is over.
async fn confirm(
    link: &Link,
    statuses: &Samples,
    nodes: &[NodeId],
    asked: Instant,
    wanted: impl Fn(&Status) -> bool,
) -> Result<Confirmations, Failure> {
    let mut confirmations: Confirmations = nodes.iter().map(|node| (*node, None)).collect();
    let deadline = tokio::time::Instant::from_std(asked + link.timeout());
    while confirmations.values().any(Option::is_none) {
        let sample = tokio::select! {
            sample = statuses.recv_async() => sample?,
            () = tokio::time::sleep_until(deadline) => break,
        };
        let Some(Topic::Node { node, .. }) = link.keys().parse(sample.key_expr().as_str()) else {
            continue;
        };
        let Ok(status) = version::decode::<Status>(&sample.payload().to_bytes()) else {
            continue;
        };
        if let Ok(node) = NodeId::new(node)
            && let Some(open @ None) = confirmations.get_mut(&node)
            && wanted(&status)
        {
            let after = asked.elapsed();
            *open = Some(Confirmed { after, status });
        }
    }
    Ok(confirmations)
}

fn show_confirmations(
    link: &Link,
    confirmations: &Confirmations,
    word: &str,
    json: bool,
) -> Result<(), Failure> {
    let mut table = show::table(&["node", "state", "after", "position"]);
    let mut silent = Vec::new();
    for (node, confirmed) in confirmations {
        let after_ms = confirmed
            .as_ref()
            .map(|confirmed| confirmed.after.as_secs_f64() * 1e3);
        let position: Option<Vec<i64>> = confirmed.as_ref().map(|confirmed| {
            let axes = confirmed.status.axes.iter();
            axes.map(|axis| axis.position_steps).collect()
        });
        if json {
            let object = serde_json::json!({
                "node": node, word: confirmed.is_some(),
                "after_ms": after_ms, "position": position,
            });
            show::line(&object.to_string());
        }
        match (after_ms, position) {
            (Some(after_ms), Some(position)) => table.add_row(vec![
                Cell::new(node),
                Cell::new(word).fg(Color::Green),
                Cell::new(format!("{after_ms:.1} ms")),
                Cell::new(show::positions(&position)),
            ]),
            _ => {
                silent.push(node.as_str());
                table.add_row(vec![
                    Cell::new(node),
                    Cell::new("NOT CONFIRMED").fg(Color::Red),
                ])
            }
        };
    }
    if !json {
        show::print(table);
    }
    if silent.is_empty() {
        return Ok(());
    }
    Err(Failure::TimedOut(format!(
        "{} of {} nodes did not confirm within {} s: {}",
        silent.len(),
        confirmations.len(),
        link.timeout().as_secs_f64(),
        silent.join(", ")
    )))
}
