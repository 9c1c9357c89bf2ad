//! What a transmitter sends, measured by a receiver of the same RMT: intervals in ticks, by the same clock.

use crate::{
    board,
    pulses::{Bench, steps},
};
use esp_hal::{
    Blocking,
    rmt::{ChannelCreator, PulseCode, RxChannelConfig, RxChannelCreator},
};
use esp_println::println;
use motion::TICKS_PER_US;

/// The first receiver, with all blocks of the receivers.
type Receiver = ChannelCreator<'static, Blocking, 4>;
const RECEIVER_BLOCKS: u8 = 4;

/// Longest time without an edge that is no end, ticks: 2 ms.
const IDLE_TICKS: u16 = 32_000;

/// Steps that are received at once, and the time between them, µs: from a block's length of them on, so that
/// the transmitter wraps.
const MOVES: [(u32, i32); 5] = [(1_000, 60), (200, 120), (50, 180), (10, 180), (3, 180)];

/// Receives some moves and compares each interval with the one that was ordered.
pub(crate) fn check(bench: &mut Bench) {
    let Some(number) = board::step_pin(0) else {
        return;
    };
    let config = RxChannelConfig::default()
        .with_clk_divider(board::RMT_DIVIDER)
        .with_idle_threshold(IDLE_TICKS)
        .with_memsize(RECEIVER_BLOCKS);
    for (delay_us, count) in MOVES {
        // SAFETY: the back end has the transmitters; nobody else has a receiver.
        let receiver = unsafe { Receiver::steal() }.configure_rx(&config);
        let Ok(receiver) = receiver else {
            bench.failures += 1;
            println!("FAIL loopback: the receiver's blocks are not free");
            return;
        };
        let receiver = receiver.with_pin(board::pin(number));
        let mut codes = [PulseCode(0); 192];
        let Ok(mut transaction) = receiver.receive(&mut codes) else {
            bench.failures += 1;
            println!("FAIL loopback: the receiver does not begin");
            return;
        };
        bench.order(&steps(delay_us, count));
        bench.turn();
        while bench.motion.is_active() {
            bench.turn();
            transaction.poll();
        }
        let received = transaction.wait().map_or(0, |(received, _)| received);
        let wanted = u64::from(delay_us) * TICKS_PER_US;
        let steps_seen = codes[..received]
            .iter()
            .filter(|code| code.length1() > 0)
            .count();
        // The last one has no end: behind it comes the idle time.
        let whole = &codes[..received.saturating_sub(1)];
        let interval = |code: &PulseCode| u64::from(code.length1()) + u64::from(code.length2());
        let off = whole
            .iter()
            .map(|code| interval(code).abs_diff(wanted))
            .max();
        let narrowest = whole
            .iter()
            .map(|code| code.length1().min(code.length2()))
            .min();
        let failed = steps_seen != count as usize || off != Some(0);
        let verdict = bench.fail(failed);
        println!(
            "{verdict} loopback, us a step: {delay_us}: {steps_seen} of {count} steps, off by at most {off:?} \
             ticks, shortest part {narrowest:?} ticks"
        );
    }
}
