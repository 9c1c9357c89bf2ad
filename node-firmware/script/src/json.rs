//! What a script returns or publishes, as JSON. Owns the bounds; reading Lua's values is `ffi`'s.

use alloc::{string::String, vec::Vec};
use core::fmt::{self, Write};

/// Longest JSON text of one value, bytes: it must fit one message.
pub const JSON_BYTES_MAX: usize = 1024;

/// Why a value has no JSON text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JsonError {
    /// More than [`JSON_BYTES_MAX`] bytes.
    Long,
    /// Tables within tables, too deep, or within themselves.
    Depth,
    /// A function, a coroutine.
    Kind,
    /// A table with both items and names, or with keys that are neither.
    Mixed,
}

impl fmt::Display for JsonError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Long => write!(f, "more than {JSON_BYTES_MAX} bytes as JSON"),
            Self::Depth => write!(f, "tables nested deeper than {}", Json::DEPTH_MAX),
            Self::Kind => write!(f, "functions and coroutines have no JSON"),
            Self::Mixed => write!(f, "a table must have either items 1 to n or names"),
        }
    }
}

impl core::error::Error for JsonError {}

/// A text that grows value by value.
#[derive(Debug, Default)]
pub(crate) struct Json {
    text: String,
    /// Bytes that are kept elsewhere for a while.
    elsewhere_bytes: usize,
}

impl Json {
    pub(crate) const DEPTH_MAX: u32 = 8;

    pub(crate) fn new() -> Self {
        Self::default()
    }

    /// Begins a text that will be put into this one.
    pub(crate) fn part(&self) -> Self {
        Self {
            text: String::new(),
            elsewhere_bytes: self.elsewhere_bytes + self.text.len(),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.text.len()
    }

    pub(crate) fn count(&mut self, bytes: usize) {
        self.elsewhere_bytes = self.elsewhere_bytes.saturating_add(bytes);
    }

    pub(crate) fn check(&self) -> Result<(), JsonError> {
        if self.text.len() + self.elsewhere_bytes > JSON_BYTES_MAX {
            return Err(JsonError::Long);
        }
        Ok(())
    }

    pub(crate) fn null(&mut self) {
        self.text.push_str("null");
    }

    pub(crate) fn boolean(&mut self, value: bool) {
        self.text.push_str(if value { "true" } else { "false" });
    }

    pub(crate) fn integer(&mut self, value: i32) {
        let _ = write!(self.text, "{value}");
    }

    pub(crate) fn number(&mut self, value: f32) {
        if value.is_finite() {
            let _ = write!(self.text, "{value:?}");
        } else {
            self.null();
        }
    }

    pub(crate) fn text(&mut self, text: &str) {
        if text.len() > JSON_BYTES_MAX {
            self.count(text.len());
            return;
        }
        self.text.push('"');
        for letter in text.chars() {
            match letter {
                '"' => self.text.push_str("\\\""),
                '\\' => self.text.push_str("\\\\"),
                '\n' => self.text.push_str("\\n"),
                '\t' => self.text.push_str("\\t"),
                '\r' => self.text.push_str("\\r"),
                control if u32::from(control) < 0x20 => {
                    let _ = write!(self.text, "\\u{:04x}", u32::from(control));
                }
                letter => self.text.push(letter),
            }
        }
        self.text.push('"');
    }

    pub(crate) fn begin_list(&mut self) {
        self.text.push('[');
    }

    pub(crate) fn next_item(&mut self) {
        if !self.text.ends_with('[') {
            self.text.push(',');
        }
    }

    pub(crate) fn end_list(&mut self) {
        self.text.push(']');
    }

    /// Writes an object, its fields by name: in the same order on every node.
    pub(crate) fn object(&mut self, mut fields: Vec<(String, Self)>) {
        fields.sort_by(|a, b| a.0.cmp(&b.0));
        self.text.push('{');
        for (index, (name, value)) in fields.iter().enumerate() {
            if index > 0 {
                self.text.push(',');
            }
            self.text(name);
            self.text.push(':');
            self.text.push_str(&value.text);
            let counted = name.len() + value.text.len();
            self.elsewhere_bytes = self.elsewhere_bytes.saturating_sub(counted);
        }
        self.text.push('}');
    }

    pub(crate) fn finish(self) -> Result<String, JsonError> {
        self.check()?;
        Ok(self.text)
    }
}
