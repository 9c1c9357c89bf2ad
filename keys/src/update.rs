//! Another firmware for a node, over the network.
//!
//! ```text
//!   client ──Begin──▶ node      size, hash, signature over the hash
//!          ◀──At 0───
//!          ──Chunk──▶           in order; At says how far it came, so that what was lost goes again
//!          ◀──At n───
//!          ──Finish─▶           hash of what the flash holds
//!          ◀──Ready──           the node boots it on trial
//! ```
//!
//! These messages have no version header of their own: they are enums that are only appended to.

use serde::{Deserialize, Serialize};

/// Most bytes of an image in one message.
pub const CHUNK_BYTES_MAX: usize = 1_024;

/// What is signed: these bytes, then the SHA-256 of the image. They keep a signature that was made
/// for something else from being one for an image.
pub const SIGNED_PREFIX: &[u8] = b"stepfleet image v1\0";

/// What is said to a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum UpdateMessage<'b> {
    /// An image follows, or goes on.
    Begin {
        /// Its size.
        bytes: u32,
        /// Its SHA-256.
        hash: [u8; 32],
        /// Ed25519 signature over [`SIGNED_PREFIX`] and the hash.
        #[serde(with = "signature")]
        signature: [u8; 64],
    },
    /// Some of it.
    Chunk {
        /// Where it begins, bytes.
        at: u32,
        /// The bytes: a multiple of 16, but for the last.
        bytes: &'b [u8],
    },
    /// That was all: check it.
    Finish,
    /// Forget it.
    Abandon,
    /// What runs?
    Look,
}

/// What the node answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum UpdateReply {
    /// So much is written; the next chunk begins there.
    At {
        /// Bytes.
        bytes: u32,
    },
    /// The image is whole and signed. The node boots it now.
    Ready,
    /// It is not.
    Refused(UpdateRefusal),
    /// The answer to [`UpdateMessage::Look`].
    Runs {
        /// Version of the firmware.
        version: [u8; 3],
        /// The slot that it lies in, 0 or 1.
        slot: u8,
        /// It has not proved itself yet.
        on_trial: bool,
    },
}

/// Why an image is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum UpdateRefusal {
    /// The flash cannot be written while the node moves.
    Moving,
    /// No key is set: the node takes no images.
    NoKey,
    /// The signature is not that of the key.
    Signature,
    /// Empty, or more than a slot holds.
    Size,
    /// A chunk before the begin.
    NotBegun,
    /// A chunk that is empty, too long, or no multiple of 16.
    Chunk,
    /// What the flash holds is not what was announced.
    Hash,
    /// The flash did not take it.
    Flash,
    /// The firmware that runs is on trial itself: it has not reached the router for long enough.
    OnTrial,
    /// This node has no slots for images.
    NoSlot,
    /// The question was none of these messages.
    Message,
}

impl core::fmt::Display for UpdateRefusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Moving => "it moves, and the flash cannot be written meanwhile",
            Self::NoKey => "it was given no key for images: `fleet provision --update-key-file`",
            Self::Signature => "the image is not signed with the key that it was given",
            Self::Size => "the image is empty or larger than a slot",
            Self::NotBegun => "it has forgotten the image: it was restarted",
            Self::Chunk => "a part of the image has a size that it cannot take",
            Self::Hash => "its flash does not hold what was sent",
            Self::Flash => "its flash does not take the image",
            Self::OnTrial => "its firmware is on trial itself",
            Self::NoSlot => "it has no slots for images",
            Self::Message => "it does not understand this message",
        })
    }
}

/// 64 bytes, which serde has no array for.
mod signature {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(bytes: &[u8; 64], to: S) -> Result<S::Ok, S::Error> {
        let (first, second) = bytes.split_at(32);
        let half = |half: &[u8]| <[u8; 32]>::try_from(half).unwrap_or([0; 32]);
        (half(first), half(second)).serialize(to)
    }

    pub(super) fn deserialize<'d, D: Deserializer<'d>>(from: D) -> Result<[u8; 64], D::Error> {
        let (first, second) = <([u8; 32], [u8; 32])>::deserialize(from)?;
        let mut bytes = [0; 64];
        bytes[..32].copy_from_slice(&first);
        bytes[32..].copy_from_slice(&second);
        Ok(bytes)
    }
}
