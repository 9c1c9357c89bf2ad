//! What the gateway knows of a node's clock: offset, rate, and how wrong both may be.
//!
//! Each probe gives four stamps: t1 sent (ours), t2 arrived (node's), t3 answered (node's), t4
//! back (ours). With theta the node's clock less ours, and d1, d2 the two ways' delays:
//!
//! ```text
//!   forth = t2 − t1 =  theta + d1          so   −back ≤ theta ≤ forth,
//!   back  = t4 − t3 = −theta + d2          whatever the network does
//! ```
//!
//! **One block.** Delay only ever adds. So of a block of samples the least `forth` and the least
//! `back` say most, each by itself: the quickest probe and the quickest reply need not belong to the
//! same pair (as they must when only the shortest round trips are believed, NTP's clock filter, RFC
//! 5905 §10). Their half difference is the block's point; the spread of the least few says how well
//! it is known (order statistics: the least of n lies about as far above the floor as the next ones
//! lie above it).
//!
//! **The line.** Points go through a Kalman filter of two states, theta and rate, whose rate is a
//! random walk ([`WANDER_PPM_PER_SQRT_S`]): the textbook's clock model (Zucca and Tavella, "The
//! clock model and its relationship with the Allan and related variances", IEEE TUFFC 2005). It
//! weighs the past by itself: about a minute on WiFi, seconds on a cable.
//!
//! **The claim** is three standard deviations at the instant asked for, plus a share
//! ([`ASYMMETRY_SHARE`]) of the shortest round trip: a constant difference between the two ways is
//! invisible to any two-way method, and bounded by that round trip.
//!
//! A node that boots anew (its boot number changes) or whose clock jumps (samples that contradict
//! the bounds above) is locked afresh.
//!
//! Absent on purpose: steering. A node's clock is never set; we speak to it in its own time.

use keys::{FleetMicros, LocalMicros};
use std::collections::VecDeque;

/// Samples of the first block: the clock is known after it.
pub const LOCK_SAMPLES: usize = 8;

/// Samples of every later block: 3.2 s at ten probes a second.
pub const BLOCK_SAMPLES: usize = 32;

/// A later block of at least [`LOCK_SAMPLES`] is closed after so long, s: among thousands of nodes one is
/// probed every few seconds, and its rate would be a guess until 32 of them.
pub const BLOCK_S_MAX: f64 = 10.0;

/// Noise of a stamp that was not delayed: scheduling and the microsecond itself, µs.
pub const STAMP_US: f64 = 5.0;

/// How far two crystals' rates are expected to differ, one standard deviation, ppm.
pub const RATE_PRIOR_PPM: f64 = 50.0;

/// Random walk of a crystal's rate over one second, ppm (temperature).
pub const WANDER_PPM_PER_SQRT_S: f64 = 0.03;

/// How much more than a block says of itself the blocks before it may say of its point, as a factor of
/// the variance. When many nodes connect at once, the first blocks of some are a thousand times worse
/// than all that follow; a block that is eight times better than usual by chance is rarer than one in
/// a thousand.
pub const CALM_FACTOR: f64 = 64.0;

/// Share of one node in the time of all probes, µs: 2,000 probes a second at most, however many nodes
/// there are. Up to 40 nodes are locked as quickly as can be, up to 200 probed as often as one alone.
/// Nodes that are to start together share a time of their own of the same length.
pub const PROBE_SHARE_US: u64 = 500;

/// Share of the shortest round trip that may be constant asymmetry.
pub const ASYMMETRY_SHARE: f64 = 0.05;

/// A sample that contradicts the line by more than this beyond its claim says that the clock
/// jumped, µs.
pub const JUMP_US: f64 = 100.0;

/// That many in a row, and the clock is locked afresh.
pub const JUMP_SAMPLES: u32 = 4;

/// Time between probes while the clock is not known, µs.
pub const PROBE_FAST_US: u64 = 20_000;

/// Time between probes afterwards, µs.
pub const PROBE_SLOW_US: u64 = 100_000;

/// Samples that are taken at the fast pace: the first two blocks.
pub const FAST_SAMPLES: usize = LOCK_SAMPLES + BLOCK_SAMPLES;

/// Longest round trip that is a sample at all, µs.
pub const RTT_US_MAX: u64 = 2_000_000;

/// Blocks whose shortest round trip is remembered.
pub const RTT_BLOCKS: usize = 8;

/// Deviation of a block's point for the spread of its least three values; found by simulation with
/// log-normal and exponential delays, so that claims hold more than 99 times of 100.
pub const SPREAD_SHARE: f64 = 0.7;

/// The four stamps of one probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamps {
    /// t1: the probe left, our clock.
    pub sent_at: FleetMicros,
    /// t2: it arrived, the node's clock.
    pub received_at: LocalMicros,
    /// t3: the answer left, the node's clock.
    pub replied_at: LocalMicros,
    /// t4: it came back, our clock.
    pub back_at: FleetMicros,
}

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observed {
    /// It is part of the estimate.
    Taken,
    /// Its stamps contradict each other, or it took too long.
    Useless,
    /// It contradicts the line; more like it mean a jump.
    Outlier,
    /// The clock is another one or jumped: the estimate begins anew with this sample.
    Relocked,
}

/// What is known about a node's clock at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The node's clock at the instant asked for, whole microseconds.
    pub local: LocalMicros,
    /// Fraction of a microsecond beyond `local`.
    pub fraction_us: f64,
    /// How far that may be wrong, µs.
    pub error_us: f64,
    /// How much faster than ours the node's clock runs, ppm.
    pub drift_ppm: f64,
    /// Shortest round trip of the last blocks, µs.
    pub rtt_us_min: f64,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Half way between leaving and coming back, s after the base.
    middle_s: f64,
    /// t2 − t1 less the base's theta, µs.
    forth_us: f64,
    /// t4 − t3 plus the base's theta, µs.
    back_us: f64,
}

/// Theta (µs) and rate (ppm, which is µs/s) at one instant, with their covariance.
#[derive(Clone, Copy, Debug)]
struct Line {
    at_s: f64,
    theta_us: f64,
    rate_ppm: f64,
    /// Variances of theta, of both together, of the rate.
    p_tt: f64,
    p_tr: f64,
    p_rr: f64,
}

impl Line {
    /// Returns the line as it is expected at another instant.
    fn at(&self, at_s: f64) -> Self {
        let passed_s = at_s - self.at_s;
        // Backwards the rate is known no better either.
        let blind_s = passed_s.abs();
        let walk = WANDER_PPM_PER_SQRT_S * WANDER_PPM_PER_SQRT_S;
        Self {
            at_s,
            theta_us: self.theta_us + self.rate_ppm * passed_s,
            rate_ppm: self.rate_ppm,
            p_tt: self.p_tt
                + 2.0 * passed_s * self.p_tr
                + passed_s * passed_s * self.p_rr
                + walk * blind_s.powi(3) / 3.0,
            p_tr: self.p_tr + passed_s * self.p_rr + walk * blind_s * passed_s / 2.0,
            p_rr: self.p_rr + walk * blind_s,
        }
    }

    /// Takes a measured theta with its variance.
    fn take(&mut self, theta_us: f64, variance: f64) {
        let total = self.p_tt + variance;
        let (gain_t, gain_r) = (self.p_tt / total, self.p_tr / total);
        let surprise_us = theta_us - self.theta_us;
        self.theta_us += gain_t * surprise_us;
        self.rate_ppm += gain_r * surprise_us;
        let (p_tt, p_tr) = (self.p_tt, self.p_tr);
        self.p_tt -= gain_t * p_tt;
        self.p_tr -= gain_t * p_tr;
        self.p_rr -= gain_r * p_tr;
    }
}

/// The track of one node's clock.
#[derive(Clone, Debug)]
pub struct ClockTrack {
    boot: Option<u32>,
    /// Stamps near the samples, so that floats hold differences only.
    base_fleet: FleetMicros,
    base_theta_us: i64,
    /// The block that is being filled.
    block: Vec<Sample>,
    line: Option<Line>,
    /// Running variance of a block's point, µs².
    point_variance: f64,
    /// Shortest possible and longest round trip of the last blocks.
    rtts_us: VecDeque<(f64, f64)>,
    samples_taken: usize,
    off_line_count: u32,
    relock_count: u32,
}

impl Default for ClockTrack {
    fn default() -> Self {
        Self::new()
    }
}

impl ClockTrack {
    /// Knows nothing yet.
    pub fn new() -> Self {
        Self {
            boot: None,
            base_fleet: FleetMicros(0),
            base_theta_us: 0,
            block: Vec::with_capacity(BLOCK_SAMPLES),
            line: None,
            point_variance: 0.0,
            rtts_us: VecDeque::with_capacity(RTT_BLOCKS),
            samples_taken: 0,
            off_line_count: 0,
            relock_count: 0,
        }
    }

    /// Returns whether enough samples agree.
    pub fn is_locked(&self) -> bool {
        self.line.is_some()
    }

    /// Returns how often the estimate began anew after a jump or a boot.
    pub const fn relock_count(&self) -> u32 {
        self.relock_count
    }

    /// Returns the longest round trip of the last blocks, µs; `None` until locked.
    pub fn rtt_us_max(&self) -> Option<f64> {
        let longest = self.rtts_us.iter().map(|(_, longest_us)| *longest_us);
        self.is_locked().then(|| longest.fold(0.0, f64::max))
    }

    /// Returns how long to wait between probes now, µs.
    pub const fn probe_period_us(&self) -> u64 {
        if self.samples_taken < FAST_SAMPLES {
            PROBE_FAST_US
        } else {
            PROBE_SLOW_US
        }
    }

    /// Forgets everything: the node is gone.
    pub fn forget(&mut self) {
        let relock_count = self.relock_count;
        *self = Self {
            relock_count,
            ..Self::new()
        };
    }

    /// Takes the stamps of one probe.
    pub fn observe(&mut self, boot: u32, stamps: Stamps) -> Observed {
        let Stamps {
            sent_at,
            received_at,
            replied_at,
            back_at,
        } = stamps;
        let on_node_us = replied_at.since_us(received_at);
        let away_us = back_at.since_us(sent_at);
        if back_at < sent_at || replied_at < received_at || on_node_us > away_us {
            return Observed::Useless;
        }
        if away_us - on_node_us > RTT_US_MAX {
            return Observed::Useless;
        }
        let theta_us = (i128::from(received_at.0) - i128::from(sent_at.0)
            + i128::from(replied_at.0)
            - i128::from(back_at.0))
            / 2;
        let theta_us = i64::try_from(theta_us).unwrap_or(0);
        if self.boot != Some(boot) {
            let known_before = self.boot.is_some();
            self.begin(boot, sent_at, theta_us);
            self.push(self.sample(stamps));
            if known_before {
                self.relock_count += 1;
                return Observed::Relocked;
            }
            return Observed::Taken;
        }
        let sample = self.sample(stamps);
        if let Some(line) = self.line {
            let line = line.at(sample.middle_s);
            let margin_us = 3.0 * line.p_tt.sqrt() + JUMP_US;
            let above = line.theta_us > sample.forth_us + margin_us;
            let below = line.theta_us < -sample.back_us - margin_us;
            if above || below {
                self.off_line_count += 1;
                if self.off_line_count >= JUMP_SAMPLES {
                    self.begin(boot, sent_at, theta_us);
                    self.push(self.sample(stamps));
                    self.relock_count += 1;
                    return Observed::Relocked;
                }
                return Observed::Outlier;
            }
        }
        self.off_line_count = 0;
        self.push(sample);
        Observed::Taken
    }

    /// Returns the node's time at an instant of ours, with its error; `None` until locked.
    pub fn estimate(&self, at: FleetMicros) -> Option<Estimate> {
        let at_s = (at.0 as i64 - self.base_fleet.0 as i64) as f64 / 1e6;
        let line = self.line?.at(at_s);
        let whole_us = line.theta_us.floor();
        let rtt_us_min = self
            .rtts_us
            .iter()
            .map(|(least_us, _)| *least_us)
            .fold(f64::INFINITY, f64::min);
        let error_us = 3.0 * line.p_tt.max(0.0).sqrt() + ASYMMETRY_SHARE * rtt_us_min + 1.0;
        let local = at.0 as i64 + self.base_theta_us + whole_us as i64;
        Some(Estimate {
            local: LocalMicros(u64::try_from(local).unwrap_or(0)),
            fraction_us: line.theta_us - whole_us,
            error_us,
            drift_ppm: line.rate_ppm,
            rtt_us_min,
        })
    }

    /// Returns the instant of ours at which the node's clock shows `local`; `None` until locked.
    pub fn fleet_from_local(&self, local: LocalMicros) -> Option<FleetMicros> {
        let line = self.line?;
        // local = fleet + base + theta(fleet); theta changes by less than 200 ppm, so one step of
        // refinement leaves less than a nanosecond per second of distance.
        let guess_us = local.0 as i64 - self.base_theta_us;
        let theta_at = |fleet_us: f64| {
            let at_s = (fleet_us - self.base_fleet.0 as f64) / 1e6;
            line.theta_us + line.rate_ppm * (at_s - line.at_s)
        };
        let once_us = guess_us as f64 - theta_at(guess_us as f64);
        let twice_us = guess_us as f64 - theta_at(once_us);
        Some(FleetMicros(twice_us.max(0.0).round() as u64))
    }

    fn begin(&mut self, boot: u32, at: FleetMicros, theta_us: i64) {
        *self = Self {
            boot: Some(boot),
            base_fleet: at,
            base_theta_us: theta_us,
            relock_count: self.relock_count,
            ..Self::new()
        };
    }

    fn sample(&self, stamps: Stamps) -> Sample {
        let base = i128::from(self.base_fleet.0);
        let middle2_us = i128::from(stamps.sent_at.0) + i128::from(stamps.back_at.0) - 2 * base;
        let base_theta_us = i128::from(self.base_theta_us);
        let forth_us =
            i128::from(stamps.received_at.0) - i128::from(stamps.sent_at.0) - base_theta_us;
        let back_us =
            i128::from(stamps.back_at.0) - i128::from(stamps.replied_at.0) + base_theta_us;
        Sample {
            middle_s: middle2_us as f64 / 2e6,
            forth_us: forth_us as f64,
            back_us: back_us as f64,
        }
    }

    fn push(&mut self, sample: Sample) {
        self.block.push(sample);
        self.samples_taken = self.samples_taken.saturating_add(1);
        let is_slow = || sample.middle_s - self.block[0].middle_s >= BLOCK_S_MAX;
        let wanted = if self.line.is_none() || is_slow() {
            LOCK_SAMPLES
        } else {
            BLOCK_SAMPLES
        };
        if self.block.len() >= wanted {
            self.close_block();
        }
    }

    /// The block is full: its point goes into the line.
    fn close_block(&mut self) {
        let count = self.block.len() as f64;
        let middle_s = self.block.iter().map(|sample| sample.middle_s).sum::<f64>() / count;
        let rate_ppm = self.line.map_or(0.0, |line| line.rate_ppm);
        let drift_us = |sample: &Sample| rate_ppm * (sample.middle_s - middle_s);
        let (forth_us, forth_spread_us) = least(
            self.block
                .iter()
                .map(|sample| sample.forth_us - drift_us(sample)),
        );
        let (back_us, back_spread_us) = least(
            self.block
                .iter()
                .map(|sample| sample.back_us + drift_us(sample)),
        );
        if self.rtts_us.len() == RTT_BLOCKS {
            self.rtts_us.pop_front();
        }
        let longest_us = self
            .block
            .iter()
            .map(|sample| sample.forth_us + sample.back_us)
            .fold(0.0, f64::max);
        self.rtts_us.push_back((forth_us + back_us, longest_us));
        let spread2 = forth_spread_us * forth_spread_us + back_spread_us * back_spread_us;
        let variance = SPREAD_SHARE * SPREAD_SHARE * spread2 / 4.0;
        let theta_us = (forth_us - back_us) / 2.0;
        let point_floor = STAMP_US * STAMP_US;
        match self.line {
            None => {
                // Eight samples say little: what the network alone allows is the bound.
                let doubt_us = (forth_us + back_us) / 2.0;
                self.point_variance = variance;
                self.line = Some(Line {
                    at_s: middle_s,
                    theta_us,
                    rate_ppm: 0.0,
                    p_tt: (variance + point_floor).max(doubt_us * doubt_us / 9.0),
                    p_tr: 0.0,
                    p_rr: RATE_PRIOR_PPM * RATE_PRIOR_PPM,
                });
            }
            Some(line) => {
                self.point_variance += (variance - self.point_variance) / 4.0;
                let calm = CALM_FACTOR * (variance + point_floor);
                self.point_variance = self.point_variance.min(calm);
                let mut line = line.at(middle_s);
                line.take(
                    theta_us,
                    self.point_variance.max(variance / 4.0) + point_floor,
                );
                self.line = Some(line);
            }
        }
        self.block.clear();
    }
}

/// Returns the least value and how far the third one lies above it.
fn least(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let mut three = [f64::INFINITY; 3];
    for value in values {
        if value < three[2] {
            three[2] = value;
            three.sort_by(f64::total_cmp);
        }
    }
    (three[0], three[2] - three[0])
}
