//! Which firmware an emulated board runs: its boot loader, its slots, its way back.
//!
//! The boot loader's note has the format of ESP-IDF's (`esp_flash_partitions.h`,
//! `esp_ota_select_entry_t`), and what an image says of itself is `esp_app_desc_t`. So a flash image
//! can be looked at with Espressif's tools. The code of an image is not run: a board that boots one
//! is this emulator with the image's version.

use crate::flash::Flash;
use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use update::{Keeper, Layout, Loader, Place, Region, TrialError, layout};

/// Version of the firmware from the factory.
pub const FACTORY: [u8; 3] = [0, 1, 0];

/// What takes images on an emulated board.
pub type EmulatedKeeper = Keeper<Flash, BootLoader>;

/// Bytes of an entry of the boot loader's note.
const ENTRY_BYTES: usize = 32;

/// First byte of an image.
const IMAGE_MAGIC: u8 = 0xe9;

/// Where `esp_app_desc_t` lies in an image: behind its header and that of its first segment.
const DESCRIPTION_AT: usize = 24 + 8;

/// How `esp_app_desc_t` begins.
const DESCRIPTION_MAGIC: [u8; 4] = 0xabcd_5432_u32.to_le_bytes();

/// Where the version lies in it, and how long it is.
const VERSION_AT: usize = DESCRIPTION_AT + 16;
const VERSION_BYTES: usize = 32;

/// The emulated boot loader.
#[derive(Debug)]
pub struct BootLoader {
    note: Region<Flash>,
    running: u8,
}

impl BootLoader {
    /// Boots: takes the selected slot, or the other one if that holds no image. A blank slot 0 holds
    /// the firmware that a board has from the factory.
    pub fn boot(flash: &Flash) -> Self {
        let mut note = Region::new(flash.clone(), layout::OTADATA);
        let selected = selected(&mut note).map_or(0, |(_, sequence)| slot_of(sequence));
        let starts = |slot: u8| {
            let mut start = [0; 4];
            let mut region = Region::new(flash.clone(), layout::SLOTS[usize::from(slot)]);
            region.read(0, &mut start).is_ok()
                && (start[0] == IMAGE_MAGIC || slot == 0 && start == [0xff; 4])
        };
        let running = if starts(selected) {
            selected
        } else {
            1 - selected
        };
        Self { note, running }
    }

    /// Returns the version of the image that runs.
    pub fn version(&self, flash: &Flash) -> [u8; 3] {
        version_of(flash, layout::SLOTS[usize::from(self.running)]).unwrap_or(FACTORY)
    }
}

/// Sequence numbers count from 1, and slots take turns.
fn slot_of(sequence: u32) -> u8 {
    u8::from(sequence.is_multiple_of(2))
}

/// CRC-32 over the sequence number, begun as ESP-IDF begins it.
fn checksum(sequence: u32) -> u32 {
    let mut hasher = crc32fast::Hasher::new_with_initial(u32::MAX);
    hasher.update(&sequence.to_le_bytes());
    hasher.finalize()
}

/// Returns the unit of the entry that counts, and its sequence number.
fn selected(note: &mut Region<Flash>) -> Option<(u32, u32)> {
    let entries = (0..2).filter_map(|unit| {
        let mut bytes = [0; ENTRY_BYTES];
        let at = unit * Flash::ERASE_SIZE as u32;
        note.read(at, &mut bytes).ok()?;
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte]));
        let sequence = word(0);
        let is_whole = sequence != u32::MAX && sequence != 0 && word(28) == checksum(sequence);
        is_whole.then_some((unit, sequence))
    });
    entries.max_by_key(|(_, sequence)| *sequence)
}

impl Loader for BootLoader {
    fn running(&mut self) -> u8 {
        self.running
    }

    fn select(&mut self, slot: u8) -> Result<(), TrialError> {
        let (unit, sequence) = match selected(&mut self.note) {
            Some((_, sequence)) if slot_of(sequence) == slot => return Ok(()),
            Some((unit, sequence)) => (1 - unit, sequence + 1),
            None => (0, 1 + u32::from(slot)),
        };
        let mut bytes = [0xff; ENTRY_BYTES];
        bytes[..4].copy_from_slice(&sequence.to_le_bytes());
        bytes[28..].copy_from_slice(&checksum(sequence).to_le_bytes());
        let at = unit * Flash::ERASE_SIZE as u32;
        let end = at + Flash::ERASE_SIZE as u32;
        self.note
            .erase(at, end)
            .and_then(|()| self.note.write(at, &bytes))
            .map_err(|_| TrialError)
    }

    fn confirm(&mut self) -> Result<(), TrialError> {
        Ok(())
    }
}

/// Returns the version that an image says it has.
fn version_of(flash: &Flash, place: Place) -> Option<[u8; 3]> {
    let mut bytes = [0; VERSION_AT + VERSION_BYTES];
    Region::new(flash.clone(), place).read(0, &mut bytes).ok()?;
    if bytes[0] != IMAGE_MAGIC || bytes[DESCRIPTION_AT..][..4] != DESCRIPTION_MAGIC {
        return None;
    }
    let text = bytes[VERSION_AT..].split(|byte| *byte == 0).next()?;
    let mut numbers = std::str::from_utf8(text).ok()?.split(['.', '-', '+']);
    let mut number = || numbers.next()?.parse().ok();
    Some([number()?, number()?, number()?])
}

/// Boots the firmware of a flash.
///
/// # Errors
/// The flash does not keep the journal: the board runs on without updates.
pub(crate) fn boot(
    flash: &Flash,
    key: Option<[u8; 32]>,
    now_us: u64,
) -> Result<EmulatedKeeper, TrialError> {
    let loader = BootLoader::boot(flash);
    let version = loader.version(flash);
    Keeper::boot(flash.clone(), Layout::BOARD, loader, version, key, now_us)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_note_has_the_bytes_of_the_real_boot_loader() {
        // From the flash of a board whose slot 0 ESP-IDF has selected.
        assert_eq!(checksum(1).to_le_bytes(), [0x9a, 0x98, 0x43, 0x47]);
    }

    #[test]
    fn the_selected_slot_boots_if_it_holds_an_image() {
        let flash = Flash::blank();
        let mut loader = BootLoader::boot(&flash);
        assert_eq!(loader.running(), 0, "a new board");
        loader.select(1).expect("has power");
        assert_eq!(BootLoader::boot(&flash).running(), 0, "slot 1 is blank");
        Region::new(flash.clone(), layout::SLOTS[1])
            .write(0, &[IMAGE_MAGIC, 0, 0, 0])
            .expect("has power");
        for slot in [1, 1, 0, 1, 0] {
            BootLoader::boot(&flash).select(slot).expect("has power");
            assert_eq!(BootLoader::boot(&flash).running(), slot);
        }
    }
}
