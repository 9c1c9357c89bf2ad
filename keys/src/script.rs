//! How a script travels to its node, and how its end comes back.
//!
//! A script takes one number in its node's queue, as a command that does nothing; the commands that
//! it queues get the numbers behind. So the numbers say whether a node has a script, and a script
//! that arrives twice, late or after a restart of the gateway has no second effect.
//!
//! ```text
//!   Order::Script on `batch`                          ScriptReport on `report`
//! ┌─────────┬───────────────┬─────────────────┐     ┌─────────┬──────────────┬──────────────────┐
//! │ version │ ScriptHeader  │ part of the     │     │ version │ ScriptReport │ JSON of what it  │
//! │ 1 byte  │ (postcard)    │ text, UTF-8     │     │ 1 byte  │ (postcard)   │ returned, or why │
//! └─────────┴───────────────┴─────────────────┘     └─────────┴──────────────┴──────────────────┘
//! ```
//!
//! The parts of a text are sent in order. A node that lacks one refuses what follows as a gap; it
//! is begun again from the first part, and what the node has already changes nothing. The report is
//! said again until [`Order::ScriptSeen`](crate::Order::ScriptSeen) answers it.

use crate::{JobId, batch::QueueId, status::DecodeError, version};
use serde::{Deserialize, Serialize};

/// Longest script, bytes.
pub const SCRIPT_BYTES_MAX: usize = 64 * 1024;

/// Most bytes of a script in one order.
pub const PART_BYTES_MAX: usize = 1400;

/// Longest text in a report, bytes.
pub const REPORT_TEXT_BYTES_MAX: usize = 1200;

/// Most bytes of a report on the wire.
pub const REPORT_BYTES_MAX: usize = 80 + REPORT_TEXT_BYTES_MAX;

/// One part of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScriptHeader {
    /// The queue that the script is for.
    pub queue: QueueId,
    /// The script's own number in it.
    pub first_command: u64,
    /// The job.
    pub job: JobId,
    /// Where this part begins in the text, bytes.
    pub offset_bytes: u32,
    /// How long the text is, 1 to [`SCRIPT_BYTES_MAX`].
    pub total_bytes: u32,
}

/// How a script ended by itself. One that a stop or a cancel ended is told by the stop report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScriptReport {
    /// The queue that it was in.
    pub queue: QueueId,
    /// The script's own number in it.
    pub first_command: u64,
    /// The number behind its last command.
    pub end_command: u64,
    /// The job.
    pub job: JobId,
    /// How.
    pub outcome: ScriptOutcome,
}

/// How a script ended by itself. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScriptOutcome {
    /// It returned; the text is JSON, empty if it returned nothing.
    Returned,
    /// It failed; the text says why. The node drops the queue and comes to rest.
    Failed,
}

impl ScriptReport {
    /// Writes the report, with as much of the text as fits.
    pub fn encode<'b>(&self, text: &str, buffer: &'b mut [u8; REPORT_BYTES_MAX]) -> &'b [u8] {
        let used = version::encode(self, buffer)
            .expect("a report without text has at most 80 bytes")
            .len();
        let mut end = text.len().min(REPORT_TEXT_BYTES_MAX);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        buffer[used..used + end].copy_from_slice(&text.as_bytes()[..end]);
        &buffer[..used + end]
    }

    /// Reads a report and its text.
    ///
    /// # Errors
    /// Unknown version, malformed bytes, or a text that is not UTF-8.
    pub fn decode(bytes: &[u8]) -> Result<(Self, &str), DecodeError> {
        let (report, text) = version::decode_some(bytes)?;
        let text = core::str::from_utf8(text).map_err(|_| DecodeError::Malformed)?;
        Ok((report, text))
    }
}
