//! `fleet demo`: a gateway and six emulated nodes in this process, over real TCP.
//!
//! Plays another example job on each node, one of them a Lua script, handed in by an ordinary client, and then one job on all
//! of them that starts at one instant. Holds four things against each other: where the commands of
//! the file lead, where the gateway's record says the axes are, what the emulated pulse counters
//! counted at the pins, and the oracle's judgement of every edge.

use crate::{
    args::Common,
    follow::Follower,
    link::{Failure, Link, read},
    show,
};
use anyhow::{Context, Result, anyhow};
use comfy_table::{Cell, Color};
use emulator::{EmulatedHandle, EmulatorConfig, Recording, oracle};
use gateway::{config::GatewayConfig, service::Service};
use keys::{
    Command, Keys, NodeId, NodeTopic,
    job::{JobRequest, Work},
    record::{JobRecord, JobState, NodeRecord, Receipt},
};
use std::{
    io::IsTerminal,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use zenoh::bytes::Encoding;

/// Node, name of its job, and the job.
const PLAYS: [(&str, &str, &str); 6] = [
    (
        "left",
        "squares",
        include_str!("../../../examples/jobs/squares.json"),
    ),
    (
        "middle",
        "stair",
        include_str!("../../../examples/jobs/stair.json"),
    ),
    (
        "right",
        "ripples",
        include_str!("../../../examples/jobs/ripples.json"),
    ),
    (
        "front",
        "ramp",
        include_str!("../../../examples/jobs/ramp.json"),
    ),
    (
        "back",
        "path",
        include_str!("../../../examples/jobs/path.json"),
    ),
    (
        "top",
        "spiral",
        include_str!("../../../examples/jobs/spiral.json"),
    ),
];

/// The job that starts on all nodes at one instant; each axis ends where it began.
const TOGETHER: &str = r#"[{"move": {"axis": 0, "delay_us": 500, "steps": 600}},
    {"move": {"axis": 0, "delay_us": 500, "steps": -600}}]"#;

/// Its name.
const TOGETHER_NAME: &str = "together";

/// Far more than the jobs take, 5 s.
const PLAY_WITHIN: Duration = Duration::from_secs(60);

/// Changes of pins that are kept of each node: more than the jobs make.
const RECORDED_MAX: usize = 1_000_000;

/// A directory of this run, removed with its store at the end.
struct Workshop(PathBuf);

impl Workshop {
    fn make() -> Result<Self> {
        use std::hash::{BuildHasher, RandomState};
        let name = format!(
            "fleet-demo-{}-{:08x}",
            std::process::id(),
            RandomState::new().hash_one(0) as u32
        );
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir(&path).with_context(|| path.display().to_string())?;
        Ok(Self(path))
    }

    fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        // What cannot be removed is left to the system's own cleaning of temporary files.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What is known of one play at the end.
struct Played {
    node: NodeId,
    record: JobRecord,
    expected: Vec<i64>,
    counted: Vec<i64>,
    /// Pulses that the oracle found right, or what it found wrong.
    judgement: Result<u64, Vec<String>>,
}

impl Played {
    fn reported(&self) -> Vec<i64> {
        self.record
            .result
            .as_ref()
            .map_or_else(Vec::new, |result| result.position.clone())
    }

    /// Whether commands, node and pins agree about where it is.
    fn agrees(&self) -> bool {
        self.reported() == self.expected && self.counted == self.expected
    }

    fn positions(&self) -> String {
        let [expected, reported, counted] =
            [&self.expected, &self.reported(), &self.counted].map(|list| show::positions(list));
        if self.agrees() {
            expected
        } else {
            format!("expected {expected}, reported {reported}, counted {counted}")
        }
    }

    fn good(&self) -> bool {
        self.record.state == JobState::Succeeded && self.agrees() && self.judgement.is_ok()
    }
}

/// `fleet demo`
pub(crate) async fn demo(common: &Common) -> Result<(), Failure> {
    if common.connect.is_some() {
        let message =
            "demo brings its own gateway and nodes: --connect or FLEET_CONNECT has no meaning here";
        return Err(Failure::Usage(message.to_owned()));
    }
    let began = Instant::now();
    let workshop = Workshop::make()?;
    let config = GatewayConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        keys: common.keys(),
        ..GatewayConfig::new(workshop.path().join("fleet.redb"))
    };
    let service = Service::start(config).await.map_err(anyhow::Error::from)?;
    let locator = service.locators()[0].clone();
    let talk = !common.json;
    if talk {
        show::line(&format!(
            "gateway on {locator}, store in {}",
            workshop.path().display()
        ));
    }
    let played = play(common, &locator, talk).await;
    let ended = service.shutdown().await;
    let (played, together) = played?;
    ended.map_err(anyhow::Error::from)?;

    let started = together.start.as_deref();
    let good = played.iter().all(Played::good)
        && together.state == JobState::Succeeded
        && started.is_some();
    if common.json {
        for one in &played {
            show::line(&json_of(one).to_string());
        }
        let line = serde_json::json!({
            "job": together.job, "state": together.state, "start": together.start,
            "error": together.error,
        });
        show::line(&line.to_string());
    } else {
        show::print(table_of(&played));
        for one in &played {
            if let Err(violations) = &one.judgement {
                for violation in violations {
                    show::line(&format!("{}: {violation}", one.node));
                }
            }
        }
        show::line(&match started {
            Some(start) => format!(
                "Started together: first edges {:.0} µs apart, as the nodes measured it, ± {:.0} µs.",
                start.skew_us, start.uncertainty_us
            ),
            None => format!("NOT started together: {:?}", together.error),
        });
        let words = if good {
            "Every pulse is where the commands say, by oracle, ledgers and counters."
        } else {
            "NOT every pulse is where the commands say."
        };
        show::line(&format!("{words} {:.1} s", began.elapsed().as_secs_f64()));
    }
    if good {
        Ok(())
    } else {
        Err(Failure::Failed(None))
    }
}

/// Boots the nodes, plays the jobs, and judges what the pins did.
async fn play(
    common: &Common,
    locator: &str,
    talk: bool,
) -> Result<(Vec<Played>, JobRecord), Failure> {
    let link = Link::connect(locator, common.keys(), None, common.timeout).await?;
    let states = link
        .subscribe(link.keys().every_node(NodeTopic::State).as_str())
        .await?;
    let mut handles = Vec::new();
    for (seed, (node, _, _)) in (1_u64..).zip(PLAYS) {
        handles.push(boot(node, &common.keys(), locator, seed)?);
    }
    let mut waiting: Vec<NodeId> = handles.iter().map(EmulatedHandle::name).collect();
    let deadline = tokio::time::Instant::now() + common.timeout;
    while !waiting.is_empty() {
        let sample = tokio::time::timeout_at(deadline, states.recv_async())
            .await
            .map_err(|_| {
                let names: Vec<&str> = waiting.iter().map(NodeId::as_str).collect();
                Failure::TimedOut(format!("nodes did not come up: {}", names.join(", ")))
            })??;
        let record: NodeRecord = read(&sample.payload().to_bytes())?;
        if record.alive {
            waiting.retain(|node| *node != record.node);
        }
    }
    drop(states);
    if talk {
        let names: Vec<&str> = PLAYS.iter().map(|(node, _, _)| *node).collect();
        show::line(&format!(
            "nodes {} are there, two axes each",
            names.join(", ")
        ));
    }

    let bars = talk && std::io::stderr().is_terminal();
    let follower = Follower::new(&link, bars).await?;
    let mut jobs = Vec::new();
    for (node, name, text) in PLAYS {
        let mut job: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(text).context(name)?;
        job.insert("id".to_owned(), name.into());
        let payload = serde_json::to_vec(&job).context(name)?;
        let key = format!("{}/node/{node}/job", link.keys().prefix());
        let answers = link
            .get(&key, Some((payload, Encoding::APPLICATION_JSON)))
            .await?;
        for answer in answers {
            let payload = answer.map_err(|error| anyhow!("{name} for {node}: {error}"))?;
            jobs.push(read::<Receipt>(&payload)?.job);
        }
    }
    let ended = follower.wait(&jobs, Some(PLAY_WITHIN)).await?;
    if ended.timed_out {
        let message = format!("the jobs did not end within {} s", PLAY_WITHIN.as_secs());
        return Err(Failure::TimedOut(message));
    }
    let together = start_together(&link, bars).await?;
    link.close().await;

    let mut played = Vec::new();
    for ((handle, record), (_, name, text)) in handles.into_iter().zip(ended.records).zip(PLAYS) {
        let node = handle.name();
        let lives = handle.shutdown().await;
        let [life] = lives.as_slice() else {
            return Err(anyhow!("{node} booted {} times", lives.len()).into());
        };
        let judgement = match oracle::check_life(life) {
            Ok(summary) if !life.cut => Ok(summary.steps.iter().sum()),
            Ok(_) => Err(vec!["the record was full".to_owned()]),
            Err(violations) => Err(violations.iter().map(ToString::to_string).collect()),
        };
        played.push(Played {
            node,
            record,
            expected: destination(name, text, life.axis_count)?,
            counted: life.counted_steps.clone(),
            judgement,
        });
    }
    Ok((played, together))
}

/// Starts one job on all nodes at one instant and waits for its end.
///
/// A machine that is busy for a quarter of a second is late for a start. Then nobody has moved, and
/// the job is handed in once more under another name.
async fn start_together(link: &Link, bars: bool) -> Result<JobRecord, Failure> {
    let deadline = Instant::now() + PLAY_WITHIN;
    let mut attempts = 0;
    loop {
        attempts += 1;
        let name = match attempts {
            1 => TOGETHER_NAME.to_owned(),
            _ => format!("{TOGETHER_NAME}-{attempts}"),
        };
        let record = start_once(link, bars, &name).await?;
        let late = record.state == JobState::Failed && record.start.is_none();
        if !late || Instant::now() >= deadline {
            return Ok(record);
        }
    }
}

async fn start_once(link: &Link, bars: bool, name: &str) -> Result<JobRecord, Failure> {
    let follower = Follower::new(link, bars).await?;
    let commands: serde_json::Value =
        serde_json::from_str(TOGETHER).context("the example is JSON")?;
    let part = |(node, _, _)| (node, serde_json::json!({"commands": commands}));
    let nodes: serde_json::Map<_, _> = PLAYS
        .into_iter()
        .map(part)
        .map(|(node, part)| (String::from(node), part))
        .collect();
    // Nodes of this demo are seconds old, and the machine may be busy: what is measured is shown,
    // whatever it is.
    let job = serde_json::json!({
        "id": name, "nodes": nodes, "max_skew_us": 20_000, "ready_timeout_ms": 30_000,
    });
    let key = format!("{}/group/demo/job", link.keys().prefix());
    let payload = (job.to_string().into_bytes(), Encoding::APPLICATION_JSON);
    let mut jobs = Vec::new();
    for answer in link.get(&key, Some(payload)).await? {
        let payload = answer.map_err(|error| anyhow!("{name}: {error}"))?;
        jobs.push(read::<Receipt>(&payload)?.job);
    }
    let ended = follower.wait(&jobs, Some(PLAY_WITHIN)).await?;
    let record = ended.records.into_iter().next();
    Ok(record.ok_or_else(|| anyhow!("{name} has no record"))?)
}

fn boot(node: &str, keys: &Keys, locator: &str, seed: u64) -> Result<EmulatedHandle> {
    let name = NodeId::new(node).expect("names of the demo are legal");
    let config = EmulatorConfig {
        keys: keys.clone(),
        connect: locator.to_owned(),
        seed,
        record: Recording::Edges { max: RECORDED_MAX },
        ..EmulatorConfig::new(name)
    };
    emulator::spawn(config).map_err(|error| anyhow!("{node}: {error}"))
}

/// Adds up the commands of a job: where it leads from 0. A script of the demo ends where it began.
fn destination(name: &str, text: &str, axis_count: usize) -> Result<Vec<i64>> {
    let request = JobRequest::from_json(text.as_bytes()).context(name.to_owned())?;
    let Work::Commands(commands) = request.work else {
        return Ok(vec![0; axis_count]);
    };
    // A job of its own has no barriers to be numbered.
    let commands: Vec<Command> = commands
        .iter()
        .map(|command| command.to_command(|_| 0))
        .collect();
    if let Some(command) = commands.iter().find(|c| matches!(c, Command::Home { .. })) {
        return Err(anyhow!("{name}: where {command:?} ends is not known here"));
    }
    Ok(oracle::positions_after(&commands, axis_count))
}

fn table_of(played: &[Played]) -> comfy_table::Table {
    let mut table = show::table(&[
        "node", "job", "state", "commands", "position", "pulses", "verdict",
    ]);
    for one in played {
        let progress = one.record.progress;
        let pulses = match &one.judgement {
            Ok(pulses) => pulses.to_string(),
            Err(violations) => format!("{} violations", violations.len()),
        };
        let verdict = if one.good() {
            Cell::new("good").fg(Color::Green)
        } else {
            Cell::new("WRONG").fg(Color::Red)
        };
        table.add_row(vec![
            Cell::new(one.node),
            Cell::new(one.record.job),
            Cell::new(one.record.state).fg(show::job_color(one.record.state)),
            Cell::new(format!("{}/{}", progress.done, progress.total)),
            Cell::new(one.positions()),
            Cell::new(pulses),
            verdict,
        ]);
    }
    table
}

fn json_of(one: &Played) -> serde_json::Value {
    serde_json::json!({
        "node": one.node,
        "job": one.record.job,
        "state": one.record.state,
        "commands": one.record.progress.total,
        "pulses": one.judgement.as_ref().ok(),
        "expected": one.expected,
        "reported": one.reported(),
        "counted": one.counted,
        "violations": one.judgement.as_ref().err(),
        "good": one.good(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_example_is_a_legal_job_that_leads_somewhere() {
        let ends: Vec<Vec<i64>> = PLAYS
            .iter()
            .map(|(_, name, text)| destination(name, text, 2).expect("legal"))
            .collect();
        assert_eq!(
            ends,
            [
                [-1_200, 0],
                [0, 0],
                [800, 800],
                [-500, 250],
                [-400, -1_000],
                [0, 0]
            ]
        );
    }
}
