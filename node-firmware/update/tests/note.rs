//! The boot loader's note, with both kinds of boot loader and the power cut at every byte.

// The same flash in memory, whose power can be cut.
#[path = "../../provision/tests/flash/mod.rs"]
mod flash;

use ed25519_dalek::{Signer, SigningKey};
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use flash::Flash;
use keys::update::{SIGNED_PREFIX, UpdateMessage, UpdateRefusal, UpdateReply};
use sha2::{Digest, Sha256};
use std::{cell::RefCell, rc::Rc};
use update::{
    Keeper, Layout, Note, Place, Region, TRIAL_US,
    note::{Entry, ImageState, checksum},
};

const UNIT: u32 = 4096;

const LAYOUT: Layout = Layout {
    slots: [Place::new(4 * UNIT, UNIT), Place::new(5 * UNIT, UNIT)],
    journal: Place::new(2 * UNIT, 2 * UNIT),
    note: Place::new(0, 2 * UNIT),
};

/// Several handles to one flash.
#[derive(Clone)]
struct Shared(Rc<RefCell<Flash>>);

impl Shared {
    fn new() -> Self {
        Self(Rc::new(RefCell::new(Flash::new(6))))
    }

    fn duplicate(&self) -> Self {
        Self(Rc::new(RefCell::new(self.0.borrow().clone())))
    }

    fn power(&self, power: usize) {
        self.0.borrow_mut().power = power;
    }

    fn note(&self) -> Note<Region<Self>> {
        Note::new(Region::new(self.clone(), LAYOUT.note))
    }

    fn bytes_of_note(&self, unit: u32) -> [u8; 32] {
        let at = (unit * UNIT) as usize;
        self.0.borrow().bytes[at..at + 32]
            .try_into()
            .expect("32 bytes")
    }
}

impl ErrorType for Shared {
    type Error = flash::Gone;
}

impl ReadNorFlash for Shared {
    const READ_SIZE: usize = Flash::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), flash::Gone> {
        self.0.borrow_mut().read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.borrow().capacity()
    }
}

impl NorFlash for Shared {
    const WRITE_SIZE: usize = Flash::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), flash::Gone> {
        self.0.borrow_mut().erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), flash::Gone> {
        self.0.borrow_mut().write(offset, bytes)
    }
}

/// ESP-IDF's boot loader, as far as it looks at its note (`bootloader_common_get_active_otadata`,
/// `bootloader_utility_get_selected_boot_partition`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BootLoader {
    Plain,
    /// It keeps a note of first boots, in place.
    Rollback,
}

impl BootLoader {
    /// Returns the slot that it starts; `None`: the power was cut.
    fn start(self, flash: &Shared) -> Option<u8> {
        if self == Self::Rollback {
            for entry in flash.note().entries().ok()?.into_iter().flatten() {
                if entry.state == ImageState::Pending {
                    mark(flash, entry, ImageState::Aborted)?;
                }
            }
        }
        let Some(entry) = flash.note().in_force().ok()? else {
            return Some(0);
        };
        if self == Self::Rollback && entry.state == ImageState::New {
            mark(flash, entry, ImageState::Pending)?;
        }
        Some(entry.slot())
    }
}

/// Rewrites an entry in its place, as the boot loader does.
fn mark(flash: &Shared, entry: Entry, state: ImageState) -> Option<()> {
    let mut flash = flash.clone();
    let mut bytes = flash.bytes_of_note(entry.unit);
    bytes[24..28].copy_from_slice(&(state as u32).to_le_bytes());
    let at = entry.unit * UNIT;
    flash.erase(at, at + UNIT).ok()?;
    flash.write(at, &bytes).ok()
}

/// A board that is switched on: the slot that runs, and what keeps it.
fn boot(flash: &Shared, loader: BootLoader) -> Option<Keeper<Shared>> {
    let running = loader.start(flash)?;
    let mut keeper = Keeper::boot(flash.clone(), LAYOUT, running, [0, 1, 0], 0).ok()?;
    keeper.trust(Some(key().verifying_key().to_bytes()));
    Some(keeper)
}

/// Boots until nothing wants a restart any more, without a router.
fn settle(flash: &Shared, loader: BootLoader) -> Option<Keeper<Shared>> {
    for _ in 0..8 {
        let mut keeper = boot(flash, loader)?;
        let failed = keeper.poll(0, false) || keeper.poll(TRIAL_US, false);
        if !failed && !keeper.is_on_trial() {
            return Some(keeper);
        }
    }
    panic!("it restarts for ever");
}

fn key() -> SigningKey {
    SigningKey::from_bytes(&[7; 32])
}

const IMAGE: [u8; 12] = *b"other image.";

fn begin() -> UpdateMessage<'static> {
    let hash: [u8; 32] = Sha256::digest(IMAGE).into();
    UpdateMessage::Begin {
        bytes: IMAGE.len() as u32,
        hash,
        signature: key().sign(&[SIGNED_PREFIX, &hash[..]].concat()).to_bytes(),
    }
}

/// Sends the image. Returns whether it is to be booted.
fn send(keeper: &mut Keeper<Shared>, begin: &UpdateMessage<'_>) -> bool {
    let chunk = UpdateMessage::Chunk {
        at: 0,
        bytes: &IMAGE,
    };
    keeper.handle(begin, false, 0);
    keeper.handle(&chunk, false, 0);
    keeper.handle(&UpdateMessage::Finish, false, 0) == UpdateReply::Ready
}

/// An update from a board that rests, its trial and its end. `None`: the power was cut.
fn play(
    flash: &Shared,
    loader: BootLoader,
    begin: &UpdateMessage<'_>,
    reaches: bool,
) -> Option<u8> {
    let mut keeper = settle(flash, loader)?;
    if !send(&mut keeper, begin) {
        return None;
    }
    let mut keeper = boot(flash, loader)?;
    if reaches {
        keeper.link_up();
        keeper.poll(1, false);
        return (!keeper.is_on_trial()).then(|| keeper.running());
    }
    let restarts = keeper.poll(TRIAL_US, false);
    restarts.then(|| boot(flash, loader))?;
    settle(flash, loader).map(|keeper| keeper.running())
}

#[test]
fn the_note_has_the_bytes_of_the_real_boot_loader() {
    // From the flash of a board whose slot 0 ESP-IDF has selected.
    assert_eq!(checksum(1).to_le_bytes(), [0x9a, 0x98, 0x43, 0x47]);
    let flash = Shared::new();
    flash.note().select_proven(0).expect("has power");
    let mut bytes = [0xff; 32];
    bytes[..4].copy_from_slice(&[1, 0, 0, 0]);
    bytes[24..28].copy_from_slice(&[2, 0, 0, 0]);
    bytes[28..].copy_from_slice(&[0x9a, 0x98, 0x43, 0x47]);
    assert_eq!(flash.bytes_of_note(0), bytes);
    assert_eq!(flash.bytes_of_note(1), [0xff; 32]);
}

#[test]
fn what_is_in_force_is_never_written_over() {
    let flash = Shared::new();
    let mut note = flash.note();
    for slot in [1, 0, 0, 1, 1, 0] {
        let before = note.in_force().expect("has power");
        note.select_on_trial(slot).expect("has power");
        let after = note.in_force().expect("has power").expect("there is one");
        assert_eq!((after.slot(), after.state), (slot, ImageState::New));
        assert_ne!(Some(after.unit), before.map(|entry| entry.unit));
        note.select_proven(slot).expect("has power");
        let proven = note.in_force().expect("has power").expect("there is one");
        assert_eq!((proven.slot(), proven.state), (slot, ImageState::Valid));
        assert_ne!(proven.unit, after.unit);
        let used = flash.0.borrow().used;
        note.select_proven(slot).expect("has power");
        assert_eq!(flash.0.borrow().used, used, "once is enough");
    }
}

#[test]
fn a_torn_entry_is_as_if_it_were_not_there() {
    let flash = Shared::new();
    let mut note = flash.note();
    note.select_proven(1).expect("has power");
    let good = note.in_force().expect("has power").expect("there is one");
    for byte in 0..32 {
        let torn = flash.duplicate();
        let at = ((1 - good.unit) * UNIT) as usize;
        torn.0.borrow_mut().bytes[at + byte] = 0x55;
        let mut note = torn.note();
        assert_eq!(note.in_force(), Ok(Some(good)), "{byte}");
        note.select_on_trial(0).expect("has power");
        let now = note.in_force().expect("has power").expect("there is one");
        assert_eq!(now.slot(), 0, "{byte}");
    }
}

#[test]
fn a_slot_that_is_gone_back_to_stays_however_often_it_boots() {
    for loader in [BootLoader::Plain, BootLoader::Rollback] {
        let flash = Shared::new();
        let begin = begin();
        assert_eq!(play(&flash, loader, &begin, false), Some(0), "{loader:?}");
        for _ in 0..3 {
            let keeper = boot(&flash, loader).expect("has power");
            assert_eq!((keeper.running(), keeper.is_on_trial()), (0, false));
        }
    }
}

#[test]
fn an_image_that_resets_on_trial_is_left_by_both_boot_loaders() {
    for loader in [BootLoader::Plain, BootLoader::Rollback] {
        let flash = Shared::new();
        let mut keeper = boot(&flash, loader).expect("has power");
        assert!(send(&mut keeper, &begin()));
        let keeper = boot(&flash, loader).expect("has power");
        assert_eq!((keeper.running(), keeper.is_on_trial()), (1, true));
        // It crashes at once, and all it ever did was to begin its boot.
        let keeper = settle(&flash, loader).expect("has power");
        assert_eq!(keeper.running(), 0, "{loader:?}");
        let keeper = boot(&flash, loader).expect("has power");
        assert_eq!((keeper.running(), keeper.is_on_trial()), (0, false));
    }
}

#[test]
fn an_image_without_a_key_is_refused_and_a_key_may_come_later() {
    let flash = Shared::new();
    let mut keeper = Keeper::boot(flash, LAYOUT, 0, [0, 1, 0], 0).expect("has power");
    let refused = UpdateReply::Refused(UpdateRefusal::NoKey);
    assert_eq!(keeper.handle(&begin(), false, 0), refused);
    keeper.trust(Some(key().verifying_key().to_bytes()));
    assert!(send(&mut keeper, &begin()));
}

#[test]
fn a_power_cut_at_any_byte_leaves_a_board_that_boots_and_can_be_updated() {
    let begin = begin();
    for loader in [BootLoader::Plain, BootLoader::Rollback] {
        // From a new board, and from one whose slot 1 has proved itself.
        let new = Shared::new();
        let updated = Shared::new();
        assert_eq!(play(&updated, loader, &begin, true), Some(1));
        for (before, old) in [(new, 0), (updated, 1)] {
            for reaches in [true, false] {
                let whole = before.duplicate();
                let begun = whole.0.borrow().used;
                let end = play(&whole, loader, &begin, reaches);
                assert_eq!(end, Some(if reaches { 1 - old } else { old }));
                let bytes = whole.0.borrow().used - begun;
                for power in 0..bytes {
                    let case = format!("{loader:?} from {old}, {reaches}: {power} of {bytes}");
                    let flash = before.duplicate();
                    flash.power(power);
                    let _ = play(&flash, loader, &begin, reaches);
                    flash.power(usize::MAX);
                    let keeper = settle(&flash, loader).expect("has power");
                    let runs = keeper.running();
                    assert!(reaches || runs == old, "{case}: {runs} has failed");
                    let again = play(&flash, loader, &begin, true);
                    assert_eq!(again, Some(1 - runs), "{case}");
                }
            }
        }
    }
}

#[test]
fn a_note_that_the_flash_has_not_taken_is_written_when_it_is_told_again() {
    let flash = Shared::new();
    let mut keeper = boot(&flash, BootLoader::Plain).expect("has power");
    let begin = begin();
    keeper.handle(&begin, false, 0);
    let chunk = UpdateMessage::Chunk {
        at: 0,
        bytes: &IMAGE,
    };
    keeper.handle(&chunk, false, 0);
    // Enough for the journal: a unit erased and an entry. Not for the note.
    flash.power(64 + 16 + 40);
    let refused = UpdateReply::Refused(UpdateRefusal::Flash);
    assert_eq!(
        keeper.handle(&UpdateMessage::Finish, false, 0),
        refused,
        "the flash fails once"
    );
    flash.power(usize::MAX);
    assert_eq!(
        keeper.handle(&UpdateMessage::Finish, false, 0),
        UpdateReply::Ready
    );
    let keeper = boot(&flash, BootLoader::Plain).expect("has power");
    assert_eq!((keeper.running(), keeper.is_on_trial()), (1, true));
}
