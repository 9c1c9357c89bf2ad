//! Every number of motion, with its arithmetic.
//!
//! Ticks are those of the pulse hardware: 16 MHz, so that a microsecond is a whole number of them,
//! a symbol's half reaches 2 ms, and the shortest legal half is 2 ticks (ESP32-S3 TRM §37.3:
//! 3·T_apb + 5·T_sclk < period, 100 ns at 80 MHz).

/// Ticks of one second.
pub const TICK_HZ: u64 = 16_000_000;

/// Ticks of one microsecond.
pub const TICKS_PER_US: u64 = TICK_HZ / 1_000_000;

/// Words of one RMT channel's block (TRM §37.2: 8 blocks of 48 words).
pub const CHANNEL_WORDS: usize = 48;

/// Words of one refill: half a block, so that one half plays while the other is written.
/// 24 steps: 240 µs at 100 kHz.
pub const REFILL_WORDS: usize = CHANNEL_WORDS / 2;

/// Longest half of a symbol: 15 bits, 2.05 ms.
pub const PART_TICKS_MAX: u64 = 32_767;

/// Shortest half of a symbol: 125 ns.
pub const PART_TICKS_MIN: u64 = 2;

/// Shortest half of a symbol before an end marker: 250 ns (ESP32-S3 TRM §37.3:
/// 6·T_apb + 12·T_sclk < period, 225 ns at 80 MHz; said of continuous mode, kept in every mode).
pub const PART_BEFORE_END_TICKS_MIN: u64 = 4;

/// Shortest symbol.
pub const WORD_TICKS_MIN: u64 = 2 * PART_TICKS_MIN;

/// Longest word that this crate writes, a rest or a step with its low time: 40 µs, although the
/// hardware could take 4 ms. So an axis has at most 48 · 40 µs = 1.92 ms in its block, and what comes
/// next (another speed, a stop) need not wait longer than that. Only high times of 40 µs and more
/// need longer words.
pub const LOW_WORD_TICKS_MAX: u64 = 640;

/// Latest that a refill may come after its threshold when a direction changes: 100 µs. The
/// direction pin is switched in the refill, so a turn is a half block of rest that lasts as long, and
/// the half block before it, which the last steps may leave short, does too.
pub const TURN_LATENCY_TICKS: u64 = 100 * TICKS_PER_US;

/// Least that a half block of rest lasts: 120 µs for the refill, as long as a half block of steps
/// at 200 kHz.
pub const REST_HALF_TICKS_MIN: u64 = 120 * TICKS_PER_US;

/// Segments that wait for the encoder, for each axis: 40 bytes each, 7.5 KiB of internal RAM. More
/// than two blocks, so that an axis that steps at every command cannot come to its end while
/// another one still has its ring full; and at 1 MHz more time than two half blocks of rest.
pub const SEGMENTS_MAX: usize = 192;

/// Most segments that one command puts on one axis: rest, turn, steps, rest.
pub const SEGMENTS_PER_COMMAND: usize = 4;

/// An axis with less than this ahead of its encoder wants planning: 20 ms, more than a planning
/// task is ever held up by others.
pub const LOW_WATER_TICKS: u64 = 20_000 * TICKS_PER_US;

/// A line is planned no earlier than this before it begins: 100 ms. Until then more of its path
/// may arrive, so that it need not end at rest; and it is more than [`LOW_WATER_TICKS`] and what a
/// block holds.
pub const PATH_AHEAD_TICKS: u64 = 100_000 * TICKS_PER_US;

/// Commands that are planned and not yet executed. The block holds up to 48 of one step each, the
/// segment ring 192; the rest is for those that take no time.
pub const MARKS_MAX: usize = 640;

/// A start at an instant is begun this much before it: 3 ms. A task may be woken that late; the
/// lead-in takes what is left, to the tick.
pub const ALARM_TICKS: u64 = 3_000 * TICKS_PER_US;

/// Longest setup time of a driver profile: 200 µs (the slowest driver in LinuxCNC's table).
pub const SETUP_TICKS_MAX: u64 = 200 * TICKS_PER_US;

/// Longest hold time of a driver profile: 200 µs.
pub const HOLD_TICKS_MAX: u64 = 200 * TICKS_PER_US;

/// Longest command: 9,139 years. Longer ones are refused, so that no sum of ticks overflows.
pub const COMMAND_TICKS_MAX: u64 = 1 << 62;

/// Axes that this crate drives: one for each RMT transmitter.
pub const CHANNELS: usize = 4;

const _: () = assert!(CHANNEL_WORDS.is_multiple_of(2));
const _: () = assert!(LOW_WORD_TICKS_MAX <= PART_TICKS_MAX);
const _: () = assert!(
    TURN_LATENCY_TICKS + SETUP_TICKS_MAX <= REFILL_WORDS as u64 * LOW_WORD_TICKS_MAX,
    "a turn fits one half block"
);
const _: () = assert!(MARKS_MAX >= 2 * (CHANNEL_WORDS + SEGMENTS_MAX));
const _: () = assert!(PATH_AHEAD_TICKS > 2 * LOW_WATER_TICKS);
const _: () = assert!(ALARM_TICKS <= REFILL_WORDS as u64 * PART_TICKS_MAX);
const _: () = assert!(SEGMENTS_MAX > 2 * CHANNEL_WORDS);
const _: () = assert!(SEGMENTS_MAX as u64 * TICKS_PER_US > 3 * REST_HALF_TICKS_MIN / 2);
const _: () = assert!(CHANNELS <= keys::AXES_MAX);
