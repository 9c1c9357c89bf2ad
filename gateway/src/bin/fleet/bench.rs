//! `fleet bench`: how much a fleet on this machine does, and how fast.
//!
//! ```text
//!  this process: client, counters        fleet serve: the gateway        fleet bench-nodes: N nodes
//!        └────────────── loopback TCP ──────┴────────────── loopback TCP ──────────┘
//! ```
//!
//! Gateway and nodes are processes of their own, so that each one's processor time and memory can
//! be told apart; for the first pulse the nodes are in this process, where a pulse and the moment
//! of the put have one clock. All share this machine's processors: the table names them.

mod field;
mod phases;

use crate::{
    args::{Common, What},
    link::Failure,
    show,
};
use field::Field;
use std::time::{Duration, Instant};

pub(crate) use field::run_nodes;

/// One figure.
pub(super) struct Figure {
    what: String,
    value: f64,
    unit: &'static str,
}

/// The figures of one size of fleet, printed as they come.
pub(super) struct Figures {
    nodes: usize,
    json: bool,
}

impl Figures {
    /// Prints one.
    fn tell(&self, what: impl Into<String>, value: f64, unit: &'static str) {
        let figure = Figure {
            what: what.into(),
            value,
            unit,
        };
        show::line(&if self.json {
            let line = serde_json::json!({
                "nodes": self.nodes, "what": figure.what, "value": figure.value,
                "unit": figure.unit,
            });
            line.to_string()
        } else {
            let digits = if figure.value.abs() < 100.0 { 2 } else { 0 };
            format!(
                "{:>6}  {:<52} {:>12.digits$} {}",
                self.nodes, figure.what, figure.value, figure.unit
            )
        });
    }

    /// Prints median and 99 % of sorted times in ms.
    fn tell_times(&self, what: &str, mut times_ms: Vec<f64>) {
        times_ms.sort_by(f64::total_cmp);
        for (name, share) in [("p50", 0.5), ("p99", 0.99)] {
            let index = (times_ms.len().saturating_sub(1) as f64 * share).round() as usize;
            let value = times_ms.get(index).copied().unwrap_or(f64::NAN);
            self.tell(format!("{what}, {name}"), value, "ms");
        }
    }
}

/// `fleet bench`
pub(crate) async fn bench(
    common: &Common,
    what: &[What],
    sizes: &[usize],
    lasting: Duration,
) -> Result<(), Failure> {
    if common.connect.is_some() {
        let message = "bench brings its own gateway and nodes: --connect or FLEET_CONNECT has no meaning here";
        return Err(Failure::Usage(message.to_owned()));
    }
    let began = Instant::now();
    let json = common.json;
    if !json {
        show::line(&field::machine());
        show::line(&format!("{:>6}  {:<52} {:>12}", "nodes", "what", "figure"));
    }
    let wants = |one| what.is_empty() || what.contains(&one);
    for &nodes in sizes {
        let figures = Figures { nodes, json };
        if wants(What::Intake) {
            let field = Field::open(nodes, common.timeout).await?;
            phases::intake(&figures, &field, lasting).await?;
            field.close().await;
        }
        if wants(What::Batches) {
            let field = Field::open(nodes, common.timeout).await?;
            phases::batches(&figures, &field).await?;
            field.close().await;
        }
        if wants(What::Scale) {
            let field = Field::open(nodes, common.timeout).await?;
            phases::scale(&figures, &field, lasting).await?;
            field.close().await;
        }
        // More nodes than this in one process with their client measure that process.
        if wants(What::Pulse) && nodes <= phases::PULSE_NODES_MAX {
            let field = Field::open(0, common.timeout).await?;
            phases::pulse(&figures, &field, lasting).await?;
            field.close().await;
        }
    }
    if !json {
        show::line(&format!("{:.0} s", began.elapsed().as_secs_f64()));
    }
    Ok(())
}
