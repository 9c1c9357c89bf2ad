//! The flash, which belongs to core 0, and the boot loader's note in it.
//!
//! While flash is written the other core is stopped, wherever it is. So a write is made in a window
//! ([`crate::plan::in_window`]): the planning task says that nothing moves, and waits.

use core::cell::RefCell;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use esp_bootloader_esp_idf::{
    ota::OtaImageState,
    ota_updater::OtaUpdater,
    partitions::{
        AppPartitionSubType, PARTITION_TABLE_MAX_LEN, PartitionType, read_partition_table,
    },
};
use esp_storage::{FlashStorage, FlashStorageError};
use update::{Loader, TrialError};

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
        ReadNorFlash::read(&mut *self.0.borrow_mut(), offset, bytes)
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&*self.0.borrow())
    }
}

impl NorFlash for CoreFlash {
    const WRITE_SIZE: usize = FlashStorage::WRITE_SIZE;
    const ERASE_SIZE: usize = FlashStorage::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashStorageError> {
        NorFlash::erase(&mut *self.0.borrow_mut(), from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashStorageError> {
        NorFlash::write(&mut *self.0.borrow_mut(), offset, bytes)
    }
}

/// The boot loader of ESP-IDF.
pub(crate) struct BootLoader(CoreFlash);

impl BootLoader {
    pub(crate) fn new(flash: CoreFlash) -> Self {
        Self(flash)
    }

    fn note(
        &self,
        change: impl FnOnce(
            &mut OtaUpdater<'_, '_>,
        ) -> Result<(), esp_bootloader_esp_idf::partitions::Error>,
    ) -> Result<(), TrialError> {
        let mut flash = self.0.0.borrow_mut();
        let mut buffer = [0; PARTITION_TABLE_MAX_LEN];
        OtaUpdater::new(&mut flash, &mut buffer)
            .and_then(|mut updater| change(&mut updater))
            .map_err(|_| TrialError)
    }
}

impl Loader for BootLoader {
    fn running(&mut self) -> u8 {
        let mut flash = self.0.0.borrow_mut();
        let mut buffer = [0; PARTITION_TABLE_MAX_LEN];
        let booted = read_partition_table(&mut flash, &mut buffer)
            .and_then(|table| table.booted_partition())
            .ok()
            .flatten();
        let second = PartitionType::App(AppPartitionSubType::Ota1);
        u8::from(booted.is_some_and(|entry| entry.partition_type() == second))
    }

    fn select(&mut self, slot: u8) -> Result<(), TrialError> {
        let slot = if slot == 0 {
            AppPartitionSubType::Ota0
        } else {
            AppPartitionSubType::Ota1
        };
        self.note(|updater| {
            updater.ota_data()?.set_current_app_partition(slot)?;
            // A boot loader that watches first boots goes back by itself; the others take it as any.
            updater.set_current_ota_state(OtaImageState::New)
        })
    }

    fn confirm(&mut self) -> Result<(), TrialError> {
        self.note(|updater| updater.set_current_ota_state(OtaImageState::Valid))
    }
}
