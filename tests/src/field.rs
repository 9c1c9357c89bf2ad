//! A fleet as processes and sockets on this machine, for what virtual time cannot tell: benchmarks,
//! long runs, cables that are cut.
//!
//! Everything listens on loopback, on ports that were free, and ends with its owner.

use crate::memory::Usage;
use serde_json::Value;
use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::Once,
    time::{Duration, Instant},
};
use zenoh::{
    Config, Session, Wait,
    bytes::Encoding,
    handlers::{RingChannel, RingChannelHandler},
    pubsub::Subscriber,
    sample::Sample,
};

/// Far more than any step here takes.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A child that does not outlive its owner.
#[derive(Debug)]
pub struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Process {
    /// Starts a program.
    ///
    /// # Panics
    /// The system does not start it.
    pub fn start(command: &mut Command) -> Self {
        let child = command.spawn();
        Self(child.unwrap_or_else(|error| panic!("{command:?}: {error}")))
    }

    /// Its number.
    pub fn number(&self) -> u32 {
        self.0.id()
    }

    /// What it uses now.
    pub fn usage(&self) -> Usage {
        Usage::of(&self.number().to_string())
    }

    /// `kill -9`, and waits for its end.
    pub fn kill(&mut self) {
        // It may be gone already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }

    /// Sends a signal by name: `STOP`, `CONT`, `TERM`.
    ///
    /// # Panics
    /// There is no program `kill`.
    pub fn signal(&self, name: &str) {
        let status = Command::new("kill")
            .args([format!("-{name}"), self.number().to_string()])
            .status()
            .expect("every Unix has kill");
        assert!(status.success(), "{name} to {}", self.number());
    }

    /// Waits until it ends by itself.
    ///
    /// # Panics
    /// The system does not tell.
    pub fn wait(&mut self) -> std::process::ExitStatus {
        self.0.wait().expect("a child of ours")
    }
}

/// Returns one of our binaries beside the present program, built as that was.
///
/// # Panics
/// It does not build.
pub fn binary(name: &str) -> PathBuf {
    static BUILT: Once = Once::new();
    let mut folder = std::env::current_exe().expect("it has a path");
    folder.pop();
    if folder.ends_with("deps") {
        folder.pop();
    }
    BUILT.call_once(|| build(&folder));
    let path = folder.join(name);
    assert!(path.exists(), "{} is not built", path.display());
    path
}

/// Cargo knows whether they are old. Without it, a copy of this program finds copies of them.
fn build(folder: &Path) {
    if let Some(cargo) = std::env::var_os("CARGO") {
        let mut build = Command::new(cargo);
        // All at once: chosen alone, each would get dependencies with other features, built anew.
        build.args(["build", "--quiet", "--bins"]);
        build.args(["-p", "tests", "-p", "gateway", "-p", "emulator"]);
        if folder.ends_with("release") {
            build.arg("--release");
        }
        let status = build.current_dir(env!("CARGO_MANIFEST_DIR")).status();
        assert!(
            status.is_ok_and(|status| status.success()),
            "the programs must build"
        );
    }
}

/// A gateway that listens on loopback.
#[derive(Debug)]
pub struct Gateway {
    /// The process.
    pub process: Process,
    /// Where clients and nodes connect.
    pub connect: String,
}

impl Gateway {
    /// Starts `fleet serve` on this store, and waits until it is ready. With `network` it joins that
    /// router instead of bringing its own.
    ///
    /// # Panics
    /// It does not get ready; its own words are on standard error.
    pub fn start(store: &Path, network: Option<&str>) -> Self {
        Self::run(Command::new(binary("fleet")), store, network)
    }

    /// The same by another program that runs it, a shell for example.
    ///
    /// # Panics
    /// See [`Gateway::start`].
    pub fn run(mut program: Command, store: &Path, network: Option<&str>) -> Self {
        program.args(["serve", "--json", "--store"]).arg(store);
        match network {
            Some(router) => program.args(["--connect", router]),
            None => program.args(["--listen", "tcp/127.0.0.1:0"]),
        };
        program.env("RUST_LOG", "error").stdout(Stdio::piped());
        let mut process = Process::start(&mut program);
        let out = process.0.stdout.take().expect("it is piped");
        let mut line = String::new();
        BufReader::new(out).read_line(&mut line).expect("text");
        let ready: Value = serde_json::from_str(&line).expect("a gateway tells that it is ready");
        let connect = ready["locators"][0].as_str().expect("text").to_owned();
        Self { process, connect }
    }
}

/// Starts one process of `count` emulated nodes, `NAME-1` and so on.
pub fn emulators(name: &str, count: usize, connect: &str) -> Process {
    let mut command = Command::new(binary("emulator"));
    command
        .args(["--name", name, "--nodes", &count.to_string()])
        .args(["--connect", connect])
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    Process::start(&mut command)
}

/// Opens a router of its own; the gateway can then be killed without it.
///
/// # Panics
/// The system has no free port.
pub fn open_router() -> (Session, String) {
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a free port")
        .port();
    let address = format!("tcp/127.0.0.1:{port}");
    (open_router_on(&address), address)
}

/// The same at a given address.
///
/// # Panics
/// Somebody else listens there.
pub fn open_router_on(address: &str) -> Session {
    let since = Instant::now();
    loop {
        match open(&[
            ("mode", "\"router\"".to_owned()),
            ("listen/endpoints", format!("[\"{address}\"]")),
        ]) {
            Ok(session) => return session,
            // The one before may not be gone yet.
            Err(error) => assert!(since.elapsed() < PATIENCE, "{error}"),
        }
    }
}

/// Opens a client, as soon as there is somebody to connect to.
///
/// # Panics
/// There is nobody for [`PATIENCE`].
pub fn open_client(connect: &str) -> Session {
    let since = Instant::now();
    loop {
        match open(&[
            ("mode", "\"client\"".to_owned()),
            ("connect/endpoints", format!("[\"{connect}\"]")),
        ]) {
            Ok(session) => return session,
            Err(error) => assert!(since.elapsed() < PATIENCE, "{error}"),
        }
    }
}

fn open(settings: &[(&str, String)]) -> zenoh::Result<Session> {
    let mut config = Config::default();
    for (key, value) in settings {
        config.insert_json5(key, value).expect("a known setting");
    }
    config
        .insert_json5("scouting/multicast/enabled", "false")
        .expect("a known setting");
    zenoh::open(config).wait()
}

/// Asks, with JSON if there is any; gives what comes back, errors too.
///
/// # Panics
/// The session is closed.
pub fn get(session: &Session, key: &str, payload: Option<&Value>) -> Vec<Value> {
    get_within(session, key, payload, PATIENCE)
}

/// The same for somebody who waits no longer than this.
///
/// # Panics
/// See [`get`].
pub fn get_within(
    session: &Session,
    key: &str,
    payload: Option<&Value>,
    patience: Duration,
) -> Vec<Value> {
    let mut query = session
        .get(key)
        .timeout(patience)
        .consolidation(zenoh::query::ConsolidationMode::None);
    if let Some(payload) = payload {
        query = query
            .payload(payload.to_string())
            .encoding(Encoding::APPLICATION_JSON);
    }
    let replies = query.wait().expect("an open session");
    let text = |reply: zenoh::query::Reply| match reply.into_result() {
        Ok(sample) => sample.payload().to_bytes().into_owned(),
        Err(error) => error.payload().to_bytes().into_owned(),
    };
    // Zenoh's own errors, a timeout for example, are plain text.
    let json = |bytes: Vec<u8>| {
        let text = || Value::String(String::from_utf8_lossy(&bytes).into_owned());
        serde_json::from_slice(&bytes).unwrap_or_else(|_| text())
    };
    replies.into_iter().map(text).map(json).collect()
}

/// Hears a key from now on, the last message only: a channel that fills while its session asks for
/// something would keep the answers back, because one thread brings both.
///
/// # Panics
/// The session is closed.
pub fn news(session: &Session, key: &str) -> Subscriber<RingChannelHandler<Sample>> {
    let subscriber = session.declare_subscriber(key).with(RingChannel::new(1));
    subscriber.wait().expect("an open session")
}

/// Waits until the gateway counts this many nodes for which something holds.
///
/// # Panics
/// It does not come to that.
pub fn wait_for_nodes(session: &Session, count: usize, holds: impl Fn(&Value) -> bool) {
    let since = Instant::now();
    let changes = news(session, "fleet/node/*/state");
    loop {
        let nodes = get(session, "fleet/node/*/state", None);
        if nodes.iter().filter(|node| holds(node)).count() >= count {
            return;
        }
        assert!(since.elapsed() < PATIENCE, "{} nodes", nodes.len());
        let _ = changes.recv_timeout(Duration::from_secs(1));
    }
}

/// Returns the value below which this share of the sorted ones lies.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    let index = (last as f64 * share).round() as usize;
    sorted.get(index).copied().unwrap_or(f64::NAN)
}
