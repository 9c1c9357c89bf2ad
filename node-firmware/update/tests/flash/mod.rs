//! Flash in memory, or of a file's content, whose power can be cut in the middle of anything.
#![allow(dead_code, reason = "each test uses a part of it")]

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// The power is gone, or the access is not what flash can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Gone;

impl NorFlashError for Gone {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// Bits go from 1 to 0 by writing and back by erasing units of 4 KiB.
#[derive(Clone, Debug)]
pub(crate) struct Flash {
    pub(crate) bytes: Vec<u8>,
    /// Bytes that can still be written or erased before the power is cut; an erased unit counts as
    /// 64.
    pub(crate) power: usize,
    pub(crate) used: usize,
}

impl Flash {
    pub(crate) fn new(units: usize) -> Self {
        Self {
            bytes: vec![0xff; units * Self::ERASE_SIZE],
            power: usize::MAX,
            used: 0,
        }
    }

    fn spend(&mut self) -> Result<(), Gone> {
        if self.power == 0 {
            return Err(Gone);
        }
        self.power -= 1;
        self.used += 1;
        Ok(())
    }
}

impl ErrorType for Flash {
    type Error = Gone;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Gone> {
        let at = offset as usize;
        bytes.copy_from_slice(self.bytes.get(at..at + bytes.len()).ok_or(Gone)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Gone> {
        assert!((from as usize).is_multiple_of(Self::ERASE_SIZE));
        assert!((to as usize).is_multiple_of(Self::ERASE_SIZE));
        for chunk in (from as usize..to as usize).step_by(64) {
            self.spend()?;
            self.bytes[chunk..chunk + 64].fill(0xff);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Gone> {
        assert!((offset as usize).is_multiple_of(Self::WRITE_SIZE));
        assert!(bytes.len().is_multiple_of(Self::WRITE_SIZE));
        for (index, byte) in bytes.iter().enumerate() {
            self.spend()?;
            // Flash only clears bits: a unit that was not erased shows.
            self.bytes[offset as usize + index] &= byte;
        }
        Ok(())
    }
}
