//! A fleet on real cables: router, gateway and every node in a network namespace of its own, with
//! delay and loss on each cable (where the kernel has netem), and cables that are pulled, a gateway that is killed and a router
//! that restarts. Linux only, and only as root.
//!
//! ```text
//!   node ns ──veth── ┐                       netem on both ends of each cable
//!   node ns ──veth── ├─ bridge in the router's ns (here)
//!   gateway ns ─veth─┘
//! ```
//!
//! Nodes finish what they hold when the link is away, so at the end every job has succeeded and every
//! node is where the sum of all jobs leads: nothing was lost and nothing doubled. Each node judges its
//! own pulses at its end.

use crate::{
    Random,
    field::{self, PATIENCE, Process, binary},
};
use serde_json::{Value, json};
use std::{
    fmt,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};
use zenoh::Session;

/// Nodes.
const NODES: usize = 3;

/// Addresses of nobody: a net for benchmarks.
const NET: &str = "198.18.7";

/// What the router listens on.
const ROUTER: &str = "tcp/198.18.7.1:7447";

/// What happened, and what came of it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Jobs that succeeded: all.
    pub jobs: u64,
    /// Steps that they ordered, both ways.
    pub steps: u64,
    /// Cables that were pulled for up to 5 s.
    pub cuts: u64,
    /// `kill -9` of the gateway.
    pub kills: u64,
    /// Restarts of the router.
    pub restarts: u64,
    /// The cables had delay and loss; a kernel without netem has none to give.
    pub disturbed: bool,
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            jobs,
            steps,
            cuts,
            kills,
            restarts,
            disturbed,
        } = self;
        let cables = if *disturbed {
            "with 8 ms of delay, 4 ms of jitter and 1 % of loss"
        } else {
            "WITHOUT delay and loss: this kernel has no netem"
        };
        write!(
            f,
            "{jobs} jobs of {steps} steps succeeded, every node is where they lead; {cuts} cables \
             pulled, gateway killed {kills} times, router restarted {restarts} times; cables {cables}"
        )
    }
}

/// Namespaces that go with their owner.
struct Spaces {
    names: Vec<String>,
}

impl Drop for Spaces {
    fn drop(&mut self) {
        for name in &self.names {
            // It may never have come to be.
            let _ = ip(&["netns", "del", name]);
        }
    }
}

fn ip(arguments: &[&str]) -> Result<(), String> {
    let output = Command::new("ip").args(arguments).output();
    let output = output.map_err(|error| format!("ip: {error}"))?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    Err(format!("ip {}: {said}", arguments.join(" ")))
}

fn within(space: &str) -> Command {
    let mut command = Command::new("ip");
    command.args(["netns", "exec", space]);
    command
}

/// Makes the router's namespace and runs this program again within it.
///
/// # Errors
/// Namespaces are not allowed here, with the system's words.
///
/// # Panics
/// The program within it failed.
pub fn enter(arguments: &[String]) -> Result<(), String> {
    let space = format!("stepfleet{}", std::process::id());
    let _spaces = Spaces {
        names: vec![space.clone()],
    };
    ip(&["netns", "add", &space])?;
    // Once, out here.
    binary("fleet");
    let program = std::env::current_exe().expect("it has a path");
    let mut inner = within(&space);
    inner.env_remove("CARGO");
    inner
        .arg(program)
        .args(arguments)
        .args(["--inside", &space]);
    let status = inner.status().map_err(|error| error.to_string())?;
    assert!(status.success(), "the fleet on cables failed");
    Ok(())
}

/// Lets the fleet work for so long. To be called within the router's namespace `here`.
///
/// # Errors
/// The kernel has no bridge or no veth.
///
/// # Panics
/// Something was lost or doubled.
pub fn run(here: &str, wall: Duration, seed: u64) -> Result<Outcome, String> {
    let mut spaces = Spaces { names: Vec::new() };
    ip(&["link", "set", "lo", "up"])?;
    ip(&["link", "add", "floor", "type", "bridge"])?;
    ip(&["addr", "add", &format!("{NET}.1/24"), "dev", "floor"])?;
    ip(&["link", "set", "floor", "up"])?;
    let mut space = |name: &str, number: usize| -> Result<String, String> {
        let space = format!("{here}-{name}");
        ip(&["netns", "add", &space])?;
        spaces.names.push(space.clone());
        let port = format!("p-{name}");
        ip(&[
            "link", "add", &port, "type", "veth", "peer", "name", "eth0", "netns", &space,
        ])?;
        ip(&["link", "set", &port, "master", "floor", "up"])?;
        let address = format!("{NET}.{number}/24");
        for line in [
            &["link", "set", "lo", "up"][..],
            &["addr", "add", &address, "dev", "eth0"],
            &["link", "set", "eth0", "up"],
        ] {
            ip(&[&["-n", &space][..], line].concat())?;
        }
        Ok(space)
    };
    let gateway_space = space("gw", 2)?;
    let mut node_spaces = Vec::new();
    for number in 1..=NODES {
        node_spaces.push(space(&format!("n{number}"), 10 + number)?);
    }
    let mut outcome = Outcome {
        disturbed: true,
        ..Outcome::default()
    };
    let cables = (1..).zip(&node_spaces).map(|(number, space)| {
        let how = "delay 8ms 4ms distribution normal loss 1%";
        (format!("p-n{number}"), space, how)
    });
    let all = [("p-gw".to_owned(), &gateway_space, "delay 1ms")];
    for (port, space, how) in all.into_iter().chain(cables) {
        if let Err(error) = disturb(&port, space, how) {
            eprintln!("{error}");
            outcome.disturbed = false;
            break;
        }
    }

    let store = tempfile::tempdir().expect("a directory");
    let file = store.path().join("fleet.redb");
    let mut router = start_router();
    let mut gateway = start_gateway(&gateway_space, &file);
    let mut nodes: Vec<Process> = (1..)
        .zip(&node_spaces)
        .map(|(number, space)| {
            let mut node = within(space);
            node.arg(binary("emulator"))
                .args(["--name", &format!("node-{number}"), "--connect", ROUTER])
                .args(["--link-loss", "finish", "--check"])
                .stdout(Stdio::null());
            Process::start(&mut node)
        })
        .collect();
    let mut client = field::open_client(ROUTER);
    field::wait_for_nodes(&client, NODES, |node| node["alive"] == true);

    let mut random = Random(seed);
    let mut expected = [0_i64; NODES];
    let mut pulled: Vec<(Instant, String)> = Vec::new();
    let since = Instant::now();
    while since.elapsed() < wall {
        pulled.retain(|(until, port)| {
            let over = *until <= Instant::now();
            if over {
                ip(&["link", "set", port, "up"]).expect("it was pulled by us");
            }
            !over
        });
        let node = random.below(NODES as u64) as usize;
        match random.below(40) {
            0..3 => {
                outcome.cuts += 1;
                let port = format!("p-n{}", node + 1);
                ip(&["link", "set", &port, "down"])?;
                let until = Instant::now() + Duration::from_millis(random.between(100, 5_000));
                pulled.push((until, port));
            }
            3 => {
                outcome.kills += 1;
                gateway.kill();
                gateway = start_gateway(&gateway_space, &file);
            }
            4 if random.below(2) == 0 => {
                outcome.restarts += 1;
                router.kill();
                router = start_router();
                client = field::open_client(ROUTER);
            }
            _ => {
                let steps: Vec<i64> = (0..random.between(1, 40))
                    .map(|_| random.between(1, 60) as i64 * [1, -1][random.below(2) as usize])
                    .collect();
                let id = format!("job-{}", outcome.jobs);
                hand_in(&client, node + 1, &id, &steps);
                expected[node] += steps.iter().sum::<i64>();
                outcome.steps += steps.iter().map(|steps| steps.unsigned_abs()).sum::<u64>();
                outcome.jobs += 1;
            }
        }
        std::thread::sleep(Duration::from_micros(random.below(500_000)));
    }
    for (_, port) in pulled {
        ip(&["link", "set", &port, "up"])?;
    }
    for number in 0..outcome.jobs {
        let record = wait_for_end(&client, &format!("job-{number}"));
        assert_eq!(record["state"], "succeeded", "{record}");
    }
    for (index, steps) in expected.iter().enumerate() {
        let key = format!("fleet/node/node-{}/state", index + 1);
        let records = field::get(&client, &key, None);
        assert_eq!(records[0]["position"][0], *steps, "{:?}", records[0]);
    }
    for node in &mut nodes {
        node.signal("TERM");
        assert!(node.wait().success(), "a node's own judge found something");
    }
    Ok(outcome)
}

/// Both ends of a cable: what leaves here, and what leaves there.
fn disturb(port: &str, space: &str, how: &str) -> Result<(), String> {
    for (space, device) in [(None, port), (Some(space), "eth0")] {
        let mut tc = space.map_or_else(
            || Command::new("tc"),
            |space| {
                let mut tc = within(space);
                tc.arg("tc");
                tc
            },
        );
        tc.args(["qdisc", "add", "dev", device, "root", "netem"]);
        let output = tc.args(how.split(' ')).output();
        let output = output.map_err(|error| format!("tc: {error}"))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(format!("tc netem: {}", said.trim()));
        }
    }
    Ok(())
}

fn start_router() -> Process {
    let program = std::env::current_exe().expect("it has a path");
    Process::start(Command::new(program).args(["router", ROUTER]))
}

fn start_gateway(space: &str, store: &Path) -> Process {
    let mut gateway = within(space);
    gateway
        .arg(binary("fleet"))
        .args(["serve", "--connect", ROUTER, "--store"])
        .arg(store)
        .env("RUST_LOG", "off")
        .stdout(Stdio::null());
    Process::start(&mut gateway)
}

/// Hands a job in until there is a receipt, always under the same name: once or several times, it
/// runs once.
fn hand_in(client: &Session, node: usize, id: &str, steps: &[i64]) {
    let commands: Vec<_> = steps
        .iter()
        .map(|steps| json!({"move": {"axis": 0, "delay_us": 200, "steps": steps}}))
        .collect();
    let job = json!({"id": id, "commands": commands});
    let since = Instant::now();
    loop {
        let answers = field::get_within(
            client,
            &format!("fleet/node/node-{node}/job"),
            Some(&job),
            Duration::from_secs(2),
        );
        if answers.iter().any(|answer| answer["job"] == id) {
            return;
        }
        assert!(since.elapsed() < PATIENCE, "{answers:?}");
    }
}

fn wait_for_end(client: &Session, id: &str) -> Value {
    let since = Instant::now();
    loop {
        let key = format!("fleet/job/{id}");
        let records = field::get_within(client, &key, None, Duration::from_secs(2));
        let record = records.first().cloned().unwrap_or_default();
        let state = record["state"].as_str().unwrap_or("");
        if ["succeeded", "failed", "canceled", "timed_out", "rejected"].contains(&state) {
            return record;
        }
        assert!(since.elapsed() < 2 * PATIENCE, "{record}");
        std::thread::sleep(Duration::from_millis(200));
    }
}
