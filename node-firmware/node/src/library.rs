//! Scripts that are stored on the node, by name: all of them in memory, and a copy in a
//! [`ScriptStore`] that outlives a restart.
//!
//! ```text
//!  put, delete ─▶ Library (memory) ─ unsaved names ─▶ ScriptStore (flash, a folder)
//!                     ▲                 one at a time, while nothing moves │
//!                     └──────────────────── load, at the start ◀───────────┘
//! ```
//!
//! What is put counts at once and is saved when nothing moves, since a flash that is being written
//! cannot be read. A log line says when it is safe. A power cut in between costs the change, not the
//! text before it.

pub mod flash;

use alloc::{boxed::Box, string::String, vec::Vec};
use keys::{NodeId, script::SCRIPT_BYTES_MAX};

/// Most stored scripts.
pub const STORED_MAX: usize = 32;

/// Most changes that wait to be saved.
pub const UNSAVED_MAX: usize = 2 * STORED_MAX;

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
    /// [`UNSAVED_MAX`] changes wait for the motion to end.
    Busy,
}

impl core::fmt::Display for StoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Name => write!(f, "the name must be 1 to 32 of a-z, 0-9, _ and -"),
            Self::Long => write!(f, "a script has at most {SCRIPT_BYTES_MAX} bytes"),
            Self::Text => write!(f, "the script is not UTF-8"),
            Self::Full => write!(f, "a node stores at most {STORED_MAX} scripts"),
            Self::Busy => write!(f, "{UNSAVED_MAX} changes wait for the motion to end"),
        }
    }
}

impl core::error::Error for StoreError {}

/// Why a store could not do it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError {
    /// There is no room.
    Full,
    /// The flash, or the folder, cannot be read or written.
    Broken,
}

impl core::fmt::Display for SaveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Full => "there is no room for it",
            Self::Broken => "the store cannot be read or written",
        })
    }
}

impl core::error::Error for SaveError {}

/// Where stored scripts outlive a restart: the flash of a board, a folder of a PC.
///
/// | call | when | contract |
/// |---|---|---|
/// | `load` | once, at the start, before anything moves | gives every script that is whole, in any order |
/// | `save` | while nothing moves | afterwards, and after a power cut at any point in it, `load` gives the text before or this one |
/// | `remove` | while nothing moves | a name that is not there is no error |
///
/// A call may take as long as it needs: the node does nothing else meanwhile.
pub trait ScriptStore: core::fmt::Debug {
    /// Gives names and texts to `take`.
    ///
    /// # Errors
    /// Some of it could not be read; what was given is good.
    fn load(&mut self, take: &mut dyn FnMut(&str, &[u8])) -> Result<(), SaveError>;

    /// Saves a script in place of one of the same name. Names are `[a-z0-9][a-z0-9_-]{0,31}`, texts
    /// have at most [`SCRIPT_BYTES_MAX`] bytes of UTF-8, and there are at most [`STORED_MAX`].
    ///
    /// # Errors
    /// It is not saved.
    fn save(&mut self, name: &str, text: &[u8]) -> Result<(), SaveError>;

    /// Removes a script.
    ///
    /// # Errors
    /// It may be there again after a restart.
    fn remove(&mut self, name: &str) -> Result<(), SaveError>;
}

/// A store that a node takes with it, to whatever thread.
pub type BoxedStore = Box<dyn ScriptStore + Send>;

/// One change that reached the store, or did not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Saved {
    /// The script's name.
    pub name: String,
    /// Whether it was removed.
    pub removed: bool,
    /// How it went.
    pub result: Result<(), SaveError>,
}

#[derive(Debug)]
struct Script {
    name: String,
    text: String,
    /// The node may run it.
    runs: bool,
}

/// One change that somebody else is to save.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The script's name.
    pub name: String,
    /// Its text; `None`: it was removed.
    pub text: Option<String>,
}

/// Scripts by name.
#[derive(Debug, Default)]
pub struct Library {
    scripts: Vec<Script>,
    store: Option<BoxedStore>,
    /// There is a store, here or with whoever calls [`Library::save_next_to`].
    is_kept: bool,
    /// Names whose text, or absence, the store does not have yet, oldest first.
    unsaved: Vec<String>,
}

impl Library {
    /// Takes what a store holds, and saves changes to it from now on.
    ///
    /// # Errors
    /// Some of it could not be read; the rest is here, and changes are saved all the same.
    pub fn attach(&mut self, mut store: BoxedStore) -> Result<(), SaveError> {
        let result = self.load(&mut *store);
        self.store = Some(store);
        result
    }

    /// Takes what a store holds that stays with the caller, who saves the changes to it from now on:
    /// [`Library::save_next_to`].
    ///
    /// # Errors
    /// Those of [`Library::attach`].
    pub fn load(&mut self, store: &mut dyn ScriptStore) -> Result<(), SaveError> {
        let mut result = Ok(());
        let loaded = store.load(&mut |name, text| {
            // What no node would have saved has come there by other ways.
            if self.put_text(name, text).is_err() {
                result = Err(SaveError::Broken);
            }
        });
        self.is_kept = true;
        loaded.and(result)
    }

    /// Gives the store back, for the next start. What was not saved is lost with this one.
    pub fn detach(&mut self) -> Option<BoxedStore> {
        self.unsaved.clear();
        self.is_kept = false;
        self.store.take()
    }

    /// Returns the text of this name.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.find(name).map(|script| script.text.as_str())
    }

    /// Returns the text of this name, if the node may run it.
    pub fn runnable(&self, name: &str) -> Option<&str> {
        let found = self.find(name).filter(|script| script.runs);
        found.map(|script| script.text.as_str())
    }

    /// Decides, by name and text, which scripts may be run.
    pub fn judge(&mut self, mut may_run: impl FnMut(&str, &str) -> bool) {
        for script in &mut self.scripts {
            script.runs = may_run(&script.name, &script.text);
        }
    }

    fn find(&self, name: &str) -> Option<&Script> {
        self.scripts.iter().find(|script| script.name == name)
    }

    /// Stores a script that may be run, in place of one of the same name.
    ///
    /// # Errors
    /// Why not; nothing has changed then.
    pub fn put(&mut self, name: &str, text: &[u8]) -> Result<(), StoreError> {
        self.demand_room(name)?;
        self.put_text(name, text)?;
        self.note_unsaved(name);
        Ok(())
    }

    /// Removes a script; one that is not there is no error.
    ///
    /// # Errors
    /// Why not; nothing has changed then.
    pub fn remove(&mut self, name: &str) -> Result<(), StoreError> {
        if self.get(name).is_none() {
            return Ok(());
        }
        self.demand_room(name)?;
        self.scripts.retain(|script| script.name != name);
        self.note_unsaved(name);
        Ok(())
    }

    /// Gives names and texts, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.scripts
            .iter()
            .map(|script| (script.name.as_str(), script.text.as_str()))
    }

    /// Takes what somebody else has read, and keeps: [`Library::take_change`] tells what changes.
    pub fn stock(&mut self, scripts: impl IntoIterator<Item = (String, String)>) {
        self.is_kept = true;
        for (name, text) in scripts {
            // What no node would have saved is not there.
            let _ = self.put_text(&name, text.as_bytes());
        }
    }

    /// Gives the oldest change to whoever saves it.
    pub fn take_change(&mut self) -> Option<Change> {
        if self.unsaved.is_empty() {
            return None;
        }
        let name = self.unsaved.remove(0);
        let text = self.get(&name).map(String::from);
        Some(Change { name, text })
    }

    /// Makes a change that somebody else has decided on, and notes that it is to be saved.
    ///
    /// # Errors
    /// Those of [`Library::put`].
    pub fn follow(&mut self, change: &Change) -> Result<(), StoreError> {
        match &change.text {
            Some(text) => self.put(&change.name, text.as_bytes()),
            None => self.remove(&change.name),
        }
    }

    /// Returns whether changes wait to be saved.
    pub fn has_unsaved(&self) -> bool {
        !self.unsaved.is_empty()
    }

    /// Returns whether [`Library::save_next`] has something to do.
    pub fn can_save(&self) -> bool {
        self.has_unsaved() && self.store.is_some()
    }

    /// Saves the oldest change, and tells how that went; `None` if there was none. One that fails is
    /// not tried again: a flash that is worn out gets no better.
    pub fn save_next(&mut self) -> Option<Saved> {
        let mut store = self.store.take()?;
        let saved = self.save_next_to(&mut *store);
        self.store = Some(store);
        saved
    }

    /// Does what [`Library::save_next`] does, with a store that stays with the caller.
    pub fn save_next_to(&mut self, store: &mut dyn ScriptStore) -> Option<Saved> {
        if self.unsaved.is_empty() {
            return None;
        }
        let name = self.unsaved.remove(0);
        let script = self.find(&name);
        let result = match script {
            Some(script) => store.save(&name, script.text.as_bytes()),
            None => store.remove(&name),
        };
        Some(Saved {
            removed: script.is_none(),
            name,
            result,
        })
    }

    fn put_text(&mut self, name: &str, text: &[u8]) -> Result<(), StoreError> {
        NodeId::new(name).map_err(|_| StoreError::Name)?;
        if text.len() > SCRIPT_BYTES_MAX {
            return Err(StoreError::Long);
        }
        let text = core::str::from_utf8(text).map_err(|_| StoreError::Text)?;
        if let Some(script) = self.scripts.iter_mut().find(|script| script.name == name) {
            script.text = text.into();
            script.runs = true;
            return Ok(());
        }
        if self.scripts.len() >= STORED_MAX {
            return Err(StoreError::Full);
        }
        self.scripts.push(Script {
            name: name.into(),
            text: text.into(),
            runs: true,
        });
        self.scripts.sort_unstable_by(|a, b| a.name.cmp(&b.name));
        Ok(())
    }

    fn demand_room(&self, name: &str) -> Result<(), StoreError> {
        let waits = self.unsaved.iter().any(|unsaved| unsaved == name);
        if self.unsaved.len() >= UNSAVED_MAX && !waits {
            return Err(StoreError::Busy);
        }
        Ok(())
    }

    fn note_unsaved(&mut self, name: &str) {
        if self.is_kept && !self.unsaved.iter().any(|unsaved| unsaved == name) {
            self.unsaved.push(name.into());
        }
    }
}
