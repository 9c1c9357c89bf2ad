//! Which firmware an emulated board runs: its boot loader, its slots, its way back.
//!
//! The boot loader's note ([`update::note`]) has the format of ESP-IDF's, and what an image says of itself is `esp_app_desc_t`. So a flash image
//! can be looked at with Espressif's tools. The code of an image is not run: a board that boots one
//! is this emulator with the image's version.

use crate::flash::Flash;
use embedded_storage::nor_flash::ReadNorFlash;
use update::{Keeper, Layout, Note, Place, Region, TrialError, layout};

/// Version of the firmware from the factory.
pub const FACTORY: [u8; 3] = [0, 1, 0];

/// What takes images on an emulated board.
pub type EmulatedKeeper = Keeper<Flash>;

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
    running: u8,
}

impl BootLoader {
    /// Boots: takes the selected slot, or the other one if that holds no image. A blank slot 0 holds
    /// the firmware that a board has from the factory.
    pub fn boot(flash: &Flash) -> Self {
        let mut note = Note::new(Region::new(flash.clone(), layout::OTADATA));
        let in_force = note.in_force().ok().flatten();
        let selected = in_force.map_or(0, |entry| entry.slot());
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
        Self { running }
    }

    /// Returns the slot that runs.
    pub fn running(&self) -> u8 {
        self.running
    }

    /// Returns the version of the image that runs.
    pub fn version(&self, flash: &Flash) -> [u8; 3] {
        version_of(flash, layout::SLOTS[usize::from(self.running)]).unwrap_or(FACTORY)
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
    let running = loader.running();
    let mut keeper = Keeper::boot(flash.clone(), Layout::BOARD, running, version, now_us)?;
    keeper.trust(key);
    Ok(keeper)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_storage::nor_flash::NorFlash;

    #[test]
    fn the_selected_slot_boots_if_it_holds_an_image() {
        let flash = Flash::blank();
        let mut note = Note::new(Region::new(flash.clone(), layout::OTADATA));
        assert_eq!(BootLoader::boot(&flash).running(), 0, "a new board");
        note.select_on_trial(1).expect("has power");
        assert_eq!(BootLoader::boot(&flash).running(), 0, "slot 1 is blank");
        Region::new(flash.clone(), layout::SLOTS[1])
            .write(0, &[IMAGE_MAGIC, 0, 0, 0])
            .expect("has power");
        for slot in [1, 1, 0, 1, 0] {
            note.select_proven(slot).expect("has power");
            assert_eq!(BootLoader::boot(&flash).running(), slot);
        }
    }
}
