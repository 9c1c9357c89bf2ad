//! Executes only what an operator has signed. Owns the operators' keys, which numbers were used in
//! this life of the node, and how far the signed job has come.
//!
//! Without keys everything passes, as the node was told to.
//!
//! | an order is | when |
//! |---|---|
//! | taken | its commands and the chain behind them give what was signed, and it goes on where the job is |
//! | refused as `NotSigned` | it has no proof; the key is unknown; the number was used, or is older than the last [`NUMBERS_MAX`]; the signature is wrong or of another life; a command is not the one that was signed |
//!
//! A stop, a cancel, a release and the instant of a start need no signature: none of them executes
//! what was not signed. Absent on purpose: a clock.

mod stored;

pub(crate) use stored::{StoredRefusal, check_stored};

use keys::{
    BatchHeader, JobId, NodeId, QueueId, Refusal,
    batch::BATCH_COMMANDS_MAX,
    signed::{END, Hash, Proof, Statement, link, root_of_script},
};

/// Most operators' keys.
pub const KEYS_MAX: usize = 8;

/// Numbers of each key that are remembered: jobs that two clients with one key have signed may come
/// in another order, by so many.
pub const NUMBERS_MAX: usize = 16;

/// Public keys of operators.
pub type Keys = heapless::Vec<Hash, KEYS_MAX>;

/// Ends of the commands of one batch, in its bytes.
pub(crate) type Ends = heapless::Vec<u16, BATCH_COMMANDS_MAX>;

/// Numbers of one key, ascending.
type Numbers = heapless::Vec<u64, NUMBERS_MAX>;

/// The job that is being executed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Progress {
    proof: Proof,
    job: JobId,
    queue: QueueId,
    /// The next command.
    at: u64,
    /// The chain there.
    expected: Hash,
}

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Verifier {
    used: [Numbers; KEYS_MAX],
    progress: Option<Progress>,
}

impl Verifier {
    /// Checks commands that are to be executed next; nothing has changed yet. `bytes` are those of
    /// the commands.
    pub(crate) fn check_commands(
        &self,
        keys: &Keys,
        name: &NodeId,
        proof: Option<&Proof>,
        header: &BatchHeader,
        bytes: &[u8],
        ends: &Ends,
    ) -> Result<Option<Progress>, Refusal> {
        if keys.is_empty() {
            return Ok(None);
        }
        let proof = proof.ok_or(Refusal::NotSigned)?;
        if !proof.includes(header) {
            return Err(Refusal::NotSigned);
        }
        let mut progress = self.progress_of(keys, name, proof, header.queue, &header.job)?;
        if progress.at != header.first_command {
            return Err(Refusal::NotSigned);
        }
        let mut chain = proof.after;
        let mut end = bytes.len();
        for start in ends
            .iter()
            .rev()
            .skip(1)
            .map(|end| usize::from(*end))
            .chain([0])
        {
            chain = link(&bytes[start..end], &chain);
            end = start;
        }
        progress.at += u64::from(header.command_count);
        let is_last = progress.at == proof.end();
        if chain != progress.expected || is_last != (proof.after == END) {
            return Err(Refusal::NotSigned);
        }
        progress.expected = proof.after;
        Ok(Some(progress))
    }

    /// Checks a script of which all is here.
    pub(crate) fn check_script(
        &self,
        keys: &Keys,
        name: &NodeId,
        proof: Option<&Proof>,
        (queue, at): (QueueId, u64),
        job: &JobId,
        text: &[u8],
    ) -> Result<Option<Progress>, Refusal> {
        if keys.is_empty() {
            return Ok(None);
        }
        let proof = proof.ok_or(Refusal::NotSigned)?;
        let mut progress = self.progress_of(keys, name, proof, queue, job)?;
        let is_new = !self.is_going_on(proof, queue, job);
        // Alone, or as the last of what was signed.
        let in_place = if proof.command_count == 0 {
            is_new
        } else {
            progress.at == at && at + 1 == proof.end()
        };
        if !in_place || root_of_script(text) != progress.expected {
            return Err(Refusal::NotSigned);
        }
        progress.at = at + 1;
        progress.expected = END;
        Ok(Some(progress))
    }

    /// What was checked is taken now.
    pub(crate) fn advance(&mut self, keys: &Keys, progress: Option<Progress>) {
        let Some(progress) = progress else { return };
        let proof = &progress.proof;
        if !self.is_going_on(proof, progress.queue, &progress.job)
            && let Some(place) = keys.iter().position(|key| *key == proof.key)
        {
            stored::note_number(&mut self.used[place], proof.number);
        }
        self.progress = Some(progress);
    }

    fn is_going_on(&self, proof: &Proof, queue: QueueId, job: &JobId) -> bool {
        self.progress.is_some_and(|progress| {
            progress.proof.is_of(proof) && progress.queue == queue && progress.job == *job
        })
    }

    /// Returns where this job is: where it was, or at its beginning if its signature is good.
    fn progress_of(
        &self,
        keys: &Keys,
        name: &NodeId,
        proof: &Proof,
        queue: QueueId,
        job: &JobId,
    ) -> Result<Progress, Refusal> {
        if let Some(progress) = self.progress
            && self.is_going_on(proof, queue, job)
        {
            return Ok(progress);
        }
        let place = keys
            .iter()
            .position(|key| *key == proof.key)
            .ok_or(Refusal::NotSigned)?;
        let numbers = &self.used[place];
        let is_old =
            numbers.is_full() && numbers.first().is_some_and(|least| proof.number < *least);
        if is_old || numbers.contains(&proof.number) {
            return Err(Refusal::NotSigned);
        }
        let statement = Statement {
            node: name,
            boot: queue.boot,
            job,
            number: proof.number,
            command_count: proof.command_count,
            root: proof.root,
        };
        let key =
            ed25519_dalek::VerifyingKey::from_bytes(&proof.key).map_err(|_| Refusal::NotSigned)?;
        let signature = ed25519_dalek::Signature::from_bytes(&proof.signature());
        key.verify_strict(&statement.bytes(), &signature)
            .map_err(|_| Refusal::NotSigned)?;
        Ok(Progress {
            proof: *proof,
            job: *job,
            queue,
            at: proof.first_command,
            expected: proof.root,
        })
    }
}
