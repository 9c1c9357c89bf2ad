//! The other side of the serial line: what `fleet provision` says, one request at a time.

use crate::{
    dialogue::{Refused, Reply, Request},
    frame::{self, FRAME_BYTES_MAX, FrameReader},
};
use core::fmt;

/// How often a request is sent before the line counts as dead.
pub const ATTEMPTS_MAX: u32 = 5;

/// Longest wait for an answer, µs: erasing a unit of flash takes up to 400 ms.
pub const ANSWER_US_MAX: u64 = 1_000_000;

/// Why a request was not answered as hoped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostError {
    /// Nobody answers.
    Silent,
    /// The node says no.
    Refused(Refused),
    /// An answer to something else.
    Answer,
}

impl fmt::Display for HostError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => f.write_str("no node answers on this port"),
            Self::Refused(Refused::Setting(error)) => {
                write!(f, "the node refuses a setting: {error}")
            }
            Self::Refused(Refused::Moving) => f.write_str("the node moves: stop it first"),
            Self::Refused(Refused::Flash) => f.write_str("the node's flash did not take it"),
            Self::Refused(Refused::Incomplete) => {
                f.write_str("the node needs at least a name and a WiFi network")
            }
            Self::Refused(Refused::Authority) => f.write_str(
                "a router by tls/ needs an authority to trust (--ca), and an authority a router by tls/",
            ),
            Self::Refused(Refused::Pins(fault)) => write!(f, "{fault}"),
            Self::Answer => f.write_str("the node answers something else"),
        }
    }
}

impl core::error::Error for HostError {}

/// One request under way. All requests may be sent twice without harm.
#[derive(Clone, Debug)]
pub struct Host {
    request: Request,
    reader: FrameReader,
    attempts: u32,
    due_at: u64,
}

impl Host {
    /// Begins a request.
    pub const fn new(request: Request) -> Self {
        Self {
            request,
            reader: FrameReader::new(),
            attempts: 0,
            due_at: 0,
        }
    }

    /// Gives the bytes to send now, if any.
    ///
    /// # Errors
    /// It was sent often enough.
    pub fn poll_transmit(
        &mut self,
        now_us: u64,
        out: &mut [u8; FRAME_BYTES_MAX + 2],
    ) -> Result<Option<usize>, HostError> {
        if now_us < self.due_at {
            return Ok(None);
        }
        if self.attempts == ATTEMPTS_MAX {
            return Err(HostError::Silent);
        }
        self.attempts += 1;
        self.due_at = now_us + ANSWER_US_MAX;
        Ok(Some(frame::write(&self.request, out)))
    }

    /// Takes bytes; gives the answer that they complete.
    ///
    /// # Errors
    /// The node says no.
    pub fn handle_bytes(&mut self, bytes: &[u8]) -> Result<Option<Reply>, HostError> {
        for byte in bytes {
            match self.reader.handle_byte::<Reply>(*byte) {
                Some(Reply::Refused(refused)) => return Err(HostError::Refused(refused)),
                Some(reply) => return Ok(Some(reply)),
                None => {}
            }
        }
        Ok(None)
    }
}
