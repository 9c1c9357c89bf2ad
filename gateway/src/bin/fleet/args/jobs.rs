//! What can be typed about jobs.

use super::parse::{group_id, instant, job_id, job_state, node_id, pattern, seconds, setting};
use clap::{Args, ValueEnum};
use keys::{GroupId, JobId, NodeId, record::JobState};
use std::{path::PathBuf, time::Duration};

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
pub(crate) struct Trace {
    /// The job.
    #[arg(value_name = "JOB", value_parser = job_id)]
    pub(crate) job: JobId,
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
pub(crate) struct Cancel {
    /// The job, or pattern with `*` or `$*`.
    #[arg(value_name = "JOB", value_parser = pattern)]
    pub(crate) job: String,
}
