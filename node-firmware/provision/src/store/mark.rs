//! The mark of a record that was finished: which one, and whose.

use crate::record::Record;

/// A mark begins with this.
const MARK_MAGIC: u32 = 0x4b52_4d46;
pub(super) const MARK_BYTES: usize = 16;
/// A finished record, in the words of its mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Mark {
    pub(super) sequence: u32,
    pub(super) identity: u32,
}

/// Returns a checksum of who the node is, whom it talks to and believes, and how it is wired: of all that
/// an older record must have in common to stand in for a newer one.
pub(super) fn identity(record: &Record) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    // Each with its length, and what may be missing with a sign, so that nothing else reads the same.
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u32).to_le_bytes());
        hasher.update(bytes);
    };
    part(
        record
            .name
            .as_ref()
            .map_or("", |name| name.as_str())
            .as_bytes(),
    );
    part(record.prefix.as_bytes());
    part(&[record.networks.len() as u8]);
    for network in &record.networks {
        part(network.ssid.as_bytes());
        part(network.password.as_bytes());
    }
    let mut address = [0; 10];
    if let Some(fixed) = &record.fixed_address {
        address[0] = 1;
        address[1..5].copy_from_slice(&fixed.address);
        address[5] = fixed.prefix_bits;
        address[6..].copy_from_slice(&fixed.gateway);
    }
    part(&address);
    part(record.router.as_bytes());
    part(&[u8::from(record.login.is_some())]);
    if let Some(login) = &record.login {
        part(login.user.as_bytes());
        part(login.password.as_bytes());
    }
    part(record.update_key.as_ref().map_or(&[], |key| &key[..]));
    part(&[u8::from(record.boot_script), record.signers.len() as u8]);
    for key in &record.signers {
        part(key);
    }
    part(&[u8::from(record.authority.is_some())]);
    if let Some(authority) = &record.authority {
        part(&authority.subject);
        part(&authority.key);
    }
    part(&[record.wiring.axes() as u8, record.wiring.pins.len() as u8]);
    for pin in &record.wiring.pins {
        let mut bytes = [0; 8];
        let bytes = postcard::to_slice(pin, &mut bytes).expect("a pin is six bytes at most");
        part(bytes);
    }
    hasher.finalize()
}

pub(super) fn mark_bytes(mark: Mark) -> [u8; MARK_BYTES] {
    let mut bytes = [0; MARK_BYTES];
    bytes[0..4].copy_from_slice(&MARK_MAGIC.to_le_bytes());
    bytes[4..8].copy_from_slice(&mark.sequence.to_le_bytes());
    bytes[8..12].copy_from_slice(&mark.identity.to_le_bytes());
    let crc = crc32fast::hash(&bytes[..12]);
    bytes[12..16].copy_from_slice(&crc.to_le_bytes());
    bytes
}

pub(super) fn mark_of(bytes: &[u8; MARK_BYTES]) -> Option<Mark> {
    let word =
        |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let mark = Mark {
        sequence: word(4),
        identity: word(8),
    };
    (mark_bytes(mark) == *bytes).then_some(mark)
}
