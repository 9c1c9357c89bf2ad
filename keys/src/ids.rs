//! Names of nodes, jobs and groups, and the number of an axis.
//!
//! A name matches `[a-z0-9][a-z0-9_-]{0,31}`, is `Copy` and needs no allocator. What cannot be a
//! name cannot be in one of these types.

use core::{fmt, str::FromStr};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Longest name.
pub const NAME_BYTES_MAX: usize = 32;

/// Why a text is no name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NameError {
    /// The text is empty.
    Empty,
    /// The text is longer than [`NAME_BYTES_MAX`].
    TooLong,
    /// The byte at this index is not allowed there.
    Letter {
        /// Index of the first byte that is not allowed.
        index: usize,
    },
}

impl fmt::Display for NameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => write!(f, "a name must not be empty"),
            Self::TooLong => write!(f, "a name has at most {NAME_BYTES_MAX} characters"),
            Self::Letter { index } => write!(
                f,
                "a name consists of a-z, 0-9, _ and - and starts with a letter or digit (character {})",
                index + 1
            ),
        }
    }
}

impl core::error::Error for NameError {}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Name {
    // Unused bytes are zero, so that derived order and equality are those of the text.
    bytes: [u8; NAME_BYTES_MAX],
    byte_count: u8,
}

impl Name {
    const fn new(text: &str) -> Result<Self, NameError> {
        let from = text.as_bytes();
        if from.is_empty() {
            return Err(NameError::Empty);
        }
        if from.len() > NAME_BYTES_MAX {
            return Err(NameError::TooLong);
        }
        let mut bytes = [0; NAME_BYTES_MAX];
        let mut index = 0;
        while index < from.len() {
            let byte = from[index];
            let alphanumeric = byte.is_ascii_lowercase() || byte.is_ascii_digit();
            if !(alphanumeric || (index > 0 && (byte == b'_' || byte == b'-'))) {
                return Err(NameError::Letter { index });
            }
            bytes[index] = byte;
            index += 1;
        }
        Ok(Self {
            bytes,
            byte_count: from.len() as u8,
        })
    }

    fn as_str(&self) -> &str {
        core::str::from_utf8(&self.bytes[..usize::from(self.byte_count)])
            .expect("checked to be ASCII when it was made")
    }
}

struct NameVisitor;

impl de::Visitor<'_> for NameVisitor {
    type Value = Name;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a name: 1 to {NAME_BYTES_MAX} of a-z, 0-9, _ and -")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Name, E> {
        Name::new(text).map_err(E::custom)
    }
}

macro_rules! name_type {
    ($(#[$doc:meta])* $type:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $type(Name);

        impl $type {
            /// Checks the text and keeps it.
            ///
            /// # Errors
            /// The text is no name: `[a-z0-9][a-z0-9_-]{0,31}`.
            pub const fn new(text: &str) -> Result<Self, NameError> {
                match Name::new(text) {
                    Ok(name) => Ok(Self(name)),
                    Err(error) => Err(error),
                }
            }

            /// Returns the text.
            pub fn as_str(&self) -> &str {
                self.0.as_str()
            }
        }

        impl FromStr for $type {
            type Err = NameError;
            fn from_str(text: &str) -> Result<Self, NameError> {
                Self::new(text)
            }
        }

        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.as_str())
            }
        }

        impl fmt::Debug for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{:?}", self.as_str())
            }
        }

        impl Serialize for $type {
            fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
                to.serialize_str(self.as_str())
            }
        }

        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
                from.deserialize_str(NameVisitor).map(Self)
            }
        }
    };
}

name_type! {
    /// A node: one controller with its axes.
    NodeId
}
name_type! {
    /// A job, named by the client or by the gateway.
    JobId
}
name_type! {
    /// A group of nodes that a synchronized job names.
    GroupId
}

/// The number of an axis on its node, from 0.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct AxisId(pub u8);

impl AxisId {
    /// Returns the number as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_what_the_contract_says() {
        for text in [
            "a",
            "0",
            "left",
            "cell-a-1",
            "a_b",
            "01234567890123456789012345678901",
        ] {
            assert_eq!(
                NodeId::new(text).map(|n| n.as_str() == text),
                Ok(true),
                "{text}"
            );
        }
        assert_eq!(NodeId::new(""), Err(NameError::Empty));
        assert_eq!(
            NodeId::new("012345678901234567890123456789012"),
            Err(NameError::TooLong)
        );
        for (text, index) in [
            ("-a", 0),
            ("_a", 0),
            ("Left", 0),
            ("a b", 1),
            ("a/b", 1),
            ("a*", 1),
            ("aé", 1),
        ] {
            assert_eq!(
                NodeId::new(text),
                Err(NameError::Letter { index }),
                "{text}"
            );
        }
    }
}
