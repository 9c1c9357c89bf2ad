//! Which messages can be read, and the rule for changing them.
//!
//! Every postcard message starts with one byte: its version.
//!
//! The rule: (1) enums grow at the end only, and no number is used again; (2) a struct that must
//! change gets a new version, and the reader of every version from [`MIN`] stays; (3) frozen bytes
//! in `tests/bytes_v*.rs` are never edited; a new version adds a file; (4) [`MIN`] rises only when
//! no node in the field can still speak the old one.
//!
//! # Version 1
//! The first.

use crate::status::DecodeError;
use serde::{Serialize, de::DeserializeOwned};

/// The oldest version that can be read.
pub const MIN: u8 = 1;

/// The version that is written.
pub const CURRENT: u8 = 1;

/// The buffer was too small for the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl core::fmt::Display for EncodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the buffer is too small for the message")
    }
}

impl core::error::Error for EncodeError {}

/// Writes version and message into `buffer` and returns the part that was used.
///
/// # Errors
/// The buffer is too small.
pub fn encode<'b, M: Serialize>(
    message: &M,
    buffer: &'b mut [u8],
) -> Result<&'b [u8], EncodeError> {
    let (version, rest) = buffer.split_first_mut().ok_or(EncodeError)?;
    *version = CURRENT;
    let used = postcard::to_slice(message, rest)
        .map_err(|_| EncodeError)?
        .len();
    Ok(&buffer[..=used])
}

/// Reads a message and demands that nothing follows it.
///
/// # Errors
/// An unknown version, malformed or left-over bytes.
pub fn decode<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, DecodeError> {
    let (message, rest) = decode_some(bytes)?;
    if rest.is_empty() {
        Ok(message)
    } else {
        Err(DecodeError::Trailing)
    }
}

/// Reads a message and returns the bytes that follow it.
///
/// # Errors
/// An unknown version or malformed bytes.
pub fn decode_some<M: DeserializeOwned>(bytes: &[u8]) -> Result<(M, &[u8]), DecodeError> {
    let (version, rest) = bytes.split_first().ok_or(DecodeError::Malformed)?;
    if !(MIN..=CURRENT).contains(version) {
        return Err(DecodeError::Version(*version));
    }
    postcard::take_from_bytes(rest).map_err(|_| DecodeError::Malformed)
}
