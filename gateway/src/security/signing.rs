//! Operators' signing keys, and jobs that are signed with them. The node verifies; the gateway looks
//! too, so that a client is told at once what a node would refuse later.
//!
//! ```text
//!   fleet keys DIR new alice ──▶ DIR/alice.key   64 hexadecimal digits, for alice alone
//!                                DIR/signers     NAME PUBLIC-KEY, a line each: for gateway and nodes
//!   fleet submit job.json --node left --sign alice.key
//! ```

use crate::job::Job;
use ed25519_dalek::{Signature, Signer as _, SigningKey, VerifyingKey};
use keys::{
    Command, JobId, NodeId,
    job::{Hex, JobSignature},
    record::{ErrorCode, JobError},
    signed::{
        END, Hash, Proof, SIGNED_COMMANDS_MAX, Statement, link_command, root_before,
        root_of_commands, root_of_script,
    },
    signed_script::Line,
};
use std::sync::Arc;

/// A private key.
pub struct Signer(SigningKey);

impl std::fmt::Debug for Signer {
    /// Leaves the private key out.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Signer({})", self.public())
    }
}

impl Signer {
    /// Makes a key.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn new() -> Result<Self, getrandom::Error> {
        let mut secret = [0; 32];
        getrandom::getrandom(&mut secret)?;
        Ok(Self(SigningKey::from_bytes(&secret)))
    }

    /// Reads the text of a key file.
    ///
    /// # Errors
    /// It is none; the text is not quoted.
    pub fn parse(text: &str) -> Result<Self, String> {
        let secret: Hex<32> = text
            .trim()
            .parse()
            .map_err(|error| format!("no key: {error}"))?;
        Ok(Self(SigningKey::from_bytes(&secret.0)))
    }

    /// Returns the text of its file: a secret.
    pub fn secret(&self) -> String {
        format!("{}\n", Hex(self.0.to_bytes()))
    }

    /// Returns the public key.
    pub fn public(&self) -> Hex<32> {
        Hex(self.0.verifying_key().to_bytes())
    }

    /// Signs a statement.
    pub fn sign(&self, statement: &Statement<'_>) -> JobSignature {
        JobSignature {
            key: self.public(),
            boot: statement.boot,
            number: statement.number,
            signature: Hex(self.0.sign(&statement.bytes()).to_bytes()),
        }
    }

    /// Signs a script that is to be stored on a node, or its removal: gives its first line.
    ///
    /// # Panics
    /// The script's name is longer than any.
    pub fn sign_script(&self, statement: &keys::signed_script::Statement<'_>) -> Line {
        let bytes = statement
            .bytes()
            .expect("a script's name has 32 bytes at most");
        Line {
            key: self.public().0,
            boot: statement.boot,
            number: statement.number,
            signature: self.0.sign(&bytes).to_bytes(),
        }
    }
}

/// Returns the root and the number of commands that are signed. A script with commands is one part of
/// a synchronized job, and stands behind them.
///
/// # Errors
/// There are more than [`SIGNED_COMMANDS_MAX`].
pub fn root_of(commands: &[Command], script: Option<&str>) -> Result<(Hash, u64), JobError> {
    match script.map(|script| root_of_script(script_bytes(script))) {
        Some(root) if commands.is_empty() => Ok((root, 0)),
        Some(root) => Ok((root_before(commands, root), commands.len() as u64 + 1)),
        None if commands.len() > SIGNED_COMMANDS_MAX => {
            let message = format!(
                "{} commands; a signed job has at most {SIGNED_COMMANDS_MAX}",
                commands.len()
            );
            Err(JobError::new(ErrorCode::TooLarge, message))
        }
        None => Ok((root_of_commands(commands), commands.len() as u64)),
    }
}

/// Returns what is sent of a script: a node wants at least one byte.
pub fn script_bytes(script: &str) -> &[u8] {
    if script.is_empty() {
        b" "
    } else {
        script.as_bytes()
    }
}

/// Says why the node would refuse a job, as far as that is known before. `signers`: whose signature
/// counts; `None`: anybody's.
///
/// # Errors
/// `not_allowed` with the reason.
pub fn check(
    signers: Option<&[Hash]>,
    statement: &Statement<'_>,
    signature: &JobSignature,
    boot: u32,
) -> Result<(), JobError> {
    let not = |words: &str| {
        let message = format!("signature: {words}");
        Err(JobError::new(ErrorCode::NotAllowed, message))
    };
    if signature.boot != boot {
        return not("it is for an earlier start of the node; sign the job again");
    }
    if signers.is_some_and(|signers| !signers.contains(&signature.key.0)) {
        return not("nobody whose signature counts here has this key");
    }
    let Ok(key) = VerifyingKey::from_bytes(&signature.key.0) else {
        return not("no public key");
    };
    let signed = Signature::from_bytes(&signature.signature.0);
    if key.verify_strict(&statement.bytes(), &signed).is_err() {
        return not("it is not the signature of this job for this node");
    }
    Ok(())
}

/// What is sent with the orders of a signed job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signed {
    proof: Proof,
    /// The chain at each command, and behind the last.
    chain: Arc<[Hash]>,
}

impl Signed {
    /// Of a job that has a signature and a place on its node.
    pub fn of(job: &Job) -> Option<Self> {
        let signature = job.entry.signature.as_ref()?;
        let activation = job.entry.activation?;
        let (root, command_count) = root_of(&job.commands, job.script.as_deref()).ok()?;
        let script = job.script.as_deref();
        let end = script.map_or(END, |script| root_of_script(script_bytes(script)));
        let mut chain = vec![end];
        for command in job.commands.iter().rev() {
            chain.push(link_command(command, &chain[chain.len() - 1]));
        }
        chain.reverse();
        let half = |from: usize| {
            let mut half = END;
            half.copy_from_slice(&signature.signature.0[from..from + 32]);
            half
        };
        let proof = Proof {
            key: signature.key.0,
            number: signature.number,
            first_command: activation.base,
            command_count,
            root,
            signature: [half(0), half(32)],
            after: END,
        };
        let chain = chain.into();
        Some(Self { proof, chain })
    }

    /// Returns what stands before an order whose last command is the one before this number.
    pub fn proof(&self, end: u64) -> Proof {
        let index = usize::try_from(end.saturating_sub(self.proof.first_command));
        let after = index.ok().and_then(|index| self.chain.get(index));
        Proof {
            after: after.copied().unwrap_or(END),
            ..self.proof
        }
    }
}

/// Returns the statement of a job.
pub fn statement<'s>(
    node: &'s NodeId,
    job: &'s JobId,
    boot: u32,
    number: u64,
    (root, command_count): (Hash, u64),
) -> Statement<'s> {
    Statement {
        node,
        boot,
        job,
        number,
        command_count,
        root,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_private_key_is_in_its_file_and_nowhere_else() {
        let signer = Signer::new().expect("random numbers");
        let again = Signer::parse(&signer.secret()).expect("a key");
        assert_eq!(again.public(), signer.public());
        let secret = signer.secret();
        assert!(!format!("{signer:?}").contains(secret.trim()));
        assert!(!Signer::parse("hush").expect_err("none").contains("hush"));
    }

    #[test]
    fn what_was_not_signed_is_refused_with_the_reason() {
        let (alice, mallory) = (
            Signer::new().expect("random numbers"),
            Signer::new().expect("random numbers"),
        );
        let (left, right) = (
            NodeId::new("left").expect("legal"),
            NodeId::new("right").expect("legal"),
        );
        let job = JobId::new("a").expect("legal");
        let signers = [alice.public().0];
        let root = (root_of_script(b"x"), 0);
        let of_left = statement(&left, &job, 7, 1, root);
        let of_right = statement(&right, &job, 7, 1, root);
        let signature = alice.sign(&of_left);
        assert_eq!(check(Some(&signers), &of_left, &signature, 7), Ok(()));
        let refused = |statement, signature: &JobSignature, boot| {
            let error = check(Some(&signers), statement, signature, boot).expect_err("refused");
            assert_eq!(error.code, ErrorCode::NotAllowed);
            error.message
        };
        assert!(refused(&of_left, &signature, 8).contains("earlier start"));
        assert!(refused(&of_right, &signature, 7).contains("for this node"));
        assert!(refused(&of_left, &mallory.sign(&of_left), 7).contains("nobody"));
        let nobody = check(Some(&[]), &of_left, &signature, 7).expect_err("all are revoked");
        assert!(nobody.message.contains("nobody"), "{nobody:?}");
        assert_eq!(check(None, &of_left, &signature, 7), Ok(()));
    }
}
