//! G-code → the commands of a job. Pure: a text and a [`Machine`] in, a [`Program`] out.
//!
//! ```text
//!  text ─▶ words.rs ─▶ block.rs ─▶ modal.rs ──────▶ emit.rs ─────▶ Vec<JobCommand>
//!          (the crate   one of a   what it means   mm → steps,
//!           `gcode`)    group      · arc.rs        limits      └─▶ preview.rs: time and bounds
//! ```
//!
//! The common subset of GRBL: G0–G4, G17–G21, G28, G53–G59, G90–G94, M0–M5, M30, F and S. M0 and M1 rest
//! until `fleet resume`. What is
//! not understood is refused with its line and column; nothing is skipped but comments, line
//! numbers, tool numbers (`T`) and words that only confirm what holds anyway (`G40`, `G49`, `G61`,
//! `G80`, `M9`).
//!
//! # Where the axes are at the beginning
//! A job may wait behind others, so nobody knows that when a program is read. Relative moves (G91) need
//! not know it. The first absolute move of an axis is a `ramp_to`: that axis alone goes there, Z
//! before X, Y and A, and the beam must be off. From then on every way is a straight line between
//! known places. `G92` before that names the place where the axis is.
//!
//! # Accuracy
//! Places are kept in mm; each end of a line is rounded to whole steps on its own, so that no error
//! adds up. An arc becomes chords that are nowhere farther from it than `arc_tolerance_mm`.
//!
//! Absent on purpose: variables, expressions, canned cycles, probing (`G38`), tool changes,
//! coolant.

mod arc;
mod block;
mod emit;
mod machine;
mod modal;
mod preview;
mod words;

pub use machine::{Machine, Machines};
pub use preview::{Bounds, Preview};

use keys::{
    job::{JOB_BYTES_MAX, JobCommand},
    record::{ErrorCode, JobError},
};

/// A program that has been read.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// What the node is told.
    pub commands: Vec<JobCommand>,
    /// Time and bounds.
    pub preview: Preview,
}

/// What is wrong with a program, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {message}")]
pub struct GcodeError {
    /// Line, from 1.
    pub line: usize,
    /// Character in the line, from 1.
    pub column: usize,
    /// What is wrong.
    pub message: String,
}

impl From<GcodeError> for JobError {
    fn from(error: GcodeError) -> Self {
        Self::new(ErrorCode::BadCommand, error.to_string())
    }
}

/// Reads a program for a machine.
///
/// # Errors
/// The first thing that is wrong, with its line and column.
pub fn compile(text: &str, machine: &Machine) -> Result<Program, GcodeError> {
    if text.len() > JOB_BYTES_MAX {
        let message = format!("{} bytes; a job has at most {JOB_BYTES_MAX}", text.len());
        return Err(at(1, 1, message));
    }
    let mut state = modal::Modal::new(machine);
    let mut last = 1;
    for (index, line) in text.lines().enumerate() {
        last = index + 1;
        let words = words::read(line).map_err(|error| error.on(last))?;
        state.block(&words).map_err(|error| error.on(last))?;
        if state.has_ended() {
            break;
        }
    }
    let emitted = state.finish();
    if emitted.commands.is_empty() {
        return Err(at(last, 1, "the program does nothing".to_owned()));
    }
    let preview = preview::of(&emitted, machine);
    Ok(Program {
        commands: emitted.commands,
        preview,
    })
}

fn at(line: usize, column: usize, message: String) -> GcodeError {
    GcodeError {
        line,
        column,
        message,
    }
}

/// An error in a line of which the number is not yet known.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Wrong {
    column: usize,
    message: String,
}

impl Wrong {
    fn new(column: usize, message: impl Into<String>) -> Self {
        Self {
            column,
            message: message.into(),
        }
    }

    fn on(self, line: usize) -> GcodeError {
        at(line, self.column, self.message)
    }
}
