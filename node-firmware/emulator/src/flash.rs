//! The flash of an emulated board: in memory, or in a file, with a power that can be cut.
//!
//! It does what flash does: writing turns ones into zeros, erasing makes ones of 4 KiB at once, and
//! what a power cut leaves is what had been done by then.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use std::{
    fs::{File, OpenOptions},
    io::{self, Read, Seek, SeekFrom, Write},
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use update::layout::FLASH_BYTES;

/// Bytes that are erased at once where the power can be cut.
const ERASE_STEP: usize = 64;

/// Why an access failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The power is gone.
    Power,
    /// Outside, or not aligned.
    Access,
    /// The file does not take it.
    File,
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Access => NorFlashErrorKind::OutOfBounds,
            _ => NorFlashErrorKind::Other,
        }
    }
}

#[derive(Debug)]
struct Chip {
    bytes: Vec<u8>,
    file: Option<File>,
    /// Steps of work until the power is cut: a word that is written, [`ERASE_STEP`] bytes erased.
    power_steps: Option<u64>,
    /// Steps of work so far.
    worked_steps: u64,
}

/// A handle to the flash of one board.
#[derive(Clone, Debug)]
pub struct Flash(Arc<Mutex<Chip>>);

impl Default for Flash {
    fn default() -> Self {
        Self::blank()
    }
}

impl Flash {
    /// Makes a new flash, in memory.
    pub fn blank() -> Self {
        Self::with(vec![0xff; FLASH_BYTES as usize], None)
    }

    /// Opens the flash in a file, and makes a blank one if there is no file.
    ///
    /// # Errors
    /// The file cannot be read or written, or is no flash of a board.
    pub fn open(path: &Path) -> io::Result<Self> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        if bytes.is_empty() {
            bytes = vec![0xff; FLASH_BYTES as usize];
            file.write_all(&bytes)?;
        }
        if bytes.len() != FLASH_BYTES as usize {
            let error = format!("a flash has {FLASH_BYTES} bytes, this has {}", bytes.len());
            return Err(io::Error::new(io::ErrorKind::InvalidData, error));
        }
        Ok(Self::with(bytes, Some(file)))
    }

    fn with(bytes: Vec<u8>, file: Option<File>) -> Self {
        Self(Arc::new(Mutex::new(Chip {
            bytes,
            file,
            power_steps: None,
            worked_steps: 0,
        })))
    }

    fn chip(&self) -> MutexGuard<'_, Chip> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Cuts the power after this much more work, in words written and 64 bytes erased; `None`: the
    /// power is there.
    pub fn cut_after(&self, steps: Option<u64>) {
        self.chip().power_steps = steps;
    }

    /// Returns how much work it has done.
    pub fn worked_steps(&self) -> u64 {
        self.chip().worked_steps
    }

    /// Returns whether the power was cut.
    pub fn is_cut(&self) -> bool {
        self.chip().power_steps == Some(0)
    }

    /// Returns a copy that goes its own way, in memory.
    pub fn duplicate(&self) -> Self {
        Self::with(self.chip().bytes.clone(), None)
    }
}

impl Chip {
    fn range(&self, offset: u32, count: usize) -> Result<std::ops::Range<usize>, FlashError> {
        let from = offset as usize;
        let to = from.checked_add(count).ok_or(FlashError::Access)?;
        (to <= self.bytes.len())
            .then_some(from..to)
            .ok_or(FlashError::Access)
    }

    fn work(&mut self) -> Result<(), FlashError> {
        if let Some(steps) = self.power_steps.as_mut() {
            *steps = steps.checked_sub(1).ok_or(FlashError::Power)?;
        }
        self.worked_steps += 1;
        Ok(())
    }

    /// Puts what has changed into the file.
    fn keep(&mut self, range: std::ops::Range<usize>) -> Result<(), FlashError> {
        let Some(file) = self.file.as_mut() else {
            return Ok(());
        };
        let written = file
            .seek(SeekFrom::Start(range.start as u64))
            .and_then(|_| file.write_all(&self.bytes[range]));
        written.map_err(|error| {
            tracing::error!("the file of the flash: {error}");
            FlashError::File
        })
    }

    fn change(
        &mut self,
        range: std::ops::Range<usize>,
        step: usize,
        mut change: impl FnMut(usize, &mut [u8]),
    ) -> Result<(), FlashError> {
        let mut result = Ok(());
        let mut end = range.start;
        while end < range.end && result.is_ok() {
            result = self.work();
            if result.is_ok() {
                change(end - range.start, &mut self.bytes[end..end + step]);
                end += step;
            }
        }
        result.and(self.keep(range.start..end))
    }
}

impl ErrorType for Flash {
    type Error = FlashError;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let chip = self.chip();
        let range = chip.range(offset, bytes.len())?;
        bytes.copy_from_slice(&chip.bytes[range]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.chip().bytes.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let count = to.checked_sub(from).ok_or(FlashError::Access)?;
        let mut chip = self.chip();
        let range = chip.range(from, count as usize)?;
        if !range.start.is_multiple_of(Self::ERASE_SIZE)
            || !range.end.is_multiple_of(Self::ERASE_SIZE)
        {
            return Err(FlashError::Access);
        }
        chip.change(range, ERASE_STEP, |_, bytes| bytes.fill(0xff))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let mut chip = self.chip();
        let range = chip.range(offset, bytes.len())?;
        if !range.start.is_multiple_of(Self::WRITE_SIZE)
            || !bytes.len().is_multiple_of(Self::WRITE_SIZE)
        {
            return Err(FlashError::Access);
        }
        chip.change(range, Self::WRITE_SIZE, |at, word| {
            for (to, from) in word.iter_mut().zip(&bytes[at..]) {
                *to &= from;
            }
        })
    }
}
