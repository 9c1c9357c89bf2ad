//! Records: ChaCha20-Poly1305 (RFC 8439).

use alloc::boxed::Box;
use chacha20poly1305::{AeadInOut, ChaCha20Poly1305, KeyInit, Nonce as ChaNonce, Tag};
use rustls::{
    ConnectionTrafficSecrets, ContentType, Error, ProtocolVersion,
    crypto::cipher::{
        AeadKey, InboundOpaqueMessage, InboundPlainMessage, Iv, MessageDecrypter, MessageEncrypter,
        Nonce, OutboundOpaqueMessage, OutboundPlainMessage, PrefixedPayload, Tls13AeadAlgorithm,
        UnsupportedOperationError, make_tls13_aad,
    },
};

/// Bytes of a key.
const KEY_BYTES: usize = 32;

/// Bytes that prove a record.
pub(super) const TAG_BYTES: usize = 16;

pub(super) struct ChaCha;

impl Tls13AeadAlgorithm for ChaCha {
    fn encrypter(&self, key: AeadKey, iv: Iv) -> Box<dyn MessageEncrypter> {
        Box::new(Direction::new(&key, iv))
    }

    fn decrypter(&self, key: AeadKey, iv: Iv) -> Box<dyn MessageDecrypter> {
        Box::new(Direction::new(&key, iv))
    }

    fn key_len(&self) -> usize {
        KEY_BYTES
    }

    fn extract_keys(
        &self,
        key: AeadKey,
        iv: Iv,
    ) -> Result<ConnectionTrafficSecrets, UnsupportedOperationError> {
        Ok(ConnectionTrafficSecrets::Chacha20Poly1305 { key, iv })
    }
}

/// Records of one direction.
struct Direction {
    cipher: ChaCha20Poly1305,
    iv: Iv,
}

impl Direction {
    fn new(key: &AeadKey, iv: Iv) -> Self {
        let cipher = ChaCha20Poly1305::new_from_slice(key.as_ref());
        Self {
            cipher: cipher.expect("rustls gives keys of `key_len` bytes"),
            iv,
        }
    }

    fn nonce(&self, seq: u64) -> ChaNonce {
        ChaNonce::from(Nonce::new(&self.iv, seq).0)
    }
}

impl MessageEncrypter for Direction {
    fn encrypt(
        &mut self,
        msg: OutboundPlainMessage<'_>,
        seq: u64,
    ) -> Result<OutboundOpaqueMessage, Error> {
        let total_bytes = self.encrypted_payload_len(msg.payload.len());
        let mut payload = PrefixedPayload::with_capacity(total_bytes);
        payload.extend_from_chunks(&msg.payload);
        payload.extend_from_slice(&[u8::from(msg.typ)]);
        let aad = make_tls13_aad(total_bytes);
        let nonce = self.nonce(seq);
        let tag = self
            .cipher
            .encrypt_inout_detached(&nonce, &aad, payload.as_mut().into())
            .map_err(|_| Error::EncryptError)?;
        payload.extend_from_slice(&tag);
        Ok(OutboundOpaqueMessage::new(
            ContentType::ApplicationData,
            // What a record of TLS 1.3 says of itself (RFC 8446, 5.1).
            ProtocolVersion::TLSv1_2,
            payload,
        ))
    }

    fn encrypted_payload_len(&self, payload_len: usize) -> usize {
        payload_len + 1 + TAG_BYTES
    }
}

impl MessageDecrypter for Direction {
    fn decrypt<'a>(
        &mut self,
        mut msg: InboundOpaqueMessage<'a>,
        seq: u64,
    ) -> Result<InboundPlainMessage<'a>, Error> {
        let aad = make_tls13_aad(msg.payload.len());
        let nonce = self.nonce(seq);
        let (plain, tag) = msg
            .payload
            .split_last_chunk_mut::<TAG_BYTES>()
            .ok_or(Error::DecryptError)?;
        let tag = Tag::from(*tag);
        let plain_bytes = plain.len();
        self.cipher
            .decrypt_inout_detached(&nonce, &aad, plain.into(), &tag)
            .map_err(|_| Error::DecryptError)?;
        msg.payload.truncate(plain_bytes);
        msg.into_tls13_unpadded_message()
    }
}
