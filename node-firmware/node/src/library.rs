//! Scripts that are stored on the node, by name. In memory; a board keeps a copy in its flash and
//! puts it back at its boot.

use alloc::{string::String, vec::Vec};
use keys::{NodeId, script::SCRIPT_BYTES_MAX};

/// Most stored scripts.
pub const STORED_MAX: usize = 32;

/// Why a script is not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// The name is none: `[a-z0-9][a-z0-9_-]{0,31}`.
    Name,
    /// Longer than [`SCRIPT_BYTES_MAX`].
    Long,
    /// The text is not UTF-8.
    Text,
    /// There are [`STORED_MAX`] already.
    Full,
}

impl core::fmt::Display for StoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Name => write!(f, "the name must be 1 to 32 of a-z, 0-9, _ and -"),
            Self::Long => write!(f, "a script has at most {SCRIPT_BYTES_MAX} bytes"),
            Self::Text => write!(f, "the script is not UTF-8"),
            Self::Full => write!(f, "a node stores at most {STORED_MAX} scripts"),
        }
    }
}

impl core::error::Error for StoreError {}

/// Scripts by name.
#[derive(Clone, Debug, Default)]
pub struct Library {
    scripts: Vec<(String, String)>,
}

impl Library {
    /// Returns the text of this name.
    pub fn get(&self, name: &str) -> Option<&str> {
        let found = self.scripts.iter().find(|(stored, _)| stored == name);
        found.map(|(_, text)| text.as_str())
    }

    /// Stores a script, in place of one of the same name.
    ///
    /// # Errors
    /// Why not; nothing has changed then.
    pub fn put(&mut self, name: &str, text: &[u8]) -> Result<(), StoreError> {
        NodeId::new(name).map_err(|_| StoreError::Name)?;
        if text.len() > SCRIPT_BYTES_MAX {
            return Err(StoreError::Long);
        }
        let text = core::str::from_utf8(text).map_err(|_| StoreError::Text)?;
        if let Some((_, stored)) = self.scripts.iter_mut().find(|(stored, _)| stored == name) {
            *stored = text.into();
            return Ok(());
        }
        if self.scripts.len() >= STORED_MAX {
            return Err(StoreError::Full);
        }
        self.scripts.push((name.into(), text.into()));
        self.scripts.sort_unstable();
        Ok(())
    }

    /// Removes a script; one that is not there is no error.
    pub fn remove(&mut self, name: &str) {
        self.scripts.retain(|(stored, _)| stored != name);
    }

    /// Gives names and texts, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.scripts
            .iter()
            .map(|(name, text)| (name.as_str(), text.as_str()))
    }
}
