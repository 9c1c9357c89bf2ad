//! The lidar's serial line, on core 0.

use crate::{
    board::{Other, other_pin, pin},
    plan::WAKE,
};
use core::sync::atomic::{AtomicU32, Ordering};
use embassy_sync::{blocking_mutex::raw::CriticalSectionRawMutex, signal::Signal};
use embedded_io_async::Read;
use esp_hal::{
    peripherals::UART1,
    uart::{Config, Uart},
};
use periphery::{TfLuna, lidar::BAUD};

/// A reading is asked for.
pub(crate) static ASKED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// The reading that was asked for, mm; 0: none yet.
pub(crate) static READING_MM: AtomicU32 = AtomicU32::new(0);

/// Reads for ever. Who asks gets the first distance of a frame that began later; without one motion
/// waits no longer than it was told to, and says so.
#[embassy_executor::task]
pub(crate) async fn read(uart: UART1<'static>) {
    let config = Config::default().with_baudrate(BAUD);
    let uart = Uart::new(uart, config).expect("a rate that every clock of the chip can make");
    let number = other_pin(Other::Lidar).expect("a wiring that was checked");
    let mut line = uart.with_rx(pin(number)).into_async();
    let mut lidar = TfLuna::new();
    loop {
        ASKED.wait().await;
        READING_MM.store(0, Ordering::Relaxed);
        // What has waited in the line's buffer is old.
        let mut bytes = [0; 64];
        while line.read_ready() && line.read_buffered(&mut bytes).is_ok() {}
        lidar.clear();
        'reading: loop {
            // A disturbed byte is one that is missing.
            let count = Read::read(&mut line, &mut bytes).await.unwrap_or(0);
            for byte in &bytes[..count] {
                if let Some(Ok(mm)) = lidar.handle_byte(*byte) {
                    READING_MM.store(mm, Ordering::Release);
                    WAKE.signal(());
                    break 'reading;
                }
            }
        }
    }
}
