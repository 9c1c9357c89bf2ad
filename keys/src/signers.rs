//! Whose signature counts: the list of operators' public keys, for the gateway and for nodes.

use crate::{NodeId, job::Hex};
use std::{
    format,
    string::{String, ToString},
    vec::Vec,
};

/// An operator whose signature counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignerKey {
    /// Who.
    pub name: NodeId,
    /// The public key.
    pub key: Hex<32>,
}

/// Reads a list of signers.
///
/// # Errors
/// The line and what is wrong with it.
pub fn parse(text: &str) -> Result<Vec<SignerKey>, String> {
    let mut signers: Vec<SignerKey> = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = |what: &str| format!("line {number}: {what}");
        let (name, key) = line
            .split_once(' ')
            .ok_or_else(|| bad("not of the form NAME KEY"))?;
        let name = NodeId::new(name).map_err(|error| bad(&error.to_string()))?;
        let key: Hex<32> = key.trim().parse().map_err(|error: String| bad(&error))?;
        if signers
            .iter()
            .any(|signer| signer.name == name || signer.key == key)
        {
            return Err(bad("the name or the key is there already"));
        }
        signers.push(SignerKey { name, key });
    }
    Ok(signers)
}

/// Returns the text of a list of signers.
pub fn print(signers: &[SignerKey]) -> String {
    let mut text = String::from(
        "# Whose signature counts: NAME PUBLIC-KEY. Kept by `fleet keys`; read by the gateway and by \
         nodes when they start.\n",
    );
    for SignerKey { name, key } in signers {
        text.push_str(&format!("{name} {key}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{borrow::ToOwned, vec};

    #[test]
    fn a_list_is_read_as_it_was_printed_and_errors_name_the_line() {
        let key = Hex([0xab; 32]);
        let name = NodeId::new("alice").expect("legal");
        let list = vec![SignerKey { name, key }];
        assert_eq!(parse(&print(&list)), Ok(list));
        for (text, words) in [
            ("alice".to_owned(), "line 1: not of the form"),
            ("\nalice 00".to_owned(), "line 2: not 64"),
            (format!("A {key}"), "line 1: "),
            (format!("a {key}\nb {key}"), "line 2: the name or the key"),
        ] {
            let error = parse(&text).expect_err("illegal");
            assert!(error.contains(words), "{text:?}: {error}");
        }
    }
}
