//! The key of something that was received, in a form that costs no memory of the heap while it is
//! short.
//!
//! A key is short up to [`KEY_INLINE_BYTES`]; the keys of a fleet are. A longer one is a `String`.

use alloc::string::String;
use core::{fmt, ops::Deref};

use crate::limits::KEY_INLINE_BYTES;

/// A key expression as it was sent; it may be wild. Reads as `str`.
#[derive(Clone)]
pub struct Key(Text);

#[derive(Clone)]
enum Text {
    Short {
        bytes: [u8; KEY_INLINE_BYTES],
        length: u8,
    },
    Long(String),
}

const _: () = assert!(KEY_INLINE_BYTES <= u8::MAX as usize);

impl Key {
    /// Puts two parts together.
    pub(crate) fn joined(base: &str, suffix: &str) -> Self {
        let length = base.len() + suffix.len();
        if length > KEY_INLINE_BYTES {
            return Self(Text::Long(crate::declarations::joined(base, suffix)));
        }
        let mut bytes = [0; KEY_INLINE_BYTES];
        bytes[..base.len()].copy_from_slice(base.as_bytes());
        bytes[base.len()..length].copy_from_slice(suffix.as_bytes());
        // Checked above, and by the assertion that the bound fits.
        let length = length as u8;
        Self(Text::Short { bytes, length })
    }

    /// Returns the text.
    pub fn as_str(&self) -> &str {
        match &self.0 {
            Text::Short { bytes, length } => core::str::from_utf8(&bytes[..usize::from(*length)])
                .expect("whole texts are put in, one behind the other"),
            Text::Long(text) => text,
        }
    }
}

impl Deref for Key {
    type Target = str;

    fn deref(&self) -> &str {
        self.as_str()
    }
}

impl From<&str> for Key {
    fn from(text: &str) -> Self {
        Self::joined(text, "")
    }
}

impl From<String> for Key {
    /// Keeps the memory that the text has already.
    fn from(text: String) -> Self {
        Self(Text::Long(text))
    }
}

impl From<Key> for String {
    fn from(key: Key) -> Self {
        match key.0 {
            Text::Short { .. } => Self::from(key.as_str()),
            Text::Long(text) => text,
        }
    }
}

impl PartialEq for Key {
    fn eq(&self, other: &Self) -> bool {
        self.as_str() == other.as_str()
    }
}

impl Eq for Key {}

impl PartialEq<str> for Key {
    fn eq(&self, other: &str) -> bool {
        self.as_str() == other
    }
}

impl PartialEq<&str> for Key {
    fn eq(&self, other: &&str) -> bool {
        self.as_str() == *other
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::{format, string::ToString};

    #[test]
    fn a_key_reads_the_same_whether_short_or_long_and_wherever_it_was_cut() {
        // Miri takes a thousand times as long: it sees some lengths, and those around the border.
        let stride = if cfg!(miri) { 31 } else { 1 };
        let text = "fleet/node/ä/".repeat(KEY_INLINE_BYTES);
        let looked_at = |bytes: &usize| bytes.is_multiple_of(stride) || *bytes >= KEY_INLINE_BYTES;
        let lengths = (0..=KEY_INLINE_BYTES + 2).filter(looked_at);
        for bytes in lengths.filter(|at| text.is_char_boundary(*at)) {
            let whole = &text[..bytes];
            let cuts = (0..=bytes).step_by(stride);
            for cut in cuts.filter(|at| whole.is_char_boundary(*at)) {
                let key = Key::joined(&whole[..cut], &whole[cut..]);
                assert_eq!(key, *whole);
                assert_eq!(key, Key::from(whole.to_string()));
                assert_eq!(format!("{key:?}"), format!("{whole:?}"));
                assert_eq!(String::from(key), whole);
            }
        }
    }
}
