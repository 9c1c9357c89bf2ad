//! What can be typed about a gateway, its settings and its store.

use super::parse::node_id;
use clap::Args;
use keys::NodeId;
use std::path::PathBuf;

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
