//! Which gateway a node obeys: the one with the newest epoch.
//!
//! Every start of a gateway has an epoch of its own, newer than all before it of the same store. To
//! a node that knows epochs ([`Features::EPOCH`](crate::Features::EPOCH)) it says each order, clock
//! probe, start and pace behind its epoch; the node remembers the newest one it has heard since its
//! boot and obeys no older one. So a gateway that was replaced while it was cut off, or that slept,
//! moves nothing when it is back. A stop is never said behind an epoch: everybody may stop.
//!
//! ```text
//! ┌──────┬────────────────┬──────────────────────────────────────┐
//! │ 0x45 │ epoch (varint) │ the message as it is without (proof, │
//! │      │ 1 to 5 bytes   │ version, …)                          │
//! └──────┴────────────────┴──────────────────────────────────────┘
//! ```
//!
//! No version of a message and no proof begins with that byte. A message without it has epoch 0,
//! which is what a gateway says that is older than this page.

use crate::status::DecodeError;

/// What a message behind an epoch begins with.
pub const MARK: u8 = 0x45;

/// Most bytes that an epoch adds to a message.
pub const EPOCH_BYTES_MAX: usize = 1 + 5;

/// Returns what goes before a message: nothing for epoch 0.
pub fn mark(epoch: u32) -> heapless::Vec<u8, EPOCH_BYTES_MAX> {
    let mut bytes = heapless::Vec::new();
    if epoch != 0 {
        let mut buffer = [MARK; EPOCH_BYTES_MAX];
        let used = postcard::to_slice(&epoch, &mut buffer[1..])
            .expect("a varint of 32 bits has at most 5 bytes")
            .len();
        // Both have the same size.
        let _ = bytes.extend_from_slice(&buffer[..=used]);
    }
    bytes
}

/// Takes the epoch off a message.
///
/// # Errors
/// Bytes that begin as an epoch and are none.
pub fn split(bytes: &[u8]) -> Result<(u32, &[u8]), DecodeError> {
    let Some(rest) = bytes.strip_prefix(&[MARK]) else {
        return Ok((0, bytes));
    };
    postcard::take_from_bytes(rest).map_err(|_| DecodeError::Malformed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::version;

    extern crate std;

    #[test]
    fn what_is_put_before_a_message_is_taken_off_again() {
        for epoch in [1, 127, 128, 1_795_230_000, u32::MAX] {
            let mut bytes = std::vec::Vec::from(mark(epoch).as_slice());
            let used = bytes.len();
            bytes.extend([version::CURRENT, 7]);
            assert_eq!(split(&bytes), Ok((epoch, &[version::CURRENT, 7][..])));
            for end in 1..used {
                assert_eq!(split(&bytes[..end]), Err(DecodeError::Malformed));
            }
        }
        assert!(mark(0).is_empty());
        assert_eq!(
            split(&[version::CURRENT, 7]),
            Ok((0, &[version::CURRENT, 7][..]))
        );
        assert_eq!(split(&[]), Ok((0, &[][..])));
    }

    #[cfg(feature = "signed")]
    const _: () = assert!(MARK != crate::signed::MARK);
    const _: () = assert!(MARK > version::CURRENT, "no version begins like an epoch");
}
