//! Orders of the gateway to a node, and the node's answer.
//!
//! Commands of a queue are numbered from 0, as TCP numbers bytes: a batch says the number of its
//! first command, the answer says how many the node has and how many more fit. So a batch that
//! arrives twice, late or after a restart of the gateway has no second effect, and what a node
//! has tells exactly where to go on.
//!
//! A [`QueueId`] names one life of a node's queue. It changes when the node boots and when the
//! queue is dropped by a stop or a cancel; an order for an earlier queue is refused as stale, so a
//! late batch can never move a machine that was stopped in between.
//!
//! ```text
//! ┌─────────┬───────────────────┬──────────────────────────────┐
//! │ version │ Order (postcard)  │ only after Order::Batch:     │
//! │ 1 byte  │                   │ count × Command (postcard)   │
//! └─────────┴───────────────────┴──────────────────────────────┘
//! ```

use crate::{
    Command, JobId, ScriptHeader, StopMode,
    status::DecodeError,
    version::{self, EncodeError},
};
use serde::{Deserialize, Serialize};

/// Most bytes of one order on the wire: fits one zenoh batch of 2048 with all headers and keys.
pub const ORDER_BYTES_MAX: usize = 1536;

/// Most commands in one batch.
pub const BATCH_COMMANDS_MAX: usize = 256;

/// Names one life of a node's queue.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct QueueId {
    /// Random number of the node's boot.
    pub boot: u32,
    /// How often the queue was dropped since.
    pub flush: u32,
}

/// What the gateway tells a node on the key `batch`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// Commands follow.
    Batch(BatchHeader),
    /// Stop what this queue does and drop the rest; sets no latch. A new queue begins.
    Cancel {
        /// The queue to drop; another one is left alone.
        queue: QueueId,
        /// How to stop.
        mode: StopMode,
    },
    /// Lift the stop latch.
    Release {
        /// The queue that began with the stop. A release that is older than a stop lifts nothing.
        queue: QueueId,
    },
    /// A part of a script follows.
    Script(ScriptHeader),
    /// The report of a script has arrived: it need not be said again.
    ScriptSeen {
        /// The queue that the script was in.
        queue: QueueId,
        /// The script's number in it.
        first_command: u64,
    },
}

/// A numbered run of commands of one job, accepted whole or not at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BatchHeader {
    /// The queue that the commands are for.
    pub queue: QueueId,
    /// Number of the first command in that queue, from 0.
    pub first_command: u64,
    /// How many commands follow, 1 to [`BATCH_COMMANDS_MAX`].
    pub command_count: u16,
    /// The job that they are part of.
    pub job: JobId,
    /// Number after the job's last command in this queue: until then, more will come.
    pub job_end: u64,
}

/// Builds the bytes of one [`Order::Batch`] command by command.
#[derive(Debug)]
pub struct BatchWriter {
    commands: heapless::Vec<u8, ORDER_BYTES_MAX>,
    command_count: u16,
}

/// Room for version, tag and the longest header.
const HEADER_BYTES_MAX: usize = 1 + 1 + 2 * 5 + 10 + 3 + 33 + 10;

/// No postcard command is longer: tag, axis, and the largest of `Ramp…` and `Line`.
pub const COMMAND_BYTES_MAX: usize = 48;

impl Default for BatchWriter {
    fn default() -> Self {
        Self::new()
    }
}

impl BatchWriter {
    /// Starts an empty batch.
    pub const fn new() -> Self {
        Self {
            commands: heapless::Vec::new(),
            command_count: 0,
        }
    }

    /// Returns how many commands are in.
    pub const fn command_count(&self) -> u16 {
        self.command_count
    }

    /// Adds a command; `false` when the batch is full, and the command is not in.
    pub fn push(&mut self, command: &Command) -> bool {
        let mut bytes = [0; COMMAND_BYTES_MAX];
        let bytes =
            postcard::to_slice(command, &mut bytes).expect("COMMAND_BYTES_MAX holds every command");
        if usize::from(self.command_count) >= BATCH_COMMANDS_MAX
            || self.commands.len() + bytes.len() + HEADER_BYTES_MAX > ORDER_BYTES_MAX
        {
            return false;
        }
        self.commands
            .extend_from_slice(bytes)
            .expect("the room was checked");
        self.command_count += 1;
        true
    }

    /// Writes the order; `command_count` of the header is filled in.
    ///
    /// # Errors
    /// The buffer is smaller than [`ORDER_BYTES_MAX`].
    pub fn finish<'b>(
        &self,
        header: BatchHeader,
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], EncodeError> {
        let header = BatchHeader {
            command_count: self.command_count,
            ..header
        };
        let used = version::encode(&Order::Batch(header), buffer)?.len();
        let end = used + self.commands.len();
        buffer
            .get_mut(used..end)
            .ok_or(EncodeError)?
            .copy_from_slice(&self.commands);
        Ok(&buffer[..end])
    }
}

/// Reads an [`Order`] and gives the commands of a batch one by one, without a list in between.
#[derive(Clone, Debug)]
pub struct BatchReader<'b> {
    order: Order,
    rest: &'b [u8],
    commands_left: u16,
}

impl<'b> BatchReader<'b> {
    /// Reads the order itself.
    ///
    /// # Errors
    /// Unknown version, malformed bytes, or bytes after an order that carries no commands.
    pub fn new(bytes: &'b [u8]) -> Result<Self, DecodeError> {
        let (order, rest) = version::decode_some::<Order>(bytes)?;
        let commands_left = match order {
            Order::Batch(header) => header.command_count,
            Order::Script(_) => 0,
            Order::Cancel { .. } | Order::Release { .. } | Order::ScriptSeen { .. }
                if rest.is_empty() =>
            {
                0
            }
            Order::Cancel { .. } | Order::Release { .. } | Order::ScriptSeen { .. } => {
                return Err(DecodeError::Trailing);
            }
        };
        Ok(Self {
            order,
            rest,
            commands_left,
        })
    }

    /// Returns the order.
    pub const fn order(&self) -> &Order {
        &self.order
    }

    /// Returns the bytes behind the order: of an [`Order::Script`] a part of the text.
    pub const fn rest(&self) -> &'b [u8] {
        self.rest
    }

    /// Returns the next command, `None` after the last one.
    ///
    /// # Errors
    /// Malformed bytes, too few, or bytes after the last command. The batch must then be refused whole.
    pub fn next_command(&mut self) -> Result<Option<Command>, DecodeError> {
        if self.commands_left == 0 {
            return if self.rest.is_empty() {
                Ok(None)
            } else {
                Err(DecodeError::Trailing)
            };
        }
        let (command, rest) =
            postcard::take_from_bytes(self.rest).map_err(|_| DecodeError::Malformed)?;
        self.rest = rest;
        self.commands_left -= 1;
        Ok(Some(command))
    }
}

/// The node's answer to an order, also sent unasked when much room has become free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BatchAck {
    /// The node's queue now.
    pub queue: QueueId,
    /// What became of the order.
    pub verdict: Verdict,
    /// How many commands this queue has taken: the number of the next one.
    pub accepted_commands: u64,
    /// How many of them have ended: their last pulse has left the pin.
    pub executed_commands: u64,
    /// How many more fit.
    pub credit_commands: u32,
}

/// What became of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verdict {
    /// It was carried out.
    Accepted,
    /// It had been carried out before.
    Duplicate,
    /// It had no effect at all.
    Refused(Refusal),
    /// No order: the ack only tells the credit.
    Credit,
}

/// Why an order had no effect. Numbers on the wire are the order here: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The bytes are no order of a known version.
    Malformed,
    /// It is for another queue: the node has booted, stopped or canceled since.
    Stale,
    /// Commands before it are missing.
    Gap,
    /// It starts within what the node has and ends beyond.
    Overlap,
    /// It does not fit now.
    QueueShort,
    /// The stop latch is set.
    Stopped,
    /// The command at this index of the batch is not for this node: no such axis or feature, or a
    /// value out of range.
    BadCommand {
        /// Index in the batch, from 0.
        index: u16,
    },
    /// The command at this index of the batch would lead an axis out of its soft limits.
    OutOfReach {
        /// Index in the batch, from 0.
        index: u16,
    },
    /// A script is running, and the queue is its own until it ends.
    ScriptRuns,
    /// The node executes only what an operator has signed, and this is not, or it was before.
    NotSigned,
    /// The node obeys another gateway, which has a newer epoch.
    Superseded {
        /// The epoch that it obeys.
        epoch: u32,
    },
}
