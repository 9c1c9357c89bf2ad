//! Stored scripts in a board's flash: each in as many erase units as it needs, anywhere.
//!
//! ```text
//!   unit (one erase unit)                                        a script of 3 units
//!   ┌────────────────────── header, 64 bytes ──────────┬───────┐   ┌───┐ ┌───┐   ┌───┐
//!   │ magic │ version │ index, count │ sequence │ …    │ text… │   │ 1 │ │ 2 │ … │ 0 │ head,
//!   └──────────────────────────────────────────────────┴───────┘   └───┘ └───┘   └───┘ written last
//! ```
//!
//! A script is there when all its units are, with one sequence number; of several with one name the
//! one with the highest number counts. Saving takes free units, erases and fills them, the head
//! last, and then erases the head of the text before. So at every moment one of the two is whole.
//!
//! | what | answer |
//! |---|---|
//! | no free units beside the text before | [`SaveError::Full`]; that text stays |
//! | a unit that does not keep what was written | left out until the next start; another one is taken |
//! | wear | units are taken in turns: at 100,000 erasures for each, 384 units take 19 million short texts |
//!
//! Absent on purpose: a list of contents, which would be written with every change and wear out
//! first; the headers tell everything at the start.

use super::{SaveError, ScriptStore};
use alloc::{vec, vec::Vec};
use embedded_storage::nor_flash::NorFlash;
use keys::script::SCRIPT_BYTES_MAX;

const MAGIC: u32 = 0x5354_534c;
/// Layout of a unit.
const VERSION: u16 = 1;
const HEADER_BYTES: usize = 64;
const NAME_BYTES_MAX: usize = 32;
/// Where the header's own checksum lies.
const SUM_AT: usize = HEADER_BYTES - 4;
/// Bytes that are written or read at once, on the stack: whole words of any flash.
const STEP_BYTES: usize = 256;

const _: () = assert!(STEP_BYTES.is_multiple_of(HEADER_BYTES));

type Name = heapless::String<NAME_BYTES_MAX>;

/// What the first bytes of a unit say.
#[derive(Clone, Debug)]
struct Header {
    index: u8,
    count: u8,
    sequence: u32,
    bytes: u16,
    text_sum: u32,
    name: Name,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    /// To be erased and written.
    Free,
    /// Part of a script.
    Used,
    /// It did not keep what was written.
    Bad,
}

/// A script that is whole.
#[derive(Clone, Debug)]
struct Kept {
    name: Name,
    bytes: usize,
    /// Where its parts are, in order; the first is the head.
    units: Vec<usize>,
    /// Heads of texts before it that could not be erased, oldest first: they must go before it.
    old_heads: Vec<usize>,
}

/// A region of flash that keeps scripts.
pub struct FlashStore<F> {
    flash: F,
    units: Vec<Unit>,
    scripts: Vec<Kept>,
    /// Where the search for a free unit begins.
    next_unit: usize,
    next_sequence: u32,
    /// Something was there that is not whole, and no power cut explains it.
    is_damaged: bool,
}

impl<F> core::fmt::Debug for FlashStore<F> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("FlashStore")
            .field("units", &self.units.len())
            .field("free", &self.free_units())
            .field("scripts", &self.scripts.len())
            .finish_non_exhaustive()
    }
}

impl<F> FlashStore<F> {
    /// Gives the region back, as a power cut would.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Returns how many units can be written.
    pub fn free_units(&self) -> usize {
        self.units
            .iter()
            .filter(|unit| **unit == Unit::Free)
            .count()
    }

    /// Returns how many units do not keep what is written, as far as that was tried.
    pub fn bad_units(&self) -> usize {
        self.units.iter().filter(|unit| **unit == Unit::Bad).count()
    }
}

impl<F: NorFlash> FlashStore<F> {
    /// Bytes of text in a unit.
    pub const UNIT_TEXT_BYTES: usize = F::ERASE_SIZE - HEADER_BYTES;

    /// Reads what the region holds; writes nothing.
    ///
    /// # Errors
    /// It cannot be read, or is no region for scripts: less than two units, or units of less than
    /// 512 bytes or more than 64 KiB, or words of more than 64 bytes.
    pub fn open(flash: F) -> Result<Self, SaveError> {
        let units = flash.capacity() / F::ERASE_SIZE;
        let fits = units >= 2
            && (512..=0x1_0000).contains(&F::ERASE_SIZE)
            && SCRIPT_BYTES_MAX.div_ceil(Self::UNIT_TEXT_BYTES) <= usize::from(u8::MAX)
            && HEADER_BYTES.is_multiple_of(F::WRITE_SIZE)
            && HEADER_BYTES.is_multiple_of(F::READ_SIZE);
        if !fits {
            return Err(SaveError::Broken);
        }
        let mut store = Self {
            flash,
            units: vec![Unit::Free; units],
            scripts: Vec::new(),
            next_unit: 0,
            next_sequence: 1,
            is_damaged: false,
        };
        store.look()?;
        Ok(store)
    }

    /// Finds the scripts that are whole.
    fn look(&mut self) -> Result<(), SaveError> {
        let mut found = Vec::new();
        for unit in 0..self.units.len() {
            if let Some(header) = self.header(unit)? {
                found.push((unit, header));
            }
        }
        // The newest first, so that what comes later is older.
        found.sort_by_key(|(_, header)| core::cmp::Reverse(header.sequence));
        if let Some((unit, newest)) = found.first() {
            self.next_sequence = newest.sequence.wrapping_add(1);
            self.next_unit = (unit + 1) % self.units.len();
        }
        for copy in found.chunk_by(|(_, a), (_, b)| a.sequence == b.sequence) {
            self.take_copy(copy)?;
        }
        Ok(())
    }

    /// Takes the units of one sequence number, if they are a script.
    fn take_copy(&mut self, copy: &[(usize, Header)]) -> Result<(), SaveError> {
        let Some((head, header)) = copy.iter().find(|(_, header)| header.index == 0) else {
            // The power was cut before its head was written, or the script was removed.
            return Ok(());
        };
        if let Some(newer) = self
            .scripts
            .iter_mut()
            .find(|kept| kept.name == header.name)
        {
            newer.old_heads.insert(0, *head);
            self.units[*head] = Unit::Used;
            return Ok(());
        }
        let mut units = Vec::with_capacity(usize::from(header.count));
        let mut bytes = 0;
        for index in 0..header.count {
            let mut good = None;
            for (unit, part) in copy.iter().filter(|(_, part)| part.index == index) {
                if part.name == header.name && self.is_text_good(*unit, part)? {
                    good = Some((*unit, usize::from(part.bytes)));
                    break;
                }
            }
            let Some((unit, more)) = good else {
                self.is_damaged = true;
                return Ok(());
            };
            units.push(unit);
            bytes += more;
        }
        for unit in &units {
            self.units[*unit] = Unit::Used;
        }
        self.scripts.push(Kept {
            name: header.name.clone(),
            bytes,
            units,
            old_heads: Vec::new(),
        });
        Ok(())
    }

    fn address(unit: usize) -> u32 {
        (unit * F::ERASE_SIZE) as u32
    }

    fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), SaveError> {
        self.flash.read(at, bytes).map_err(|_| SaveError::Broken)
    }

    fn erase(&mut self, unit: usize) -> Result<(), SaveError> {
        self.flash
            .erase(Self::address(unit), Self::address(unit + 1))
            .map_err(|_| SaveError::Broken)
    }

    fn header(&mut self, unit: usize) -> Result<Option<Header>, SaveError> {
        let mut bytes = [0; HEADER_BYTES];
        self.read(Self::address(unit), &mut bytes)?;
        Ok(header_from(&bytes, Self::UNIT_TEXT_BYTES))
    }

    /// Gives the text of a unit to `take`, step by step.
    fn read_text(
        &mut self,
        unit: usize,
        bytes: usize,
        mut take: impl FnMut(&[u8]),
    ) -> Result<(), SaveError> {
        let mut at = Self::address(unit) + HEADER_BYTES as u32;
        let mut left = bytes;
        while left > 0 {
            let used = left.min(STEP_BYTES);
            let mut buffer = [0; STEP_BYTES];
            let words = used.next_multiple_of(F::READ_SIZE);
            self.read(at, &mut buffer[..words])?;
            take(&buffer[..used]);
            at += used as u32;
            left -= used;
        }
        Ok(())
    }

    fn is_text_good(&mut self, unit: usize, header: &Header) -> Result<bool, SaveError> {
        let mut sum = crc32fast::Hasher::new();
        self.read_text(unit, usize::from(header.bytes), |part| sum.update(part))?;
        Ok(sum.finalize() == header.text_sum)
    }

    /// Writes a part into some free unit, the header last; returns which.
    fn write_part(&mut self, header: &Header, text: &[u8]) -> Result<usize, SaveError> {
        let header_bytes = bytes_of(header);
        loop {
            let count = self.units.len();
            let turn = (0..count).map(|more| (self.next_unit + more) % count);
            let unit = turn
                .into_iter()
                .find(|unit| self.units[*unit] == Unit::Free)
                .ok_or(SaveError::Full)?;
            self.next_unit = (unit + 1) % count;
            if self.write_unit(unit, &header_bytes, text)? {
                self.units[unit] = Unit::Used;
                return Ok(unit);
            }
            self.units[unit] = Unit::Bad;
        }
    }

    /// Returns whether the unit has kept it.
    fn write_unit(
        &mut self,
        unit: usize,
        header: &[u8; HEADER_BYTES],
        text: &[u8],
    ) -> Result<bool, SaveError> {
        self.erase(unit)?;
        let mut at = Self::address(unit) + HEADER_BYTES as u32;
        for part in text.chunks(STEP_BYTES) {
            if !self.write_checked(at, part)? {
                return Ok(false);
            }
            at += part.len() as u32;
        }
        self.write_checked(Self::address(unit), header)
    }

    fn write_checked(&mut self, at: u32, part: &[u8]) -> Result<bool, SaveError> {
        let mut buffer = [0xff; STEP_BYTES];
        buffer[..part.len()].copy_from_slice(part);
        let words = part.len().next_multiple_of(F::WRITE_SIZE.max(F::READ_SIZE));
        self.flash
            .write(at, &buffer[..words])
            .map_err(|_| SaveError::Broken)?;
        let mut written = [0; STEP_BYTES];
        self.read(at, &mut written[..words])?;
        Ok(written[..words] == buffer[..words])
    }

    /// Writes all parts of a text, the head last. What was written before an error is left behind
    /// without a head.
    fn write_parts(
        &mut self,
        name: &Name,
        text: &[u8],
        units: &mut Vec<(u8, usize)>,
    ) -> Result<(), SaveError> {
        let sequence = self.next_sequence;
        self.next_sequence = sequence.wrapping_add(1);
        let count = text.len().div_ceil(Self::UNIT_TEXT_BYTES).max(1);
        for index in (1..count).chain([0]) {
            let from = index * Self::UNIT_TEXT_BYTES;
            let part = &text[from..text.len().min(from + Self::UNIT_TEXT_BYTES)];
            let header = Header {
                index: index as u8,
                count: count as u8,
                sequence,
                bytes: part.len() as u16,
                text_sum: crc32fast::hash(part),
                name: name.clone(),
            };
            let unit = self.write_part(&header, part)?;
            units.push((index as u8, unit));
        }
        Ok(())
    }

    /// Lets go of a copy: erases the heads, the oldest first, and frees the units.
    fn forget(&mut self, heads: &mut Vec<usize>, rest: &[usize]) -> Result<(), SaveError> {
        while let Some(head) = heads.first().copied() {
            self.erase(head)?;
            self.units[head] = Unit::Free;
            heads.remove(0);
        }
        for unit in rest {
            self.units[*unit] = Unit::Free;
        }
        Ok(())
    }
}

impl<F: NorFlash> ScriptStore for FlashStore<F> {
    fn load(&mut self, take: &mut dyn FnMut(&str, &[u8])) -> Result<(), SaveError> {
        for place in 0..self.scripts.len() {
            let Kept {
                name, bytes, units, ..
            } = self.scripts[place].clone();
            let mut text = Vec::with_capacity(bytes);
            for unit in units {
                let left = bytes - text.len();
                self.read_text(unit, left.min(Self::UNIT_TEXT_BYTES), |part| {
                    text.extend_from_slice(part);
                })?;
            }
            take(&name, &text);
        }
        if self.is_damaged {
            Err(SaveError::Broken)
        } else {
            Ok(())
        }
    }

    fn save(&mut self, name: &str, text: &[u8]) -> Result<(), SaveError> {
        let name = Name::try_from(name).map_err(|_| SaveError::Broken)?;
        let count = text.len().div_ceil(Self::UNIT_TEXT_BYTES).max(1);
        if text.len() > SCRIPT_BYTES_MAX || count > self.free_units() {
            return Err(SaveError::Full);
        }
        let mut written = Vec::with_capacity(count);
        if let Err(error) = self.write_parts(&name, text, &mut written) {
            for (_, unit) in written {
                self.units[unit] = Unit::Free;
            }
            return Err(error);
        }
        written.sort_unstable();
        let units = written.into_iter().map(|(_, unit)| unit).collect();
        let mut old_heads = Vec::new();
        if let Some(place) = self.scripts.iter().position(|kept| kept.name == name) {
            let before = self.scripts.swap_remove(place);
            old_heads = before.old_heads;
            old_heads.extend(before.units.first());
            // One that cannot be erased is older, and goes before this one does.
            let _ = self.forget(&mut old_heads, &[]);
            for unit in before.units.iter().skip(1) {
                self.units[*unit] = Unit::Free;
            }
        }
        self.scripts.push(Kept {
            name,
            bytes: text.len(),
            units,
            old_heads,
        });
        Ok(())
    }

    fn remove(&mut self, name: &str) -> Result<(), SaveError> {
        let Some(place) = self.scripts.iter().position(|kept| kept.name == name) else {
            return Ok(());
        };
        let mut kept = self.scripts.swap_remove(place);
        let mut heads = core::mem::take(&mut kept.old_heads);
        heads.extend(kept.units.first());
        let rest: Vec<usize> = kept.units.iter().skip(1).copied().collect();
        let result = self.forget(&mut heads, &rest);
        if result.is_err() {
            // The last head is its own.
            heads.pop();
            kept.old_heads = heads;
            self.scripts.push(kept);
        }
        result
    }
}

fn bytes_of(header: &Header) -> [u8; HEADER_BYTES] {
    let mut bytes = [0; HEADER_BYTES];
    bytes[0..4].copy_from_slice(&MAGIC.to_le_bytes());
    bytes[4..6].copy_from_slice(&VERSION.to_le_bytes());
    bytes[6] = header.index;
    bytes[7] = header.count;
    bytes[8..12].copy_from_slice(&header.sequence.to_le_bytes());
    bytes[12..14].copy_from_slice(&header.bytes.to_le_bytes());
    bytes[14] = header.name.len() as u8;
    bytes[16..20].copy_from_slice(&header.text_sum.to_le_bytes());
    bytes[20..20 + header.name.len()].copy_from_slice(header.name.as_bytes());
    let sum = crc32fast::hash(&bytes[..SUM_AT]);
    bytes[SUM_AT..].copy_from_slice(&sum.to_le_bytes());
    bytes
}

fn header_from(bytes: &[u8; HEADER_BYTES], text_bytes_max: usize) -> Option<Header> {
    let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let word = |at: usize| u32::from(half(at)) | u32::from(half(at + 2)) << 16;
    if word(0) != MAGIC || half(4) != VERSION || word(SUM_AT) != crc32fast::hash(&bytes[..SUM_AT]) {
        return None;
    }
    let name = bytes[20..].get(..usize::from(bytes[14]))?;
    let header = Header {
        index: bytes[6],
        count: bytes[7],
        sequence: word(8),
        bytes: half(12),
        text_sum: word(16),
        name: Name::try_from(core::str::from_utf8(name).ok()?).ok()?,
    };
    let is_full = usize::from(header.bytes) == text_bytes_max;
    let is_last = header.index.checked_add(1) == Some(header.count);
    let fits = header.index < header.count
        && usize::from(header.bytes) <= text_bytes_max
        && (is_full || is_last);
    fits.then_some(header)
}
