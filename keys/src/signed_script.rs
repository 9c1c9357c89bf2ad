//! A stored script that carries its operator's signature, in a first line that Lua takes for a
//! comment:
//!
//! ```text
//!   --signed KEY BOOT NUMBER SIGNATURE        64, 8 hexadecimal digits, a number, 128 digits
//!   motor.queue_move(0, 500, 1000)            the text that was signed, without the line above
//! ```
//!
//! So what is stored, in whatever store, says by itself who answers for it, and a node can check it
//! again at every start. A signature is good for one name on one node. Putting it there is good for
//! one life of that node, once: a text that was replaced does not come back. Signed nothing, an empty
//! text, removes the script.

use crate::{NodeId, signed::Hash};
use core::fmt;
use sha2::{Digest as _, Sha256};

/// How the line begins.
pub const MARK: &str = "--signed ";

/// Most bytes of the line, with its end.
pub const LINE_BYTES_MAX: usize = MARK.len() + 64 + 1 + 8 + 1 + 20 + 1 + 128 + 1;

/// Longest text that is signed, bytes.
const STATEMENT_BYTES_MAX: usize = 160;

/// What an operator signs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Statement<'s> {
    /// The node that is to store it.
    pub node: &'s NodeId,
    /// Random number of that node's boot, as its status tells it.
    pub boot: u32,
    /// The script's name.
    pub name: &'s str,
    /// Used once: see [`crate::signed::Statement::number`].
    pub number: u64,
    /// The text behind the line.
    pub text: &'s str,
}

impl Statement<'_> {
    /// Returns the bytes that are signed; `None` if the name is longer than any.
    pub fn bytes(&self) -> Option<heapless::Vec<u8, STATEMENT_BYTES_MAX>> {
        let mut bytes = heapless::Vec::new();
        let mut root = Sha256::new();
        root.update([3]);
        root.update(self.text.as_bytes());
        bytes.extend_from_slice(b"stepfleet script 1\0").ok()?;
        for name in [self.node.as_str(), self.name] {
            bytes.push(u8::try_from(name.len()).ok()?).ok()?;
            bytes.extend_from_slice(name.as_bytes()).ok()?;
        }
        bytes.extend_from_slice(&self.boot.to_le_bytes()).ok()?;
        bytes.extend_from_slice(&self.number.to_le_bytes()).ok()?;
        bytes.extend_from_slice(&root.finalize()).ok()?;
        Some(bytes)
    }
}

/// The line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Whose signature: an Ed25519 public key.
    pub key: Hash,
    /// See [`Statement::boot`].
    pub boot: u32,
    /// See [`Statement::number`].
    pub number: u64,
    /// The Ed25519 signature of the statement.
    pub signature: [u8; 64],
}

impl Line {
    /// Takes the line off a stored text; `None` if there is none.
    pub fn split(stored: &str) -> Option<(Self, &str)> {
        let (line, text) = stored.split_once('\n')?;
        let mut words = line.strip_prefix(MARK)?.split(' ');
        let line = Self {
            key: bytes_of(words.next()?)?,
            boot: u32::from_be_bytes(bytes_of(words.next()?)?),
            number: words.next()?.parse().ok()?,
            signature: bytes_of(words.next()?)?,
        };
        words.next().is_none().then_some((line, text))
    }
}

impl fmt::Display for Line {
    /// Writes the line, with its end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(MARK)?;
        self.key
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02x}"))?;
        write!(f, " {:08x} {} ", self.boot, self.number)?;
        let mut signature = self.signature.iter();
        signature.try_for_each(|byte| write!(f, "{byte:02x}"))?;
        f.write_str("\n")
    }
}

fn bytes_of<const COUNT: usize>(digits: &str) -> Option<[u8; COUNT]> {
    let mut bytes = [0; COUNT];
    if digits.len() != 2 * COUNT || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&digits[2 * index..2 * index + 2], 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::fmt::Write;

    const LINE: Line = Line {
        key: [0xab; 32],
        boot: 0x0102_0304,
        number: u64::MAX,
        signature: [0xcd; 64],
    };

    fn stored(text: &str) -> heapless::String<512> {
        let mut stored = heapless::String::new();
        write!(stored, "{LINE}{text}").expect("room");
        stored
    }

    #[test]
    fn a_line_is_read_as_it_was_written_and_anything_else_is_none() {
        let whole = stored("return 1\nreturn 2");
        assert_eq!(Line::split(&whole), Some((LINE, "return 1\nreturn 2")));
        assert_eq!(Line::split(&stored("")), Some((LINE, "")));
        assert_eq!(stored("").len(), LINE_BYTES_MAX);
        let end = whole.find('\n').expect("a line");
        for cut in 0..=end {
            assert_eq!(Line::split(&whole[..cut]), None, "cut at {cut}");
        }
        for other in ["", "\n", "return 1", "--signed \n", "--signed x y z w\n"] {
            assert_eq!(Line::split(other), None, "{other:?}");
        }
        let signed = whole.replacen(' ', "  ", 2);
        assert_eq!(Line::split(&signed), None);
    }

    #[test]
    fn everything_that_is_signed_changes_what_is_signed() {
        let [left, right] = ["left", "right"].map(|name| NodeId::new(name).expect("legal"));
        let statement = Statement {
            node: &left,
            boot: 1,
            name: "a",
            number: 2,
            text: "return 1",
        };
        let bytes = statement.bytes().expect("short");
        assert_eq!(bytes.len(), 19 + 5 + 2 + 4 + 8 + 32);
        for other in [
            Statement {
                node: &right,
                ..statement
            },
            Statement {
                boot: 2,
                ..statement
            },
            Statement {
                name: "b",
                ..statement
            },
            Statement {
                number: 3,
                ..statement
            },
            Statement {
                text: "return 1 ",
                ..statement
            },
        ] {
            assert_ne!(other.bytes(), Some(bytes.clone()));
        }
        let longest = "n234567890123456789012345678901a";
        let node = NodeId::new(longest).expect("legal");
        let longest = Statement {
            node: &node,
            name: longest,
            ..statement
        };
        assert!(longest.bytes().is_some());
    }
}
