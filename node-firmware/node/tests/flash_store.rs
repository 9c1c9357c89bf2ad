//! Stored scripts in flash: the power cut at every byte, units that wear out, a flash that is full.
//!
//! A failure of the random run prints its seed; `SEED=n cargo test -p node --test flash_store` runs
//! that one alone.

// The same flash in memory, whose power can be cut.
#[path = "../../provision/tests/flash/mod.rs"]
mod flash;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use flash::{Flash, Gone};
use node::library::{Library, SaveError, ScriptStore, flash::FlashStore};
use std::collections::BTreeMap;

const UNIT_TEXT_BYTES: usize = FlashStore::<Flash>::UNIT_TEXT_BYTES;

type Scripts = BTreeMap<String, Vec<u8>>;

fn contents<F: NorFlash>(store: &mut FlashStore<F>) -> (Scripts, Result<(), SaveError>) {
    let mut all = Scripts::new();
    let result = store.load(&mut |name, text| {
        let before = all.insert(name.to_owned(), text.to_owned());
        assert_eq!(before, None, "{name} twice");
    });
    (all, result)
}

/// What the next start finds.
fn reopened(flash: &Flash) -> (Scripts, Result<(), SaveError>) {
    let mut flash = flash.clone();
    flash.power = usize::MAX;
    contents(&mut FlashStore::open(flash).expect("a region"))
}

/// A text of this length that no other number gives.
fn text(number: u64, bytes: usize) -> Vec<u8> {
    let digits = format!("-- {number} ").into_bytes();
    digits.into_iter().cycle().take(bytes).collect()
}

#[test]
fn what_is_saved_is_there_at_the_next_start_whatever_its_length() {
    let mut store = FlashStore::open(Flash::new(80)).expect("a region");
    assert_eq!(contents(&mut store), (Scripts::new(), Ok(())));
    let mut expected = Scripts::new();
    let lengths = [
        0,
        1,
        255,
        256,
        257,
        UNIT_TEXT_BYTES - 1,
        UNIT_TEXT_BYTES,
        UNIT_TEXT_BYTES + 1,
        64 * 1024,
    ];
    for (number, bytes) in (0..).zip(lengths) {
        let name = format!("n{number}");
        assert_eq!(store.save(&name, &text(number, bytes)), Ok(()));
        expected.insert(name, text(number, bytes));
    }
    let longest = "n234567890123456789012345678901a";
    assert_eq!(store.save(longest, b"long name"), Ok(()));
    expected.insert(longest.to_owned(), b"long name".to_vec());
    assert_eq!(store.remove("n3"), Ok(()));
    expected.remove("n3");
    assert_eq!(store.remove("never"), Ok(()));
    assert_eq!(store.save("n4", b"another"), Ok(()));
    expected.insert("n4".to_owned(), b"another".to_vec());
    assert_eq!(contents(&mut store), (expected.clone(), Ok(())));
    assert_eq!(reopened(&store.into_flash()), (expected, Ok(())));
}

/// Does it with the power cut at every byte.
fn cut_everywhere(before: &Flash, name: &str, change: Option<&[u8]>) -> Flash {
    let act = |flash: Flash| {
        let mut store = FlashStore::open(flash).expect("a region");
        let result = match change {
            Some(text) => store.save(name, text),
            None => store.remove(name),
        };
        (result, store.into_flash())
    };
    let (old, _) = reopened(before);
    let mut new = old.clone();
    match change {
        Some(text) => drop(new.insert(name.to_owned(), text.to_owned())),
        None => drop(new.remove(name)),
    }
    let (result, whole) = act(before.clone());
    assert_eq!(result, Ok(()));
    assert_eq!(reopened(&whole), (new.clone(), Ok(())));
    for power in 0..whole.used - before.used {
        let mut flash = before.clone();
        flash.power = power;
        let (result, flash) = act(flash);
        let (found, told) = reopened(&flash);
        assert!(found == old || found == new, "{power}: {:?}", found.keys());
        assert_eq!(told, Ok(()), "{power}: a power cut is no damage");
        // What was told to be saved is.
        assert!(result.is_err() || found == new, "{power}");
    }
    whole
}

#[test]
fn a_power_cut_at_every_byte_leaves_the_old_text_or_the_new_one() {
    let flash = cut_everywhere(&Flash::new(6), "a", Some(&text(1, 300)));
    let flash = cut_everywhere(&flash, "b", Some(&text(2, 20)));
    let flash = cut_everywhere(&flash, "a", Some(&text(3, UNIT_TEXT_BYTES + 90)));
    // Over units that were used before.
    let flash = cut_everywhere(&flash, "b", Some(&text(4, UNIT_TEXT_BYTES + 1)));
    let flash = cut_everywhere(&flash, "a", Some(b""));
    let flash = cut_everywhere(&flash, "b", None);
    let flash = cut_everywhere(&flash, "a", Some(&text(5, 70)));
    cut_everywhere(&flash, "a", None);
}

#[test]
fn a_full_flash_is_an_answer_and_keeps_what_it_has() {
    let mut store = FlashStore::open(Flash::new(4)).expect("a region");
    let three = text(1, 3 * UNIT_TEXT_BYTES);
    assert_eq!(store.save("a", &three), Ok(()));
    assert_eq!(
        store.save("b", &text(2, UNIT_TEXT_BYTES + 1)),
        Err(SaveError::Full)
    );
    // The text before stays until the new one is whole, and there is no room for both.
    assert_eq!(
        store.save("a", &text(3, 2 * UNIT_TEXT_BYTES)),
        Err(SaveError::Full)
    );
    assert_eq!(store.save("b", b"short"), Ok(()));
    assert_eq!(store.save("b", b"other"), Err(SaveError::Full));
    let before = [("a".to_owned(), three), ("b".to_owned(), b"short".to_vec())];
    assert_eq!(contents(&mut store).0, before.into());
    assert_eq!(store.remove("a"), Ok(()));
    assert_eq!(store.free_units(), 3);
    assert_eq!(store.save("b", b"other"), Ok(()));
    let after = [("b".to_owned(), b"other".to_vec())];
    assert_eq!(reopened(&store.into_flash()), (after.into(), Ok(())));
}

#[test]
fn units_are_taken_in_turns_so_that_none_wears_out_first() {
    let mut store = FlashStore::open(Wearing::new(10)).expect("a region");
    store
        .save("rests", &text(0, 2 * UNIT_TEXT_BYTES))
        .expect("room");
    for number in 0..800 {
        store.save("busy", &text(number, 100)).expect("room");
        if number % 50 == 0 {
            // A restart does not begin from the first unit again.
            store = FlashStore::open(store.into_flash()).expect("a region");
        }
    }
    let erased = store.into_flash().erased;
    let (rests, turns): (Vec<u32>, Vec<u32>) = erased.iter().partition(|count| **count <= 2);
    assert_eq!((rests.len(), turns.len()), (2, 8), "{erased:?}");
    // Each save erases the unit it takes and the one it leaves.
    assert!(
        turns.iter().all(|count| (196..=204).contains(count)),
        "{erased:?}"
    );
}

#[test]
fn a_worn_unit_is_left_out_and_the_text_goes_elsewhere() {
    let mut store = FlashStore::open(Wearing::new(6)).expect("a region");
    store.save("a", b"before").expect("room");
    let mut flash = store.into_flash();
    flash.worn = vec![1, 3];
    let mut store = FlashStore::open(flash).expect("a region");
    for number in 0..6 {
        assert_eq!(store.save("a", &text(number, 500)), Ok(()));
    }
    assert_eq!((store.bad_units(), store.free_units()), (2, 3));
    let mut flash = store.into_flash();
    let found = contents(&mut FlashStore::open(flash.clone()).expect("a region"));
    assert_eq!(found, ([("a".to_owned(), text(5, 500))].into(), Ok(())));
    // When nothing is left, that is said, and the text stays.
    flash.worn = (0..6).collect();
    let mut store = FlashStore::open(flash).expect("a region");
    assert_eq!(store.save("a", b"new"), Err(SaveError::Full));
    let found = contents(&mut FlashStore::open(store.into_flash()).expect("a region"));
    assert_eq!(found, ([("a".to_owned(), text(5, 500))].into(), Ok(())));
}

#[test]
fn a_flipped_bit_is_noticed_and_told_and_costs_that_script_only() {
    let mut store = FlashStore::open(Flash::new(6)).expect("a region");
    store
        .save("a", &text(1, UNIT_TEXT_BYTES + 300))
        .expect("room");
    store.save("b", b"return 2").expect("room");
    let whole = store.into_flash();
    let (before, _) = reopened(&whole);
    for at in (0..3 * Flash::ERASE_SIZE).filter(|at| whole.bytes[*at] != 0xff) {
        let mut flash = whole.clone();
        flash.bytes[at] ^= 0x04;
        let (found, _) = reopened(&flash);
        assert_eq!(found.len(), 1, "{at}");
        assert!(
            found.iter().all(|(name, text)| before[name] == *text),
            "{at}"
        );
    }
    let mut flash = whole.clone();
    // In the text of the head of `b`.
    flash.bytes[2 * Flash::ERASE_SIZE + 66] ^= 1;
    assert_eq!(reopened(&flash).1, Err(SaveError::Broken));
}

#[test]
fn noise_is_no_script() {
    let mut flash = Flash::new(8);
    flash.bytes.fill(0);
    assert_eq!(reopened(&flash), (Scripts::new(), Ok(())));
    let mut random = Random(3);
    for byte in &mut flash.bytes {
        *byte = random.next() as u8;
    }
    assert_eq!(reopened(&flash), (Scripts::new(), Ok(())));
    let mut store = FlashStore::open(flash).expect("a region");
    assert_eq!(store.save("a", b"text"), Ok(()));
    assert!(FlashStore::open(Flash::new(1)).is_err());
}

#[test]
fn a_library_saves_to_a_store_that_stays_with_its_caller() {
    let mut store = FlashStore::open(Flash::new(6)).expect("a region");
    store.save("old", b"return 1").expect("room");
    let mut library = Library::default();
    assert_eq!(library.load(&mut store), Ok(()));
    assert_eq!(library.get("old"), Some("return 1"));
    assert!(!library.has_unsaved());
    library.put("new", b"return 2").expect("fits");
    library.remove("old").expect("fits");
    let names: Vec<_> = core::iter::from_fn(|| library.save_next_to(&mut store))
        .map(|saved| (saved.name, saved.removed, saved.result))
        .collect();
    let expected = [("new", false), ("old", true)];
    assert_eq!(
        names,
        expected.map(|(name, removed)| (name.to_owned(), removed, Ok(())))
    );
    let after = [("new".to_owned(), b"return 2".to_vec())];
    assert_eq!(reopened(&store.into_flash()), (after.into(), Ok(())));
}

/// Saves and removes at random, with the power cut now and then.
fn campaign(seed: u64) {
    let mut random = Random(seed);
    let mut flash = Flash::new(12);
    let mut model = Scripts::new();
    for round in 0..60 {
        let mut store = FlashStore::open(flash).expect("a region");
        let (found, told) = contents(&mut store);
        assert_eq!(
            (&found, told),
            (&model, Ok(())),
            "seed {seed}, round {round}"
        );
        flash = store.into_flash();
        if random.next().is_multiple_of(2) {
            flash.power = (random.next() % 30_000) as usize;
        }
        let mut store = FlashStore::open(flash).expect("a region");
        // What may be there after a cut: the contents before and after the change under way.
        let mut either = [model.clone(), model.clone()];
        for _ in 0..random.next() % 6 {
            let name = format!("s{}", random.next() % 5);
            let mut after = either[1].clone();
            let result = if random.next().is_multiple_of(3) {
                after.remove(&name);
                store.remove(&name)
            } else {
                let bytes = random.next() as usize % (3 * UNIT_TEXT_BYTES);
                let text = text(random.next(), bytes);
                after.insert(name.clone(), text.clone());
                store.save(&name, &text)
            };
            match result {
                Ok(()) => either = [after.clone(), after],
                Err(SaveError::Full) => {}
                Err(SaveError::Broken) => {
                    either[1] = after;
                    break;
                }
            }
        }
        flash = store.into_flash();
        flash.power = usize::MAX;
        let (found, _) = reopened(&flash);
        assert!(either.contains(&found), "seed {seed}, round {round}");
        model = found;
    }
}

#[test]
fn random_changes_and_power_cuts_never_lose_or_mix_texts() {
    match std::env::var("SEED") {
        Ok(seed) => campaign(seed.parse().expect("a number")),
        Err(_) => (1..=40).for_each(campaign),
    }
}

/// Flash that counts erasures, some of whose units do not keep what is written.
#[derive(Clone, Debug)]
struct Wearing {
    flash: Flash,
    erased: Vec<u32>,
    worn: Vec<usize>,
}

impl Wearing {
    fn new(units: usize) -> Self {
        Self {
            flash: Flash::new(units),
            erased: vec![0; units],
            worn: Vec::new(),
        }
    }
}

impl ErrorType for Wearing {
    type Error = Gone;
}

impl ReadNorFlash for Wearing {
    const READ_SIZE: usize = Flash::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Gone> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl NorFlash for Wearing {
    const WRITE_SIZE: usize = Flash::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Gone> {
        for unit in from as usize / Self::ERASE_SIZE..to as usize / Self::ERASE_SIZE {
            self.erased[unit] += 1;
        }
        self.flash.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Gone> {
        let mut bytes = bytes.to_vec();
        if self.worn.contains(&(offset as usize / Self::ERASE_SIZE)) {
            // One cell is stuck.
            bytes[0] &= 0xfe;
            bytes[1] &= 0x7f;
            bytes[2] = 0;
        }
        self.flash.write(offset, &bytes)
    }
}

struct Random(u64);

impl Random {
    /// SplitMix64.
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }
}
