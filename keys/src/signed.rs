//! Jobs that carry their operator's signature as far as the node that executes them.
//!
//! The operator's client signs a [`Statement`]: which node, in which of its lives (`boot`), which
//! job, its number, how many commands, and the root of a chain of hashes over exactly the commands
//! that the node is to execute. The gateway cuts the commands into orders as always and wraps each
//! order into a [`Proof`]; whoever is in between can withhold them and can change nothing.
//!
//! ```text
//!   commands   c0   c1   c2   c3            ┌──────┬─────────────────┬───────────────┐
//!   chain      h0 ← h1 ← h2 ← h3 ← END      │ MARK │ Proof (postcard)│ an order, as  │
//!   signed     └ root                       │ 0x53 │ … after         │ without proof │
//!   an order with c1 c2 carries h3 (after)  └──────┴─────────────────┴───────────────┘
//! ```
//!
//! `h(i) = SHA-256(1, h(i+1), bytes of c(i))`, so a node that knows h1 and is given c1, c2 and h3 can
//! check both commands before it takes the first, without knowing the rest of the job. The root of a
//! script is `SHA-256(2, text)`; it runs only when all of it is there.
//!
//! A part of a synchronized job is signed like a job: for its node, under the name of the whole, over
//! the barrier of the start in front of its commands and the numbers of the other meeting points.
//! The script of a part stands behind that barrier as if it were the last command, and its root in
//! place of END.
//!
//! A number is used once by each key in one life of a node; after a reboot no signature from before
//! is good any more. So no clock is needed on the node, and a wrong one on the client's side cannot
//! make an old job new.

use crate::{BatchHeader, Command, JobId, NodeId, batch::COMMAND_BYTES_MAX};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// First byte of an order with a proof; no version is called so.
pub const MARK: u8 = 0x53;

/// Most bytes that a proof adds to an order.
pub const PROOF_BYTES_MAX: usize = 1 + 5 * 32 + 3 * 10;

/// Most commands of a signed job: its chain is 32 bytes a command in the gateway.
pub const SIGNED_COMMANDS_MAX: usize = 200_000;

/// A SHA-256.
pub type Hash = [u8; 32];

/// What stands behind the last command.
pub const END: Hash = [0; 32];

/// Longest text that is signed, bytes.
const STATEMENT_BYTES_MAX: usize = 160;

/// What an operator signs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Statement<'s> {
    /// The node that is to execute it.
    pub node: &'s NodeId,
    /// Random number of that node's boot, as its status tells it.
    pub boot: u32,
    /// The job.
    pub job: &'s JobId,
    /// Used once; the client's UTC in microseconds, or one more than the number before.
    pub number: u64,
    /// How many commands, a script behind some counted as one; 0: a script alone.
    pub command_count: u64,
    /// Root of the chain, or of the script.
    pub root: Hash,
}

impl Statement<'_> {
    /// Returns the bytes that are signed.
    pub fn bytes(&self) -> heapless::Vec<u8, STATEMENT_BYTES_MAX> {
        let mut bytes = heapless::Vec::new();
        let mut add = |part: &[u8]| {
            bytes
                .extend_from_slice(part)
                .expect("STATEMENT_BYTES_MAX is the sum of the longest parts");
        };
        add(b"stepfleet job 1\0");
        for name in [self.node.as_str(), self.job.as_str()] {
            add(&[name.len() as u8]);
            add(name.as_bytes());
        }
        add(&self.boot.to_le_bytes());
        add(&self.number.to_le_bytes());
        add(&self.command_count.to_le_bytes());
        add(&self.root);
        bytes
    }
}

/// What travels before an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    /// Whose signature: an Ed25519 public key.
    pub key: Hash,
    /// See [`Statement::number`].
    pub number: u64,
    /// Number of the job's first command in the node's queue.
    pub first_command: u64,
    /// See [`Statement::command_count`].
    pub command_count: u64,
    /// See [`Statement::root`].
    pub root: Hash,
    /// The Ed25519 signature of the statement, in halves.
    pub signature: [Hash; 2],
    /// The chain behind the last command of this order.
    pub after: Hash,
}

impl Proof {
    /// Writes the proof before an order and returns how many bytes that took.
    ///
    /// # Errors
    /// The buffer is smaller than [`PROOF_BYTES_MAX`].
    pub fn write(&self, buffer: &mut [u8]) -> Result<usize, crate::version::EncodeError> {
        let (mark, rest) = buffer
            .split_first_mut()
            .ok_or(crate::version::EncodeError)?;
        *mark = MARK;
        let used = postcard::to_slice(self, rest).map_err(|_| crate::version::EncodeError)?;
        Ok(1 + used.len())
    }

    /// Takes the proof off an order, if it has one.
    ///
    /// # Errors
    /// Bytes that begin as a proof and are none.
    pub fn split(bytes: &[u8]) -> Result<(Option<Self>, &[u8]), crate::status::DecodeError> {
        let Some(rest) = bytes.strip_prefix(&[MARK]) else {
            return Ok((None, bytes));
        };
        let (proof, order) =
            postcard::take_from_bytes(rest).map_err(|_| crate::status::DecodeError::Malformed)?;
        Ok((Some(proof), order))
    }

    /// Returns the signature in one piece.
    pub fn signature(&self) -> [u8; 64] {
        let mut whole = [0; 64];
        let (first, second) = whole.split_at_mut(32);
        first.copy_from_slice(&self.signature[0]);
        second.copy_from_slice(&self.signature[1]);
        whole
    }

    /// Returns whether both are of one signature: only `after` differs.
    pub fn is_of(&self, other: &Self) -> bool {
        let after = END;
        Self { after, ..*self } == Self { after, ..*other }
    }

    /// Returns the number behind the job's last command.
    pub fn end(&self) -> u64 {
        self.first_command.saturating_add(self.command_count)
    }

    /// Returns whether this order is within what was signed.
    pub fn includes(&self, header: &BatchHeader) -> bool {
        let count = u64::from(header.command_count);
        // An order that ends behind the last number there is was never signed.
        let end = header.first_command.checked_add(count);
        self.first_command <= header.first_command
            && end.is_some_and(|end| end <= self.end())
            && header.job_end == self.end()
    }
}

/// Returns the chain at a command, from the chain behind it and the command's own bytes.
pub fn link(command: &[u8], after: &Hash) -> Hash {
    let mut hash = Sha256::new();
    hash.update([1]);
    hash.update(after);
    hash.update(command);
    hash.finalize().into()
}

/// Returns the chain at a command.
pub fn link_command(command: &Command, after: &Hash) -> Hash {
    let mut bytes = [0; COMMAND_BYTES_MAX];
    let bytes =
        postcard::to_slice(command, &mut bytes).expect("COMMAND_BYTES_MAX holds every command");
    link(bytes, after)
}

/// Returns the root of a script.
pub fn root_of_script(text: &[u8]) -> Hash {
    let mut hash = Sha256::new();
    hash.update([2]);
    hash.update(text);
    hash.finalize().into()
}

/// Returns the root of a list of commands.
pub fn root_of_commands(commands: &[Command]) -> Hash {
    root_before(commands, END)
}

/// Returns the root of commands behind which something else stands.
pub fn root_before(commands: &[Command], end: Hash) -> Hash {
    commands
        .iter()
        .rev()
        .fold(end, |after, command| link_command(command, &after))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AxisId, QueueId, version};

    fn command(steps: i32) -> Command {
        Command::Move {
            axis: AxisId(0),
            delay_us: 500,
            steps,
        }
    }

    #[test]
    fn every_change_of_a_job_changes_its_root() {
        let job = [command(1), command(2), command(3)];
        let root = root_of_commands(&job);
        assert_ne!(root, root_of_commands(&job[..2]));
        assert_ne!(root, root_of_commands(&job[1..]));
        assert_ne!(root, root_of_commands(&[job[1], job[0], job[2]]));
        assert_ne!(
            root,
            root_of_commands(&[command(1), command(2), command(4)])
        );
        assert_eq!(root_of_commands(&[]), END);
        assert_ne!(root_of_script(b""), END);
    }

    #[test]
    fn the_longest_statement_and_the_longest_proof_fit() {
        let node = NodeId::new("n234567890123456789012345678901a").expect("legal");
        let job = JobId::new("j234567890123456789012345678901a").expect("legal");
        let statement = Statement {
            node: &node,
            boot: u32::MAX,
            job: &job,
            number: u64::MAX,
            command_count: u64::MAX,
            root: [255; 32],
        };
        assert_eq!(statement.bytes().len(), 16 + 2 * 33 + 4 + 8 + 8 + 32);
        let proof = Proof {
            key: [255; 32],
            number: u64::MAX,
            first_command: u64::MAX,
            command_count: u64::MAX,
            root: [255; 32],
            signature: [[255; 32]; 2],
            after: [255; 32],
        };
        let mut buffer = [0; PROOF_BYTES_MAX + 2];
        let used = proof.write(&mut buffer).expect("fits");
        assert_eq!(used, PROOF_BYTES_MAX);
        buffer[used] = version::CURRENT;
        let (read, order) = Proof::split(&buffer).expect("reads");
        assert_eq!((read, order), (Some(proof), &[version::CURRENT, 0][..]));
        for end in 1..used {
            assert!(Proof::split(&buffer[..end]).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn an_order_is_within_what_was_signed_or_not() {
        let proof = Proof {
            key: END,
            number: 1,
            first_command: 10,
            command_count: 5,
            root: END,
            signature: [END; 2],
            after: END,
        };
        let header = |first_command, command_count, job_end| BatchHeader {
            queue: QueueId::default(),
            first_command,
            command_count,
            job: JobId::new("a").expect("legal"),
            job_end,
        };
        assert!(proof.includes(&header(10, 5, 15)) && proof.includes(&header(12, 2, 15)));
        assert!(!proof.includes(&header(9, 1, 15)));
        assert!(!proof.includes(&header(14, 2, 15)));
        assert!(!proof.includes(&header(10, 5, 16)));
    }
}
