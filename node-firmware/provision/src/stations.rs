//! Which of its networks a node tries next, and when: a state machine without radio and clock.
//!
//! ```text
//!              nothing known of the air            seen               connected
//!   poll ─▶ Scan ──────────▶ handle_scan ─▶ Try(n) ────▶ handle_up ─▶ Stay
//!             ▲                               │ handle_failure          │ handle_lost
//!             └──── Wait(until) ◀── all back off                        └─▶ Try(the same)
//! ```
//!
//! - The order is the record's: the first one that is heard well enough counts. Of those that are all heard
//!   badly, the loudest one. What is not heard at all is tried behind them, in order: its name may be hidden.
//! - Whoever fails is left alone for a while, twice as long each time. A wrong password takes long at once: an
//!   access point locks out who tries again and again.
//! - What was lost is tried again at once, without a scan.
//! - A node that knows one network only does not scan: the radio does so itself.

use crate::record::NETWORKS_MAX;

/// Heard well enough, dBm: below, a link loses more than it carries.
pub const GOOD_DBM: i8 = -75;

/// From the first failure of a network to the next attempt.
pub const BACK_OFF_US_MIN: u64 = 2_000_000;

/// From a failure to the next attempt at most.
pub const BACK_OFF_US_MAX: u64 = 30_000_000;

/// From a wrong password to the next attempt.
pub const PASSWORD_US: u64 = 60_000_000;

/// What is known of a scan is forgotten after this.
pub const SCAN_US_MAX: u64 = 10_000_000;

/// What is to be done now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Listen, and tell by [`Stations::handle_scan`] what is there.
    Scan,
    /// Connect to the network of this number.
    Try(usize),
    /// Nothing until then.
    Wait {
        /// The instant.
        until_us: u64,
    },
    /// Nothing: it is connected.
    Stay,
}

/// Why a network was not to be had.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// It does not take the password.
    Password,
    /// Anything else.
    Other,
}

/// One network.
#[derive(Clone, Copy, Debug, Default)]
struct Station {
    /// How loud it was at the last scan; `None`: not heard.
    dbm: Option<i8>,
    /// Attempts since the last success.
    failures: u32,
    /// Not tried before.
    free_at_us: u64,
    /// The scan that it was heard in has been used: it was tried since.
    tried: bool,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Stations {
    stations: [Station; NETWORKS_MAX],
    count: usize,
    /// When there was a scan.
    scanned_at_us: Option<u64>,
    /// The one that it is connected to, or that was lost a moment ago.
    up: Option<usize>,
    lost: bool,
}

impl Stations {
    /// Knows so many networks, in their order.
    pub fn new(count: usize) -> Self {
        Self {
            stations: [Station::default(); NETWORKS_MAX],
            count: count.min(NETWORKS_MAX),
            scanned_at_us: None,
            up: None,
            lost: false,
        }
    }

    /// Returns what is to be done now.
    pub fn poll(&mut self, now_us: u64) -> Next {
        if let Some(index) = self.up {
            return if self.lost {
                Next::Try(index)
            } else {
                Next::Stay
            };
        }
        let Some(free_at_us) = self.known().iter().map(|station| station.free_at_us).min() else {
            // Nothing is known: nothing will ever be.
            return Next::Wait { until_us: u64::MAX };
        };
        if free_at_us > now_us {
            return Next::Wait {
                until_us: free_at_us,
            };
        }
        let is_fresh = |at_us: u64| now_us.saturating_sub(at_us) < SCAN_US_MAX;
        if self.count > 1 && !self.scanned_at_us.is_some_and(is_fresh) {
            return Next::Scan;
        }
        match self.best(now_us) {
            Some(index) => Next::Try(index),
            // Each was tried since the last scan.
            None => Next::Scan,
        }
    }

    fn known(&self) -> &[Station] {
        &self.stations[..self.count]
    }

    /// Returns the network to try, of those that may be tried.
    fn best(&self, now_us: u64) -> Option<usize> {
        let free = || {
            let known = self.known().iter().enumerate();
            known.filter(|(_, station)| station.free_at_us <= now_us && !station.tried)
        };
        let good = |(_, station): &(usize, &Station)| station.dbm >= Some(GOOD_DBM);
        let heard = free().filter(|(_, station)| station.dbm.is_some());
        // Of two that are as loud, the first one.
        let loudest = heard.rev().max_by_key(|(_, station)| station.dbm);
        let found = free().find(good).or(loudest).or_else(|| free().next());
        found.map(|(index, _)| index)
    }

    /// Takes what a scan has heard: networks by number, with their strength. A name may be heard more than
    /// once. Nothing, if the scan has failed.
    pub fn handle_scan(&mut self, heard: impl IntoIterator<Item = (usize, i8)>, now_us: u64) {
        for station in &mut self.stations {
            station.dbm = None;
            station.tried = false;
        }
        for (index, dbm) in heard {
            if let Some(station) = self.stations[..self.count].get_mut(index) {
                station.dbm = station.dbm.max(Some(dbm));
            }
        }
        self.scanned_at_us = Some(now_us);
    }

    /// It is connected.
    pub fn handle_up(&mut self, index: usize) {
        if let Some(station) = self.stations[..self.count].get_mut(index) {
            *station = Station::default();
            self.up = Some(index);
            self.lost = false;
        }
    }

    /// It was connected and is no longer.
    pub fn handle_lost(&mut self) {
        self.lost = self.up.is_some();
        self.scanned_at_us = None;
    }

    /// An attempt has failed.
    pub fn handle_failure(&mut self, index: usize, why: Failure, now_us: u64) {
        self.up = None;
        self.lost = false;
        let count = self.count;
        let Some(station) = self.stations[..count].get_mut(index) else {
            return;
        };
        station.failures = station.failures.saturating_add(1);
        station.tried = count > 1;
        let doubled = BACK_OFF_US_MIN << (station.failures - 1).min(8);
        let back_off_us = match why {
            Failure::Password => PASSWORD_US,
            Failure::Other => doubled.min(BACK_OFF_US_MAX),
        };
        station.free_at_us = now_us + back_off_us;
    }
}
