//! The clock's estimate against clocks whose truth is known: crystals of any offset that drift and
//! wander, and networks of several kinds. What is claimed must hold, and be worth something.

use gateway::fleet::clock::{ClockTrack, Observed, Stamps};
use keys::{FleetMicros, LocalMicros};

const EPOCH_US: f64 = 1_795_230_000_000_000.0;

/// A seeded source of chance (xorshift).
struct Chance(u64);

impl Chance {
    fn new(seed: u64) -> Self {
        let mut chance = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        for _ in 0..5 {
            chance.unit();
        }
        chance
    }

    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.unit()).ln()
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }
}

/// A node's clock: offset, a rate that wanders, and the instant up to which that is worked out.
struct Crystal {
    offset_us: f64,
    phase_us: f64,
    rate: f64,
    at_us: f64,
}

impl Crystal {
    fn new(chance: &mut Chance) -> Self {
        Self {
            offset_us: chance.unit() * 1e10,
            phase_us: 0.0,
            rate: chance.normal() * 20e-6,
            at_us: 0.0,
        }
    }

    fn go_to(&mut self, at_us: f64, chance: &mut Chance) {
        let passed_us = at_us - self.at_us;
        self.phase_us += self.rate * passed_us;
        self.rate += 0.02e-6 * (passed_us / 1e6).max(0.0).sqrt() * chance.normal();
        self.at_us = at_us;
    }

    /// What it shows at an instant a little ahead.
    fn local_us(&self, at_us: f64) -> f64 {
        self.offset_us + at_us + self.phase_us + self.rate * (at_us - self.at_us)
    }
}

fn fleet(at_us: f64) -> FleetMicros {
    FleetMicros((EPOCH_US + at_us) as u64)
}

/// One probe that leaves at `at_us`; returns its stamps and when it came back.
fn probe(
    crystal: &Crystal,
    at_us: f64,
    chance: &mut Chance,
    delay_us: &dyn Fn(&mut Chance) -> f64,
) -> (Stamps, f64) {
    let arrived_us = at_us + delay_us(chance);
    let left_us = arrived_us + 30.0 + chance.exponential(20.0);
    let back_us = left_us + delay_us(chance);
    let stamps = Stamps {
        sent_at: fleet(at_us),
        received_at: LocalMicros(crystal.local_us(arrived_us) as u64),
        replied_at: LocalMicros(crystal.local_us(left_us) as u64),
        back_at: fleet(back_us),
    };
    (stamps, back_us)
}

struct Outcome {
    /// Errors in fact, sorted, µs.
    errors_us: Vec<f64>,
    /// Errors as claimed, sorted, µs.
    claims_us: Vec<f64>,
    /// Share of the errors that were within their claim.
    inside: f64,
    /// Longest time until the clock was known, s.
    lock_s: f64,
}

fn percentile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

/// A minute with each of many crystals; asked every two seconds for a quarter second ahead.
fn minute(delay_us: &dyn Fn(&mut Chance) -> f64) -> Outcome {
    watch(delay_us, 0.0, 5e6, 60e6)
}

/// The same for other times: the shortest between two probes, the first question and the end, µs.
fn watch(
    delay_us: &dyn Fn(&mut Chance) -> f64,
    probe_us_min: f64,
    first_us: f64,
    end_us: f64,
) -> Outcome {
    let (mut errors_us, mut claims_us) = (Vec::new(), Vec::new());
    let (mut inside, mut lock_s) = (0_usize, 0.0_f64);
    for seed in 1..=30 {
        let mut chance = Chance::new(seed);
        let mut crystal = Crystal::new(&mut chance);
        let mut track = ClockTrack::new();
        let mut at_us = 0.0;
        let mut ask_us = first_us;
        let mut locked = false;
        while at_us < end_us {
            crystal.go_to(at_us, &mut chance);
            let (stamps, back_us) = probe(&crystal, at_us, &mut chance, delay_us);
            track.observe(1, stamps);
            if track.is_locked() && !locked {
                locked = true;
                lock_s = lock_s.max(back_us / 1e6);
            }
            if at_us > ask_us {
                ask_us = at_us + 2e6;
                let ahead_us = back_us + 250e3;
                let estimate = track.estimate(fleet(ahead_us)).expect("known by then");
                let told_us = estimate.local.0 as f64 + estimate.fraction_us;
                let error_us = (told_us - crystal.local_us(ahead_us)).abs();
                inside += usize::from(error_us <= estimate.error_us);
                errors_us.push(error_us);
                claims_us.push(estimate.error_us);
            }
            at_us = back_us.max(at_us + probe_us_min.max(track.probe_period_us() as f64));
        }
    }
    errors_us.sort_by(f64::total_cmp);
    claims_us.sort_by(f64::total_cmp);
    let inside = inside as f64 / errors_us.len() as f64;
    Outcome {
        errors_us,
        claims_us,
        inside,
        lock_s,
    }
}

#[test]
fn what_is_claimed_holds_and_is_worth_something_on_every_kind_of_network() {
    type Delay = Box<dyn Fn(&mut Chance) -> f64>;
    let networks: [(&str, Delay, f64, f64); 4] = [
        (
            "one machine",
            Box::new(|c| 30.0 + c.exponential(20.0)),
            10.0,
            40.0,
        ),
        (
            "a quiet cable",
            Box::new(|c| 200.0 + c.exponential(144.0)),
            40.0,
            120.0,
        ),
        (
            "WiFi, half within 2 ms and one in a hundred above 20 ms",
            Box::new(|c| (2000.0_f64.ln() + 0.99 * c.normal()).exp()),
            400.0,
            1_000.0,
        ),
        (
            "an access point with bursts",
            Box::new(|c| {
                let burst = c.unit() < 0.05;
                900.0 + c.exponential(if burst { 15_000.0 } else { 1_500.0 })
            }),
            250.0,
            700.0,
        ),
    ];
    for (name, delay_us, error_us_max, claim_us_max) in networks {
        let outcome = minute(&*delay_us);
        let error_us = percentile(&outcome.errors_us, 0.99);
        let claim_us = percentile(&outcome.claims_us, 0.5);
        let Outcome { inside, lock_s, .. } = outcome;
        eprintln!(
            "{name}: p99 {error_us:.1} µs, claimed half the time {claim_us:.1} µs, inside {inside:.4}, known after {lock_s:.2} s"
        );
        assert!(error_us <= error_us_max, "{name}: {error_us}");
        assert!(claim_us <= claim_us_max, "{name}: {claim_us}");
        assert!(inside >= 0.99, "{name}: {inside}");
        assert!(lock_s <= 2.0, "{name}: {lock_s}");
    }
}

#[test]
fn a_clock_that_is_asked_every_five_seconds_is_known_to_a_millisecond_too() {
    let wifi: &dyn Fn(&mut Chance) -> f64 = &|c| 900.0 + c.exponential(1_500.0);
    let cable: &dyn Fn(&mut Chance) -> f64 = &|c| 200.0 + c.exponential(144.0);
    for (name, delay_us, claim_us_max) in [("cable", cable, 400.0), ("WiFi", wifi, 2_500.0)] {
        let outcome = watch(delay_us, 5e6, 120e6, 600e6);
        let claim_us = percentile(&outcome.claims_us, 0.5);
        let error_us = percentile(&outcome.errors_us, 0.99);
        let inside = outcome.inside;
        eprintln!("{name}: p99 {error_us:.1} µs, claimed {claim_us:.1} µs, inside {inside:.4}");
        assert!(claim_us <= claim_us_max, "{name}: {claim_us}");
        assert!(inside >= 0.99, "{name}: {inside}");
    }
}

/// A track that knows a crystal, and the time.
fn known(seed: u64) -> (ClockTrack, Crystal, Chance, f64) {
    let mut chance = Chance::new(seed);
    let mut crystal = Crystal::new(&mut chance);
    let mut track = ClockTrack::new();
    let mut at_us = 0.0;
    for _ in 0..300 {
        crystal.go_to(at_us, &mut chance);
        let (stamps, _) = probe(&crystal, at_us, &mut chance, &|c| {
            200.0 + c.exponential(100.0)
        });
        track.observe(1, stamps);
        at_us += 100e3;
    }
    (track, crystal, chance, at_us)
}

#[test]
fn a_first_block_in_a_storm_of_nodes_that_connect_is_forgotten_with_the_next_one() {
    for seed in 1..=30 {
        let mut chance = Chance::new(seed);
        let mut crystal = Crystal::new(&mut chance);
        let mut track = ClockTrack::new();
        let mut at_us = 0.0;
        while at_us < 8e6 {
            crystal.go_to(at_us, &mut chance);
            let storm_us = if track.is_locked() { 0.0 } else { 400e3 };
            let delay_us =
                |chance: &mut Chance| 100.0 + chance.exponential(100.0) + storm_us * chance.unit();
            let (stamps, back_us) = probe(&crystal, at_us, &mut chance, &delay_us);
            track.observe(1, stamps);
            at_us = back_us.max(at_us + track.probe_period_us() as f64);
        }
        let estimate = track.estimate(fleet(at_us)).expect("known");
        let told_us = estimate.local.0 as f64 + estimate.fraction_us;
        let error_us = (told_us - crystal.local_us(at_us)).abs();
        let claim_us = estimate.error_us;
        assert!(
            claim_us < 1_000.0,
            "seed {seed}: ± {claim_us} µs is claimed"
        );
        assert!(error_us <= claim_us, "seed {seed}: {error_us} > {claim_us}");
    }
}

#[test]
fn a_clock_that_jumps_or_boots_is_locked_afresh() {
    for (boot, ahead_us) in [(1, 5e6), (1, -2e6), (2, 1e9)] {
        let (mut track, mut crystal, mut chance, mut at_us) = known(7);
        crystal.offset_us += ahead_us;
        let mut relocked = false;
        for _ in 0..30 {
            at_us += 100e3;
            crystal.go_to(at_us, &mut chance);
            let (stamps, _) = probe(&crystal, at_us, &mut chance, &|_| 200.0);
            relocked |= track.observe(boot, stamps) == Observed::Relocked;
        }
        assert!(
            relocked && track.relock_count() == 1,
            "boot {boot}, {ahead_us} µs"
        );
        let estimate = track.estimate(fleet(at_us)).expect("known again");
        let error_us = (estimate.local.0 as f64 - crystal.local_us(at_us)).abs();
        assert!(error_us < 100.0, "boot {boot}, {ahead_us} µs: {error_us}");
    }
}

#[test]
fn stamps_that_contradict_themselves_are_useless() {
    let (mut track, crystal, mut chance, at_us) = known(3);
    let before = track.estimate(fleet(at_us));
    let (good, _) = probe(&crystal, at_us, &mut chance, &|_| 200.0);
    for bad in [
        Stamps {
            back_at: FleetMicros(good.sent_at.0 - 1),
            ..good
        },
        Stamps {
            replied_at: LocalMicros(good.received_at.0 - 1),
            ..good
        },
        Stamps {
            replied_at: LocalMicros(good.received_at.0 + 10_000),
            ..good
        },
        Stamps {
            back_at: FleetMicros(good.sent_at.0 + 3_000_000),
            ..good
        },
    ] {
        assert_eq!(track.observe(1, bad), Observed::Useless, "{bad:?}");
    }
    assert_eq!(track.estimate(fleet(at_us)), before);
}

#[test]
fn an_instant_survives_the_way_to_the_nodes_clock_and_back() {
    let (track, _, _, at_us) = known(11);
    for ahead_us in [0.0, 1e3, 250e3, 10e6] {
        let at = fleet(at_us + ahead_us);
        let local = track.estimate(at).expect("known").local;
        let back = track.fleet_from_local(local).expect("known");
        assert!(back.0.abs_diff(at.0) <= 1, "{at:?} {back:?}");
    }
}
