//! What a node does about its firmware: takes images, proves itself on trial, goes back.
//!
//! ```text
//!   boot ─ Run ─────────────▶ proven ──image, signed──▶ journal: new ─ loader: other slot ─ restart
//!        ├ OnTrial ─▶ router reached ─▶ journal: good      (a cut in between: the old one runs)
//!        │          └ 60 s ─┐
//!        └ GoBack ──────────┴─▶ loader: other slot ─ restart (its boot settles the journal)
//! ```
//!
//! Which slot runs is the boot loader's word, never the journal's: the journal only says whether
//! that slot has proved itself. So the two are never written together, and a power cut between them
//! leaves a slot that boots. Flash is written only while nothing moves.

use crate::{
    Boot, Note, TRIAL_US, Trial, TrialError, Updater,
    region::{Place, Region},
};
use embedded_storage::nor_flash::NorFlash;
use keys::update::{UpdateMessage, UpdateRefusal, UpdateReply};

/// From the last answer to the restart, µs: the answer has left by then.
pub const RESTART_US: u64 = 500_000;

/// Where a node's images lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The slots.
    pub slots: [Place; 2],
    /// The journal of trials.
    pub journal: Place,
    /// The boot loader's note.
    pub note: Place,
}

impl Layout {
    /// That of a board.
    pub const BOARD: Self = Self {
        slots: crate::layout::SLOTS,
        journal: crate::layout::JOURNAL,
        note: crate::layout::OTADATA,
    };
}

/// See the module. `F` is a handle to the whole flash.
#[derive(Debug)]
pub struct Keeper<F> {
    updater: Updater<Region<F>>,
    trial: Trial<Region<F>>,
    note: Note<Region<F>>,
    running: u8,
    version: [u8; 3],
    /// When a trial has failed; `None`: it is none, or has succeeded.
    trial_ends_us: Option<u64>,
    /// The router was reached on trial, and the journal does not say so yet.
    reached: bool,
    restart_at_us: Option<u64>,
}

impl<F: NorFlash + Clone> Keeper<F> {
    /// Begins a boot of firmware of this version out of the slot `running`, as the first thing that
    /// it does: what fails before is not known to have been tried. It takes no images before it
    /// [trusts](Self::trust) a key.
    ///
    /// # Errors
    /// The journal cannot be read or written. The node runs on as it is, without updates.
    pub fn boot(
        flash: F,
        layout: Layout,
        running: u8,
        version: [u8; 3],
        now_us: u64,
    ) -> Result<Self, TrialError> {
        let mut trial = Trial::new(Region::new(flash.clone(), layout.journal))?;
        let boot = trial.boot(running)?;
        let other = layout.slots[usize::from(1 - running)];
        Ok(Self {
            updater: Updater::new(Region::new(flash.clone(), other), None),
            trial,
            note: Note::new(Region::new(flash, layout.note)),
            running,
            version,
            trial_ends_us: match boot {
                Boot::Run => None,
                Boot::OnTrial => Some(now_us.saturating_add(TRIAL_US)),
                // At the first poll.
                Boot::GoBack => Some(now_us),
            },
            reached: false,
            restart_at_us: None,
        })
    }

    /// Takes images from now on, if they are signed with this public key.
    pub fn trust(&mut self, key: Option<[u8; 32]>) {
        self.updater.trust(key);
    }

    /// Returns the slot that runs.
    pub fn running(&self) -> u8 {
        self.running
    }

    /// Returns whether the slot that runs has not proved itself yet.
    pub fn is_on_trial(&self) -> bool {
        self.trial_ends_us.is_some()
    }

    /// Takes a message. `moves`: something moves, so the flash must not be touched.
    pub fn handle(&mut self, message: &UpdateMessage<'_>, moves: bool, now_us: u64) -> UpdateReply {
        if *message == UpdateMessage::Look {
            return UpdateReply::Runs {
                version: self.version,
                slot: self.running,
                on_trial: self.is_on_trial(),
            };
        }
        if self.is_on_trial() {
            // The other slot is the way back.
            return UpdateReply::Refused(UpdateRefusal::OnTrial);
        }
        if self.restart_at_us.is_some() {
            // The other slot is decided; whoever has missed the answer hears it again.
            return UpdateReply::Ready;
        }
        let reply = self.updater.handle(message, moves);
        if reply != UpdateReply::Ready {
            return reply;
        }
        let other = 1 - self.running;
        let selected = self
            .trial
            .try_other()
            .and_then(|()| self.note.select_on_trial(other));
        if selected.is_err() {
            return UpdateReply::Refused(UpdateRefusal::Flash);
        }
        self.restart_at_us = Some(now_us.saturating_add(RESTART_US));
        reply
    }

    /// The session with the router is open.
    pub fn link_up(&mut self) {
        self.reached |= self.trial_ends_us.is_some();
    }

    /// Lets time pass. Returns whether the node must restart now.
    pub fn poll(&mut self, now_us: u64, moves: bool) -> bool {
        if moves {
            return false;
        }
        if self.reached {
            // Not kept: tried again at the next call.
            if self
                .trial
                .confirm()
                .and_then(|()| self.note.select_proven(self.running))
                .is_ok()
            {
                self.reached = false;
                self.trial_ends_us = None;
            }
        } else if self.trial_ends_us.is_some_and(|at_us| now_us >= at_us)
            && self.restart_at_us.is_none()
            && self.note.select_proven(1 - self.running).is_ok()
        {
            self.restart_at_us = Some(now_us);
        }
        self.restart_at_us.is_some_and(|at_us| now_us >= at_us)
    }

    /// Returns whether [`Keeper::poll`] has something to do now, for whom a call is dear.
    pub fn is_due(&self, now_us: u64) -> bool {
        self.reached || self.poll_timeout().is_some_and(|at_us| at_us <= now_us)
    }

    /// Returns when [`Keeper::poll`] has something to do next.
    pub fn poll_timeout(&self) -> Option<u64> {
        let trial = self.trial_ends_us.filter(|_| !self.reached);
        trial.into_iter().chain(self.restart_at_us).min()
    }
}
