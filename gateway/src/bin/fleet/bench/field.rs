//! The processes of a benchmark: a gateway, nodes, and what both use.

use crate::link::{Failure, Link, read};
use anyhow::{Context, Result, anyhow};
use emulator::{EmulatedHandle, EmulatorConfig};
use keys::{Keys, NodeId, NodeTopic, record::NodeRecord};
use std::{
    fs,
    io::{BufRead, BufReader},
    path::PathBuf,
    process::{Child, Command, Stdio},
    sync::Arc,
    time::{Duration, Instant},
};

/// Far more than a thousand nodes need to come up on one processor.
const PATIENCE: Duration = Duration::from_secs(120);

/// Settings of the gateway under test: nothing that a client asks for is refused, whatever it asks
/// for; everything else as by default.
const SETTINGS: &str = "\
[fleet]\nwaiting_jobs = 1000000\n\
[client]\nrequests_per_s = 1000000\nmib_per_s = 10000\ngets_open = 4096\n";

/// What Linux counts processor time in for programs, whatever the kernel's own tick is.
const TICKS_PER_S: f64 = 100.0;

/// A child that does not outlive its owner.
pub(super) struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What a process has used.
#[derive(Clone, Copy, Default)]
pub(super) struct Usage {
    pub(super) processor_s: f64,
    pub(super) resident_kib: f64,
}

impl Process {
    fn usage(&self) -> Usage {
        let folder = format!("/proc/{}", self.0.id());
        let table = fs::read_to_string(format!("{folder}/status")).unwrap_or_default();
        let resident = table.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let resident = resident.and_then(|line| line.split_whitespace().next()?.parse().ok());
        // Fields 14 and 15, behind the name, which may have blanks in it.
        let stat = fs::read_to_string(format!("{folder}/stat")).unwrap_or_default();
        let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
        let ticks: f64 = fields
            .split_whitespace()
            .skip(11)
            .take(2)
            .filter_map(|field| field.parse::<f64>().ok())
            .sum();
        Usage {
            processor_s: ticks / TICKS_PER_S,
            resident_kib: resident.unwrap_or(0.0),
        }
    }
}

/// A gateway, nodes, and a client.
pub(super) struct Field {
    gateway: Process,
    nodes: Option<Process>,
    pub(super) link: Arc<Link>,
    pub(super) connect: String,
    pub(super) names: Vec<NodeId>,
    /// How long it took until the gateway saw all nodes.
    pub(super) came_up: Duration,
    /// Of the gateway, before the nodes came.
    pub(super) empty: Usage,
    folder: PathBuf,
}

/// Starts this program once more, with as many open files as the system allows.
fn start(arguments: &[&str], piped: bool) -> Result<Process> {
    let program = std::env::current_exe().context("this program")?;
    let mut command = Command::new("sh");
    command
        .args(["-c", "ulimit -n $(ulimit -Hn) && exec \"$0\" \"$@\""])
        .arg(program)
        .args(arguments)
        .env("RUST_LOG", "error")
        .stdin(Stdio::null())
        .stdout(if piped { Stdio::piped() } else { Stdio::null() });
    let child = command.spawn().context("a process of the benchmark")?;
    Ok(Process(child))
}

impl Field {
    /// Starts everything and waits until the gateway sees all nodes.
    pub(super) async fn open(count: usize, timeout: Duration) -> Result<Self, Failure> {
        let folder = std::env::temp_dir().join(format!("fleet-bench-{}", std::process::id()));
        fs::create_dir_all(&folder)?;
        let settings = folder.join("fleet.toml");
        fs::write(&settings, SETTINGS)?;
        let store = folder.join("fleet.redb");
        // The one of the phase before.
        let _ = fs::remove_file(&store);
        let (settings, store) = (settings.to_string_lossy(), store.to_string_lossy());
        let mut gateway = start(
            &[
                "--json",
                "serve",
                "--config",
                &settings,
                "--store",
                &store,
                "--listen",
                "tcp/127.0.0.1:0",
            ],
            true,
        )?;
        let out = gateway.0.stdout.take().expect("it is piped");
        let mut line = String::new();
        BufReader::new(out).read_line(&mut line)?;
        let ready: serde_json::Value =
            serde_json::from_str(&line).context("the gateway does not get ready")?;
        let connect = ready["locators"][0].as_str().unwrap_or_default().to_owned();
        let link = Link::connect(&connect, Keys::default(), None, timeout).await?;
        let empty = gateway.usage();
        let names: Vec<NodeId> = (1..=count).map(name).collect();
        let began = Instant::now();
        let nodes = match count {
            0 => None,
            _ => Some(start(
                &["bench-nodes", &count.to_string(), &connect],
                false,
            )?),
        };
        let field = Self {
            gateway,
            nodes,
            link: Arc::new(link),
            connect,
            names,
            came_up: Duration::ZERO,
            empty,
            folder,
        };
        field.wait_for_nodes(count).await?;
        Ok(Self {
            came_up: began.elapsed(),
            ..field
        })
    }

    /// Waits until the gateway sees so many nodes.
    pub(super) async fn wait_for_nodes(&self, count: usize) -> Result<(), Failure> {
        let began = Instant::now();
        let key = self.link.keys().every_node(NodeTopic::State);
        loop {
            let answers = match count {
                0 => Vec::new(),
                _ => self.link.get(key.as_str(), None).await?,
            };
            let mut alive = 0;
            for answer in answers.into_iter().flatten() {
                alive += usize::from(read::<NodeRecord>(&answer)?.alive);
            }
            if alive >= count {
                return Ok(());
            }
            if began.elapsed() > PATIENCE {
                let message = format!("{alive} of {count} nodes came up");
                return Err(Failure::TimedOut(message));
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    /// What the gateway has used so far.
    pub(super) fn gateway(&self) -> Usage {
        self.gateway.usage()
    }

    /// What the nodes have used so far.
    pub(super) fn nodes(&self) -> Usage {
        self.nodes.as_ref().map(Process::usage).unwrap_or_default()
    }

    /// Ends everything.
    pub(super) async fn close(self) {
        if let Some(link) = Arc::into_inner(self.link) {
            link.close().await;
        }
        drop((self.nodes, self.gateway));
        // What cannot be removed is left to the system's own cleaning of temporary files.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn name(number: usize) -> NodeId {
    NodeId::new(&format!("node-{number}")).expect("a legal name")
}

/// Boots nodes in this process.
pub(super) fn boot(
    count: usize,
    connect: &str,
    set: impl Fn(&mut EmulatorConfig),
) -> Result<Vec<EmulatedHandle>> {
    let boot = |number| {
        let mut config = EmulatorConfig::new(name(number));
        config.connect = connect.to_owned();
        config.seed = number as u64;
        set(&mut config);
        emulator::spawn(config).map_err(|error| anyhow!("node-{number}: {error}"))
    };
    (1..=count).map(boot).collect()
}

/// `fleet bench-nodes`, the process of the nodes: until it is killed.
pub(crate) async fn run_nodes(count: usize, connect: &str) -> Result<(), Failure> {
    // It outlives neither the benchmark nor a kill of that.
    let parent = std::os::unix::process::parent_id();
    let _nodes = boot(count, connect, |_| {})?;
    while std::os::unix::process::parent_id() == parent {
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    Ok(())
}

/// Processors, system and build, on one line.
pub(super) fn machine() -> String {
    let processors = std::thread::available_parallelism().map_or(0, usize::from);
    let table = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = table
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .map_or("an unknown processor", |line| {
            line.trim_start_matches([' ', '\t', ':'])
        });
    let load = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let load = load.split(' ').next().unwrap_or("unknown").to_owned();
    let build = if cfg!(debug_assertions) {
        "DEVELOPMENT BUILD"
    } else {
        "release build"
    };
    format!(
        "{processors} × {model}, {}, {build}, load before: {load}",
        std::env::consts::OS
    )
}
