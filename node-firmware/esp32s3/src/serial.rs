//! The serial line: the dialogue with `fleet provision`, and a prompt for whoever looks.

use crate::plan::MOVES;
use core::sync::atomic::Ordering;
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};
use embedded_io_async::{Read, Write};
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use esp_hal::{Async, system::software_reset, usb::usb_serial_jtag::UsbSerialJtag};
use esp_storage::{FlashStorage, FlashStorageError};
use provision::{Dialogue, frame::FRAME_BYTES_MAX};

/// Where the record lies: `record` in partitions.csv.
const RECORD_AT: u32 = 0x61_0000;
const RECORD_BYTES: usize = 0x2000;

/// The region of the flash that the record lies in.
#[derive(Debug)]
pub(crate) struct RecordFlash(pub(crate) FlashStorage<'static>);

impl ErrorType for RecordFlash {
    type Error = FlashStorageError;
}

impl ReadNorFlash for RecordFlash {
    const READ_SIZE: usize = FlashStorage::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashStorageError> {
        ReadNorFlash::read(&mut self.0, RECORD_AT + offset, bytes)
    }

    fn capacity(&self) -> usize {
        RECORD_BYTES
    }
}

impl NorFlash for RecordFlash {
    const WRITE_SIZE: usize = FlashStorage::WRITE_SIZE;
    const ERASE_SIZE: usize = FlashStorage::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashStorageError> {
        NorFlash::erase(&mut self.0, RECORD_AT + from, RECORD_AT + to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashStorageError> {
        NorFlash::write(&mut self.0, RECORD_AT + offset, bytes)
    }
}

/// Talks for ever. `prompts`: nobody has told this node anything yet.
pub(crate) async fn run(
    mut port: UsbSerialJtag<'static, Async>,
    mut dialogue: Dialogue<RecordFlash>,
    prompts: bool,
) -> ! {
    let mut answer = [0; FRAME_BYTES_MAX + 2];
    loop {
        let mut bytes = [0; 64];
        let prompt = Timer::after(Duration::from_secs(5));
        let count = match select(Read::read(&mut port, &mut bytes), prompt).await {
            Either::First(Ok(count)) => count,
            Either::First(Err(_)) => 0,
            Either::Second(()) => {
                if prompts {
                    let text = b"stepfleet node, not provisioned: \
                        fleet provision PORT --name NAME --wifi SSID --router tcp/HOST:7447\r\n";
                    // Nobody listens: then nobody misses it.
                    let limit = Timer::after(Duration::from_millis(100));
                    select(port.write_all(text), limit).await;
                }
                continue;
            }
        };
        for byte in &bytes[..count] {
            let may_write = !MOVES.load(Ordering::Acquire);
            if let Some(used) = dialogue.handle_byte(*byte, may_write, &mut answer) {
                let _ = port.write_all(&answer[..used]).await;
                let _ = port.flush().await;
            }
        }
        if dialogue.wants_restart() {
            Timer::after(Duration::from_millis(100)).await;
            software_reset();
        }
    }
}
