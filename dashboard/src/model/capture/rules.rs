//! What a driver chip wants of its pins, and where a capture breaks it.

use super::{Axis, Capture};
use serde::{Deserialize, Serialize};

/// Violations that are listed; more are counted.
pub const LISTED_MAX: usize = 10_000;

/// The least times that a driver wants, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Limits {
    /// The step pin high.
    pub high_min_ns: u32,
    /// The step pin low.
    pub low_min_ns: u32,
    /// From a change of the direction pin to the next rising edge of the step pin.
    pub setup_min_ns: u32,
    /// From a rising edge of the step pin to the next change of the direction pin.
    pub hold_min_ns: u32,
}

impl Default for Limits {
    /// Those of TI's DRV8825 (data sheet SLVSA73, timing requirements), one of the slowest chips
    /// in use.
    fn default() -> Self {
        Self {
            high_min_ns: 1_900,
            low_min_ns: 1_900,
            setup_min_ns: 650,
            hold_min_ns: 650,
        }
    }
}

/// Which rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The step pin was high for too short a time.
    High,
    /// The step pin was low for too short a time.
    Low,
    /// The direction changed too shortly before a step.
    Setup,
    /// The direction changed too shortly after a step.
    Hold,
}

impl Rule {
    /// Returns the words for the screen.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::High => "step high too short",
            Self::Low => "step low too short",
            Self::Setup => "direction changed too shortly before a step",
            Self::Hold => "direction changed too shortly after a step",
        }
    }
}

/// A place where a rule is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Where the time that is too short begins, ps.
    pub at_ps: u64,
    /// The axis, an index of [`Capture::axes`].
    pub axis: usize,
    /// The rule.
    pub rule: Rule,
    /// How long it was, ps.
    pub was_ps: u64,
    /// How long it must be, ps.
    pub least_ps: u64,
}

/// Everything that was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// The first of each axis by time, together at most [`LISTED_MAX`].
    pub listed: Vec<Violation>,
    /// All of them.
    pub count: u64,
}

/// Checks every axis.
pub fn check(capture: &Capture, limits: &Limits) -> Findings {
    let mut findings = Findings::default();
    // Each axis has its share of the list, so that a bad one does not hide the others.
    let share = LISTED_MAX / capture.axes.len().max(1);
    for (index, axis) in capture.axes.iter().enumerate() {
        let mut listed = 0;
        check_axis(axis, limits, |at_ps, rule, was_ps, least_ps| {
            findings.count += 1;
            listed += 1;
            if listed <= share {
                findings.listed.push(Violation {
                    at_ps,
                    axis: index,
                    rule,
                    was_ps,
                    least_ps,
                });
            }
        });
    }
    findings
        .listed
        .sort_by_key(|found| (found.at_ps, found.axis));
    findings
}

fn check_axis(axis: &Axis, limits: &Limits, mut found: impl FnMut(u64, Rule, u64, u64)) {
    let ps = |ns: u32| u64::from(ns) * 1_000;
    let mut judge = |from_ps: u64, to_ps: u64, rule: Rule, least_ns: u32| {
        let was_ps = to_ps - from_ps;
        if was_ps < ps(least_ns) {
            found(from_ps, rule, was_ps, ps(least_ns));
        }
    };
    for pair in axis.step_edges.windows(2) {
        let (rule, least_ns) = match pair[0].high {
            true => (Rule::High, limits.high_min_ns),
            false => (Rule::Low, limits.low_min_ns),
        };
        judge(pair[0].at_ps, pair[1].at_ps, rule, least_ns);
    }
    for edge in &axis.direction_edges {
        // At the same moment the step still sees the old level or the new one: that is too short too.
        let next = axis.steps.partition_point(|step| step.at_ps < edge.at_ps);
        if let Some(step) = axis.steps.get(next) {
            judge(edge.at_ps, step.at_ps, Rule::Setup, limits.setup_min_ns);
        }
        if let Some(step) = next.checked_sub(1).and_then(|last| axis.steps.get(last)) {
            judge(step.at_ps, edge.at_ps, Rule::Hold, limits.hold_min_ns);
        }
    }
}
