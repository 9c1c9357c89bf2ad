//! `fleet bench`, short: every figure is there. What the figures are is not for a test to say.
#![cfg(feature = "demo")]

mod program;

use program::{Ran, fleet};
use serde_json::Value;

#[test]
fn a_short_benchmark_tells_every_figure_once() {
    let line = [
        "bench",
        "--nodes",
        "2",
        "--seconds",
        "0.2",
        "--timeout",
        "60",
        "--json",
    ];
    let Ran { code, out, err } = fleet(&line);
    assert_eq!(code, Some(0), "{out}{err}");
    let figures: Vec<Value> = out
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    for begin in [
        "jobs accepted durably",
        "a job until it is accepted",
        "jobs executed",
        "records published",
        "batches to nodes",
        "commands to nodes",
        "nodes there after",
        "gateway's memory for each",
        "gateway's processors, all moving",
        "a start of 2 together",
        "stop for all, put to confirmation, p99",
        "put to first pulse, p50",
    ] {
        let meant = |figure: &&Value| {
            let what = figure["what"].as_str().expect("text");
            what.starts_with(begin) && figure["nodes"] == 2
        };
        let Some(figure) = figures.iter().find(meant) else {
            panic!("no {begin} in {out}");
        };
        assert!(figure["value"].is_f64(), "{figure}");
    }
    let confirmed = figures
        .iter()
        .find(|figure| figure["what"] == "nodes that confirmed a stop for all");
    assert_eq!(confirmed.expect("a figure")["value"], 2.0, "{out}");
}

#[test]
fn a_benchmark_brings_its_own_gateway() {
    let ran = fleet(&["bench", "--connect", "tcp/127.0.0.1:1"]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
}
