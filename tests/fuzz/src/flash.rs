//! Flash in memory, with the rules of flash: bits go from 1 to 0 by writing and back by erasing.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// The access is not what flash can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gone;

impl NorFlashError for Gone {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Flash(pub Vec<u8>);

impl Flash {
    /// Makes this many erase units, filled with what is given and blank behind it.
    pub fn with(units: usize, content: &[u8]) -> Self {
        let mut bytes = vec![0xff; units * Self::ERASE_SIZE];
        let used = content.len().min(bytes.len());
        bytes[..used].copy_from_slice(&content[..used]);
        Self(bytes)
    }
}

impl ErrorType for Flash {
    type Error = Gone;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Gone> {
        let at = offset as usize;
        bytes.copy_from_slice(self.0.get(at..at + bytes.len()).ok_or(Gone)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Gone> {
        let (from, to) = (from as usize, to as usize);
        assert!(from.is_multiple_of(Self::ERASE_SIZE) && to.is_multiple_of(Self::ERASE_SIZE));
        self.0.get_mut(from..to).ok_or(Gone)?.fill(0xff);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Gone> {
        let at = offset as usize;
        assert!(
            at.is_multiple_of(Self::WRITE_SIZE) && bytes.len().is_multiple_of(Self::WRITE_SIZE)
        );
        let to = self.0.get_mut(at..at + bytes.len()).ok_or(Gone)?;
        for (to, from) in to.iter_mut().zip(bytes) {
            *to &= from;
        }
        Ok(())
    }
}
