//! Images into slots, with the power cut at every byte, bad signatures, and the way back.

// The same flash in memory, whose power can be cut.
#[path = "../../provision/tests/flash/mod.rs"]
mod flash;

use ed25519_dalek::{Signer, SigningKey};
use embedded_storage::nor_flash::ReadNorFlash;
use flash::Flash;
use keys::update::{SIGNED_PREFIX, UpdateMessage, UpdateRefusal, UpdateReply};
use sha2::{Digest, Sha256};
use update::{Boot, Trial, Updater};

const CHUNK: usize = 1_024;

fn signing_key() -> SigningKey {
    SigningKey::from_bytes(&[7; 32])
}

fn image(bytes: usize) -> Vec<u8> {
    (0..bytes).map(|index| (index * 31 % 251) as u8).collect()
}

fn begin(image: &[u8], key: &SigningKey) -> UpdateMessage<'static> {
    let hash: [u8; 32] = Sha256::digest(image).into();
    let signed = [SIGNED_PREFIX, &hash[..]].concat();
    UpdateMessage::Begin {
        bytes: image.len() as u32,
        hash,
        signature: key.sign(&signed).to_bytes(),
    }
}

/// A board: two slots and the journal.
#[derive(Clone)]
struct Board {
    slots: [Flash; 2],
    journal: Flash,
    /// What the boot loader starts.
    selected: u8,
}

impl Board {
    fn new() -> Self {
        Self {
            slots: [Flash::new(6), Flash::new(6)],
            journal: Flash::new(2),
            selected: 0,
        }
    }

    /// Boots, and again if it must go back. Returns the slot that runs and whether it is on trial.
    fn boot(&mut self) -> (u8, Boot) {
        loop {
            let running = self.selected;
            match self.journal(|trial| trial.boot(running)) {
                Ok(Boot::GoBack) => self.selected = 1 - running,
                boot => return (running, boot.expect("has power")),
            }
        }
    }

    fn journal<T>(&mut self, f: impl FnOnce(&mut Trial<Flash>) -> T) -> T {
        let mut trial = Trial::new(self.journal.clone()).expect("room");
        let result = f(&mut trial);
        self.journal = trial.into_flash();
        result
    }

    /// Sends an image to the slot that does not run, as a client would.
    fn send(&mut self, image: &[u8], key: &SigningKey) -> UpdateReply {
        let other = 1 - usize::from(self.selected);
        let public = signing_key().verifying_key().to_bytes();
        let mut updater = Updater::new(self.slots[other].clone(), Some(public));
        let reply = send(&mut updater, image, key);
        let ready = updater.is_ready();
        self.slots[other] = updater.into_slot();
        if ready {
            self.journal(Trial::try_other).expect("has power");
            self.selected = 1 - self.selected;
        }
        reply
    }
}

fn send(updater: &mut Updater<Flash>, image: &[u8], key: &SigningKey) -> UpdateReply {
    let mut reply = updater.handle(&begin(image, key), false);
    loop {
        let UpdateReply::At { bytes: at } = reply else {
            return reply;
        };
        let at_index = at as usize;
        if at_index == image.len() {
            return updater.handle(&UpdateMessage::Finish, false);
        }
        let end = (at_index + CHUNK).min(image.len());
        let bytes = &image[at_index..end];
        reply = updater.handle(&UpdateMessage::Chunk { at, bytes }, false);
    }
}

#[test]
fn an_image_boots_on_trial_and_stays_when_the_router_is_reached() {
    let mut board = Board::new();
    assert_eq!(board.boot(), (0, Boot::Run));
    let image = image(20_003);
    assert_eq!(board.send(&image, &signing_key()), UpdateReply::Ready);
    assert_eq!(board.slots[1].bytes[..image.len()], image[..]);
    assert_eq!(board.boot(), (1, Boot::OnTrial));
    board.journal(Trial::confirm).expect("has power");
    assert_eq!(board.boot(), (1, Boot::Run));
    // And the next one goes to slot 0.
    assert_eq!(board.send(&image, &signing_key()), UpdateReply::Ready);
    assert_eq!(board.boot(), (0, Boot::OnTrial));
}

#[test]
fn an_image_that_does_not_reach_the_router_is_left() {
    let mut board = Board::new();
    board.send(&image(5_000), &signing_key());
    assert_eq!(board.boot(), (1, Boot::OnTrial));
    // 60 s without a router.
    board.selected = 0;
    assert_eq!(board.boot(), (0, Boot::Run));
    assert_eq!(board.boot(), (0, Boot::Run));
}

#[test]
fn an_image_that_crashes_on_trial_is_left() {
    let mut board = Board::new();
    board.send(&image(5_000), &signing_key());
    assert_eq!(board.boot(), (1, Boot::OnTrial));
    assert_eq!(board.boot(), (0, Boot::Run), "it never confirmed");
}

#[test]
fn nothing_is_taken_while_it_moves_without_a_key_or_with_a_bad_signature() {
    let mut board = Board::new();
    let thief = SigningKey::from_bytes(&[8; 32]);
    let bad = UpdateReply::Refused(UpdateRefusal::Signature);
    assert_eq!(board.send(&image(5_000), &thief), bad);
    assert_eq!(board.slots[1].used, 0, "the flash is not touched");
    assert_eq!(board.boot(), (0, Boot::Run));

    let mut updater = Updater::new(Flash::new(6), None);
    let message = begin(&image(100), &signing_key());
    let no_key = UpdateReply::Refused(UpdateRefusal::NoKey);
    assert_eq!(updater.handle(&message, false), no_key);
    let moving = UpdateReply::Refused(UpdateRefusal::Moving);
    assert_eq!(updater.handle(&message, true), moving);
}

#[test]
fn an_image_that_is_not_what_was_signed_is_refused() {
    let key = signing_key();
    let public = Some(key.verifying_key().to_bytes());
    let good = image(5_000);
    let mut other = good.clone();
    other[4_321] ^= 1;
    let mut updater = Updater::new(Flash::new(6), public);
    assert_eq!(
        updater.handle(&begin(&good, &key), false),
        UpdateReply::At { bytes: 0 }
    );
    for (index, bytes) in other.chunks(CHUNK).enumerate() {
        let at = (index * CHUNK) as u32;
        updater.handle(&UpdateMessage::Chunk { at, bytes }, false);
    }
    let refused = UpdateReply::Refused(UpdateRefusal::Hash);
    assert_eq!(updater.handle(&UpdateMessage::Finish, false), refused);
    assert!(!updater.is_ready());
}

#[test]
fn lost_and_repeated_chunks_are_asked_for_again() {
    let key = signing_key();
    let mut updater = Updater::new(Flash::new(6), Some(key.verifying_key().to_bytes()));
    let image = image(5_000);
    updater.handle(&begin(&image, &key), false);
    let chunk = |at: usize| UpdateMessage::Chunk {
        at: at as u32,
        bytes: &image[at..at + CHUNK],
    };
    let at = |bytes| UpdateReply::At { bytes };
    assert_eq!(updater.handle(&chunk(0), false), at(1_024));
    assert_eq!(updater.handle(&chunk(2_048), false), at(1_024), "lost one");
    assert_eq!(updater.handle(&chunk(0), false), at(1_024), "twice");
    assert_eq!(updater.handle(&UpdateMessage::Finish, false), at(1_024));
    assert_eq!(send(&mut updater, &image, &key), UpdateReply::Ready);
    let odd = UpdateMessage::Chunk {
        at: 0,
        bytes: &image[..3],
    };
    let mut fresh = Updater::new(Flash::new(6), Some(key.verifying_key().to_bytes()));
    let not_begun = UpdateReply::Refused(UpdateRefusal::NotBegun);
    assert_eq!(fresh.handle(&odd, false), not_begun);
    fresh.handle(&begin(&image, &key), false);
    let refused = UpdateReply::Refused(UpdateRefusal::Chunk);
    assert_eq!(fresh.handle(&odd, false), refused);
    let big = vec![0; 6 * 4096 + 1];
    let size = UpdateReply::Refused(UpdateRefusal::Size);
    assert_eq!(fresh.handle(&begin(&big, &key), false), size);
}

#[test]
fn a_power_cut_at_every_byte_of_the_journal_leaves_a_slot_that_boots() {
    // Long enough to fill a unit and wrap into the other one.
    let mut board = Board::new();
    for round in 0..180 {
        let before = board.clone();
        let slot = before.selected;
        // Units hold 256 entries, a round writes three.
        let cuts = if round < 3 || (83..87).contains(&(round % 85)) {
            80
        } else {
            0
        };
        for power in 0..cuts {
            let mut cut = before.clone();
            cut.journal.power = power;
            if cut.journal(Trial::try_other).is_ok() {
                cut.selected = 1 - slot;
            }
            cut.journal.power = usize::MAX;
            let (running, boot) = cut.boot();
            let expected = if running == slot {
                Boot::Run
            } else {
                Boot::OnTrial
            };
            assert_eq!(boot, expected, "{round} {power}");
            // And the boot after a trial without success is the old one again.
            assert_eq!(cut.boot(), (slot, Boot::Run), "{round} {power}");
        }
        board.journal(Trial::try_other).expect("has power");
        let new = board.clone();
        for power in 0..cuts {
            // The journal is new, and the boot loader was not told any more.
            let mut cut = new.clone();
            cut.journal.power = power;
            let _ = cut.journal(|trial| trial.boot(slot));
            cut.journal.power = usize::MAX;
            assert_eq!(cut.boot(), (slot, Boot::Run), "{round} {power}");
        }
        board.selected = 1 - slot;
        assert_eq!(board.boot(), (1 - slot, Boot::OnTrial));
        let on_trial = board.clone();
        for power in 0..cuts {
            let mut cut = on_trial.clone();
            cut.journal.power = power;
            let confirmed = cut.journal(Trial::confirm).is_ok();
            cut.journal.power = usize::MAX;
            let (running, boot) = cut.boot();
            assert_eq!(boot, Boot::Run, "nobody is tried twice");
            assert!(running == 1 - slot || !confirmed, "{round} {power}");
        }
        board.journal(Trial::confirm).expect("has power");
        if round % 16 != 0 {
            continue;
        }
        assert_eq!(board.boot(), (1 - slot, Boot::Run));
    }
}

#[test]
fn a_power_cut_in_the_middle_of_an_image_leaves_the_running_one() {
    let image = image(9_000);
    let whole = {
        let mut board = Board::new();
        board.send(&image, &signing_key());
        board.slots[1].used
    };
    for power in (0..whole).step_by(97) {
        let mut board = Board::new();
        board.slots[1].power = power;
        let reply = board.send(&image, &signing_key());
        assert_eq!(reply, UpdateReply::Refused(UpdateRefusal::Flash));
        assert_eq!(board.boot(), (0, Boot::Run), "{power}");
        board.slots[1].power = usize::MAX;
        assert_eq!(board.send(&image, &signing_key()), UpdateReply::Ready);
        assert_eq!(board.boot(), (1, Boot::OnTrial));
        let mut start = [0; 16];
        board.slots[1].read(0, &mut start).expect("has power");
        assert_eq!(start[..], image[..16]);
    }
}

#[test]
fn bytes_of_messages_do_not_change() {
    let chunk = UpdateMessage::Chunk {
        at: 300,
        bytes: &[1, 2, 3],
    };
    let mut buffer = [0; 200];
    let bytes = postcard::to_slice(&chunk, &mut buffer).expect("room");
    assert_eq!(bytes, [1, 0xac, 2, 3, 1, 2, 3]);
    let begin = UpdateMessage::Begin {
        bytes: 5,
        hash: [9; 32],
        signature: [8; 64],
    };
    let bytes = postcard::to_slice(&begin, &mut buffer).expect("room");
    assert_eq!(bytes.len(), 2 + 32 + 64);
    let back: UpdateMessage<'_> = postcard::from_bytes(bytes).expect("readable");
    assert_eq!(back, begin);
    let reply = UpdateReply::Refused(UpdateRefusal::Hash);
    let bytes = postcard::to_slice(&reply, &mut buffer).expect("room");
    assert_eq!(bytes, [2, 6]);
}
