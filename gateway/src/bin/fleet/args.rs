//! What can be typed.

use clap::{Args, Parser, Subcommand, ValueEnum};
use keys::{
    GroupId, JobId, NodeId,
    jog::{JogWay, LEASE_MS_DEFAULT, LEASE_MS_MAX, LEASE_MS_MIN},
    pace::{SPEED_PERCENT_MAX, SPEED_PERCENT_MIN},
    record::JobState,
};
use std::{path::PathBuf, time::Duration};

/// Where clients look for the gateway when nothing else is said.
pub(crate) const CONNECT_DEFAULT: &str = "tcp/127.0.0.1:7447";

const BEHIND_HELP: &str = "\
First steps:
  fleet demo                                  six emulated nodes, a job on each
  fleet serve                                 a gateway; leave it running
  fleet help node                             how to add a node
  fleet nodes                                 who is there
  fleet submit job.json --node left --wait    `fleet help submit`: what is a job
  fleet stop                                  all nodes, at once
  fleet release                               when the reason is gone

Exit codes:
  0  done
  1  the job or the request failed or was refused
  2  bad option or file
  3  no connection, or no gateway answers
  4  timed out waiting

Log on standard error: RUST_LOG says what (default for serve:
info,zenoh=error), FLEET_LOG=json makes each line a JSON object.
`fleet help TOPIC`: node, stop, trouble, client, gcode, service.";

/// The operator's command line of a fleet of stepper controllers.
#[derive(Debug, Parser)]
#[command(name = "fleet", version, max_term_width = 100, disable_help_subcommand = true, after_help = BEHIND_HELP)]
pub(crate) struct Line {
    #[command(flatten)]
    pub(crate) common: Common,
    #[command(subcommand)]
    pub(crate) verb: Verb,
}

impl Common {
    /// Returns the keys of the fleet.
    pub(crate) fn keys(&self) -> keys::Keys {
        self.prefix.clone().unwrap_or_default()
    }
}

/// Options of every command.
#[derive(Debug, Args)]
#[command(next_help_heading = "Connection and output")]
pub(crate) struct Common {
    /// Gateway or zenoh router to connect to [default: tcp/127.0.0.1:7447; serve: none, it brings
    /// its own router]
    #[arg(
        long,
        global = true,
        value_name = "tcp/HOST:PORT",
        env = "FLEET_CONNECT"
    )]
    pub(crate) connect: Option<String>,

    /// Prefix of all keys of the fleet [default: fleet]
    #[arg(long, global = true, env = "FLEET_PREFIX", value_parser = prefix)]
    pub(crate) prefix: Option<keys::Keys>,

    /// File that `fleet users` made: where to connect, as whom, and whom to trust. Nobody but you
    /// may be able to read it.
    #[arg(
        long,
        global = true,
        value_name = "FILE",
        env = "FLEET_CREDENTIALS",
        conflicts_with = "user"
    )]
    pub(crate) credentials: Option<PathBuf>,

    /// User for a router that asks.
    #[arg(long, global = true, requires = "password_file")]
    pub(crate) user: Option<String>,

    /// File with the user's password; a newline at its end does not count.
    #[arg(long, global = true, value_name = "FILE", requires = "user")]
    pub(crate) password_file: Option<PathBuf>,

    /// Longest wait for a connection and for each answer, s.
    #[arg(long, global = true, value_name = "SECONDS", default_value = "10", value_parser = seconds)]
    pub(crate) timeout: Duration,

    /// Print one JSON object per line, for scripts.
    #[arg(long, global = true)]
    pub(crate) json: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Verb {
    /// Run the gateway, with its own zenoh router unless --connect joins one.
    #[command(after_help = "\
Examples:
  fleet serve
  fleet serve --store /var/lib/fleet.redb
  fleet serve --listen tcp/0.0.0.0:7447    # unsecured, and open to the whole network
  fleet serve --secure /etc/fleet          # TLS, passwords and roles; see `fleet init`
  fleet serve --connect tcp/router:7447    # join an existing zenoh network")]
    Serve(Serve),

    /// Print every setting of `fleet.toml` with its default, or check a file.
    #[command(after_help = "\
Examples:
  fleet config > fleet.toml
  fleet config fleet.toml
  fleet serve --config fleet.toml")]
    Config(Config),

    /// Read a G-code program and tell its time and bounds; nothing moves, no gateway is asked.
    #[command(after_help = "\
Examples:
  fleet check part.gcode --config /etc/fleet.toml --node left
  fleet check part.gcode --config fleet.toml --commands > part.json")]
    Check(Check),

    /// Make a secured fleet: TLS with its own authority, users with roles, everything else denied.
    #[command(after_help = "\
Examples:
  fleet init /etc/fleet --host plant.local --host 192.168.1.5
  fleet serve --secure /etc/fleet
  fleet --credentials /etc/fleet/operator.json nodes")]
    Init(Init),

    /// Copy the store of a running gateway into a file; it goes on meanwhile.
    #[command(after_help = "\
Examples:
  fleet backup monday.redb
  fleet --credentials /etc/fleet/operator.json backup monday.redb
  fleet backup monday.redb --store /var/lib/fleet.redb    # of a gateway that does not run
To go back: end the gateway, put the backup in the place of its store, start it.")]
    Backup(Backup),

    /// Tell what is in a store or a backup, and what is wrong with it; changes nothing.
    #[command(
        after_help = "Examples:\n  fleet doctor /var/lib/fleet.redb\n  fleet doctor monday.redb"
    )]
    Doctor(Doctor),

    /// Add, revoke and list the users of a secured fleet.
    #[command(after_help = "\
Examples:
  fleet users /etc/fleet add alice --role viewer
  fleet users /etc/fleet add left --role node
  fleet users /etc/fleet revoke alice
  fleet users /etc/fleet list")]
    Users(Users),

    /// Make, list and revoke the keys with which operators sign jobs.
    ///
    /// While there is one, only signed jobs are executed.
    #[command(after_help = "\
Examples:
  fleet keys /etc/fleet new alice       # alice.key for her; /etc/fleet/signers for every node
  fleet submit job.json --node left --sign alice.key
  fleet keys /etc/fleet revoke alice")]
    Keys(Keys),

    /// List the nodes.
    #[command(after_help = "Examples:\n  fleet nodes\n  fleet nodes --json | jq -r .node")]
    Nodes,

    /// Hand in a job: JSON commands, a Lua script, or G-code.
    #[command(after_help = "\
Commands; ways in steps, accel in steps/s², jerk in steps/s³:
  {\"move\":{\"axis\":0,\"delay_us\":500,\"steps\":-2000}}                  no ramp
  {\"sync_move\":{\"delay_us\":[500,1000],\"steps\":[2000,1000]}}         axes 0 and 1
  {\"ramp\":{\"axis\":0,\"steps\":1000,\"speed_hz\":500,\"accel\":100}}     relative (1)
  {\"ramp_to\":{\"axis\":0,\"position\":0,\"speed_hz\":500,\"accel\":100}}  absolute (1)
  {\"smooth_ramp\":{\"axis\":0,\"steps\":6000,\"start_hz\":500,\"speed_hz\":1500,
                  \"ramp_steps\":500}}                         relative (3)
  {\"smooth_ramp_to\":{\"axis\":0,\"position\":0,…}}         the same, absolute (3)
  {\"line\":{\"steps\":[9000,4000],\"speed_hz\":5000,\"accel\":10000}}    all axes (2)
  {\"pause\":{\"ms\":100}}  {\"laser\":{\"power_percent\":50}}  {\"lidar_read\":{}}
  {\"set_position\":{\"axis\":0,\"position\":0}}  {\"barrier\":{\"name\":\"layer-2\"}}
  {\"wait_resume\":{}}       rests until `fleet resume`; not in synchronized jobs
  (1) may have \"linear_steps\" and \"jump_steps\", or \"jerk\"  (2) may have \"jerk\"
  (3) speed by 3x² - 2x³ over ramp_steps, ESP-IDF's smoothstep; start < speed

Examples:
  fleet submit square.json --node left --wait
  fleet submit drill.lua --node 'cell-$*' --id drill-7
  fleet submit part.gcode --node left --wait     # `fleet check` tells its time and bounds
  fleet submit cut.json --group table --wait
  fleet submit hole.gcode --node left --set depth=4 --set x=10    # ${depth} and ${x} in the file
  fleet submit --template hole --set depth=4 --set x=10 --node left   # `fleet template put`
  fleet submit clean.lua --label mill --when-idle
  fleet submit warm-up.json --node left --at 2026-11-23T05:00:00Z
  echo '{\"commands\":[{\"move\":{\"axis\":0,\"delay_us\":500,\"steps\":2000}}]}' | \\
      fleet submit - --node left --wait=60")]
    Submit(Submit),

    /// List jobs, newest first.
    #[command(
        after_help = "Examples:\n  fleet jobs --limit 10\n  fleet jobs --state failed --node left\n  fleet jobs --limit 1000 --export csv > history.csv"
    )]
    Jobs(Jobs),

    /// Tell the way of a job, step by step.
    #[command(after_help = "Examples:\n  fleet trace part-7")]
    Trace(Trace),

    /// Give labels to nodes, take them away, or show how nodes are arranged.
    #[command(after_help = "\
Examples:
  fleet label left mill big       # and now: fleet submit part.json --label mill
  fleet label left --remove big
  fleet label                     # labels, maintenance and queue of every node")]
    Label(Label),

    /// Let a node take no jobs, and say why; or let it take jobs again.
    #[command(after_help = "\
Examples:
  fleet maintenance left 'new belt, Bob'
  fleet maintenance left --end")]
    Maintenance(Maintenance),

    /// Let the jobs that wait for a node go on waiting.
    ///
    /// New ones are taken, none begins. What moves goes on; `fleet hold` is for that.
    #[command(after_help = "\
Examples:
  fleet queue left hold
  fleet queue left resume")]
    Queue(Queue),

    /// Keep jobs with ${NAME} in them in the gateway, for everybody who hands in jobs.
    #[command(after_help = "\
Examples:
  fleet template put drill drill.gcode --about 'a hole, mm'
  fleet template list
  fleet submit --template drill --set depth=4 --set x=10 --node left")]
    Template(crate::kept::Templates),

    /// Hand in a job again and again, at times in UTC.
    ///
    /// A time that passes while the gateway does not run, or while the job before has not ended, is left
    /// out and counted as missed.
    #[command(after_help = "\
Examples:
  fleet schedule add warm-up warm.json --label mill --daily 05:00
  fleet schedule add purge --template purge --set ml=5 --node left --every 10m
  fleet schedule list
  fleet schedule delete purge")]
    Schedule(crate::kept::Schedules),

    /// Change the order of jobs that wait.
    #[command(after_help = "\
Examples:
  fleet move part-7 --before part-3
  fleet move part-7 --priority 10")]
    Move(Move),

    /// Show nodes and jobs as they change, until Ctrl-C.
    #[command(after_help = "\
Examples:
  fleet watch
  fleet watch --json --seconds 60 | jq -c 'select(.job) | [.job, .state]'")]
    Watch(Watch),

    /// Cancel a job; one that runs comes to rest by the ramp of its axes.
    #[command(after_help = "Examples:\n  fleet cancel part-0815")]
    Cancel(Cancel),

    /// Stop nodes and wait until each has confirmed; works without a gateway too.
    #[command(
        after_help = "Examples:\n  fleet stop\n  fleet stop left --decelerate\n  fleet stop 'cell-$*'"
    )]
    Stop(Stop),

    /// Lift the stop latch of nodes and wait until each has confirmed.
    #[command(after_help = "Examples:\n  fleet release left\n  fleet release")]
    Release(Release),

    /// Bring nodes to rest on their path, without losing it; `fleet resume` goes on.
    #[command(after_help = "\
A held node keeps its job, its queue and its exact place. New jobs wait. A stop ends a hold. \
A start that all nodes have agreed on is made first.

Examples:
  fleet hold left
  fleet hold 'cell-$*'
  fleet resume left")]
    Hold(Pace),

    /// Let nodes go on after `fleet hold`.
    #[command(after_help = "Examples:\n  fleet resume left\n  fleet resume '*'")]
    Resume(Pace),

    /// Move single axes of a node by hand, while no job runs.
    #[command(after_help = "\
A run goes on while this command runs: it renews the node's lease, and Ctrl-C, a broken connection or \
a closed terminal bring the axis to rest. A move to a place goes on by itself: `fleet jog NODE --stop` \
or `fleet stop NODE` ends it. Soft limits and switches hold as ever. --by is relative to where the axis \
is going; --by 0 changes its speed only.

Examples:
  fleet jog left --axis 0 --run +                  # until Ctrl-C
  fleet jog left --axis 0 --run - --speed 200
  fleet jog left --axis 1 --to 2500 --speed 1000 --accel 5000
  fleet jog left --axis 1 --step +
  fleet jog left --stop                            # all axes, each by its ramp")]
    Jog(Jog),

    /// Change the speed of ramps and lines, also of those under way.
    #[command(after_help = "\
The speed stays until it is changed or the node restarts. It is never faster than the drivers allow; \
raw moves keep their delay.

Examples:
  fleet speed left 50
  fleet speed left        # as the commands say")]
    Speed(Speed),

    /// Tell a node on a serial port its name, network and router.
    ///
    /// Without options: show what it was told.
    #[command(after_help = "\
Examples:
  fleet provision /dev/ttyACM0 --name left --wifi shop --wifi-password-file wifi.txt \\
      --router tcp/10.0.0.1:7447 --restart
  fleet provision /dev/ttyACM0 --boot-script --signers /etc/fleet/signers --restart
  fleet provision /dev/ttyACM0")]
    Provision(crate::provision::Provision),

    /// Store a Lua script on a node; list, show or remove such scripts.
    ///
    /// Jobs call it by its name. The one named `boot` runs when the node starts, if `fleet provision` has
    /// allowed that.
    #[command(after_help = "\
Examples:
  fleet script left clean --put clean.lua      # and now: {\"call\":\"clean\",\"args\":{\"times\":3}}
  fleet script left                            # what is stored there
  fleet script left clean                      # its text
  fleet script left clean --remove
  fleet script left boot --put home.lua --sign alice.key    # a node that executes only what is signed")]
    Script(crate::script::Script),

    /// Give a node another firmware over the network, or show what it runs.
    ///
    /// The node tries it: if it does not reach the router within a minute, the one before runs again.
    #[command(after_help = "\
Examples:
  fleet update-key update.key              # once; update.pub is for `fleet provision`
  espflash save-image --chip esp32s3 target/xtensa-esp32s3-none-elf/release/firmware new.bin
  fleet update left new.bin --key update.key
  fleet update left")]
    Update(Update),

    /// Make a pair of keys that firmware is signed with.
    #[command(after_help = "Examples:\n  fleet update-key update.key")]
    UpdateKey(UpdateKey),

    /// Explain a command or a topic: node, stop, trouble, client, gcode, service.
    #[command(after_help = "Examples:\n  fleet help trouble\n  fleet help submit")]
    Help(Help),

    /// Print a script that completes this program's commands in a shell.
    #[command(after_help = "\
Examples:
  fleet completions bash > /usr/share/bash-completion/completions/fleet
  fleet completions fish > ~/.config/fish/completions/fleet.fish")]
    Completions(Completions),

    /// Print the manual page, with all commands.
    #[command(after_help = "Examples:\n  fleet man > fleet.1 && man ./fleet.1")]
    Man,

    /// Run a gateway and six emulated nodes, play a job on each, and check every pulse.
    #[cfg(feature = "demo")]
    Demo,

    /// Measure what a gateway and emulated nodes do on this machine.
    #[cfg(feature = "demo")]
    #[command(after_help = "\
intake   jobs accepted durably, jobs executed and records, 1/s
batches  batches and commands to all nodes, 1/s
pulse    put of a job to the first pulse, up to 100 nodes
scale    1,000 nodes that move: processors, memory, a start of 100 together, a stop for all
Gateway and nodes share this machine's processors with the client that measures.

Examples:
  cargo run --release -p gateway -- bench
  cargo run --release -p gateway -- bench scale --nodes 1000")]
    Bench(Bench),

    /// The nodes of `bench`, in a process of their own.
    #[cfg(feature = "demo")]
    #[command(hide = true)]
    BenchNodes(BenchNodes),
}

/// What `fleet bench` measures.
#[cfg(feature = "demo")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum What {
    Intake,
    Batches,
    Pulse,
    Scale,
}

#[cfg(feature = "demo")]
#[derive(Debug, Args)]
pub(crate) struct Bench {
    /// What is measured [default: everything]
    #[arg(value_enum)]
    pub(crate) what: Vec<What>,

    /// Sizes of the fleet, one after the other.
    #[arg(long, value_name = "COUNT", value_delimiter = ',', default_value = "1,10,100", value_parser = node_count)]
    pub(crate) nodes: Vec<usize>,

    /// How long each thing is measured that has no end of its own, s.
    #[arg(long, value_name = "SECONDS", default_value = "3", value_parser = seconds)]
    pub(crate) seconds: Duration,
}

#[cfg(feature = "demo")]
#[derive(Debug, Args)]
pub(crate) struct BenchNodes {
    /// How many.
    #[arg(value_parser = node_count)]
    pub(crate) count: usize,

    /// Where they connect.
    pub(crate) connect: String,
}

#[cfg(feature = "demo")]
fn node_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count @ 1..=4_000) => Ok(count),
        _ => Err("1 to 4000".to_owned()),
    }
}

#[derive(Debug, Args)]
pub(crate) struct Update {
    /// The node.
    #[arg(value_parser = node_id)]
    pub(crate) node: NodeId,

    /// Image, as `espflash save-image` makes it.
    #[arg(requires = "key")]
    pub(crate) image: Option<PathBuf>,

    /// File with the key that signs it. Nobody but you may be able to read it.
    #[arg(long, value_name = "FILE")]
    pub(crate) key: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct UpdateKey {
    /// File of the key; the one for nodes is beside it and ends in .pub.
    pub(crate) file: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Serve {
    /// Where the router listens; may be given several times. Port 0: the system chooses one.
    /// [default: tcp/127.0.0.1:7447; with --secure: tls/0.0.0.0:7447 for people and
    /// tcp/0.0.0.0:7448 for nodes]
    #[arg(
        long,
        value_name = "tcp/HOST:PORT",
        env = "FLEET_LISTEN",
        value_delimiter = ','
    )]
    pub(crate) listen: Vec<String>,

    /// Settings; `fleet config` prints them all. What is said here or in the environment wins.
    #[arg(long, value_name = "FILE", env = "FLEET_CONFIG")]
    pub(crate) config: Option<PathBuf>,

    /// File of jobs and nodes; made if it is not there [default: fleet.redb]
    #[arg(long, value_name = "FILE", env = "FLEET_STORE")]
    pub(crate) store: Option<PathBuf>,

    /// Who may connect to the own router: lines NAME:PASSWORD, one of them `gateway`, as which
    /// the gateway itself connects. Without it: everybody.
    #[arg(long, value_name = "FILE", conflicts_with = "connect")]
    pub(crate) users: Option<PathBuf>,

    /// Folder of a secured fleet, made by `fleet init`.
    #[arg(long, value_name = "DIR", env = "FLEET_SECURE", conflicts_with_all = ["connect", "users"])]
    pub(crate) secure: Option<PathBuf>,

    /// Serve /metrics (Prometheus) and /healthz by HTTP, for example on 127.0.0.1:9447.
    #[arg(long, value_name = "HOST:PORT", env = "FLEET_HTTP")]
    pub(crate) http: Option<std::net::SocketAddr>,

    /// Send a span for each job to this collector of OpenTelemetry, OTLP by HTTP; needs a build with
    /// the feature `otel`.
    #[arg(long, value_name = "http://HOST:PORT", env = "FLEET_OTLP")]
    pub(crate) otlp: Option<gateway::collector::Collector>,

    /// Stand by beside another gateway with the same store, and take over when it has gone.
    #[arg(long)]
    pub(crate) standby: bool,

    /// Look for other zenoh routers by multicast, and let yourself be found.
    #[arg(long)]
    pub(crate) scouting: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Config {
    /// Check this file instead.
    pub(crate) file: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct Backup {
    /// Where to; a file that exists is left alone.
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,

    /// Copy this store, which no gateway has, instead of asking a gateway for its own.
    #[arg(long, value_name = "FILE")]
    pub(crate) store: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct Doctor {
    /// The store of a gateway that does not run, or a backup.
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The program.
    pub(crate) file: PathBuf,

    /// The gateway's settings, of which the section [node.NAME] says what the machine is like.
    #[arg(long, value_name = "FILE", env = "FLEET_CONFIG")]
    pub(crate) config: Option<PathBuf>,

    /// Whose machine [default: the only one there is].
    #[arg(long, value_parser = node_id)]
    pub(crate) node: Option<NodeId>,

    /// Print the job in JSON that the node would get.
    #[arg(long)]
    pub(crate) commands: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Init {
    /// Where; made if it is not there, and readable by you only.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,

    /// Name or address under which clients and nodes reach the gateway's machine; may be given
    /// several times. `localhost` is always one.
    #[arg(long = "host", value_name = "NAME")]
    pub(crate) hosts: Vec<String>,

    /// The first operator.
    #[arg(long, value_name = "NAME", default_value = "operator", value_parser = node_id)]
    pub(crate) operator: NodeId,
}

#[derive(Debug, Args)]
pub(crate) struct Users {
    /// Folder of the fleet.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,

    #[command(subcommand)]
    pub(crate) act: UsersAct,
}

/// What to do with users. All of it counts from the gateway's next start.
#[derive(Debug, Subcommand)]
pub(crate) enum UsersAct {
    /// Add one, and write the credentials to hand out to DIR/NAME.json.
    Add {
        /// Name; a node's is its own.
        #[arg(value_parser = node_id)]
        name: NodeId,
        /// `operator` hands in, cancels, stops and releases; `viewer` looks on and stops; `node` is
        /// the node of that name.
        #[arg(long)]
        role: gateway::security::Role,
    },
    /// Take one away.
    Revoke {
        /// Name.
        #[arg(value_parser = node_id)]
        name: NodeId,
    },
    /// List them.
    List,
}

#[derive(Debug, Args)]
pub(crate) struct Keys {
    /// Folder of the fleet.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,

    #[command(subcommand)]
    pub(crate) act: KeysAct,
}

/// What to do with signing keys. All of it counts from the next start of gateway and nodes.
#[derive(Debug, Subcommand)]
pub(crate) enum KeysAct {
    /// Make one, and write the private half to hand out to DIR/NAME.key.
    New {
        /// Whose.
        #[arg(value_parser = node_id)]
        name: NodeId,
    },
    /// Take one away.
    Revoke {
        /// Whose.
        #[arg(value_parser = node_id)]
        name: NodeId,
    },
    /// List the public halves.
    List,
    /// Let jobs without a signature in again. Revoking the last key does not.
    Off,
}

#[derive(Debug, Args)]
pub(crate) struct Submit {
    /// The job; `-`: standard input.
    #[arg(value_name = "FILE|-", required_unless_present = "template")]
    pub(crate) file: Option<PathBuf>,

    /// The job is this template of the gateway (`fleet template`), filled in by --set.
    #[arg(long, conflicts_with_all = ["file", "format"], value_parser = group_id)]
    pub(crate) template: Option<GroupId>,

    /// Node, or pattern with `*` or `$*`: a job for each node that is alive and matches.
    #[arg(long, value_name = "PATTERN", value_parser = pattern, required_unless_present_any = ["group", "label"])]
    pub(crate) node: Option<String>,

    /// Label: a job for each node that has it and is alive (`fleet label`).
    #[arg(long, conflicts_with_all = ["node", "group"], value_parser = group_id)]
    pub(crate) label: Option<GroupId>,

    /// With --label: all of them start at one instant.
    #[arg(long, requires = "label")]
    pub(crate) together: bool,

    /// Group: the file has a part for each of its nodes, and all start at one instant.
    #[arg(long, conflicts_with = "node", value_parser = group_id)]
    pub(crate) group: Option<GroupId>,

    /// Name of the job; makes it idempotent. Replaces the one in the file.
    #[arg(long, value_parser = job_id)]
    pub(crate) id: Option<JobId>,

    /// Sign the job with this key, for this start of the node, or of each node of a group; they must be
    /// there.
    #[arg(long, value_name = "FILE")]
    pub(crate) sign: Option<PathBuf>,

    /// What the file is [default: by its extension
    /// (.json, .lua, .gcode, .nc, .ngc, .tap); else JSON if it begins with `{`, Lua if not].
    #[arg(long, value_enum)]
    pub(crate) format: Option<Format>,

    /// What stands for ${NAME} in the file; may be given several times. The file is a template then,
    /// and each of its names needs a value.
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = setting)]
    pub(crate) settings: Vec<(String, String)>,

    /// Among jobs that wait: -100 to 100, higher goes first.
    #[arg(long, allow_negative_numbers = true, value_parser = clap::value_parser!(i8).range(-100..=100))]
    pub(crate) priority: Option<i8>,

    /// Only when nothing else waits for the node.
    #[arg(long, conflicts_with = "priority")]
    pub(crate) when_idle: bool,

    /// Not before this time, in UTC: 2026-11-22T03:00:00Z.
    #[arg(long, value_name = "TIME", value_parser = instant)]
    pub(crate) at: Option<keys::FleetMicros>,

    /// Wait until the job has ended, SECONDS at most if given; exit code 1 if it did not succeed.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, value_parser = seconds)]
    pub(crate) wait: Option<Option<Duration>>,
}

/// How a job is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// An object with `commands` or `lua`.
    Json,
    /// The script itself.
    Lua,
    /// The common subset of GRBL, for one node whose machine is in the gateway's fleet.toml.
    Gcode,
}

#[derive(Debug, Args)]
pub(crate) struct Jobs {
    /// Only jobs in this state.
    #[arg(long, value_parser = job_state())]
    pub(crate) state: Option<JobState>,

    /// Only jobs of this node.
    #[arg(long, value_parser = node_id)]
    pub(crate) node: Option<NodeId>,

    /// Print history for another program.
    #[arg(long, value_enum, conflicts_with = "json")]
    pub(crate) export: Option<Export>,

    /// Most jobs.
    #[arg(long, value_name = "COUNT", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=1_000))]
    pub(crate) limit: u16,
}

/// How a list is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Export {
    /// Comma-separated values with a line of heads (RFC 4180).
    Csv,
    /// One list of records.
    Json,
}

#[derive(Debug, Args)]
pub(crate) struct Help {
    /// A topic, or a command.
    pub(crate) topic: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct Completions {
    /// For which shell.
    #[arg(value_enum)]
    pub(crate) shell: clap_complete::Shell,
}

#[derive(Debug, Args)]
pub(crate) struct Trace {
    /// The job.
    #[arg(value_name = "JOB", value_parser = job_id)]
    pub(crate) job: JobId,
}

#[derive(Debug, Args)]
pub(crate) struct Label {
    /// Node, or pattern with `*` or `$*`; without labels: what to show.
    #[arg(value_name = "NODE", default_value = "*", value_parser = pattern)]
    pub(crate) node: String,

    /// Labels to give.
    #[arg(value_name = "LABEL", value_parser = group_id)]
    pub(crate) labels: Vec<GroupId>,

    /// Label to take away; may be given several times.
    #[arg(long, value_name = "LABEL", value_parser = group_id)]
    pub(crate) remove: Vec<GroupId>,
}

#[derive(Debug, Args)]
pub(crate) struct Maintenance {
    /// Node, or pattern with `*` or `$*`.
    #[arg(value_name = "NODE", value_parser = pattern)]
    pub(crate) node: String,

    /// Why: whoever hands in a job is told.
    #[arg(required_unless_present = "end", conflicts_with = "end")]
    pub(crate) reason: Option<String>,

    /// It takes jobs again.
    #[arg(long)]
    pub(crate) end: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Queue {
    /// Node, or pattern with `*` or `$*`.
    #[arg(value_name = "NODE", value_parser = pattern)]
    pub(crate) node: String,

    /// What to do with its queue.
    #[arg(value_enum)]
    pub(crate) wish: QueueWish,
}

/// What to do with a queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum QueueWish {
    /// The job that runs ends, the next one does not begin.
    Hold,
    /// They go on.
    Resume,
}

#[derive(Debug, Args)]
pub(crate) struct Move {
    /// The job that waits.
    #[arg(value_name = "JOB", value_parser = job_id)]
    pub(crate) job: JobId,

    /// Right before this one, with its priority.
    #[arg(long, value_name = "JOB", value_parser = job_id, required_unless_present = "priority")]
    pub(crate) before: Option<JobId>,

    /// -100 to 100, higher goes first.
    #[arg(long, conflicts_with = "before", allow_negative_numbers = true, value_parser = clap::value_parser!(i8).range(-100..=100))]
    pub(crate) priority: Option<i8>,
}

#[derive(Debug, Args)]
pub(crate) struct Watch {
    /// End after this time, s.
    #[arg(long, value_parser = seconds)]
    pub(crate) seconds: Option<Duration>,
}

#[derive(Debug, Args)]
pub(crate) struct Cancel {
    /// The job, or pattern with `*` or `$*`.
    #[arg(value_name = "JOB", value_parser = pattern)]
    pub(crate) job: String,
}

#[derive(Debug, Args)]
pub(crate) struct Stop {
    /// Node, or pattern with `*` or `$*`; all nodes by default.
    #[arg(default_value = "*", value_parser = pattern)]
    pub(crate) pattern: String,

    /// Come to rest by the ramp of each axis instead of at once.
    #[arg(long)]
    pub(crate) decelerate: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Release {
    /// Node, or pattern with `*` or `$*`; all nodes by default.
    #[arg(default_value = "*", value_parser = pattern)]
    pub(crate) pattern: String,
}

#[derive(Debug, Args)]
pub(crate) struct Pace {
    /// Node, or pattern with `*` or `$*`.
    #[arg(value_name = "NODE", value_parser = pattern)]
    pub(crate) pattern: String,
}

#[derive(Debug, Args)]
pub(crate) struct Speed {
    /// Node, or pattern with `*` or `$*`.
    #[arg(value_name = "NODE", value_parser = pattern)]
    pub(crate) pattern: String,

    /// Percent of what the commands ask for.
    #[arg(default_value_t = 100, value_parser = clap::value_parser!(u16)
        .range(i64::from(SPEED_PERCENT_MIN)..=i64::from(SPEED_PERCENT_MAX)))]
    pub(crate) percent: u16,
}

#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
pub(crate) struct Jog {
    /// Node.
    #[arg(value_name = "NODE")]
    pub(crate) node: NodeId,

    /// Axis number, from 0.
    #[arg(long, required_unless_present = "stop")]
    pub(crate) axis: Option<u8>,

    /// To this position, steps.
    #[arg(
        long,
        value_name = "POSITION",
        group = "what",
        allow_hyphen_values = true
    )]
    pub(crate) to: Option<i64>,

    /// So many steps from where it is going.
    #[arg(long, value_name = "STEPS", group = "what", allow_hyphen_values = true)]
    pub(crate) by: Option<i64>,

    /// One step.
    #[arg(long, value_name = "+|-", group = "what", value_parser = way, allow_hyphen_values = true)]
    pub(crate) step: Option<JogWay>,

    /// On and on, until this command ends.
    #[arg(long, value_name = "+|-", group = "what", value_parser = way, allow_hyphen_values = true)]
    pub(crate) run: Option<JogWay>,

    /// Comes to rest by its ramp; without --axis all of them.
    #[arg(long, group = "what")]
    pub(crate) stop: bool,

    /// Speed, Hz.
    #[arg(long, default_value_t = 500, value_name = "HZ")]
    pub(crate) speed: u32,

    /// Acceleration, steps/s².
    #[arg(long, default_value_t = 2_000, value_name = "STEPS/S2")]
    pub(crate) accel: u32,

    /// Jerk, steps/s³: makes it an S-curve.
    #[arg(long, value_name = "STEPS/S3")]
    pub(crate) jerk: Option<u32>,

    /// How long a run goes on when this command is gone, ms.
    #[arg(long, default_value_t = LEASE_MS_DEFAULT, value_name = "MS",
        value_parser = clap::value_parser!(u32).range(i64::from(LEASE_MS_MIN)..=i64::from(LEASE_MS_MAX)))]
    pub(crate) lease: u32,
}

fn way(text: &str) -> Result<JogWay, String> {
    match text {
        "+" | "forward" => Ok(JogWay::Forward),
        "-" | "backward" => Ok(JogWay::Backward),
        _ => Err("+ or -".into()),
    }
}

fn prefix(text: &str) -> Result<keys::Keys, String> {
    keys::Keys::new(text).map_err(|error| error.to_string())
}

fn node_id(text: &str) -> Result<NodeId, String> {
    NodeId::new(text).map_err(|error| error.to_string())
}

fn group_id(text: &str) -> Result<GroupId, String> {
    GroupId::new(text).map_err(|error| error.to_string())
}

fn job_id(text: &str) -> Result<JobId, String> {
    JobId::new(text).map_err(|error| error.to_string())
}

pub(crate) fn setting(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("NAME=VALUE")?;
    if name.is_empty()
        || !name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    {
        return Err("a name consists of letters, digits and _".to_owned());
    }
    Ok((name.to_owned(), value.to_owned()))
}

pub(crate) fn instant(text: &str) -> Result<keys::FleetMicros, String> {
    keys::FleetMicros::from_rfc3339(text)
        .ok_or_else(|| "a time in UTC: 2026-11-22T03:00:00Z".into())
}

fn job_state() -> impl clap::builder::TypedValueParser<Value = JobState> {
    use clap::builder::TypedValueParser as _;
    let words = JobState::ALL.map(JobState::as_str);
    clap::builder::PossibleValuesParser::new(words)
        .map(|word| word.parse().expect("the words are those of the states"))
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| format!("{text:?} is no number of seconds"))?;
    Duration::try_from_secs_f64(seconds)
        .ok()
        .filter(|duration| !duration.is_zero() && *duration <= Duration::from_secs(86_400))
        .ok_or_else(|| "more than 0 and at most 86400 seconds".to_owned())
}

/// A name, or one chunk of a key expression.
pub(crate) fn pattern(text: &str) -> Result<String, String> {
    let words = "a name of a-z, 0-9, _ and -, or a pattern of such with `*` alone or `$*`";
    let legal =
        |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_-$*".contains(&byte);
    if text.is_empty()
        || !text.bytes().all(legal)
        || zenoh::key_expr::keyexpr::new(text).is_err()
        || text == "**"
        || (!text.contains('*') && NodeId::new(text).is_err())
    {
        return Err(words.to_owned());
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_of_the_line_is_sound() {
        Line::command().debug_assert();
    }

    #[test]
    fn the_list_of_commands_has_one_short_sentence_for_each() {
        for command in Line::command().get_subcommands() {
            let about = command.get_about().expect("a sentence").to_string();
            assert!(about.chars().count() <= 90, "{about}");
            assert!(!about.contains(". "), "{about}");
        }
    }

    #[test]
    fn a_pattern_is_one_chunk_of_a_key() {
        for good in ["left", "*", "cell-$*", "$*-x", "part-0815"] {
            assert_eq!(pattern(good).as_deref(), Ok(good));
        }
        for bad in ["", "**", "a/b", "Left", "a*b", "$", "a?", "-x", "*$*"] {
            assert!(pattern(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn times_are_numbers_of_seconds_above_zero() {
        assert_eq!(seconds("0.5"), Ok(Duration::from_millis(500)));
        for bad in ["0", "-1", "x", "nan", "inf", "1e9"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_job_is_for_nodes_or_for_a_group() {
        let parse = |line: &[&str]| {
            let line = [&["fleet", "submit", "a.json"], line].concat();
            Line::try_parse_from(line).is_ok()
        };
        assert!(parse(&["--node", "left"]) && parse(&["--group", "table"]));
        assert!(!parse(&[]) && !parse(&["--node", "left", "--group", "table"]));
        assert!(!parse(&["--group", "ta$*"]));
    }

    #[test]
    fn waiting_takes_a_limit_only_behind_an_equals_sign() {
        let wait = |line: &[&str]| {
            let line = [&["fleet", "submit", "a.json", "--node", "left"], line].concat();
            match Line::try_parse_from(line).expect("legal").verb {
                Verb::Submit(submit) => submit.wait,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(wait(&[]), None);
        assert_eq!(wait(&["--wait"]), Some(None));
        assert_eq!(wait(&["--wait=3"]), Some(Some(Duration::from_secs(3))));
    }
}
