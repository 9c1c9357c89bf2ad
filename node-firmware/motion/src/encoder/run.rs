//! Runs of fast steps, one word each: where most of the refill's work is.
//!
//! All in 32 bits: an interval is whole ticks and a fraction of 2⁻³², so that a step costs an
//! addition and its carry; what holds for the whole run is decided once before it.

use super::{Encoder, Out};
use crate::{limits::LOW_WORD_TICKS_MAX, segment::FRACTION_BITS, symbol::Symbol};

impl Encoder {
    /// Writes steps of the present segment but for its last one, as many as there is room for:
    /// those that need one word each. Returns whether there were any.
    ///
    /// Where steps are fast, most of all work is done here, so it is done in 32 bits.
    pub(super) fn run(&mut self, out: &mut Out<'_>) -> bool {
        let count = out.left().min(self.steps_left as usize - 1);
        let after = self.interval + self.change * count as i64;
        let (short, long) = if self.change < 0 {
            (after, self.interval)
        } else {
            (self.interval, after)
        };
        // Rounded up to the next tick, so that half a tick can be added before it is cut.
        let behind = self.offset + (1 << (FRACTION_BITS - 1));
        let in_word = self.low_word_ticks.max(self.timing.low_ticks_min);
        let in_word = in_word + self.timing.high_ticks_min - 1;
        let most_ticks = in_word.min(LOW_WORD_TICKS_MAX) as i64;
        let least_ticks = self.timing.interval_ticks_min() as i64;
        if count == 0
            || behind >> FRACTION_BITS != 0
            || short < least_ticks << FRACTION_BITS
            || long > most_ticks << FRACTION_BITS
        {
            return false;
        }
        let words = &mut out.fill.words[out.count..][..count];
        let high_ticks = self.timing.high_ticks as u32;
        let fraction = (behind as u32) << (32 - FRACTION_BITS);
        let sum = if short >= (self.timing.full_high_ticks_min() as i64) << FRACTION_BITS {
            // The same high time for all of them.
            let rest = high_ticks.wrapping_sub(high_ticks << 16) | 1 << 15;
            let word = |ticks: u32| (ticks << 16).wrapping_add(rest);
            run_words(words, self.interval, self.change, fraction, word)
        } else {
            let timing = &self.timing;
            let (low_min, high_min) = (timing.low_ticks_min as u32, timing.high_ticks_min as u32);
            let word = |ticks: u32| step_word(ticks, high_ticks, low_min, high_min).0;
            run_words(words, self.interval, self.change, fraction, word)
        };
        let last = words[count - 1];
        self.interval_ticks = last.ticks();
        self.speed_ticks = self.interval_ticks;
        self.low_ticks_since_step = last.second().0;
        self.resting = false;
        self.interval = after;
        self.offset = i64::from(sum.fraction >> (32 - FRACTION_BITS)) - (1 << (FRACTION_BITS - 1));
        self.left_ticks = self.left_ticks.saturating_sub(u64::from(sum.ticks));
        self.steps_left -= count as u32;
        out.fill.step_words |= ((1 << count) - 1) << out.count;
        out.facts.has_steps = true;
        out.facts.ticks += sum.ticks;
        out.count += count;
        true
    }
}

/// Returns the word of a step whose interval one word holds: `high_max` ticks high if half of the
/// interval and what the low part needs allow.
#[inline(always)]
pub(super) fn step_word(ticks: u32, high_max: u32, low_min: u32, high_min: u32) -> Symbol {
    let high = (ticks / 2).min(high_max).min(ticks - low_min).max(high_min);
    Symbol(high | 1 << 15 | (ticks - high) << 16)
}

/// What a run of words took.
struct RunSum {
    ticks: u32,
    /// Of a tick, 2⁻³², behind the last edge.
    fraction: u32,
}

/// Writes the words of steps with evenly changing intervals ([`FRACTION_BITS`] of a tick);
/// `fraction` is what the edge before lies behind its tick, 2⁻³².
#[inline(always)]
fn run_words(
    words: &mut [Symbol],
    interval: i64,
    change: i64,
    mut fraction: u32,
    word: impl Fn(u32) -> u32,
) -> RunSum {
    // Whole ticks in the upper half, so that a step is an addition and its carry.
    let mut interval = (interval as u64) << (32 - FRACTION_BITS);
    let change = (change << (32 - FRACTION_BITS)) as u64;
    if change == 0 && interval as u32 == 0 {
        let ticks = (interval >> 32) as u32;
        words.fill(Symbol(word(ticks)));
        let ticks = ticks * words.len() as u32;
        return RunSum { ticks, fraction };
    }
    let mut sum = 0;
    for out in words {
        let (next, carry) = fraction.overflowing_add(interval as u32);
        let ticks = (interval >> 32) as u32 + u32::from(carry);
        interval = interval.wrapping_add(change);
        fraction = next;
        sum += ticks;
        *out = Symbol(word(ticks));
    }
    RunSum {
        ticks: sum,
        fraction,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::{
        AxisProfile,
        encoder::Fill,
        limits::{PART_BEFORE_END_TICKS_MIN, REFILL_WORDS, TICK_HZ},
        profile::Timing,
        segment::{Segment, SegmentRing},
    };
    use std::vec::Vec;

    /// Ticks of all active edges of a segment from its begin on.
    fn edges_of(segment: Segment, profile: AxisProfile) -> Vec<u64> {
        let mut segments = SegmentRing::new();
        segments.push(segment);
        let mut encoder = Encoder::new(Timing::from(profile));
        let mut fill = Fill::END;
        encoder.lead_in(10_000, &mut fill);
        let (mut edges, mut at) = (Vec::new(), 0);
        let mut last_part_ticks = u64::MAX;
        while !encoder.has_ended() {
            encoder.fill(&mut segments, u64::MAX, &mut fill);
            let end = fill.words.iter().position(|word| word.is_end());
            for word in &fill.words[..end.unwrap_or(REFILL_WORDS)] {
                last_part_ticks = word.second().0;
            }
            if end.is_some() {
                assert!(last_part_ticks >= PART_BEFORE_END_TICKS_MIN, "{segment:?}");
            }
            for (index, word) in fill
                .words
                .iter()
                .take_while(|word| !word.is_end())
                .enumerate()
            {
                assert_eq!(word.is_step(), fill.step_words & (1 << index) != 0);
                if word.is_step() {
                    edges.push(at);
                    let timing = Timing::from(profile);
                    assert!(word.first().0 >= timing.high_ticks_min);
                    assert!(word.second().0 >= timing.low_ticks_min);
                }
                at += word.ticks();
            }
        }
        edges
    }

    #[test]
    fn a_stop_by_any_deceleration_falls_by_the_same_square_with_every_step() {
        for (stop_accel_hz_per_s, interval_ticks) in [
            (1, 40),
            (1, 7_000),
            (1, 300_000),
            (50, 600),
            (3_000, 80),
            (100_000, 80),
            (100_000, 640),
            (40_000_000, 16),
            (u32::MAX, 80),
        ] {
            let profile = AxisProfile {
                stop_accel_hz_per_s,
                ..AxisProfile::default()
            };
            let mut segments = SegmentRing::new();
            segments.push(Segment::steady(1_000_000, interval_ticks));
            let mut encoder = Encoder::new(Timing::from(profile));
            let mut fill = Fill::END;
            encoder.lead_in(10_000, &mut fill);
            encoder.fill(&mut segments, u64::MAX, &mut fill);
            encoder.decelerate(false, 0);
            let (mut edges, mut at) = (Vec::new(), 0);
            while !encoder.has_ended() && edges.len() < 30_000 {
                encoder.fill(&mut segments, u64::MAX, &mut fill);
                for word in fill.words {
                    if word.is_step() {
                        edges.push(at);
                    }
                    at += word.ticks();
                }
            }
            let lost = 2_000_000 * u64::from(stop_accel_hz_per_s);
            let mut speed = 1_000 * TICK_HZ / interval_ticks;
            let mut square = speed * speed;
            for (steps, pair) in edges.windows(2).enumerate() {
                square -= lost;
                let slower = square.isqrt();
                let expected = 2_000 * TICK_HZ / (speed + slower);
                assert_eq!(
                    pair[1] - pair[0],
                    expected,
                    "a = {stop_accel_hz_per_s}, from {interval_ticks} ticks: step {steps}"
                );
                speed = slower;
            }
            if encoder.has_ended() && stop_accel_hz_per_s < 1_000_000 {
                assert!(speed * speed < 2 * lost, "it rests when it may");
            }
        }
    }

    #[test]
    fn every_edge_lies_where_its_segment_says() {
        let mut state = 3_u64;
        let mut next = |most: u64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 20) % most
        };
        let profiles = [
            AxisProfile::default(),
            AxisProfile::tmc2209(),
            AxisProfile::dm556(),
        ];
        for case in 0..20_000 {
            let profile = profiles[case % profiles.len()];
            let least = Timing::from(profile).interval_ticks_min();
            // From the driver's limit to 10 kHz; changes that add up to less than the interval.
            let range = [4, 40, 400, 1_600][case / 3 % 4];
            let mut interval = (least << FRACTION_BITS) + next(range << FRACTION_BITS);
            if case % 5 == 0 {
                interval &= u64::MAX << FRACTION_BITS;
            }
            let step_count = 1 + next(200) as u32;
            let most = (interval - (least << FRACTION_BITS)) / u64::from(step_count);
            let change = match case % 3 {
                0 => 0,
                1 => next(1 + most) as i64,
                _ => -(next(1 + most) as i64),
            };
            let offset = next(1 << FRACTION_BITS) as i32 - (1 << (FRACTION_BITS - 1));
            let due = |x: i128| {
                let sum = i128::from(offset)
                    + x * i128::from(interval)
                    + x * (x - 1) / 2 * i128::from(change);
                ((sum + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS) as u64
            };
            let count = i128::from(step_count);
            let segment = Segment::Steps {
                step_count,
                offset,
                interval,
                change,
                total_ticks: due(count - 1) + least,
            };
            let edges = edges_of(segment, profile);
            assert_eq!(edges.len(), step_count as usize, "{case}: {segment:?}");
            let mut before = 0;
            for (x, edge) in edges.into_iter().enumerate().skip(1) {
                // At the driver's limit the second of two edges waits for it.
                let expected = due(x as i128).max(before + least);
                assert_eq!(edge, expected, "{case}: step {x} of {segment:?}");
                before = edge;
            }
        }
    }
}
