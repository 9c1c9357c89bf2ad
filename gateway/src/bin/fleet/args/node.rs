//! What can be typed about nodes.

use super::parse::{group_id, pattern};
use clap::{Args, ValueEnum};
use keys::{
    GroupId,
    pace::{SPEED_PERCENT_MAX, SPEED_PERCENT_MIN},
};

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
pub(crate) struct Setup {
    /// Node, or pattern with `*` or `$*`.
    #[arg(value_name = "NODE", value_parser = pattern)]
    pub(crate) pattern: String,
}
