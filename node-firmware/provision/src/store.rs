//! A record in flash, twice, so that one is whole at every moment.
//!
//! ```text
//!   copy (one erase unit)                     two of them; the valid one with the higher
//!   ┌───────┬─────────┬───────┬──────────┬─────┬─────────┬─────┬───────┬────────┐    sequence counts
//!   │ magic │ version │ bytes │ sequence │ crc │ record… │ ––– │ own   │ next   │    little endian
//!   │  u32  │   u16   │  u16  │   u32    │ u32 │         │     │ mark  │ mark   │
//!   └───────┴─────────┴───────┴──────────┴─────┴─────────┴─────┴───────┴────────┘
//!   mark, in the last 32 bytes of the unit: │ magic u32 │ sequence u32 │ identity u32 │ crc u32 │
//! ```
//!
//! Writing erases the copy that does not count and fills it, header last: until then the other one
//! is what is read. The checksum covers header and record. When the new copy was read back, it is marked as
//! finished: behind itself, and behind the copy that it replaces.
//!
//! So a copy that is not whole is one of two things. Without a mark it was never finished: the power was cut,
//! and the one before counts as if nothing had been begun. With a mark it has decayed, and what is in the one
//! before may be out of date: a password, an authority or a signer that was withdrawn, pins of another machine.
//! That one counts only if its *identity* is that of the mark, a checksum of everything but drivers, switches
//! and tuning; and then it is a fault ([`Found::Older`]). Else there is no record ([`Found::Damaged`]).
//!
//! Firmware that knew no marks wrote the same copies and ignores what is behind them.

mod mark;

use crate::record::{RECORD_BYTES_MAX, Record};
use embedded_storage::nor_flash::NorFlash;
use mark::{MARK_BYTES, Mark, identity, mark_bytes, mark_of};
use serde::{Deserialize, Serialize};

const MAGIC: u32 = 0x464c_5443;
/// Layout of the header. The record's own fields are appended to without a new version.
const VERSION: u16 = 1;
const HEADER_BYTES: usize = 16;
/// Header and record, in whole words of any flash (16 bytes is the widest here).
const COPY_BYTES: usize = (HEADER_BYTES + RECORD_BYTES_MAX).next_multiple_of(16);
/// A copy with zeros behind it, enough for the fields that an older one lacks.
const PADDED_BYTES: usize = COPY_BYTES + 32;

/// From the end of a unit: of the copy itself, and of the one that replaced it.
const MARKS: [usize; 2] = [2 * MARK_BYTES, MARK_BYTES];
const OWN: usize = 0;
const NEXT: usize = 1;

/// What a reading found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Found {
    /// No record, and there never was one that was finished.
    #[default]
    Nothing,
    /// The newest record.
    Whole,
    /// The newest record is damaged. The one before counts: it differs in drivers, switches and tuning at
    /// most.
    Older,
    /// The newest record is damaged, and nothing can stand in for it.
    Damaged,
}

/// What the log says of [`Found::Older`].
pub const OLDER: &str = "the newest record in flash is damaged: drivers, switches and tuning are those of \
    the one before; look at them, tell them again (fleet provision), and release";

/// Why a record was not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// The flash did not do what it was told.
    Flash,
    /// The region is smaller than two erase units, or they are smaller than a record.
    Region,
}

impl core::fmt::Display for StoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Flash => "the flash did not take the record",
            Self::Region => "the region of the flash is too small",
        })
    }
}

impl core::error::Error for StoreError {}

/// Where the next record goes.
#[derive(Clone, Copy, Debug)]
struct Next {
    copy: u32,
    sequence: u32,
}

/// A region of flash that keeps a record.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    /// Known once the region was read.
    next: Option<Next>,
}

impl<F: NorFlash> Store<F> {
    /// Takes the region: the first two erase units of `flash`.
    ///
    /// # Errors
    /// It is too small.
    pub fn new(flash: F) -> Result<Self, StoreError> {
        if flash.capacity() < 2 * F::ERASE_SIZE
            || F::ERASE_SIZE < COPY_BYTES + MARKS[OWN]
            || !16_usize.is_multiple_of(F::WRITE_SIZE)
        {
            return Err(StoreError::Region);
        }
        Ok(Self { flash, next: None })
    }

    /// Gives the region back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Returns the record, `None` if there is none that counts.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn read(&mut self) -> Result<Option<Record>, StoreError> {
        let mut record = Record::default();
        let found = self.read_into(&mut record)?;
        Ok(matches!(found, Found::Whole | Found::Older).then_some(record))
    }

    /// Reads the record to where it stays: it is too large to be handed on along a short stack. Without one
    /// that counts it becomes the empty one.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn read_into(&mut self, record: &mut Record) -> Result<Found, StoreError> {
        let marked = self.newest_mark()?;
        let mut copies = [self.sequence_of(0)?, self.sequence_of(1)?];
        // At most two: one that is whole and means nothing is as if it were not there.
        while let Some((copy, sequence)) = newest(copies) {
            if !self.record_of(copy, record)? {
                copies[copy as usize] = None;
                continue;
            }
            let decayed = marked.filter(|mark| is_newer(mark.sequence, sequence));
            let last = decayed.map_or(sequence, |mark| mark.sequence);
            self.next = Some(Next {
                copy: 1 - copy,
                sequence: last.wrapping_add(1),
            });
            return Ok(match decayed {
                None => Found::Whole,
                Some(mark) if mark.identity == identity(record) => Found::Older,
                Some(_) => {
                    clear(record);
                    Found::Damaged
                }
            });
        }
        clear(record);
        self.next = Some(Next {
            copy: 0,
            sequence: marked.map_or(1, |mark| mark.sequence.wrapping_add(1)),
        });
        Ok(marked.map_or(Found::Nothing, |_| Found::Damaged))
    }

    /// Marks the record that the last reading found as finished, if it is not: by firmware that knew no
    /// marks, or because the power was cut.
    ///
    /// # Errors
    /// The flash does not take the marks.
    pub fn confirm(&mut self, record: &Record) -> Result<(), StoreError> {
        let Some(next) = self.next else {
            return Ok(());
        };
        let sequence = next.sequence.wrapping_sub(1);
        self.mark(1 - next.copy, sequence, record)
    }

    /// Returns the sequence number of a copy that is whole.
    #[inline(never)]
    fn sequence_of(&mut self, copy: u32) -> Result<Option<u32>, StoreError> {
        let mut bytes = [0; PADDED_BYTES];
        self.read_copy(copy, &mut bytes)?;
        Ok(whole(&bytes).map(|(sequence, _)| sequence))
    }

    /// Reads the record of a copy. Apart from the rest, so that its buffer is not below anything else.
    #[inline(never)]
    fn record_of(&mut self, copy: u32, record: &mut Record) -> Result<bool, StoreError> {
        let mut bytes = [0; PADDED_BYTES];
        self.read_copy(copy, &mut bytes)?;
        let Some((_, used)) = whole(&bytes) else {
            return Ok(false);
        };
        bytes[HEADER_BYTES + used..].fill(0);
        let Some(read) = decode(&bytes[HEADER_BYTES..]) else {
            return Ok(false);
        };
        *record = read;
        Ok(true)
    }

    fn read_copy(&mut self, copy: u32, bytes: &mut [u8; PADDED_BYTES]) -> Result<(), StoreError> {
        let at = copy * F::ERASE_SIZE as u32;
        self.flash
            .read(at, &mut bytes[..COPY_BYTES])
            .map_err(|_| StoreError::Flash)
    }

    fn mark_at(copy: u32, which: usize) -> u32 {
        (copy + 1) * F::ERASE_SIZE as u32 - MARKS[which] as u32
    }

    /// Returns what was finished last, whether it can still be read or not.
    fn newest_mark(&mut self) -> Result<Option<Mark>, StoreError> {
        let mut newest = None;
        for (copy, which) in [(0, OWN), (0, NEXT), (1, OWN), (1, NEXT)] {
            let mut bytes = [0; MARK_BYTES];
            self.flash
                .read(Self::mark_at(copy, which), &mut bytes)
                .map_err(|_| StoreError::Flash)?;
            let read = mark_of(&bytes);
            newest = match (newest, read) {
                (Some(Mark { sequence, .. }), Some(read)) if is_newer(sequence, read.sequence) => {
                    newest
                }
                (_, Some(_)) => read,
                (_, None) => newest,
            };
        }
        Ok(newest)
    }

    /// Marks a copy as finished, behind itself and behind the other one. What is marked already is left
    /// alone; a mark that was cut off is completed, as its bytes are the same.
    #[inline(never)]
    fn mark(&mut self, copy: u32, sequence: u32, record: &Record) -> Result<(), StoreError> {
        let identity = identity(record);
        let bytes = mark_bytes(Mark { sequence, identity });
        for (copy, which) in [(copy, OWN), (1 - copy, NEXT)] {
            let at = Self::mark_at(copy, which);
            let mut there = [0; MARK_BYTES];
            let flash = |_| StoreError::Flash;
            self.flash.read(at, &mut there).map_err(flash)?;
            if there != bytes {
                self.flash.write(at, &bytes).map_err(flash)?;
            }
        }
        Ok(())
    }

    /// Keeps a record instead of the one before. Returns its sequence number.
    ///
    /// # Errors
    /// The flash did not take it; the one before still counts.
    pub fn write(&mut self, record: &Record) -> Result<u32, StoreError> {
        if self.next.is_none() {
            self.read()?;
        }
        let next = self.next.expect("a reading says where the next one goes");
        let Next { copy, sequence } = next;
        let mut bytes = [0xff; COPY_BYTES];
        let used = postcard::to_slice(record, &mut bytes[HEADER_BYTES..])
            .expect("RECORD_BYTES_MAX holds every record")
            .len();
        let end = (HEADER_BYTES + used).next_multiple_of(16);
        write_header(&mut bytes, used as u16, sequence);
        let base = copy * F::ERASE_SIZE as u32;
        let flash = |_| StoreError::Flash;
        self.flash
            .erase(base, base + F::ERASE_SIZE as u32)
            .map_err(flash)?;
        let first = base + HEADER_BYTES as u32;
        self.flash
            .write(first, &bytes[HEADER_BYTES..end])
            .map_err(flash)?;
        self.flash
            .write(base, &bytes[..HEADER_BYTES])
            .map_err(flash)?;
        let mut written = [0; COPY_BYTES];
        self.flash.read(base, &mut written).map_err(flash)?;
        if written[..end] != bytes[..end] {
            return Err(StoreError::Flash);
        }
        self.next = Some(Next {
            copy: 1 - copy,
            sequence: sequence.wrapping_add(1),
        });
        // It counts already. Without a mark it is marked at the next boot.
        let _ = self.mark(copy, sequence, record);
        Ok(sequence)
    }
}

/// Makes a record the empty one. Apart from the rest, for the sake of the stack.
#[inline(never)]
fn clear(record: &mut Record) {
    *record = Record::default();
}

/// Sequence numbers may wrap.
fn is_newer(sequence: u32, before: u32) -> bool {
    sequence.wrapping_sub(before) as i32 > 0
}

fn write_header(bytes: &mut [u8], used: u16, sequence: u32) {
    bytes[0..4].copy_from_slice(&MAGIC.to_le_bytes());
    bytes[4..6].copy_from_slice(&VERSION.to_le_bytes());
    bytes[6..8].copy_from_slice(&used.to_le_bytes());
    bytes[8..12].copy_from_slice(&sequence.to_le_bytes());
    let crc = checksum(bytes, usize::from(used));
    bytes[12..16].copy_from_slice(&crc.to_le_bytes());
}

fn checksum(bytes: &[u8], used: usize) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..12]);
    hasher.update(&bytes[HEADER_BYTES..HEADER_BYTES + used]);
    hasher.finalize()
}

/// Returns sequence number and bytes of a record that is whole.
fn whole(bytes: &[u8]) -> Option<(u32, usize)> {
    let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let word = |at: usize| u32::from(half(at)) | u32::from(half(at + 2)) << 16;
    let used = usize::from(half(6));
    let known = word(0) == MAGIC && half(4) == VERSION && used <= RECORD_BYTES_MAX;
    (known && word(12) == checksum(bytes, used)).then(|| (word(8), used))
}

/// Returns the newer of two copies, with its sequence number.
fn newest(copies: [Option<u32>; 2]) -> Option<(u32, u32)> {
    match copies {
        [Some(first), Some(second)] if is_newer(second, first) => Some((1, second)),
        [Some(first), _] => Some((0, first)),
        [None, Some(second)] => Some((1, second)),
        [None, None] => None,
    }
}

/// Reads a record behind which zeros follow: its last fields may be missing, and every default is a row
/// of zero bytes.
fn decode(padded: &[u8]) -> Option<Record> {
    postcard::take_from_bytes(padded)
        .ok()
        .map(|(record, _)| record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::Machine;

    fn decoded(bytes: &[u8]) -> Option<Record> {
        let mut padded = [0; PADDED_BYTES];
        padded[..bytes.len()].copy_from_slice(bytes);
        decode(&padded)
    }

    /// What the first firmware kept: every field set, before there were boot scripts and signers.
    const OLDER: &[u8] = &[
        1, 4, b'l', b'e', b'f', b't', // name
        2, b's', b'1', // prefix
        1, 4, b's', b'h', b'o', b'p', 8, b'p', b'a', b's', b's', b'w', b'o', b'r',
        b'd', // networks
        1, 10, 0, 0, 9, 24, 10, 0, 0, 1, // fixed address
        7, b't', b'c', b'p', b'/', b'a', b':', b'1', // router
        1, 1, b'u', 1, b'p', // login
        1, 1, 2, 3, 4, 5, 6, 7, 1, // axes
        1, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9, 9,
        9, 9, 9, // update key
    ];

    #[test]
    fn a_record_of_the_first_firmware_allows_no_boot_script_and_has_no_signers() {
        let record = decoded(OLDER).expect("it stays readable");
        assert_eq!(record.name.map(|name| name.as_str() == "left"), Some(true));
        assert_eq!(record.prefix, "s1");
        assert_eq!(record.networks[0].password, "password");
        assert_eq!(
            record.fixed_address.map(|fixed| fixed.prefix_bits),
            Some(24)
        );
        assert_eq!(record.router, "tcp/a:1");
        assert_eq!(
            record.login.as_ref().map(|login| login.user.as_str()),
            Some("u")
        );
        assert_eq!(record.axes[0].junction_hz, 7);
        assert!(record.axes[0].direction_inverted);
        assert_eq!(record.update_key, Some([9; 32]));
        assert!(!record.boot_script && record.signers.is_empty());
        assert_eq!(record.machine, Machine::default());
        assert_eq!(record.authority, None);
        // And the same record is still written so, with the new fields behind.
        let mut buffer = [0; RECORD_BYTES_MAX];
        let bytes = postcard::to_slice(&record, &mut buffer).expect("room");
        let (older, newer) = bytes.split_at(OLDER.len());
        assert_eq!((older, newer), (OLDER, &[0; 13][..]));
    }

    #[test]
    fn missing_fields_are_their_defaults() {
        assert_eq!(decoded(&[]), Some(Record::default()));
        let record = Record {
            router: heapless::String::try_from("tcp/a:1").expect("short"),
            ..Record::default()
        };
        let mut buffer = [0; RECORD_BYTES_MAX];
        let bytes = postcard::to_slice(&record, &mut buffer).expect("room");
        let shorter = &bytes[..bytes.len() - 6];
        assert_eq!(decoded(shorter), Some(record), "login and all behind it");
    }

    #[test]
    fn the_newer_sequence_counts_even_behind_the_last_number() {
        assert!(is_newer(2, 1) && !is_newer(1, 2) && is_newer(0, u32::MAX));
    }
}
