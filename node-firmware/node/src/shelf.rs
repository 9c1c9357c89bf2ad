//! The stored scripts of a node: what is put, removed, saved, and which of them may run.
//!
//! ```text
//!   put, delete ─▶ signed? ─▶ Library ─▶ ScriptStore, while nothing moves ─▶ a line in the log
//! ```
//!
//! On a board the flash belongs to the other core, so the store is there: [`Node::stock_scripts`],
//! [`Node::take_change`] and [`Node::note_saved`] are its border. A node with signers stores and runs only what one of them has signed; the others stay where they
//! are and can be read.

use crate::{
    Node, Outputs,
    library::{BoxedStore, Change, Saved},
    signed::{StoredRefusal, check_stored},
};
use alloc::string::String;
use keys::LocalMicros;
use motion::StepBackend;

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes the stored scripts of the boots before, and saves changes to this store from now on. Call
    /// it once, before anything else; then [`Node::run_boot_script`].
    pub fn open_store(&mut self, now: LocalMicros, store: BoxedStore) {
        let now = self.advance_to(now);
        if let Err(error) = self.stored.attach(store) {
            self.log(now, format_args!("stored scripts: {error}"));
        }
        self.judge_stored(now);
    }

    /// Takes the stored scripts from whoever keeps them elsewhere: as [`Node::open_store`].
    pub fn stock_scripts(
        &mut self,
        now: LocalMicros,
        scripts: impl IntoIterator<Item = (String, String)>,
    ) {
        let now = self.advance_to(now);
        self.stored.stock(scripts);
        self.judge_stored(now);
    }

    /// Gives the next change to whoever keeps the scripts elsewhere; nothing moves then.
    pub fn take_change(&mut self) -> Option<Change> {
        if self.may_save() && !self.stored.can_save() {
            self.stored.take_change()
        } else {
            None
        }
    }

    /// Hears how saving a change elsewhere went.
    pub fn note_saved(&mut self, now: LocalMicros, saved: &Saved) {
        let now = self.advance_to(now);
        self.log_saved(now, saved);
    }

    /// A node that executes only what was signed asks the same of what it has stored.
    fn judge_stored(&mut self, now: LocalMicros) {
        let (keys, node) = (&self.config.signers, &self.config.name);
        if keys.is_empty() {
            return;
        }
        let mut refused: Option<(String, usize)> = None;
        self.stored.judge(|name, text| {
            let may_run = check_stored(keys, node, name, text).is_ok();
            if !may_run {
                let first = refused.take();
                let (first, count) = first.unwrap_or_else(|| (name.into(), 0));
                refused = Some((first, count + 1));
            }
            may_run
        });
        // One line for all: the log of a boot has few.
        match refused {
            None => {}
            Some((name, 1)) => {
                self.log(
                    now,
                    format_args!("script {name} is not signed: it does not run"),
                );
            }
            Some((name, count)) => {
                let more = count - 1;
                let words =
                    format_args!("script {name} and {more} more are not signed: they do not run");
                self.log(now, words);
            }
        }
    }

    /// Stores a script, or removes it: in memory at once, for good as soon as nothing moves. The log
    /// says so.
    pub fn store_script(&mut self, now: LocalMicros, name: &str, text: Option<&[u8]>) {
        let now = self.advance_to(now);
        let text = match self.signed_change(name, text) {
            Ok(text) => text,
            Err(refusal) => {
                self.log(now, format_args!("script {name} not taken: {refusal}"));
                return;
            }
        };
        let (result, word) = match text {
            Some(text) => (self.stored.put(name, text), "stored"),
            None => (self.stored.remove(name), "removed"),
        };
        match result {
            Err(error) => self.log(now, format_args!("script {name} not {word}: {error}")),
            Ok(()) if !self.stored.has_unsaved() => {
                self.log(now, format_args!("script {name} {word}"));
            }
            Ok(()) if self.may_save() => {}
            Ok(()) => self.log(
                now,
                format_args!("script {name} {word}; it is saved when nothing moves"),
            ),
        }
        self.settle(now);
    }

    /// Returns what a change is once its signature was looked at: a text, or nothing for a removal.
    fn signed_change<'t>(
        &mut self,
        name: &str,
        text: Option<&'t [u8]>,
    ) -> Result<Option<&'t [u8]>, StoredRefusal> {
        if self.config.signers.is_empty() {
            return Ok(text);
        }
        // It would be called by a signed job without being signed itself.
        let stored = text.and_then(|text| core::str::from_utf8(text).ok());
        let stored = stored.ok_or(StoredRefusal::NotSigned)?;
        // What came twice over the network is there already.
        if self.stored.runnable(name) == Some(stored) {
            return Ok(text);
        }
        let (keys, node) = (&self.config.signers, &self.config.name);
        let boot = self.queue.boot;
        let signed = self.signed.take_stored(keys, node, boot, name, stored)?;
        Ok(text.filter(|_| !signed.is_empty()))
    }

    /// Saves what waits for it, one script at a time: each may take long.
    pub(crate) fn save_scripts(&mut self, now: LocalMicros) {
        if !self.may_save() {
            return;
        }
        if let Some(saved) = self.stored.save_next() {
            self.log_saved(now, &saved);
        }
    }

    fn log_saved(&mut self, now: LocalMicros, saved: &Saved) {
        let name = &saved.name;
        let word = if saved.removed { "removed" } else { "stored" };
        match saved.result {
            Ok(()) => self.log(now, format_args!("script {name} {word}")),
            Err(error) => self.log(
                now,
                format_args!("script {name} {word} until the next start only: {error}"),
            ),
        }
    }

    /// Nothing moves, and nothing is about to.
    pub(crate) fn may_save(&self) -> bool {
        !self.motion.is_active()
    }
}
