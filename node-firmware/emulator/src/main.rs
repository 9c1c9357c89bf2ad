//! The program `emulator`: emulated nodes on a real network, until Ctrl-C or SIGTERM.

use anyhow::{Context, Result, bail, ensure};
use clap::{Parser, ValueEnum};
#[cfg(unix)]
use emulator::board::EmulatedBoard;
use emulator::{
    Credentials, EmulatedHandle, EmulatorConfig, Recording, bed::CD_MARGIN_STEPS, capture::Capture,
    config::RECORDED_EDGES_MAX, flash::Flash, oracle, record::Life, scout::ScoutConfig, verdict,
    wiring::Wiring,
};
use keys::{
    Keys, NodeId,
    job::{JobRequest, Work},
};
use motion::limits::CHANNELS;
use node::LinkLoss;
use std::{
    fs::File,
    io::BufWriter,
    net::Ipv4Addr,
    path::{Path, PathBuf},
    process::ExitCode,
};

/// Emulates nodes of the fleet: the board's firmware with a virtual pulse unit, over a real
/// zenoh link. Runs until Ctrl-C or SIGTERM.
#[derive(Debug, Parser)]
#[command(version, about, long_about = None)]
#[command(after_help = "Examples:\n  \
    emulator --name left                      one node for the gateway on this machine\n  \
    emulator --nodes 8                        node-1 to node-8\n  \
    emulator --name left --scout              asks the network where the router is\n  \
    emulator --connect tls/plant:7447 --ca ca.pem --user left --password-file left.pw   a secured fleet\n  \
    emulator --name left --vcd left.vcd       its pins for GTKWave or PulseView\n  \
    emulator --home 0:min@-300 --limit 0:max@5000   axis 0 can be homed, and has a limit\n  \
    emulator --scripts scripts --boot-script  stored scripts in files; the one named boot runs at the start\n  \
    emulator --nodes 4 --check                judge every pulse; exit code 1 on a violation\n  \
    emulator --flash left.flash --serial left.port   a whole board: fleet provision ./left.port …\n\n\
    Exit codes: 0 stopped by a signal, 1 --check found a violation or an error, 2 bad option.")]
struct Args {
    /// Name of the node; with --nodes above 1 what the names begin with: NAME-1, NAME-2, …
    /// [default: node-1, or node with --nodes above 1]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,

    /// How many nodes.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1000))]
    nodes: u16,

    /// Zenoh router or gateway to connect to.
    #[arg(
        long,
        value_name = "tcp|tls/HOST:PORT",
        default_value = "tcp/127.0.0.1:7447"
    )]
    connect: String,

    /// File with the authority of a secured fleet (DIR/ca.pem): the nodes speak TLS 1.3, and only to a router
    /// whose certificate it has signed.
    #[arg(long, value_name = "FILE", conflicts_with = "scout")]
    ca: Option<PathBuf>,

    /// Find the router by scouting (UDP multicast), as a board does that was told none; with an address
    /// of this machine in that network.
    #[arg(long, value_name = "FROM", num_args = 0..=1, require_equals = true,
        default_missing_value = "0.0.0.0", conflicts_with = "connect")]
    scout: Option<Ipv4Addr>,

    /// Prefix of all keys of the fleet.
    #[arg(long, default_value = keys::key::PREFIX_DEFAULT)]
    prefix: String,

    /// Axes of each node.
    #[arg(long, value_name = "COUNT", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=CHANNELS as i64))]
    axes: u8,

    /// A switch by which an axis is homed, at a place of the machine, which is switched on at 0:
    /// AXIS:min@STEPS, AXIS:max@STEPS or AXIS:home@STEPS. May be given several times.
    #[arg(long, value_name = "AXIS:SWITCH@STEPS")]
    home: Vec<Wiring>,

    /// A limit switch that stops; written like --home.
    #[arg(long, value_name = "AXIS:SWITCH@STEPS")]
    limit: Vec<Wiring>,

    /// Give each node the axes C and D, with a limit at each end of both.
    #[arg(long)]
    cd: bool,

    /// Longest that a switch bounces, µs.
    #[arg(long, value_name = "US", default_value_t = 1_000, value_parser = clap::value_parser!(u64).range(..=100_000))]
    bounce_us: u64,

    /// Commands that the queue of each node holds.
    #[arg(long, value_name = "COMMANDS", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..=1_048_576))]
    ring: u32,

    /// What the clock of each node shows at its boot, µs.
    #[arg(long, value_name = "US", default_value_t = 0)]
    clock_offset_us: u64,

    /// By how much the clock of each node is too fast, millionths; negative: too slow.
    #[arg(
        long,
        value_name = "PPM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    clock_drift_ppm: f64,

    /// What a node does when the link stays away for two seconds while it moves.
    #[arg(long, value_enum, default_value_t = OnLinkLoss::Decelerate)]
    link_loss: OnLinkLoss,

    /// Folder for stored scripts: DIR/NODE/NAME.lua. They are there again after a restart. Without it
    /// they last as long as the emulator.
    #[arg(long, value_name = "DIR")]
    scripts: Option<PathBuf>,

    /// Run the stored script `boot` when a node starts. Without it no script starts by itself.
    #[arg(long)]
    boot_script: bool,

    /// User for a router that asks.
    #[arg(long, requires = "password_file")]
    user: Option<String>,

    /// File with the public keys of operators (DIR/signers of a secured fleet): the nodes execute
    /// only what one of them has signed.
    #[arg(long, value_name = "FILE")]
    signers: Option<PathBuf>,

    /// File with the user's password; a newline at its end does not count.
    #[arg(long, value_name = "FILE", requires = "user")]
    password_file: Option<PathBuf>,

    /// Write the pins as a value change dump. With several nodes the node's name is put before
    /// the extension.
    #[arg(long, value_name = "FILE")]
    vcd: Option<PathBuf>,

    /// Judge every pulse against the commands that were taken, at the end; with --vcd the verdict
    /// stands in the dump too, where the dashboard shows it. With a file: judge this
    /// capture of a logic analyser (CSV or VCD, signals step0, dir0, …, 16 MHz or faster) against
    /// --job, and do nothing else.
    #[arg(long, value_name = "CAPTURE", num_args = 0..=1, require_equals = false)]
    check: Option<Option<PathBuf>>,

    /// Job that the capture shows, from rest at position 0: JSON with `commands`.
    #[arg(long, value_name = "FILE", requires = "check")]
    job: Option<PathBuf>,

    /// Emulate a whole board with its flash in this file, made blank if it is not there: name, router,
    /// user, axes, switches, C and D, lidar, signers and whether a boot script may run come from what
    /// `fleet provision` has told it; stored scripts lie in it, and `fleet update` gives it other
    /// firmware. Where its switches are is said by --limit and --home, else they are 1000 steps below and
    /// 100000 above.
    #[arg(long, value_name = "FILE", conflicts_with_all =
        ["cd", "name", "nodes", "connect", "ca", "prefix", "user", "vcd", "signers", "scripts", "boot_script"])]
    flash: Option<PathBuf>,

    /// Where the board's serial port is to be found: a link that is made, and removed at the end.
    /// Without it the port's own path is printed.
    #[arg(long, value_name = "LINK", requires = "flash")]
    serial: Option<PathBuf>,

    /// Where random numbers of the virtual pulse unit come from.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// See [`LinkLoss`].
#[derive(Clone, Copy, Debug, ValueEnum)]
enum OnLinkLoss {
    /// Execute what the queue holds.
    Finish,
    /// Stop by the ramp of each axis; a release is needed afterwards.
    Decelerate,
    /// Stop at once; a release is needed afterwards.
    Halt,
}

impl Args {
    /// Returns one configuration for each node.
    fn configs(&self) -> Result<Vec<EmulatorConfig>> {
        let keys = Keys::new(&self.prefix).with_context(|| format!("--prefix {}", self.prefix))?;
        ensure!(
            self.clock_drift_ppm.is_finite() && self.clock_drift_ppm.abs() <= 1_000.0,
            "--clock-drift-ppm lies between -1000 and 1000"
        );
        let signers = match &self.signers {
            Some(file) => read_signers(file)?,
            None => node::signed::Keys::new(),
        };
        let authority = self.ca.as_deref().map(read_authority).transpose()?;
        let credentials = match (&self.user, &self.password_file) {
            (Some(user), Some(file)) => Some(credentials(user, file)?),
            _ => None,
        };
        let link_loss = match self.link_loss {
            OnLinkLoss::Finish => LinkLoss::Finish,
            OnLinkLoss::Decelerate => LinkLoss::Decelerate,
            OnLinkLoss::Halt => LinkLoss::Halt,
        };
        let record = if self.check.is_some() {
            Recording::Edges {
                max: RECORDED_EDGES_MAX,
            }
        } else {
            Recording::Off
        };
        (1..=self.nodes)
            .map(|number| {
                let name = match (&self.name, self.nodes) {
                    (Some(name), 1) => name.clone(),
                    (name, _) => format!("{}-{number}", name.as_deref().unwrap_or("node")),
                };
                let id = NodeId::new(&name).with_context(|| format!("--name: {name:?}"))?;
                let mut config = EmulatorConfig {
                    keys: keys.clone(),
                    axis_count: usize::from(self.axes),
                    ring_commands: self.ring as usize,
                    link_loss,
                    seed: self.seed.wrapping_add(u64::from(number)),
                    record,
                    connect: match self.scout {
                        Some(_) => String::new(),
                        None => self.connect.clone(),
                    },
                    scout: ScoutConfig {
                        from: self.scout.unwrap_or(Ipv4Addr::UNSPECIFIED),
                        ..ScoutConfig::default()
                    },
                    clock_offset_us: self.clock_offset_us,
                    clock_drift_ppb: (self.clock_drift_ppm * 1_000.0) as i64,
                    credentials: credentials.clone(),
                    authority: authority.clone(),
                    scripts: self.scripts.as_ref().map(|folder| folder.join(&name)),
                    boot_script: self.boot_script,
                    signers: signers.clone(),
                    ..EmulatorConfig::new(id)
                };
                config.machine.bounce_us_max = self.bounce_us;
                for limit in &self.limit {
                    limit.wire(&mut config).context("--limit")?;
                }
                for home in &self.home {
                    home.wire_home(&mut config).context("--home")?;
                }
                if self.cd {
                    config.add_cd(CD_MARGIN_STEPS).context("--cd")?;
                }
                config.check()?;
                Ok(config)
            })
            .collect()
    }
}

fn read_signers(file: &Path) -> Result<node::signed::Keys> {
    let name = file.display();
    let text = std::fs::read_to_string(file).with_context(|| format!("--signers {name}"))?;
    let list = keys::signers::parse(&text);
    let list = list.map_err(|error| anyhow::anyhow!("--signers {name}: {error}"))?;
    ensure!(!list.is_empty(), "--signers {name}: there is no key in it");
    let mut signers = node::signed::Keys::new();
    for signer in list {
        ensure!(
            signers.push(signer.key.0).is_ok(),
            "--signers {name}: more than {} keys",
            node::signed::KEYS_MAX
        );
    }
    Ok(signers)
}

fn read_authority(file: &Path) -> Result<tls::Authority> {
    let name = file.display();
    let text = std::fs::read(file).with_context(|| format!("--ca {name}"))?;
    tls::Authority::from_pem(&text).with_context(|| format!("--ca {name}"))
}

fn credentials(user: &str, password_file: &Path) -> Result<Credentials> {
    let password = keys::secret::read_password(password_file).context("--password-file")?;
    Ok(Credentials {
        user: user.to_owned(),
        password,
    })
}

/// Puts the node's name before the extension when there are several.
fn vcd_path(file: &Path, name: &NodeId, nodes: u16) -> PathBuf {
    if nodes == 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let extension = file
        .extension()
        .map_or(String::new(), |text| format!(".{}", text.to_string_lossy()));
    file.with_file_name(format!("{stem}-{name}{extension}"))
}

#[tokio::main]
async fn main() -> Result<ExitCode> {
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env()
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info")),
        )
        .with_writer(std::io::stderr)
        .init();
    let args = Args::parse();
    if let Some(Some(file)) = &args.check {
        return check_capture(file, args.job.as_deref());
    }
    #[cfg(unix)]
    if let Some(file) = &args.flash {
        return run_board(&args, file).await;
    }
    let mut handles = Vec::new();
    for config in args.configs()? {
        let name = config.name;
        let handle = emulator::spawn(config)?;
        let dump = args
            .vcd
            .as_ref()
            .map(|file| vcd_path(file, &name, args.nodes));
        if let Some(path) = &dump {
            let file = File::create(path).with_context(|| format!("--vcd {}", path.display()))?;
            handle
                .with(|node, _| node.dump_to(Box::new(BufWriter::new(file))))
                .with_context(|| format!("--vcd {}", path.display()))?;
        }
        handles.push((handle, dump));
    }
    wait_for_signal().await?;
    tracing::info!("stopping");
    finish(handles, args.check.is_some()).await
}

/// Judges a capture against a job.
fn check_capture(file: &Path, job: Option<&Path>) -> Result<ExitCode> {
    let job = job.context("--check CAPTURE needs --job FILE: what was played")?;
    let text = std::fs::read(job).with_context(|| format!("--job {}", job.display()))?;
    let request = JobRequest::from_json(&text)
        .map_err(|error| anyhow::anyhow!("--job {}: {}", job.display(), error.message))?;
    let Work::Commands(asked) = &request.work else {
        bail!(
            "--job {}: a script; only commands can be judged",
            job.display()
        );
    };
    // A capture shows one node: its barriers are passed at once.
    let commands: Vec<_> = asked.iter().map(|asked| asked.to_command(|_| 0)).collect();
    let name = file.display();
    let text = std::fs::read_to_string(file).with_context(|| format!("--check {name}"))?;
    let capture = Capture::read(&text).with_context(|| format!("{name}"))?;
    match capture.check(&commands) {
        Ok(summary) => {
            println!("{name}: good: {summary}");
            Ok(ExitCode::SUCCESS)
        }
        Err(violations) => {
            for violation in violations {
                println!("{name}: {violation}");
            }
            bail!("violations found");
        }
    }
}

/// Runs a whole board until a signal.
#[cfg(unix)]
async fn run_board(args: &Args, file: &Path) -> Result<ExitCode> {
    let flash = Flash::open(file).with_context(|| format!("--flash {}", file.display()))?;
    let base = args.configs()?.swap_remove(0);
    let board = EmulatedBoard::power_on(flash, base)?;
    if let Some(link) = &args.serial {
        let context = || format!("--serial {}", link.display());
        // Left over from a board whose power was cut.
        if link.is_symlink() {
            std::fs::remove_file(link).with_context(context)?;
        }
        std::os::unix::fs::symlink(board.port(), link).with_context(context)?;
    } else {
        println!("{}", board.port());
    }
    wait_for_signal().await?;
    if let Some(link) = &args.serial {
        std::fs::remove_file(link).with_context(|| format!("--serial {}", link.display()))?;
    }
    let mut good = true;
    let lives = board.power_off().await;
    if args.check.is_some() {
        good = judge("board", &lives);
    }
    if !good {
        bail!("violations found");
    }
    Ok(ExitCode::SUCCESS)
}

/// Ends all nodes and judges them if that was asked for.
async fn finish(handles: Vec<(EmulatedHandle, Option<PathBuf>)>, check: bool) -> Result<ExitCode> {
    let mut good = true;
    for (handle, dump) in handles {
        let name = handle.name();
        handle
            .with(|node, _| node.finish_dump())
            .with_context(|| format!("{name}: the value change dump is not whole"))?;
        let lives = handle.shutdown().await;
        if check {
            good &= judge(name.as_str(), &lives);
            // The dump ends with the first boot.
            if let (Some(path), Some(life)) = (dump, lives.first()) {
                append_verdict(&path, life).with_context(|| format!("--vcd {}", path.display()))?;
            }
        }
    }
    if check && !good {
        bail!("violations found");
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the verdict on one boot behind its dump.
fn append_verdict(path: &Path, life: &Life) -> std::io::Result<()> {
    let file = File::options().append(true).open(path)?;
    let verdict = oracle::check_life(life);
    verdict::write(BufWriter::new(file), &verdict, life.cut)
}

/// Prints the verdict on one node; `false` on a violation.
fn judge(name: &str, lives: &[Life]) -> bool {
    let mut good = true;
    for life in lives {
        match oracle::check_life(life) {
            Ok(summary) => println!("{name}: boot {:08x}: good: {summary}", life.boot),
            Err(violations) => {
                good = false;
                println!("{name}: boot {:08x}: VIOLATIONS", life.boot);
                for violation in violations {
                    println!("{name}:   {violation}");
                }
            }
        }
        if life.cut {
            println!("{name}:   the record was full, what came later was not judged");
        }
    }
    good
}

#[cfg(unix)]
async fn wait_for_signal() -> Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::select! {
        result = tokio::signal::ctrl_c() => result?,
        _ = terminate.recv() => {}
    }
    Ok(())
}

#[cfg(not(unix))]
async fn wait_for_signal() -> Result<()> {
    Ok(tokio::signal::ctrl_c().await?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(line: &[&str]) -> Vec<String> {
        let args = Args::parse_from([&["emulator"], line].concat());
        let configs = args.configs().expect("legal");
        configs
            .iter()
            .map(|config| config.name.to_string())
            .collect()
    }

    #[test]
    fn names_follow_from_name_and_number() {
        assert_eq!(names(&[]), ["node-1"]);
        assert_eq!(names(&["--name", "left"]), ["left"]);
        assert_eq!(names(&["--nodes", "2"]), ["node-1", "node-2"]);
        assert_eq!(
            names(&["--nodes", "2", "--name", "cell"]),
            ["cell-1", "cell-2"]
        );
    }

    #[test]
    fn bad_options_are_refused_with_their_name() {
        let error = |line: &[&str]| match Args::try_parse_from([&["emulator"], line].concat()) {
            Ok(args) => format!("{:#}", args.configs().expect_err("must be refused")),
            Err(error) => error.to_string(),
        };
        assert!(error(&["--name", "Left"]).contains("--name: \"Left\""));
        assert!(error(&["--prefix", "a//b"]).contains("--prefix a//b"));
        assert!(error(&["--clock-drift-ppm", "2e9"]).contains("--clock-drift-ppm"));
        assert!(error(&["--axes", "7"]).contains("--axes"));
        assert!(error(&["--nodes", "0"]).contains("--nodes"));
        assert!(error(&["--home", "0:low@3"]).contains("AXIS:SWITCH@STEPS"));
        assert!(error(&["--home", "2:min@3"]).contains("there is no axis 2"));
        assert!(error(&["--user", "u"]).contains("--password-file"));
        assert!(error(&["--ca", "/no/such.pem"]).contains("--ca /no/such.pem"));
        assert!(error(&["--ca", "Cargo.toml"]).contains("no certificate in it"));
        assert!(error(&["--ca", "a.pem", "--scout"]).contains("--scout"));
    }

    #[test]
    fn a_dump_of_several_nodes_has_a_file_for_each() {
        let name = NodeId::new("node-2").expect("legal");
        assert_eq!(
            vcd_path(Path::new("/tmp/a.vcd"), &name, 1),
            Path::new("/tmp/a.vcd")
        );
        assert_eq!(
            vcd_path(Path::new("/tmp/a.vcd"), &name, 2),
            Path::new("/tmp/a-node-2.vcd")
        );
        assert_eq!(vcd_path(Path::new("a"), &name, 2), Path::new("a-node-2"));
    }
}
