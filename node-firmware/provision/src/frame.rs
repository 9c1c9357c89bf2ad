//! Messages on a serial line that carries other text too.
//!
//! ```text
//!   0 │ COBS( postcard message │ crc32 ) │ 0        no 0 inside; anything else between two zeros,
//!                                                   boot messages for example, fails its checksum
//! ```

use serde::{Serialize, de::DeserializeOwned};

/// Most bytes of a frame, zeros not counted.
pub const FRAME_BYTES_MAX: usize = 448;

/// Most bytes of fields that an older firmware does not know, as zeros.
const MISSING_BYTES_MAX: usize = 32;

/// Bytes of a message and its checksum before COBS adds its own.
const PLAIN_BYTES_MAX: usize = FRAME_BYTES_MAX - 4;

/// Writes a message with its zeros into `out`; returns how many bytes.
///
/// # Panics
/// The message is longer than a frame; those of this crate are not.
pub fn write<M: Serialize>(message: &M, out: &mut [u8; FRAME_BYTES_MAX + 2]) -> usize {
    let mut plain = [0; PLAIN_BYTES_MAX];
    let used = postcard::to_slice(message, &mut plain[..PLAIN_BYTES_MAX - 4])
        .expect("a frame holds every message")
        .len();
    let crc = crc32fast::hash(&plain[..used]);
    plain[used..used + 4].copy_from_slice(&crc.to_le_bytes());
    out[0] = 0;
    let coded = cobs::encode(&plain[..used + 4], &mut out[1..]);
    out[1 + coded] = 0;
    coded + 2
}

/// Finds messages in a stream of bytes.
#[derive(Clone, Debug)]
pub struct FrameReader {
    bytes: heapless::Vec<u8, FRAME_BYTES_MAX>,
    /// More than a frame came without a zero: wait for one.
    skipping: bool,
}

impl Default for FrameReader {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameReader {
    /// Begins.
    pub const fn new() -> Self {
        Self {
            bytes: heapless::Vec::new(),
            skipping: false,
        }
    }

    /// Takes a byte; gives the message that it completes. What is none is dropped.
    pub fn handle_byte<M: DeserializeOwned>(&mut self, byte: u8) -> Option<M> {
        if byte != 0 {
            self.skipping |= self.bytes.push(byte).is_err();
            return None;
        }
        let message = if self.skipping {
            None
        } else {
            decode(&mut self.bytes)
        };
        self.bytes.clear();
        self.skipping = false;
        message
    }
}

fn decode<M: DeserializeOwned>(bytes: &mut [u8]) -> Option<M> {
    let plain = cobs::decode_in_place(bytes).ok()?;
    let (message, crc) = bytes.get(..plain)?.split_last_chunk::<4>()?;
    if crc32fast::hash(message) != u32::from_le_bytes(*crc) {
        return None;
    }
    // The last fields may be missing: every default is a row of zero bytes.
    let mut padded = [0; FRAME_BYTES_MAX + MISSING_BYTES_MAX];
    padded[..message.len()].copy_from_slice(message);
    let (message, _) = postcard::take_from_bytes(&padded).ok()?;
    Some(message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_of_an_older_firmware_lacks_the_last_fields() {
        let mut out = [0; FRAME_BYTES_MAX + 2];
        let used = write(&(7_u8, 300_u16), &mut out);
        let mut reader = FrameReader::new();
        type Newer = (u8, u16, bool, heapless::Vec<[u8; 4], 8>);
        let mut found = None;
        for byte in &out[..used] {
            found = found.or(reader.handle_byte::<Newer>(*byte));
        }
        assert_eq!(found, Some((7, 300, false, heapless::Vec::new())));
    }
}
