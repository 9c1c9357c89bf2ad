//! Stored scripts: only what an operator has signed for this name on this node is stored and run.

use super::{Keys, NUMBERS_MAX, Numbers, Verifier};
use keys::{
    NodeId,
    signed_script::{Line, Statement},
};

/// Why a stored script, or its removal, does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StoredRefusal {
    /// It has no signature.
    NotSigned,
    /// Nobody whose signature counts here has this key, or it is not the signature of this text
    /// under this name for this node.
    Signature,
    /// It was signed for an earlier start of the node.
    Boot,
    /// The number was used, or is too old.
    Number,
}

impl core::fmt::Display for StoredRefusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotSigned => "it is not signed",
            Self::Signature => "its signature does not count here",
            Self::Boot => "it was signed for an earlier start of the node",
            Self::Number => "its signature was used before",
        })
    }
}

/// Checks what is in the store, whenever it was put there. Gives whose signature it is, as the place
/// of the key, and the line.
pub(crate) fn check_stored<'t>(
    keys: &Keys,
    node: &NodeId,
    name: &str,
    stored: &'t str,
) -> Result<(usize, Line, &'t str), StoredRefusal> {
    let (line, text) = Line::split(stored).ok_or(StoredRefusal::NotSigned)?;
    let known = keys.iter().position(|key| *key == line.key);
    let place = known.ok_or(StoredRefusal::Signature)?;
    let statement = Statement {
        node,
        boot: line.boot,
        name,
        number: line.number,
        text,
    };
    let bad = StoredRefusal::Signature;
    let bytes = statement.bytes().ok_or(bad)?;
    let key = ed25519_dalek::VerifyingKey::from_bytes(&line.key).map_err(|_| bad)?;
    let signature = ed25519_dalek::Signature::from_bytes(&line.signature);
    key.verify_strict(&bytes, &signature).map_err(|_| bad)?;
    Ok((place, line, text))
}

impl Verifier {
    /// Checks what is put now, and remembers its number.
    pub(crate) fn take_stored<'t>(
        &mut self,
        keys: &Keys,
        node: &NodeId,
        boot: u32,
        name: &str,
        stored: &'t str,
    ) -> Result<&'t str, StoredRefusal> {
        let (place, line, text) = check_stored(keys, node, name, stored)?;
        if line.boot != boot {
            return Err(StoredRefusal::Boot);
        }
        if !note_number(&mut self.used[place], line.number) {
            return Err(StoredRefusal::Number);
        }
        Ok(text)
    }
}

/// Remembers a number; `false` if it was used or cannot be told from those that were.
pub(super) fn note_number(numbers: &mut Numbers, number: u64) -> bool {
    let is_old =
        numbers.len() == NUMBERS_MAX && numbers.first().is_some_and(|least| number < *least);
    if is_old || numbers.contains(&number) {
        return false;
    }
    if numbers.is_full() {
        numbers.remove(0);
    }
    let at = numbers.partition_point(|known| *known < number);
    numbers.insert(at, number).is_ok()
}
