//! A part of a flash that several have a handle to.

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

/// Where a region lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Its first byte.
    pub at: u32,
    /// Its size, bytes.
    pub bytes: u32,
}

impl Place {
    /// Makes a place.
    pub const fn new(at: u32, bytes: u32) -> Self {
        Self { at, bytes }
    }
}

/// A region of the flash behind the handle `F`. What lies outside is never touched.
#[derive(Clone, Debug)]
pub struct Region<F> {
    flash: F,
    place: Place,
}

/// Why an access failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegionError<E> {
    /// It does not lie inside the region.
    Outside,
    /// The flash's own error.
    Flash(E),
}

impl<E: embedded_storage::nor_flash::NorFlashError> embedded_storage::nor_flash::NorFlashError
    for RegionError<E>
{
    fn kind(&self) -> embedded_storage::nor_flash::NorFlashErrorKind {
        match self {
            Self::Outside => embedded_storage::nor_flash::NorFlashErrorKind::OutOfBounds,
            Self::Flash(error) => error.kind(),
        }
    }
}

impl<F> Region<F> {
    /// Takes a handle.
    pub const fn new(flash: F, place: Place) -> Self {
        Self { flash, place }
    }

    /// Returns where `bytes` from `offset` on lie in the flash.
    fn at<E>(&self, offset: u32, bytes: usize) -> Result<u32, RegionError<E>> {
        let end = u32::try_from(bytes)
            .ok()
            .and_then(|bytes| offset.checked_add(bytes));
        end.filter(|end| *end <= self.place.bytes)
            .map(|_| self.place.at + offset)
            .ok_or(RegionError::Outside)
    }
}

impl<F: ErrorType> ErrorType for Region<F> {
    type Error = RegionError<F::Error>;
}

impl<F: ReadNorFlash> ReadNorFlash for Region<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let at = self.at(offset, bytes.len())?;
        self.flash.read(at, bytes).map_err(RegionError::Flash)
    }

    fn capacity(&self) -> usize {
        self.place.bytes as usize
    }
}

impl<F: NorFlash> NorFlash for Region<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        let bytes = to.checked_sub(from).ok_or(RegionError::Outside)?;
        let at = self.at(from, bytes as usize)?;
        self.flash.erase(at, at + bytes).map_err(RegionError::Flash)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let at = self.at(offset, bytes.len())?;
        self.flash.write(at, bytes).map_err(RegionError::Flash)
    }
}
