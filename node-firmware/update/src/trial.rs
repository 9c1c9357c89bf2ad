//! Whether the slot that runs has proved itself. Which one runs, the boot loader says.
//!
//! ```text
//!   entry, 16 bytes, one after the other in an erase unit; the last valid one counts
//!   ┌──────────┬──────┬───────┬─────────┬─────┐   two units: when one is full the next entry
//!   │ sequence │ slot │ state │ 2 × 0xff │ crc │   begins the other one
//!   │   u32    │  u8  │  u8   │          │ u64 │
//!   └──────────┴──────┴───────┴─────────┴─────┘
//!   state: new ──boot──▶ tried ──reached the router──▶ good
//!                          └──boots again, or 60 s──▶ the boot loader starts the other one, good
//! ```

use embedded_storage::nor_flash::NorFlash;

/// How long an image on trial has to reach the router, µs.
pub const TRIAL_US: u64 = 60_000_000;

const ENTRY_BYTES: usize = 16;

/// The flash did not do what it was told, or is too small.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrialError;

impl core::fmt::Display for TrialError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the flash did not keep which slot boots")
    }
}

impl core::error::Error for TrialError {}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    New,
    Tried,
    Good,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Entry {
    sequence: u32,
    slot: u8,
    state: State,
}

impl Entry {
    fn to_bytes(self) -> [u8; ENTRY_BYTES] {
        let mut bytes = [0xff; ENTRY_BYTES];
        bytes[..4].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[4] = self.slot;
        bytes[5] = match self.state {
            State::New => 1,
            State::Tried => 2,
            State::Good => 3,
        };
        let crc = crc32fast::hash(&bytes[..8]);
        bytes[8..12].copy_from_slice(&crc.to_le_bytes());
        bytes[12..].copy_from_slice(&(!crc).to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: [u8; ENTRY_BYTES]) -> Option<Self> {
        let state = match bytes[5] {
            1 => State::New,
            2 => State::Tried,
            3 => State::Good,
            _ => return None,
        };
        let entry = Self {
            sequence: u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
            slot: bytes[4],
            state,
        };
        (entry.to_bytes() == bytes && entry.slot < 2).then_some(entry)
    }
}

/// What a boot has to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boot {
    /// Run: this slot has proved itself.
    Run,
    /// Run on trial: call [`Trial::confirm`] when the router is reached, or do as for
    /// [`Boot::GoBack`] after [`TRIAL_US`].
    OnTrial,
    /// It was tried before without success: have the boot loader start the other slot. The journal
    /// follows at that boot, so that a power cut in between changes nothing.
    GoBack,
}

/// The journal of slots.
#[derive(Debug)]
pub struct Trial<F> {
    flash: F,
    entry: Entry,
    /// Place of the next entry, in entries from the begin of the first unit.
    next: u32,
}

impl<F: NorFlash> Trial<F> {
    /// Reads the journal; without one slot 0 runs and is good.
    ///
    /// # Errors
    /// The flash cannot be read or is smaller than two erase units.
    pub fn new(mut flash: F) -> Result<Self, TrialError> {
        if flash.capacity() < 2 * F::ERASE_SIZE || !ENTRY_BYTES.is_multiple_of(F::WRITE_SIZE) {
            return Err(TrialError);
        }
        let mut entry = Entry {
            sequence: 0,
            slot: 0,
            state: State::Good,
        };
        let mut next = 0;
        for place in 0..2 * Self::entries_of_unit() {
            let mut bytes = [0; ENTRY_BYTES];
            flash
                .read(place * ENTRY_BYTES as u32, &mut bytes)
                .map_err(|_| TrialError)?;
            if let Some(found) = Entry::from_bytes(bytes)
                && found.sequence > entry.sequence
            {
                entry = found;
                next = place + 1;
            }
        }
        Ok(Self { flash, entry, next })
    }

    const fn entries_of_unit() -> u32 {
        (F::ERASE_SIZE / ENTRY_BYTES) as u32
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Returns whether the slot that runs has not proved itself yet.
    pub fn is_on_trial(&self) -> bool {
        self.entry.state != State::Good
    }

    /// Begins a boot of the slot `running`.
    ///
    /// # Errors
    /// The flash did not keep it; the node runs on as it is.
    pub fn boot(&mut self, running: u8) -> Result<Boot, TrialError> {
        match (self.entry.state, self.entry.slot == running) {
            (State::Good, true) => Ok(Boot::Run),
            (State::New, true) => {
                self.append(running, State::Tried)?;
                Ok(Boot::OnTrial)
            }
            (State::Tried, true) => Ok(Boot::GoBack),
            // A trial that failed, one that the boot loader never began, or an image that came by
            // another way, such as a cable.
            (_, false) => {
                self.append(running, State::Good)?;
                Ok(Boot::Run)
            }
        }
    }

    /// The image has proved itself.
    ///
    /// # Errors
    /// The flash did not keep it.
    pub fn confirm(&mut self) -> Result<(), TrialError> {
        if self.is_on_trial() {
            self.append(self.entry.slot, State::Good)?;
        }
        Ok(())
    }

    /// The other slot holds an image that is whole and signed: when the boot loader starts it, that
    /// is a trial.
    ///
    /// # Errors
    /// The flash did not keep it, or the present image is on trial itself.
    pub fn try_other(&mut self) -> Result<(), TrialError> {
        match self.entry.state {
            State::Good => self.append(1 - self.entry.slot, State::New),
            // Noted before in this boot, which would have taken it for tried; the boot loader was not told.
            State::New => Ok(()),
            State::Tried => Err(TrialError),
        }
    }

    fn append(&mut self, slot: u8, state: State) -> Result<(), TrialError> {
        let entry = Entry {
            sequence: self.entry.sequence + 1,
            slot,
            state,
        };
        // What a power cut left half written is skipped.
        while !self.next.is_multiple_of(Self::entries_of_unit()) && !self.is_blank(self.next)? {
            self.next += 1;
        }
        let place = self.next % (2 * Self::entries_of_unit());
        let at = place * ENTRY_BYTES as u32;
        if place.is_multiple_of(Self::entries_of_unit()) {
            let end = at + F::ERASE_SIZE as u32;
            self.flash.erase(at, end).map_err(|_| TrialError)?;
        }
        let bytes = entry.to_bytes();
        self.flash.write(at, &bytes).map_err(|_| TrialError)?;
        let mut written = [0; ENTRY_BYTES];
        self.flash.read(at, &mut written).map_err(|_| TrialError)?;
        if written != bytes {
            return Err(TrialError);
        }
        self.entry = entry;
        self.next = place + 1;
        Ok(())
    }

    fn is_blank(&mut self, place: u32) -> Result<bool, TrialError> {
        let mut bytes = [0; ENTRY_BYTES];
        let at = place * ENTRY_BYTES as u32;
        self.flash.read(at, &mut bytes).map_err(|_| TrialError)?;
        Ok(bytes == [0xff; ENTRY_BYTES])
    }
}
