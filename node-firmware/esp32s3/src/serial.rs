//! The serial line: the dialogue with `fleet provision`, and a prompt for whoever looks.

use crate::{
    flash::CoreFlash,
    link::BoardKeeper,
    plan::{in_window, now},
};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};
use embedded_io_async::{Read, Write};
use esp_hal::{Async, system::software_reset, usb::usb_serial_jtag::UsbSerialJtag};
use provision::{Dialogue, frame::FRAME_BYTES_MAX};
use update::Region;

/// The region of the flash that the record lies in.
pub(crate) type RecordFlash = Region<CoreFlash>;

/// Lets a firmware on trial be left where there is no session with a router that would.
pub(crate) async fn keep_trial(keeper: &mut Option<BoardKeeper>) -> ! {
    loop {
        let due = keeper.as_mut().filter(|keeper| keeper.is_due(now().0));
        if let Some(keeper) = due
            && in_window(|| keeper.poll(now().0, false)) == Some(true)
        {
            software_reset();
        }
        Timer::after(Duration::from_millis(100)).await;
    }
}

/// Talks for ever. `prompts`: nothing moves, because of the record.
pub(crate) async fn run(
    mut port: UsbSerialJtag<'static, Async>,
    dialogue: &'static mut Dialogue<RecordFlash>,
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
                    // Nobody listens: then nobody misses it.
                    let limit = Timer::after(Duration::from_millis(100));
                    select(port.write_all(dialogue.prompt().as_bytes()), limit).await;
                }
                continue;
            }
        };
        for byte in &bytes[..count] {
            // A frame ends with a zero: only then is something done, perhaps in the flash.
            let used = if *byte == 0 {
                in_window(|| dialogue.handle_byte(0, true, &mut answer))
                    .unwrap_or_else(|| dialogue.handle_byte(0, false, &mut answer))
            } else {
                dialogue.handle_byte(*byte, false, &mut answer)
            };
            if let Some(used) = used {
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
