//! The arithmetic of a controlled stop, exact to the last unit, without a division of more than 32 bits:
//! speeds and intervals one by one, and in a row ([`Trend`]).

use crate::{limits::TICK_HZ, symbol::Symbol};

/// Twice the ticks of a second, in 1/1000: divided by the sum of two speeds in mHz it gives ticks.
const TWICE: u64 = 2_000 * TICK_HZ;

/// Returns the speed behind a step that leaves `square` (mHz²) of the speed's square, `lost` less
/// than before; and the step's interval, ticks.
pub(super) fn slower_step(speed_mhz: u64, square: u64, lost: u64) -> (u64, u64) {
    match u32::try_from(speed_mhz) {
        Ok(speed) if is_quick(speed, lost) => {
            let (slower, interval) = slower(speed, square, lost);
            (u64::from(slower), u64::from(interval))
        }
        _ => {
            let slower = root(square);
            (slower, quotient(TWICE, speed_mhz + slower))
        }
    }
}

/// Returns whether [`slower`] can compute a step.
fn is_quick(speed: u32, lost: u64) -> bool {
    let square = u64::from(speed) * u64::from(speed);
    speed >= SLOWER_MHZ_MIN && lost <= square >> SLOWER_BITS
}

/// Returns the least speed at which [`is_quick`] holds.
pub(super) fn quick_mhz_min(lost: u64) -> u32 {
    let square = lost << SLOWER_BITS;
    let floor = root(square);
    let speed = floor + u64::from(floor * floor < square);
    u32::try_from(speed).unwrap_or(u32::MAX).max(SLOWER_MHZ_MIN)
}

/// Returns ⌊√square⌋, digit by digit: for the last few slow steps.
fn root(mut square: u64) -> u64 {
    let mut root = 0;
    // The highest power of four that is not above it.
    let mut bit = 1_u64 << ((63 - (square | 1).leading_zeros()) & !1);
    while bit != 0 {
        if square >= root + bit {
            square -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
        bit >>= 2;
    }
    root
}

/// Returns ⌊dividend / divisor⌋, digit by digit; the divisor is not 0.
pub(super) fn quotient(mut dividend: u64, divisor: u64) -> u64 {
    let places = divisor
        .leading_zeros()
        .saturating_sub(dividend.leading_zeros());
    let mut quotient = 0;
    for place in (0..=places).rev() {
        quotient <<= 1;
        if dividend >= divisor << place {
            dividend -= divisor << place;
            quotient |= 1;
        }
    }
    quotient
}

/// A step is quick to compute while it loses less than 2⁻¹⁰ of the speed's square.
const SLOWER_BITS: u32 = 10;

/// Slower than 2 kHz its numbers need more than 64 bits, and a step more than a word.
const SLOWER_MHZ_MIN: u32 = 1 << 21;

/// Returns ⌊√square⌋ and ⌊2000 · ticks of a second / the sum of both speeds⌋, without a division of
/// more than 32 bits: both are near to what the speed's reciprocal gives. Speeds in mHz, from
/// [`SLOWER_MHZ_MIN`]; `square` is `lost` less than the speed's, whose root may be rounded down.
fn slower(speed: u32, square: u64, lost: u64) -> (u32, u32) {
    let shift = speed.leading_zeros();
    let divisor = u64::from(speed << shift);
    let short = u64::from(u32::MAX / (divisor >> 16) as u32);
    let error = (1 << 48) - (divisor * short) as i64;
    // ≤ 2⁶³ / divisor, by less than 2⁻²⁸ of it.
    let inverse = ((short << 15) as i64 + ((error * short as i64) >> 33)) as u64;
    let inverse = inverse.min(u64::from(u32::MAX));
    // √(v² - l) = v - l/2v - (l/2v)²/2v …
    let over_twice = |value: u64| (((value << shift) >> 32) * inverse) >> 32;
    let first = over_twice(lost);
    let mut slower = u64::from(speed) - first - over_twice(first * first);
    while slower * slower > square {
        slower -= 1;
    }
    while (slower + 1) * (slower + 1) <= square {
        slower += 1;
    }
    let sum = u64::from(speed) + slower;
    let mut interval = (((TWICE << shift) >> 16) * inverse) >> 48;
    while (interval + 1) * sum <= TWICE {
        interval += 1;
    }
    while interval * sum > TWICE {
        interval -= 1;
    }
    (slower as u32, interval as u32)
}

/// How speed and interval went on in the steps before: what they foretell is exact or next to it.
///
/// While each step loses as much of the speed as the one before, or 1 mHz more or less as the roots are
/// rounded, all there is to know of the next one follows from that without roots and divisions. With
/// `over` = v² - speed², what the exact square has more than that of the rounded speed s: a step that
/// loses L of s makes it over + L·(2s - L) - lost, which is to be from 0 to 2·(s - L).
#[derive(Clone, Copy, Debug)]
pub(super) struct Trend {
    /// Steps that it has seen, up to 2: enough for a trend.
    seen: u8,
    /// What the last step lost of the speed, mHz, and by how much that was more than before.
    loss: u32,
    growth: u32,
    /// The last interval, ticks, and by how much it was longer than the one before.
    interval: u32,
    longer: u32,
    /// The sum of the last step's speeds, mHz.
    sum: u32,
    /// What the exact square has more than that of the speed behind the last step, mHz²: up to twice that
    /// speed.
    over: u32,
    /// By how much `loss` makes that more where the last step began: L·(2s - L) - lost, modulo 2³².
    gain: u32,
    /// What the last step lost, mHz: `loss`, or 1 more or less.
    last: u32,
    /// What its interval times that sum left of [`TWICE`].
    rest: u32,
}

/// A foretold value that is farther off is computed instead.
const TREND_MISS_MAX: u32 = 4;

/// A step that loses more than this, or than the root of the speed, is computed by itself: the next one
/// may lose more by more than 1.
const GLIDE_LOSS_MAX: u32 = 1 << 14;

/// So are steps of faster speeds, 268 kHz: what is less than nothing by three such sums has to be told,
/// modulo 2³², from what is more.
const GLIDE_SUM_MAX: u32 = 1 << 29;

impl Trend {
    pub(super) const NONE: Self = Self {
        seen: 0,
        loss: 0,
        growth: 0,
        interval: 0,
        longer: 0,
        sum: 0,
        over: 0,
        gain: 0,
        last: 0,
        rest: 0,
    };

    /// Writes steps from a speed (mHz) and its exact square on, which it lowers, as long as there is room
    /// for them. The limits are what the square loses in each, from what speed on they are quick to
    /// compute, and how long they may be. Returns how many there are and how long they last.
    pub(super) fn run(
        &mut self,
        (speed, square): (&mut u32, &mut u64),
        (lost, speed_min, ticks_max): (u64, u32, u32),
        words: &mut [Symbol],
        word: impl Fn(u32) -> Symbol,
    ) -> (usize, u32) {
        let (mut made, mut ticks) = (0, 0);
        while made < words.len() && *speed >= speed_min {
            let (more, longer) = self.glide(speed, speed_min, ticks_max, &mut words[made..], &word);
            if more > 0 {
                made += more;
                ticks += longer;
                *square = u64::from(*speed) * u64::from(*speed) + u64::from(self.over);
            }
            if made == words.len() || *speed < speed_min {
                break;
            }
            let left = *square - lost;
            let (slower, interval) = self.next(*speed, left, lost);
            if interval > ticks_max {
                break;
            }
            *square = left;
            words[made] = word(interval);
            made += 1;
            ticks += interval;
            *speed = slower;
        }
        (made, ticks)
    }

    /// Writes steps that lose as much as the one before, or 1 mHz more or less.
    #[inline(always)]
    fn glide(
        &mut self,
        speed: &mut u32,
        speed_min: u32,
        ticks_max: u32,
        words: &mut [Symbol],
        word: impl Fn(u32) -> Symbol,
    ) -> (usize, u32) {
        let known = self.seen > 0 && self.sum < GLIDE_SUM_MAX;
        let known = known && (1..GLIDE_LOSS_MAX).contains(&self.loss);
        if !known || self.interval > ticks_max || self.loss * self.loss > *speed {
            return (0, 0);
        }
        let (loss, twice) = (self.loss, 2 * self.loss);
        let Self {
            mut last,
            mut interval,
            mut sum,
            mut over,
            mut gain,
            mut rest,
            ..
        } = *self;
        let mut now = *speed;
        let mut symbol = word(interval);
        let (mut made, mut ticks) = (0, 0);
        for out in words {
            if now < speed_min {
                break;
            }
            let next_gain = gain.wrapping_sub(twice * last);
            let mut next_over = over.wrapping_add(next_gain);
            let (mut slower, mut lost) = (now - loss, loss);
            if next_over > 2 * slower {
                // The root is another one: less than nothing is left of its square, or too much.
                if (next_over as i32) < 0 {
                    (slower, lost) = (slower - 1, loss + 1);
                    next_over = next_over.wrapping_add(2 * slower + 1);
                } else {
                    next_over -= 2 * slower + 1;
                    (slower, lost) = (slower + 1, loss - 1);
                }
                if next_over > 2 * slower {
                    break;
                }
            }
            let narrower = last + lost;
            let (next_sum, mut next_rest) = (sum - narrower, rest + interval * narrower);
            if next_rest >= next_sum {
                let mut next = interval;
                while next_rest >= next_sum {
                    next_rest -= next_sum;
                    next += 1;
                }
                if next > ticks_max {
                    break;
                }
                interval = next;
                symbol = word(interval);
            }
            (sum, rest) = (next_sum, next_rest);
            (over, gain) = (next_over, next_gain);
            (now, last) = (slower, lost);
            ticks += interval;
            made += 1;
            *out = symbol;
        }
        if made > 0 {
            (self.interval, self.sum, self.rest) = (interval, sum, rest);
            (self.over, self.gain, self.last) = (over, gain, last);
            (self.growth, self.longer) = (0, 0);
            *speed = now;
        }
        (made, ticks)
    }

    /// Returns the same as [`slower`]: what is foretold is put right.
    fn next(&mut self, speed: u32, square: u64, lost: u64) -> (u32, u32) {
        let foretold = match self.seen {
            2 => self.foretell(speed, square),
            _ => None,
        };
        let (slower, interval) = foretold.unwrap_or_else(|| slower(speed, square, lost));
        let loss = speed - slower;
        self.growth = loss.saturating_sub(self.loss);
        self.longer = interval.saturating_sub(self.interval);
        (self.loss, self.last, self.interval) = (loss, loss, interval);
        self.seen = 2.min(self.seen + 1);
        // Faster than 1 MHz it does not fit, and is not asked for.
        self.sum = speed.saturating_add(slower);
        let sum = u64::from(self.sum);
        let own = u64::from(slower) * u64::from(slower);
        self.over = (square - own) as u32;
        self.gain = (u64::from(loss) * sum).wrapping_sub(lost) as u32;
        self.rest = TWICE.wrapping_sub(u64::from(interval) * sum) as u32;
        (slower, interval)
    }

    #[inline(always)]
    fn foretell(&self, speed: u32, square: u64) -> Option<(u32, u32)> {
        let mut slower = speed.checked_sub(self.loss + self.growth)?;
        // square - slower² is to be from 0 to 2·slower.
        let mut left = square.wrapping_sub(u64::from(slower) * u64::from(slower)) as i64;
        let mut misses = 0;
        while left < 0 {
            left += 2 * i64::from(slower) - 1;
            slower -= 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        while left > 2 * i64::from(slower) {
            left -= 2 * i64::from(slower) + 1;
            slower += 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        // Both below 2³¹: faster than 2 MHz nothing is.
        let sum = speed.checked_add(slower)?;
        // What the interval leaves of the dividend is to be from 0 to below the divisor.
        let mut interval = self.interval + self.longer;
        let mut left = TWICE.wrapping_sub(u64::from(interval) * u64::from(sum)) as i64;
        while left < 0 {
            left += i64::from(sum);
            interval -= 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        while left >= i64::from(sum) {
            left -= i64::from(sum);
            interval += 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        Some((slower, interval))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trend_tells_what_each_step_alone_would_tell() {
        let mut state = 5_u64;
        for case in 0..3_000_u32 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let mut speed = ((state >> 20) as u32 >> (case % 11)) | SLOWER_MHZ_MIN;
            let mut square = u64::from(speed) * u64::from(speed);
            let lost = (square >> SLOWER_BITS >> (case % 23)).max(1);
            let mut trend = Trend::NONE;
            for _ in 0..200 {
                if !is_quick(speed, lost) {
                    break;
                }
                square -= lost;
                let step = trend.next(speed, square, lost);
                assert_eq!(step, slower(speed, square, lost), "{speed} {lost}");
                assert_eq!(u64::from(step.0), square.isqrt(), "{speed} {lost}");
                speed = step.0;
            }
        }
    }

    #[test]
    fn a_run_has_the_steps_that_each_alone_would_be() {
        let mut state = 6_u64;
        let mut glided = 0;
        for case in 0..2_000_u32 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let mut speed = ((state >> 20) as u32 >> (case % 11)) | SLOWER_MHZ_MIN;
            let mut square = u64::from(speed) * u64::from(speed);
            let lost = (square >> SLOWER_BITS >> (case % 23)).max(1);
            let limits = (lost, quick_mhz_min(lost), 640);
            let mut trend = Trend::NONE;
            let (mut alone, mut exact) = (speed, square);
            for _ in 0..40 {
                let mut words = [Symbol::END; 24];
                let before = trend.seen;
                let (made, ticks) =
                    trend.run((&mut speed, &mut square), limits, &mut words, Symbol);
                let mut sum = 0;
                for word in &words[..made] {
                    exact -= lost;
                    let (slower, interval) = slower(alone, exact, lost);
                    assert_eq!(word.0, interval, "{alone} {lost}");
                    assert_eq!(u64::from(slower), exact.isqrt(), "{alone} {lost}");
                    sum += interval;
                    glided += u32::from(before == 2 && (slower + trend.loss).abs_diff(alone) <= 1);
                    alone = slower;
                }
                assert_eq!((speed, square, ticks), (alone, exact, sum), "{lost}");
                if made < words.len() {
                    let late = is_quick(alone, lost) && slower(alone, exact - lost, lost).1 <= 640;
                    assert!(!late, "{alone} {lost}");
                    break;
                }
            }
        }
        assert!(glided > 100_000, "{glided}");
    }

    #[test]
    fn the_least_quick_speed_is_where_quick_ends() {
        for case in 0..60_u64 {
            for lost in [
                1 << (case % 53),
                3 << (case % 51),
                2_000_000 * (case * case * 70_001 + 1),
            ] {
                let least = quick_mhz_min(lost);
                assert!(is_quick(least, lost), "{least} {lost}");
                let slower = least - 1;
                assert!(!is_quick(slower, lost), "{least} {lost}");
            }
        }
    }

    #[test]
    fn a_controlled_stop_has_its_speeds_and_intervals_to_the_last_unit() {
        let mut state = 4_u64;
        let mut next = |bits: u64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 20) & ((1 << bits) - 1)
        };
        for case in 0..1_000_000 {
            let speed = (next(21 + case % 12) as u32) | SLOWER_MHZ_MIN;
            let square = u64::from(speed) * u64::from(speed);
            let lost = match case % 4 {
                0 => square >> SLOWER_BITS,
                1 => 2_000_000 * next(1 + case % 31),
                _ => next(1 + case % 52),
            };
            let lost = lost.min(square >> SLOWER_BITS);
            // The speed is the root of its square, rounded down.
            let square = square + next(32) % (2 * u64::from(speed) + 1);
            let root = (square - lost).isqrt();
            let interval = 2_000 * TICK_HZ / (u64::from(speed) + root);
            let found = slower(speed, square - lost, lost);
            assert_eq!(found, (root as u32, interval as u32), "{speed} {lost}");
            let found = slower_step(u64::from(speed), square - lost, lost);
            assert_eq!(found, (root, interval), "{speed} {lost}");
        }
    }

    #[test]
    fn slow_and_hard_stops_have_their_speeds_and_intervals_to_the_last_unit() {
        let mut state = 9_u64;
        for case in 0..200_000_u32 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let speed = 1 + ((state >> 20) & ((1 << (case % 31)) - 1));
            let square = speed * speed;
            let lost = match case % 3 {
                0 => square,
                1 => square - square / 3,
                _ => (state >> 7) % (square + 1),
            };
            let slower = (square - lost).isqrt();
            let interval = TWICE / (speed + slower);
            let found = slower_step(speed, square - lost, lost);
            assert_eq!(found, (slower, interval), "{speed} {lost}");
        }
    }
}
