//! What can be typed.

mod image;
mod jobs;
mod jog;
#[cfg(feature = "demo")]
mod measure;
mod node;
mod parse;
mod people;
mod service;

pub(crate) use image::{Update, UpdateKey};
pub(crate) use jobs::{Cancel, Export, Format, Jobs, Move, Submit, Trace};
pub(crate) use jog::Jog;
#[cfg(feature = "demo")]
pub(crate) use measure::{Bench, BenchNodes, What};
pub(crate) use node::{Label, Maintenance, Pace, Queue, QueueWish, Release, Setup, Speed, Stop};
pub(crate) use parse::{instant, pattern, setting};
pub(crate) use people::{Init, Keys, KeysAct, Users, UsersAct};
pub(crate) use service::{Backup, Check, Config, Doctor, Serve};

use clap::{Args, Parser, Subcommand};
use parse::{prefix, seconds};
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

    /// Tell how a node is set: axes, switches, outputs, its way to the router; nothing secret.
    ///
    /// The node itself answers, so it must be there; what is written to its flash since its start shows
    /// behind the next one.
    #[command(after_help = "\
Examples:
  fleet setup left
  fleet setup 'cell-$*' --json | jq '{name, driver: .axes[0].driver}'")]
    Setup(Setup),

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
pub(crate) struct Watch {
    /// End after this time, s.
    #[arg(long, value_parser = seconds)]
    pub(crate) seconds: Option<Duration>,
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
