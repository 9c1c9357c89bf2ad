//! The flash, which belongs to core 0.
//!
//! While flash is written the other core is stopped, wherever it is. So a write is made in a window
//! ([`crate::plan::in_window`]): the planning task says that nothing moves, and waits. A window may last
//! for seconds, of which each step of an erasure or a write takes 0.4 s at most; after each both watchdogs
//! are fed.

use crate::watchdog::feed_both;
use core::cell::RefCell;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use esp_bootloader_esp_idf::partitions::{
    AppPartitionSubType, PARTITION_TABLE_MAX_LEN, PartitionType, read_partition_table,
};
use esp_storage::{FlashStorage, FlashStorageError};

/// Bytes that are read or written at once, by way of the stack: what the ROM's functions are given lies
/// in internal RAM, wherever the caller has it.
const STEP_BYTES: usize = 256;

/// Words of a step, aligned as the flash's registers want them.
#[repr(align(4))]
struct Step([u8; STEP_BYTES]);

/// A handle to the flash.
#[derive(Clone, Copy)]
pub(crate) struct CoreFlash(&'static RefCell<FlashStorage<'static>>);

impl CoreFlash {
    pub(crate) fn new(flash: &'static RefCell<FlashStorage<'static>>) -> Self {
        Self(flash)
    }
}

impl ErrorType for CoreFlash {
    type Error = FlashStorageError;
}

impl ReadNorFlash for CoreFlash {
    const READ_SIZE: usize = FlashStorage::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashStorageError> {
        let mut flash = self.0.borrow_mut();
        let mut step = Step([0; STEP_BYTES]);
        for (at, piece) in (offset..)
            .step_by(STEP_BYTES)
            .zip(bytes.chunks_mut(STEP_BYTES))
        {
            let step = &mut step.0[..piece.len()];
            ReadNorFlash::read(&mut *flash, at, step)?;
            piece.copy_from_slice(step);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&*self.0.borrow())
    }
}

impl NorFlash for CoreFlash {
    const WRITE_SIZE: usize = FlashStorage::WRITE_SIZE;
    const ERASE_SIZE: usize = FlashStorage::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashStorageError> {
        let mut flash = self.0.borrow_mut();
        let mut at = from;
        while at < to {
            NorFlash::erase(&mut *flash, at, at + Self::ERASE_SIZE as u32)?;
            feed_both();
            at += Self::ERASE_SIZE as u32;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashStorageError> {
        let mut flash = self.0.borrow_mut();
        let mut step = Step([0; STEP_BYTES]);
        for (at, piece) in (offset..).step_by(STEP_BYTES).zip(bytes.chunks(STEP_BYTES)) {
            let step = &mut step.0[..piece.len()];
            step.copy_from_slice(piece);
            NorFlash::write(&mut *flash, at, step)?;
            feed_both();
        }
        Ok(())
    }
}

/// Returns the slot that this program runs from, by where its code is mapped: 0 or 1.
pub(crate) fn running_slot(flash: CoreFlash) -> u8 {
    let mut flash = flash.0.borrow_mut();
    let mut buffer = [0; PARTITION_TABLE_MAX_LEN];
    let booted = read_partition_table(&mut flash, &mut buffer)
        .and_then(|table| table.booted_partition())
        .ok()
        .flatten();
    let second = PartitionType::App(AppPartitionSubType::Ota1);
    u8::from(booted.is_some_and(|entry| entry.partition_type() == second))
}
