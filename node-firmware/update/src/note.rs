//! The boot loader's note of which slot it starts: ESP-IDF's `otadata` partition
//! (`esp_flash_partitions.h`, `esp_ota_select_entry_t`).
//!
//! ```text
//!   entry, 32 bytes, at the begin of each of two erase units; of those that count, the one with the
//!   higher sequence number is in force, and its slot is (sequence - 1) mod 2
//!   ┌──────────┬───────────────┬───────┬─────┐
//!   │ sequence │ label, unused │ state │ crc │   crc: CRC-32 of the sequence number alone
//!   │   u32    │   20 bytes    │  u32  │ u32 │
//!   └──────────┴───────────────┴───────┴─────┘
//!   state: new ──boot loader──▶ pending ──boots again──▶ aborted: does not count
//! ```
//!
//! Only a boot loader that was built with `CONFIG_BOOTLOADER_APP_ROLLBACK_ENABLE` moves a state on; the
//! others look at nothing but *invalid* and *aborted*. Both are served: whatever changes here is written
//! as a new entry into the unit that is not in force, its checksum last. So a power cut at any byte
//! leaves the entry before, and an entry that one has torn is as if it were not there.

use crate::TrialError;
use embedded_storage::nor_flash::NorFlash;

/// Bytes of an entry.
const ENTRY_BYTES: usize = 32;

/// Where its checksum is.
const CHECKSUM_AT: usize = 28;

/// What the note says of the image in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ImageState {
    /// It has never been started.
    New = 0,
    /// The boot loader has started it once and waits for it to be confirmed.
    Pending = 1,
    /// It has proved itself.
    Valid = 2,
    /// It has said of itself that it does not work.
    Invalid = 3,
    /// The boot loader found it unconfirmed at its second boot.
    Aborted = 4,
    /// Nobody keeps a note of that.
    Undefined = u32::MAX,
}

impl ImageState {
    fn from_word(word: u32) -> Option<Self> {
        [
            Self::New,
            Self::Pending,
            Self::Valid,
            Self::Invalid,
            Self::Aborted,
            Self::Undefined,
        ]
        .into_iter()
        .find(|state| *state as u32 == word)
    }
}

/// An entry that is whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The erase unit that it is in.
    pub unit: u32,
    /// Which of two is newer.
    pub sequence: u32,
    /// Of the image in its slot.
    pub state: ImageState,
}

impl Entry {
    /// Returns the slot that it selects: 0 or 1.
    #[must_use]
    pub fn slot(&self) -> u8 {
        u8::from(self.sequence.is_multiple_of(2))
    }

    /// Returns whether the boot loader takes it.
    #[must_use]
    pub fn counts(&self) -> bool {
        !matches!(self.state, ImageState::Invalid | ImageState::Aborted)
    }

    fn from_bytes(unit: u32, bytes: &[u8; ENTRY_BYTES]) -> Option<Self> {
        let word = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let sequence = word(0);
        // A state that is none was torn, though the boot loader would let it pass.
        let state = ImageState::from_word(word(24))?;
        let whole = sequence != u32::MAX && word(CHECKSUM_AT) == checksum(sequence);
        whole.then_some(Self {
            unit,
            sequence,
            state,
        })
    }

    fn to_bytes(self) -> [u8; ENTRY_BYTES] {
        let mut bytes = [0xff; ENTRY_BYTES];
        bytes[..4].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[24..CHECKSUM_AT].copy_from_slice(&(self.state as u32).to_le_bytes());
        bytes[CHECKSUM_AT..].copy_from_slice(&checksum(self.sequence).to_le_bytes());
        bytes
    }
}

/// Returns the checksum of a sequence number: CRC-32, begun as ESP-IDF begins it.
#[must_use]
pub fn checksum(sequence: u32) -> u32 {
    let mut hasher = crc32fast::Hasher::new_with_initial(u32::MAX);
    hasher.update(&sequence.to_le_bytes());
    hasher.finalize()
}

/// See the module. `F` is the partition: two erase units.
#[derive(Clone, Debug)]
pub struct Note<F>(F);

impl<F: NorFlash> Note<F> {
    /// Takes the partition.
    pub const fn new(flash: F) -> Self {
        Self(flash)
    }

    /// Returns the whole entries, by unit.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn entries(&mut self) -> Result<[Option<Entry>; 2], TrialError> {
        let mut entries = [None; 2];
        for (unit, entry) in (0..).zip(&mut entries) {
            let mut bytes = [0; ENTRY_BYTES];
            let at = unit * F::ERASE_SIZE as u32;
            self.0.read(at, &mut bytes).map_err(|_| TrialError)?;
            *entry = Entry::from_bytes(unit, &bytes);
        }
        Ok(entries)
    }

    /// Returns the entry that the boot loader goes by; `None`: it begins with slot 0.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn in_force(&mut self) -> Result<Option<Entry>, TrialError> {
        let entries = self.entries()?.into_iter().flatten();
        Ok(entries
            .filter(Entry::counts)
            .max_by_key(|entry| entry.sequence))
    }

    /// Selects a slot whose image is on trial.
    ///
    /// # Errors
    /// What was in force still is.
    pub fn select_on_trial(&mut self, slot: u8) -> Result<(), TrialError> {
        self.select(slot, ImageState::New)
    }

    /// Selects a slot whose image has proved itself, if it is not selected as such.
    ///
    /// # Errors
    /// What was in force still is.
    pub fn select_proven(&mut self, slot: u8) -> Result<(), TrialError> {
        let now = self.in_force()?.filter(|entry| entry.slot() == slot);
        if now.is_some_and(|now| matches!(now.state, ImageState::Valid | ImageState::Undefined)) {
            return Ok(());
        }
        self.select(slot, ImageState::Valid)
    }

    fn select(&mut self, slot: u8, state: ImageState) -> Result<(), TrialError> {
        let in_force = self.in_force()?;
        // Beyond every entry that is whole, so that none of them is ever taken for newer.
        let entries = self.entries()?.into_iter().flatten();
        let newest = entries.map(|entry| entry.sequence).max().unwrap_or(0);
        let next = newest.checked_add(2).ok_or(TrialError)? - 1;
        let mut entry = Entry {
            unit: in_force.map_or(0, |entry| 1 - entry.unit),
            sequence: next,
            state,
        };
        entry.sequence += u32::from(entry.slot() != slot);
        let bytes = entry.to_bytes();
        let at = entry.unit * F::ERASE_SIZE as u32;
        let end = at + F::ERASE_SIZE as u32;
        self.0.erase(at, end).map_err(|_| TrialError)?;
        let (first, last) = bytes.split_at(CHECKSUM_AT);
        self.0.write(at, first).map_err(|_| TrialError)?;
        self.0
            .write(at + CHECKSUM_AT as u32, last)
            .map_err(|_| TrialError)?;
        let now = self.in_force()?;
        (now == Some(entry)).then_some(()).ok_or(TrialError)
    }
}
