//! What can be typed behind `bench`.

use super::parse::seconds;
use clap::{Args, ValueEnum};
use std::time::Duration;

/// What `fleet bench` measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum What {
    Intake,
    Batches,
    Pulse,
    Scale,
}

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

#[derive(Debug, Args)]
pub(crate) struct BenchNodes {
    /// How many.
    #[arg(value_parser = node_count)]
    pub(crate) count: usize,

    /// Where they connect.
    pub(crate) connect: String,
}

fn node_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count @ 1..=4_000) => Ok(count),
        _ => Err("1 to 4000".to_owned()),
    }
}
