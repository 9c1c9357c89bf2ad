//! What the gateway knows of a node's clock: offset, rate, and how wrong both may be.
//!
//! Each probe gives four stamps: t1 sent (ours), t2 arrived (node's), t3 answered (node's), t4
//! back (ours). From them, as in NTP (RFC 5905 §8):
//!
//! ```text
//!   rtt   = (t4 − t1) − (t3 − t2)            time on the way, both directions
//!   theta = ((t2 − t1) + (t3 − t4)) / 2      node's clock minus ours, at m = (t1 + t4) / 2
//!   |theta − truth| ≤ rtt / 2                whatever the network does
//! ```
//!
//! A line `theta(m)` is fitted through the last [`WINDOW_SAMPLES`] samples by weighted least
//! squares. A sample that took longer than the quickest one was delayed in one direction or the
//! other by up to the excess, so its weight falls with the square of the excess:
//! `w = 1 / (STAMP_US + (rtt − rtt_min) / 2)²`. Two crystals differ by at most some tens of ppm, so
//! the slope starts from a prior of 0 ± [`RATE_PRIOR_PPM`], which carries the first second, when the
//! samples lie too close together to say anything about a rate.
//!
//! The stated error is what the fit cannot know plus what no fit can know: three standard
//! deviations of the line at that instant, and the stamps' own quantum. A constant asymmetry of the
//! two directions is invisible to any two-way method; it is bounded by `rtt_min / 2`, and a share of
//! it ([`ASYMMETRY_SHARE`]) is added.
//!
//! A node that boots anew (its boot number changes) or whose clock jumps is locked afresh.
//!
//! Absent on purpose: steering. A node's clock is never set; we speak to it in its own time.

use keys::{FleetMicros, LocalMicros};

/// Samples that the line is fitted through: 25.6 s at 10 probes a second.
pub const WINDOW_SAMPLES: usize = 256;

/// Probes before the clock counts as known.
pub const LOCK_SAMPLES: usize = 8;

/// Noise of a stamp that was not delayed: scheduling and the microsecond itself, µs.
pub const STAMP_US: f64 = 15.0;

/// How far two crystals' rates are expected to differ, one standard deviation, ppm.
pub const RATE_PRIOR_PPM: f64 = 30.0;

/// Largest rate that is believed, ppm.
pub const RATE_MAX_PPM: f64 = 200.0;

/// Random walk of a crystal's rate over one second, ppm (temperature).
pub const WANDER_PPM_PER_SQRT_S: f64 = 0.02;

/// Share of the quickest round trip that may be constant asymmetry.
pub const ASYMMETRY_SHARE: f64 = 0.05;

/// A sample that lies further off the line than this, beyond what its own delay explains, says
/// that the clock jumped, µs.
pub const JUMP_US: f64 = 500.0;

/// That many in a row, and the clock is locked afresh.
pub const JUMP_SAMPLES: u32 = 4;

/// Time between probes while the clock is not known, µs.
pub const PROBE_FAST_US: u64 = 20_000;

/// Time between probes afterwards, µs.
pub const PROBE_SLOW_US: u64 = 100_000;

/// Samples that are taken at the fast pace.
pub const FAST_SAMPLES: usize = 50;

/// Longest round trip that is a sample at all, µs.
pub const RTT_US_MAX: u64 = 2_000_000;

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
    /// It lies off the line; more like it mean a jump.
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
    /// Quickest round trip in the window, µs.
    pub rtt_us_min: f64,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    /// m, µs after the base.
    middle_us: f64,
    /// theta less the base's, µs.
    theta_us: f64,
    rtt_us: f64,
}

/// The line through the window.
#[derive(Clone, Copy, Debug)]
struct Line {
    middle_us: f64,
    theta_us: f64,
    rate: f64,
    theta_variance: f64,
    rate_variance: f64,
    rtt_us_min: f64,
}

/// The track of one node's clock.
#[derive(Clone, Debug)]
pub struct ClockTrack {
    boot: Option<u32>,
    /// Stamps near the samples, so that floats hold differences only.
    base_fleet: FleetMicros,
    base_theta_us: i64,
    samples: std::collections::VecDeque<Sample>,
    line: Option<Line>,
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
            samples: std::collections::VecDeque::with_capacity(WINDOW_SAMPLES),
            line: None,
            samples_taken: 0,
            off_line_count: 0,
            relock_count: 0,
        }
    }

    /// Returns whether enough samples agree.
    pub fn is_locked(&self) -> bool {
        self.line.is_some() && self.samples.len() >= LOCK_SAMPLES
    }

    /// Returns how often the estimate began anew after a jump or a boot.
    pub const fn relock_count(&self) -> u32 {
        self.relock_count
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
        let rtt_us = away_us - on_node_us;
        if rtt_us > RTT_US_MAX {
            return Observed::Useless;
        }
        // Twice theta and twice the middle, in integers: exact.
        let theta2_us = (received_at.0 as i128 - sent_at.0 as i128)
            + (replied_at.0 as i128 - back_at.0 as i128);
        if self.boot != Some(boot) {
            let known_before = self.boot.is_some();
            self.begin(boot, sent_at, (theta2_us / 2) as i64);
            self.push(self.sample(stamps, theta2_us, rtt_us));
            if known_before {
                self.relock_count += 1;
                return Observed::Relocked;
            }
            return Observed::Taken;
        }
        let sample = self.sample(stamps, theta2_us, rtt_us);
        if let Some(line) = self.line.filter(|_| self.is_locked()) {
            let predicted_us = line.theta_us + line.rate * (sample.middle_us - line.middle_us);
            // Half the excess delay is what the network alone can explain.
            let unexplained_us = (sample.theta_us - predicted_us).abs() - (rtt_us as f64) / 2.0;
            if unexplained_us > JUMP_US {
                self.off_line_count += 1;
                if self.off_line_count >= JUMP_SAMPLES {
                    self.begin(boot, sent_at, (theta2_us / 2) as i64);
                    self.push(self.sample(stamps, theta2_us, rtt_us));
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
        let line = self.line.filter(|_| self.is_locked())?;
        let at_us = at.0 as i64 - self.base_fleet.0 as i64;
        let ahead_us = at_us as f64 - line.middle_us;
        let theta_us = line.theta_us + line.rate * ahead_us;
        let whole_us = theta_us.floor();
        let newest_us = self.samples.back().map_or(0.0, |sample| sample.middle_us);
        let blind_s = ((at_us as f64 - newest_us) / 1e6).max(0.0);
        // The rate's random walk: its integral over the blind time, std t^1.5 / √3.
        let wander_us = WANDER_PPM_PER_SQRT_S * blind_s.powf(1.5) / 3f64.sqrt();
        let variance =
            line.theta_variance + line.rate_variance * ahead_us * ahead_us + wander_us * wander_us;
        let error_us = 3.0 * variance.sqrt() + ASYMMETRY_SHARE * line.rtt_us_min + 1.0;
        let local = at.0 as i64 + self.base_theta_us + whole_us as i64;
        Some(Estimate {
            local: LocalMicros(u64::try_from(local).unwrap_or(0)),
            fraction_us: theta_us - whole_us,
            error_us,
            drift_ppm: line.rate * 1e6,
            rtt_us_min: line.rtt_us_min,
        })
    }

    /// Returns the instant of ours at which the node's clock shows `local`; `None` until locked.
    pub fn fleet_from_local(&self, local: LocalMicros) -> Option<FleetMicros> {
        let line = self.line.filter(|_| self.is_locked())?;
        // local = fleet + base + theta(fleet); theta changes by less than 200 ppm, so one step of
        // refinement leaves less than a nanosecond per second of distance.
        let guess_us = local.0 as i64 - self.base_theta_us;
        let theta_at = |fleet_us: f64| {
            line.theta_us + line.rate * (fleet_us - self.base_fleet.0 as f64 - line.middle_us)
        };
        let once_us = guess_us as f64 - theta_at(guess_us as f64);
        let twice_us = guess_us as f64 - theta_at(once_us);
        Some(FleetMicros(twice_us.max(0.0).round() as u64))
    }

    fn begin(&mut self, boot: u32, at: FleetMicros, theta_us: i64) {
        self.boot = Some(boot);
        self.base_fleet = at;
        self.base_theta_us = theta_us;
        self.samples.clear();
        self.line = None;
        self.samples_taken = 0;
        self.off_line_count = 0;
    }

    fn sample(&self, stamps: Stamps, theta2_us: i128, rtt_us: u64) -> Sample {
        let middle2_us =
            stamps.sent_at.0 as i128 + stamps.back_at.0 as i128 - 2 * i128::from(self.base_fleet.0);
        Sample {
            middle_us: middle2_us as f64 / 2.0,
            theta_us: (theta2_us - 2 * i128::from(self.base_theta_us)) as f64 / 2.0,
            rtt_us: rtt_us as f64,
        }
    }

    fn push(&mut self, sample: Sample) {
        if self.samples.len() == WINDOW_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        self.samples_taken = self.samples_taken.saturating_add(1);
        self.line = self.fit();
    }

    /// Weighted least squares about the centroid, with a prior on the slope.
    fn fit(&self) -> Option<Line> {
        let rtt_us_min = self
            .samples
            .iter()
            .map(|sample| sample.rtt_us)
            .fold(f64::INFINITY, f64::min);
        let weight = |sample: &Sample| {
            let doubt_us = STAMP_US + (sample.rtt_us - rtt_us_min) / 2.0;
            1.0 / (doubt_us * doubt_us)
        };
        let (mut sum_w, mut sum_ww, mut sum_wx, mut sum_wy) = (0.0, 0.0, 0.0, 0.0);
        for sample in &self.samples {
            let w = weight(sample);
            sum_w += w;
            sum_ww += w * w;
            sum_wx += w * sample.middle_us;
            sum_wy += w * sample.theta_us;
        }
        if sum_w <= 0.0 {
            return None;
        }
        let (middle_us, theta_us) = (sum_wx / sum_w, sum_wy / sum_w);
        let (mut sum_xx, mut sum_xy) = (0.0, 0.0);
        for sample in &self.samples {
            let w = weight(sample);
            let x = sample.middle_us - middle_us;
            sum_xx += w * x * x;
            sum_xy += w * x * (sample.theta_us - theta_us);
        }
        // Weights are inverse variances up to a common factor; the prior is one more observation
        // of the slope, with its own inverse variance.
        let prior = 1.0 / (RATE_PRIOR_PPM * 1e-6).powi(2);
        let rate_max = RATE_MAX_PPM * 1e-6;
        let rate = (sum_xy / (sum_xx + prior)).clamp(-rate_max, rate_max);
        let mut sum_rr = 0.0;
        for sample in &self.samples {
            let residual_us = sample.theta_us - theta_us - rate * (sample.middle_us - middle_us);
            sum_rr += weight(sample) * residual_us * residual_us;
        }
        let effective_count = sum_w * sum_w / sum_ww;
        // Never better than the stamps themselves are, and scaled up where the samples scatter
        // more than their weights say.
        let scale = (sum_rr / effective_count.max(1.0)).max(1.0);
        Some(Line {
            middle_us,
            theta_us,
            rate,
            theta_variance: scale / sum_w,
            rate_variance: scale / (sum_xx + prior),
            rtt_us_min,
        })
    }
}
