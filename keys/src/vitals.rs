//! How a node's chip is, on the key `vitals`: for whoever wants to know before something fails.
//!
//! Said when the link comes and every ten seconds behind it, after everything else that is to be said.
//! A lost one loses nothing that the next does not say.
//!
//! A node tells what it knows, an emulated one little: every value may be absent. Fields are only
//! appended, each of them optional: [`Vitals::decode`] reads what an older node says without the newer
//! ones, and of a newer one what it knows.

use crate::{LocalMicros, status::DecodeError, version};
use serde::{Deserialize, Serialize};

/// Most bytes of vitals on the wire; a later version may have some more fields.
pub const VITALS_BYTES_MAX: usize = 64;

/// From one to the next, µs.
pub const VITALS_US: u64 = 10_000_000;

/// See the module.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Vitals {
    /// The node's clock when this was written.
    pub at: LocalMicros,
    /// Time since boot, s.
    pub uptime_s: Option<u32>,
    /// Temperature inside the chip, °C: some degrees above that of the board.
    pub chip_celsius: Option<i16>,
    /// Free heap in internal RAM, which WiFi lives on, bytes.
    pub internal_free_bytes: Option<u32>,
    /// Free heap in external RAM, bytes.
    pub psram_free_bytes: Option<u32>,
    /// The least that was ever left since boot of the stack of the core with the network, bytes.
    pub network_stack_free_bytes: Option<u32>,
    /// The same of the core that plans.
    pub planning_stack_free_bytes: Option<u32>,
}

impl Vitals {
    /// Writes them into `buffer` and returns the part that was used.
    pub fn encode<'b>(&self, buffer: &'b mut [u8; VITALS_BYTES_MAX]) -> &'b [u8] {
        version::encode(self, buffer).expect("10 bytes and 6 times 6, and one for the version")
    }

    /// Reads them, whether the node knows fewer fields or more.
    ///
    /// # Errors
    /// An unknown version, or bytes that are none.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        if bytes.len() > VITALS_BYTES_MAX {
            return Err(DecodeError::Trailing);
        }
        // The instant at least is there; absent fields are zero bytes.
        let mut filled = [0; 2 * VITALS_BYTES_MAX];
        filled[..bytes.len()].copy_from_slice(bytes);
        let (_, behind_version) = bytes.split_first().ok_or(DecodeError::Malformed)?;
        if behind_version.is_empty() {
            return Err(DecodeError::Malformed);
        }
        version::decode_some(&filled).map(|(vitals, _)| vitals)
    }
}
