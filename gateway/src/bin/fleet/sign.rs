//! `fleet submit --sign`: the operator's signature over exactly what the node will execute.

use crate::link::{Failure, Link, read};
use gateway::{
    fleet::{commands_of, parts_of},
    security::{
        home::read_secret,
        signing::{Signer, root_of, statement},
    },
};
use keys::{
    JobId, NodeId, NodeTopic, Status,
    job::{GroupRequest, JobRequest, Work},
    record::JobError,
    version,
};
use serde_json::{Map, Value};
use std::{
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

/// Signs a job, JSON, for a node as it runs now. One without a name gets one.
pub(crate) async fn sign(
    link: &Link,
    key: &Path,
    node: &str,
    payload: &[u8],
) -> Result<Vec<u8>, Failure> {
    let node =
        NodeId::new(node).map_err(|_| usage("a job is signed for one node, not for a pattern"))?;
    let (signer, number) = open(key)?;
    let mut job: Map<String, Value> = read(payload)?;
    let id = name(&mut job, number)?;
    let bytes = serde_json::to_vec(&job).expect("it was read as JSON");
    let request = JobRequest::from_json(&bytes).map_err(failed)?;
    let commands = commands_of(&request);
    let script = match &request.work {
        Work::Lua(script) => Some(script.as_str()),
        Work::Commands(_) => None,
    };
    let root = root_of(&commands, script).map_err(failed)?;
    let boot = boot_of(link, &node).await?;
    let signature = signer.sign(&statement(&node, &id, boot, number, root));
    let signature = serde_json::to_value(signature).expect("texts and numbers are JSON");
    job.insert("signature".to_owned(), signature);
    Ok(serde_json::to_vec(&job).expect("it was read as JSON"))
}

/// Signs each part of a synchronized job, JSON, for its node as it runs now. A job without a name gets
/// one.
pub(crate) async fn sign_parts(
    link: &Link,
    key: &Path,
    payload: &[u8],
) -> Result<Vec<u8>, Failure> {
    let (signer, number) = open(key)?;
    let mut job: Map<String, Value> = read(payload)?;
    let id = name(&mut job, number)?;
    let bytes = serde_json::to_vec(&job).expect("it was read as JSON");
    let request = GroupRequest::from_json(&bytes).map_err(failed)?;
    for (node, commands) in parts_of(&request) {
        let script = match &request.nodes[&node] {
            Work::Lua(script) => Some(script.as_str()),
            Work::Commands(_) => None,
        };
        let root = root_of(&commands, script).map_err(failed)?;
        let boot = boot_of(link, &node).await?;
        let signature = signer.sign(&statement(&node, &id, boot, number, root));
        let signature = serde_json::to_value(signature).expect("texts and numbers are JSON");
        let parts = job.get_mut("nodes").and_then(Value::as_object_mut);
        let part = parts.and_then(|parts| parts.get_mut(node.as_str()));
        if let Some(part) = part.and_then(Value::as_object_mut) {
            part.insert("signature".to_owned(), signature);
        }
    }
    Ok(serde_json::to_vec(&job).expect("it was read as JSON"))
}

fn usage(error: impl std::fmt::Display) -> Failure {
    Failure::Usage(format!("--sign: {error}"))
}

fn failed(error: JobError) -> Failure {
    Failure::Failed(Some(error.to_string()))
}

/// Returns the key, and a number that it has not used.
fn open(key: &Path) -> Result<(Signer, u64), Failure> {
    let text = read_secret(key).map_err(usage)?;
    let name = key.display();
    let signer = Signer::parse(&text).map_err(|error| usage(format!("{name}: {error}")))?;
    Ok((signer, next_number(key)?))
}

/// Returns the job's name, which it gets if it has none.
fn name(job: &mut Map<String, Value>, number: u64) -> Result<JobId, Failure> {
    let made = format!("signed-{number}");
    let id = job.entry("id").or_insert(Value::from(made));
    let id = id.as_str().and_then(|id| JobId::new(id).ok());
    id.ok_or_else(|| Failure::Failed(Some("id: it is no name of a job".to_owned())))
}

/// Returns the number of the boot that the node's own status tells.
pub(crate) async fn boot_of(link: &Link, node: &NodeId) -> Result<u32, Failure> {
    let key = link.keys().node(node, NodeTopic::Status);
    let statuses = link.subscribe(key.as_str()).await?;
    let first = tokio::time::timeout(link.timeout(), statuses.recv_async()).await;
    let silent = || {
        Failure::TimedOut(format!(
            "node {node} says nothing; a job is signed for a node that is there"
        ))
    };
    let sample = first.map_err(|_| silent())?.map_err(|_| silent())?;
    let status: Status = version::decode(&sample.payload().to_bytes())
        .map_err(|error| Failure::Failed(Some(format!("the status of node {node}: {error}"))))?;
    Ok(status.queue.boot)
}

/// Returns a number that this key has not used: UTC in microseconds, and more than the last one even
/// if the clock went back.
pub(crate) fn next_number(key: &Path) -> Result<u64, Failure> {
    let mut path = key.as_os_str().to_owned();
    path.push(".number");
    let path = PathBuf::from(path);
    let last: u64 = match std::fs::read_to_string(&path) {
        Ok(text) => text
            .trim()
            .parse()
            .map_err(|_| Failure::Usage(format!("--sign: {}: no number", path.display())))?,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => 0,
        Err(error) => return Err(error.into()),
    };
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let number = (now.as_micros() as u64).max(last + 1);
    std::fs::write(&path, format!("{number}\n"))?;
    Ok(number)
}
