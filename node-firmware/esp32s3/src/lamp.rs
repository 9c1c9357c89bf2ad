//! The lamp: how the node is, for whoever stands beside it.
//!
//! | pattern | means |
//! |---|---|
//! | two short flashes a second | it was told nothing yet: `fleet provision` |
//! | slow blinking | no link to the router |
//! | on | linked, at rest |
//! | quick blinking | it moves |

use crate::{
    board::{Other, other_pin},
    plan::{LINK, MOVES},
    rmt::set_pin,
};
use core::sync::atomic::Ordering;
use embassy_time::{Duration, Timer};

/// Shows it for ever.
#[embassy_executor::task]
pub(crate) async fn show(provisioned: bool) {
    let mut step = 0_u32;
    loop {
        let linked = LINK.load(Ordering::Relaxed) & 1 == 1;
        let on = match (provisioned, MOVES.load(Ordering::Relaxed), linked) {
            (false, ..) => matches!(step % 10, 0 | 2),
            (true, true, _) => step.is_multiple_of(2),
            (true, false, true) => true,
            (true, false, false) => step % 20 < 10,
        };
        if let Some(number) = other_pin(Other::Lamp) {
            set_pin(number, on);
        }
        step = step.wrapping_add(1);
        Timer::after(Duration::from_millis(100)).await;
    }
}
