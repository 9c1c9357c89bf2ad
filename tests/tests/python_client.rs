//! The contract with clients, asked for by somebody else's zenoh client: the script
//! `tests/python/contract.py` with the package `eclipse-zenoh` from PyPI, against a gateway and
//! emulated nodes in this process, over real sockets.
//!
//! ```text
//!  contract.py ──zenoh──▶ gateway ◀──zenoh── emulated nodes
//!       └──── lines ───▶ Fixture: nodes come and go, buttons are pressed, pulses are counted
//! ```
//!
//! `CONTRACT="Stop Ids"` in the environment runs those classes only.
//!
//! The fixture does what no client can: it says what the pins did, so that the script need not
//! believe the product. Needs `python3` with `venv`, and PyPI once for each target directory.

use anyhow::{Context, Result, bail, ensure};
use emulator::{EmulatedHandle, EmulatorConfig, wiring::Wiring};
use gateway::{config::GatewayConfig, service::Service};
use keys::{AxisId, NodeId, record::NodeWord};
use std::{
    collections::HashMap,
    fs::File,
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tokio::{
    io::{AsyncBufReadExt, AsyncWriteExt, BufReader},
    net::{TcpListener, TcpSocket, TcpStream},
};

/// The version of `eclipse-zenoh`: the one of the gateway's zenoh.
const PACKAGE_VERSION: &str = "1.10.2";

/// A command line by somebody else, and what it needs for puts and gets; it draws networks, too, with
/// libraries that are not needed here.
const COMMAND_LINE: [&str; 3] = ["zenoh-cli==0.7.0", "parse==1.22.4", "networkx==3.6.1"];

/// The lines that are to be typed into a shell.
const PAGE: &str = include_str!("../../gateway/src/bin/fleet/help/client.txt");

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_contract_holds_for_a_client_in_python() {
    plays("contract.py", None).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_python_package_is_installed_by_pip_and_does_what_it_says() {
    let packages = tempfile::tempdir().expect("a folder");
    plays("package.py", Some(packages.path())).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_lines_for_a_shell_on_the_page_of_help_do_what_they_say() {
    let python = tokio::task::spawn_blocking(python)
        .await
        .expect("no panic")
        .expect("a Python with eclipse-zenoh");
    let mut fixture = Fixture::start().await.expect("a fleet");
    fixture.up("left", 2, &[]).expect("started");
    let page = PAGE.replace("tcp/127.0.0.1:7447", &fixture.locator);
    // As they stand there, with the blanks before them: a command begins two of them from the left.
    let typed = |begin: &str| -> Vec<String> {
        let mut commands: Vec<String> = Vec::new();
        for paragraph in page.split("\n\n") {
            let mut inside = false;
            for line in paragraph.lines() {
                match line.strip_prefix("  ") {
                    Some(command) if command.starts_with(begin) => {
                        inside = true;
                        commands.push(line.to_owned());
                    }
                    Some(rest) if inside && rest.starts_with(' ') => {
                        let command = commands.last_mut().expect("begun");
                        *command += "\n";
                        *command += line;
                    }
                    _ => inside = false,
                }
            }
        }
        commands
    };
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../gateway/clients/python");
    let programs = python.parent().expect("its folder").to_owned();
    let shell = |line: &str| {
        let (line, source, programs) = (line.to_owned(), source.clone(), programs.clone());
        tokio::task::spawn_blocking(move || {
            let path = std::env::var("PATH").unwrap_or_default();
            let mut shell = Command::new("sh");
            shell.args(["-c", &line]).env("PYTHONPATH", source);
            shell.env("PATH", format!("{}:{path}", programs.display()));
            let output = shell.output().expect("there is a shell");
            assert!(output.status.success(), "{line}: {}", text_of(&output));
            String::from_utf8(output.stdout).expect("UTF-8")
        })
    };
    let [put, get] = &typed("zenoh ")[..] else {
        panic!("a put and a get: {page}");
    };
    let gateway = fixture.gateway.as_ref().expect("it runs").observer();
    while gateway.snapshot().await.is_none_or(|fleet| {
        let mut nodes = fleet.nodes.values();
        nodes.all(|node| node.state == NodeWord::Offline)
    }) {
        tokio::task::yield_now().await;
    }
    shell(put).await.expect("typed");
    let record = loop {
        let text = shell(get).await.expect("typed");
        // No record yet is no answer.
        let record: Option<serde_json::Value> = serde_json::from_str(&text).ok();
        let state = record.as_ref().and_then(|record| record["state"].as_str());
        if state == Some("succeeded") {
            break record.expect("read");
        }
        assert!(
            !["rejected", "failed"].contains(&state.unwrap_or("")),
            "{text}"
        );
    };
    assert_eq!(record["result"]["position"][0], 2_000, "{record}");
    let [job] = &typed("python3 ")[..] else {
        panic!("a job: {page}");
    };
    let said = shell(job).await.expect("typed");
    assert_eq!(said.trim_end(), "succeeded");
    let left = fixture.node("left").expect("it is there");
    assert_eq!(left.step_count(AxisId(0)), 4_000);
    fixture.end().await;
}

/// Runs a script against a fleet. `packages`: where the package of this project is installed for it.
async fn plays(script: &str, packages: Option<&Path>) {
    let python = tokio::task::spawn_blocking(python)
        .await
        .expect("no panic")
        .expect("a Python with eclipse-zenoh");
    if let Some(packages) = packages {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../gateway/clients/python");
        let pip = [
            "-m",
            "pip",
            "install",
            "--disable-pip-version-check",
            "--no-deps",
            "--target",
        ];
        run(Command::new(&python).args(pip).arg(packages).arg(source)).expect("installed");
    }
    let packages = packages.map(Path::to_owned);
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("python")
        .join(script);
    let mut fixture = Fixture::start().await.expect("a fleet");
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let control = listener.local_addr().expect("bound").to_string();
    let locator = fixture.locator.clone();
    let mut client = tokio::task::spawn_blocking(move || {
        let mut command = Command::new(python);
        if let Some(packages) = packages {
            command.env("PYTHONPATH", packages);
        }
        command
            .arg(script)
            .args(["--locator", &locator, "--control", &control])
            .args(only())
            .output()
    });
    let output = loop {
        tokio::select! {
            output = &mut client => break output.expect("no panic").expect("the script ran"),
            link = listener.accept() => {
                let (link, _) = link.expect("a connection");
                // The script ends the connection, in time or by its death.
                fixture.serve(link).await;
            }
        }
    };
    fixture.end().await;
    let text = text_of(&output);
    // Shown by the test runner when the test fails.
    println!("{text}");
    assert!(output.status.success(), "{}", output.status);
}

/// Returns the tests that are asked for, all of them by default: `CONTRACT="Stop Ids.test_…"`.
fn only() -> Vec<String> {
    let names = std::env::var("CONTRACT").unwrap_or_default();
    names.split_whitespace().map(str::to_owned).collect()
}

fn text_of(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// Returns the interpreter of an environment that has the client. It is made once; other test
/// processes wait for the one that makes it.
fn python() -> Result<PathBuf> {
    // The directory of the test binaries: `target/tmp` has the target directory above it.
    let target = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .parent()
        .context("cargo's directory for tests lies in the target directory")?;
    let home = target.join(format!("python-venv-{PACKAGE_VERSION}"));
    let lock_path = target.join(format!("python-venv-{PACKAGE_VERSION}.lock"));
    // Held until the end of this function; the system lets it go with the process.
    let lock = File::create(&lock_path).with_context(|| format!("{}", lock_path.display()))?;
    lock.lock()
        .with_context(|| format!("{}", lock_path.display()))?;
    let interpreter = if cfg!(windows) {
        home.join("Scripts").join("python.exe")
    } else {
        home.join("bin").join("python")
    };
    let complete = home.join("complete-with-command-line");
    if complete.exists() && interpreter.exists() {
        return Ok(interpreter);
    }
    if home.exists() {
        std::fs::remove_dir_all(&home).with_context(|| format!("{}", home.display()))?;
    }
    let system = if cfg!(windows) { "python" } else { "python3" };
    run(Command::new(system).args(["-m", "venv"]).arg(&home)).context(
        "this test needs python3 with its venv module (Debian: apt install python3-venv)",
    )?;
    let package = format!("eclipse-zenoh=={PACKAGE_VERSION}");
    let pip = ["-m", "pip", "install", "--disable-pip-version-check"];
    run(Command::new(&interpreter)
        .args(pip)
        .args(["--only-binary", ":all:", &package]))
    .with_context(|| format!("this test needs {package} from PyPI, which pip could not get"))?;
    run(Command::new(&interpreter)
        .args(pip)
        .args(["--only-binary", ":all:", "--no-deps"])
        .args(COMMAND_LINE))
    .context("this test needs zenoh-cli from PyPI, which pip could not get")?;
    File::create(&complete).with_context(|| format!("{}", complete.display()))?;
    Ok(interpreter)
}

fn run(command: &mut Command) -> Result<()> {
    let output = command
        .output()
        .with_context(|| format!("{command:?} could not be started"))?;
    ensure!(
        output.status.success(),
        "{command:?}: {}\n{}",
        output.status,
        text_of(&output)
    );
    Ok(())
}

/// A gateway and its nodes, moved by lines of text.
struct Fixture {
    /// Where the gateway listens. Bound here too, so that the system gives the port to nobody else
    /// while the gateway restarts; only on Linux may two sockets share it as long as one listens.
    _port: Option<TcpSocket>,
    store: tempfile::TempDir,
    /// `None` while it restarts.
    gateway: Option<Service>,
    locator: String,
    nodes: HashMap<String, EmulatedHandle>,
}

impl Fixture {
    async fn start() -> Result<Self> {
        let store = tempfile::tempdir()?;
        let mut listen: SocketAddr = (Ipv4Addr::LOCALHOST, 0).into();
        let mut port = None;
        if cfg!(target_os = "linux") {
            let socket = TcpSocket::new_v4()?;
            socket.set_reuseaddr(true)?;
            socket.bind(listen)?;
            listen = socket.local_addr()?;
            port = Some(socket);
        }
        let gateway = gateway_on(&format!("tcp/{listen}"), store.path()).await?;
        let locator = gateway
            .locators()
            .first()
            .context("the gateway listens nowhere")?
            .clone();
        Ok(Self {
            _port: port,
            store,
            gateway: Some(gateway),
            locator,
            nodes: HashMap::new(),
        })
    }

    /// Answers each line with one line, `ok …` or `error …`.
    async fn serve(&mut self, mut link: TcpStream) {
        let (reader, mut writer) = link.split();
        let mut lines = BufReader::new(reader).lines();
        // A script that was killed ends its connection in whichever way.
        while let Ok(Some(line)) = lines.next_line().await {
            let answer = match self.obey(&line).await {
                Ok(answer) => format!("ok {answer}\n"),
                Err(error) => format!("error {line}: {error:#}\n"),
            };
            if writer.write_all(answer.as_bytes()).await.is_err() {
                return;
            }
        }
    }

    async fn obey(&mut self, line: &str) -> Result<String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["up", name] => self.up(name, 2, &[]),
            ["up", name, axes, ref switches @ ..] => self.up(name, axes.parse()?, switches),
            ["down", name] => {
                let node = self.nodes.remove(name).context("no such node")?;
                node.shutdown().await;
                Ok(String::new())
            }
            ["cut", name] => {
                self.node(name)?.reset();
                Ok(String::new())
            }
            ["pin", name, active] => {
                self.node(name)?.stop_pin(active.parse()?);
                Ok(String::new())
            }
            ["pulses", name, axis] => {
                let axis = AxisId(axis.parse()?);
                Ok(self.node(name)?.step_count(axis).to_string())
            }
            ["restart"] => {
                let gateway = self.gateway.take().context("it does not run")?;
                gateway.shutdown().await?;
                self.gateway = Some(gateway_on(&self.locator, self.store.path()).await?);
                Ok(String::new())
            }
            _ => bail!("no such word"),
        }
    }

    /// `switches`: `home=0:min@-300` for one by which an axis is homed, `limit=…` for another.
    fn up(&mut self, name: &str, axis_count: usize, switches: &[&str]) -> Result<String> {
        let mut config = EmulatorConfig {
            connect: self.locator.clone(),
            axis_count,
            // The gateway restarts while nodes move, and a busy machine takes its time for that.
            link_loss_after_us: 600_000_000,
            ..EmulatorConfig::new(NodeId::new(name)?)
        };
        for switch in switches {
            let (kind, wiring) = switch.split_once('=').context("no switch")?;
            let wiring: Wiring = wiring.parse()?;
            match kind {
                "home" => wiring.wire_home(&mut config)?,
                _ => wiring.wire(&mut config)?,
            }
        }
        ensure!(!self.nodes.contains_key(name), "it is there");
        self.nodes.insert(name.to_owned(), emulator::spawn(config)?);
        Ok(String::new())
    }

    fn node(&self, name: &str) -> Result<&EmulatedHandle> {
        self.nodes.get(name).context("no such node")
    }

    async fn end(self) {
        for (_, node) in self.nodes {
            node.shutdown().await;
        }
        if let Some(gateway) = self.gateway {
            gateway.shutdown().await.expect("an orderly end");
        }
    }
}

async fn gateway_on(locator: &str, store: &Path) -> Result<Service> {
    let config = GatewayConfig {
        listen: vec![locator.to_owned()],
        ..GatewayConfig::new(store.join("fleet.redb"))
    };
    Ok(Service::start(config).await?)
}
