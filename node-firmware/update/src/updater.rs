//! Takes an image chunk by chunk into the slot that does not run.
//!
//! Chunks come in order; one that comes again is answered again. The hash is taken of what the flash
//! holds, not of what came, and the signature is over the hash: so what boots is what was signed. It is
//! taken chunk by chunk, behind each write: over a whole image it would take longer than a watchdog
//! waits.

use core::ops::Range;
use ed25519_dalek::{Signature, VerifyingKey};
use embedded_storage::nor_flash::NorFlash;
use keys::update::{CHUNK_BYTES_MAX, SIGNED_PREFIX, UpdateMessage, UpdateRefusal, UpdateReply};
use sha2::{Digest, Sha256};

/// An image under way.
#[derive(Clone, Debug)]
struct Image {
    bytes: u32,
    hash: [u8; 32],
    signature: [u8; 64],
    /// How many have been written.
    written_bytes: u32,
    /// Of these, read back.
    hasher: Sha256,
    whole: bool,
}

/// See the module. `F` is the slot that does not run.
#[derive(Debug)]
pub struct Updater<F> {
    slot: F,
    key: Option<[u8; 32]>,
    image: Option<Image>,
}

impl<F: NorFlash> Updater<F> {
    /// Takes the slot that does not run, and the public key that images must be signed with.
    pub fn new(slot: F, key: Option<[u8; 32]>) -> Self {
        Self {
            slot,
            key,
            image: None,
        }
    }

    /// Takes another key.
    pub fn trust(&mut self, key: Option<[u8; 32]>) {
        self.key = key;
        self.image = None;
    }

    /// Gives the slot back.
    pub fn into_slot(self) -> F {
        self.slot
    }

    /// Returns whether an image is whole and signed: [`Trial::try_other`](crate::Trial::try_other)
    /// and a boot follow.
    pub fn is_ready(&self) -> bool {
        self.image.as_ref().is_some_and(|image| image.whole)
    }

    /// Takes a message. `moves`: something moves, so the flash must not be touched.
    pub fn handle(&mut self, message: &UpdateMessage<'_>, moves: bool) -> UpdateReply {
        if moves {
            return UpdateReply::Refused(UpdateRefusal::Moving);
        }
        let result = match *message {
            UpdateMessage::Begin {
                bytes,
                hash,
                signature,
            } => self.begin(bytes, hash, signature),
            UpdateMessage::Chunk { at, bytes } => self.chunk(at, bytes),
            UpdateMessage::Finish => self.finish(),
            // Who keeps the slots knows what runs.
            UpdateMessage::Look => Err(UpdateRefusal::Message),
            UpdateMessage::Abandon => {
                self.image = None;
                Ok(UpdateReply::At { bytes: 0 })
            }
        };
        result.unwrap_or_else(UpdateReply::Refused)
    }

    fn begin(
        &mut self,
        bytes: u32,
        hash: [u8; 32],
        signature: [u8; 64],
    ) -> Result<UpdateReply, UpdateRefusal> {
        if bytes == 0 || bytes as usize > self.slot.capacity() {
            return Err(UpdateRefusal::Size);
        }
        // The signature comes first: nobody without the key can wear the flash out.
        self.verify(&hash, &signature)?;
        // The same image again: go on where it was.
        if let Some(image) = &self.image
            && image.hash == hash
            && image.bytes == bytes
        {
            return Ok(UpdateReply::At {
                bytes: image.written_bytes,
            });
        }
        self.image = Some(Image {
            bytes,
            hash,
            signature,
            written_bytes: 0,
            hasher: Sha256::new(),
            whole: false,
        });
        Ok(UpdateReply::At { bytes: 0 })
    }

    fn chunk(&mut self, at: u32, bytes: &[u8]) -> Result<UpdateReply, UpdateRefusal> {
        let image = self.image.as_mut().ok_or(UpdateRefusal::NotBegun)?;
        let written_bytes = image.written_bytes;
        let end = at.saturating_add(bytes.len() as u32);
        if at != written_bytes || end > image.bytes {
            // Twice, or one is missing: say where it is.
            return Ok(UpdateReply::At {
                bytes: written_bytes,
            });
        }
        let last = end == image.bytes;
        if bytes.is_empty()
            || bytes.len() > CHUNK_BYTES_MAX
            || !last && !bytes.len().is_multiple_of(F::WRITE_SIZE)
        {
            return Err(UpdateRefusal::Chunk);
        }
        let unit = F::ERASE_SIZE as u32;
        let mut erase_at = at.next_multiple_of(unit);
        while erase_at < end {
            self.slot
                .erase(erase_at, erase_at + unit)
                .map_err(|_| UpdateRefusal::Flash)?;
            erase_at += unit;
        }
        let whole = bytes.len() / F::WRITE_SIZE * F::WRITE_SIZE;
        self.slot
            .write(at, &bytes[..whole])
            .map_err(|_| UpdateRefusal::Flash)?;
        if whole < bytes.len() {
            let mut word = [0xff; 16];
            word[..bytes.len() - whole].copy_from_slice(&bytes[whole..]);
            self.slot
                .write(at + whole as u32, &word[..F::WRITE_SIZE])
                .map_err(|_| UpdateRefusal::Flash)?;
        }
        let mut hasher = image.hasher.clone();
        hash_slot(&mut self.slot, at..end, &mut hasher)?;
        image.hasher = hasher;
        image.written_bytes = end;
        Ok(UpdateReply::At { bytes: end })
    }

    fn finish(&mut self) -> Result<UpdateReply, UpdateRefusal> {
        let image = self.image.as_ref().ok_or(UpdateRefusal::NotBegun)?;
        if image.written_bytes != image.bytes {
            return Ok(UpdateReply::At {
                bytes: image.written_bytes,
            });
        }
        let hash: [u8; 32] = image.hasher.clone().finalize().into();
        if hash != image.hash {
            self.image = None;
            return Err(UpdateRefusal::Hash);
        }
        self.verify(&hash, &image.signature)?;
        if let Some(image) = &mut self.image {
            image.whole = true;
        }
        Ok(UpdateReply::Ready)
    }

    fn verify(&self, hash: &[u8; 32], signature: &[u8; 64]) -> Result<(), UpdateRefusal> {
        let key = self.key.ok_or(UpdateRefusal::NoKey)?;
        let key = VerifyingKey::from_bytes(&key).map_err(|_| UpdateRefusal::NoKey)?;
        let mut signed = [0; SIGNED_PREFIX.len() + 32];
        signed[..SIGNED_PREFIX.len()].copy_from_slice(SIGNED_PREFIX);
        signed[SIGNED_PREFIX.len()..].copy_from_slice(hash);
        key.verify_strict(&signed, &Signature::from_bytes(signature))
            .map_err(|_| UpdateRefusal::Signature)
    }
}

/// Adds what the slot holds there. `range` begins at a word that can be written.
fn hash_slot<F: NorFlash>(
    slot: &mut F,
    range: Range<u32>,
    hasher: &mut Sha256,
) -> Result<(), UpdateRefusal> {
    let mut at = range.start;
    while at < range.end {
        let mut piece = [0; 256];
        let used = (range.end - at).min(256) as usize;
        let words = used.next_multiple_of(F::READ_SIZE.max(F::WRITE_SIZE));
        slot.read(at, &mut piece[..words])
            .map_err(|_| UpdateRefusal::Flash)?;
        hasher.update(&piece[..used]);
        at += used as u32;
    }
    Ok(())
}
