//! Who serves a fleet when several gateways could: one owner, and who waits to be it.
//!
//! # Several gateways
//! A gateway serves everything below its prefix, so one zenoh network has room for many: `plant/line-a`
//! and `plant/line-b` are two fleets with a gateway each, which share routers and nothing else. Names
//! of nodes and jobs are of one prefix; a synchronized job starts nodes of one prefix, because one
//! gateway must know all their clocks. A stop on `plant/*/node/*/stop` stops all of them.
//!
//! # A standby
//! For one prefix there is one owner. A gateway that is told to stand by (`fleet serve --connect …
//! --standby`) waits beside it, with the same store: on the same machine, or on a disk that both
//! machines reach and that keeps locks (NFSv4, a shared block device with a cluster file system).
//!
//! ```text
//!            no owner's token for HANDOVER_US          opened, epoch raised
//!   Waiting ──────────────────────────────▶ Taking ──────────────────────▶ Owning
//!     ▲ ▲                                     │ in use: again after RETRY_US   │
//!     │ └─────────────────────────────────────┘                               │
//!     └──── a newer token, or the own one is gone for CUT_OFF_US: Resign ◀─────┘
//! ```
//!
//! Three things, each enough to forbid what the others might let through:
//! 1. **The token.** The owner declares the liveliness token `PREFIX/gateway/EPOCH`. As long as there
//!    is one nobody else reaches for the store. It goes with the owner's session: at once when its
//!    process is killed, after zenoh's lease (10 s) when its machine loses power or its cable.
//! 2. **The store.** Its lock has one holder. What an owner accepted is in it before anybody is told,
//!    so whoever opens it knows every job, and from a job's activation and the node's numbers where to
//!    go on: hand-over is a restart of the gateway, by another process. Nothing is copied, so nothing
//!    can be missing.
//! 3. **The epoch.** Whoever takes the store first writes a newer epoch into it: one more than before,
//!    or UTC in seconds if that is more. Every word to a node goes behind it, and a node obeys no
//!    older one than it has heard ([`keys::epoch`]). So an owner that slept, or whose disk let its
//!    lock go, can neither order, start, hold nor resume anything once its nodes have heard the new
//!    one, which they do with its first clock probe. It cannot begin a new job before either: that
//!    needs a write.
//!
//! An owner whose own token is gone from the network is cut off. It resigns, so that its store is free
//! for the other one, and stands by.
//!
//! # What this does not do
//! - An owner that hangs, or whose network is split behind its own router, keeps the store: its nodes
//!   play what they have and stand still. A machine at rest is the safe side; `WatchdogSec` of
//!   systemd ends one that hangs.
//! - Without a shared disk there is no standby. A copy of the store (`fleet backup`) is for
//!   repairs: what was accepted after it is not in it, and would be done twice if it were asked again.
//! - A gateway that brings its own router never resigns. Two of them that find each other by scouting
//!   with one prefix and two stores are a mistake: nodes obey the newer one, and the records of the
//!   other say so.
//! - Gateways that speak no epochs are not obeyed by a node any more that has heard one, until it
//!   boots.
//!
//! Owns when to reach for the store and when to give it up. Absent on purpose: store, tokens, clock.

use keys::FleetMicros;
use std::collections::BTreeSet;

/// How long no owner may be there before somebody reaches for the store, µs: a router that restarts
/// brings back the tokens of those who come back to it.
pub const HANDOVER_US: u64 = 1_000_000;

/// How long a store that is in use is left alone, µs.
pub const RETRY_US: u64 = 1_000_000;

/// How long an owner may miss its own token, µs: longer than a router takes for a restart.
pub const CUT_OFF_US: u64 = 5_000_000;

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OwnerEvent {
    /// The tokens of owners that are there now, by epoch.
    Tokens(BTreeSet<u32>),
    /// The store was opened, and this epoch written into it.
    Taken(u32),
    /// Somebody else has the store.
    InUse,
    /// Time has passed.
    Tick,
}

/// What to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnerStep {
    /// Nothing.
    Nothing,
    /// Open the store and raise its epoch, or say that it is in use.
    Take,
    /// Stop serving, and stand by.
    Resign(Resignation),
}

/// Why an owner is none any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resignation {
    /// There is a newer one.
    Superseded {
        /// Its epoch.
        epoch: u32,
    },
    /// The network does not know it any more.
    CutOff,
}

impl std::fmt::Display for Resignation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Superseded { epoch } => {
                write!(
                    f,
                    "another gateway has taken the fleet over (epoch {epoch})"
                )
            }
            Self::CutOff => f.write_str("this gateway is cut off from the network"),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    /// Since when there is no owner.
    Waiting(Option<FleetMicros>),
    Taking,
    Owning {
        epoch: u32,
        /// The own token was there once.
        seen: bool,
        missed_at: Option<FleetMicros>,
    },
}

/// One gateway's place among those of its prefix.
#[derive(Clone, Debug)]
pub struct Ownership {
    role: Role,
    tokens: BTreeSet<u32>,
}

impl Ownership {
    /// Stands by; what tokens there are is to be told.
    pub fn standby() -> Self {
        Self {
            role: Role::Waiting(None),
            tokens: BTreeSet::new(),
        }
    }

    /// Returns the epoch as an owner.
    pub fn epoch(&self) -> Option<u32> {
        match self.role {
            Role::Owning { epoch, .. } => Some(epoch),
            _ => None,
        }
    }

    /// Takes what happened and returns what to do.
    pub fn handle(&mut self, event: OwnerEvent, now: FleetMicros) -> OwnerStep {
        match event {
            OwnerEvent::Tokens(tokens) => self.tokens = tokens,
            OwnerEvent::Taken(epoch) => {
                self.role = Role::Owning {
                    epoch,
                    seen: false,
                    missed_at: None,
                };
            }
            OwnerEvent::InUse => {
                // As if the owner had gone just so long ago that it is time after a pause.
                let since = now.0 + RETRY_US - HANDOVER_US;
                self.role = Role::Waiting(Some(FleetMicros(since)));
            }
            OwnerEvent::Tick => {}
        }
        self.step(now)
    }

    fn step(&mut self, now: FleetMicros) -> OwnerStep {
        match self.role {
            Role::Waiting(_) if !self.tokens.is_empty() => {
                self.role = Role::Waiting(None);
                OwnerStep::Nothing
            }
            Role::Waiting(since) => {
                let since = since.unwrap_or(now);
                self.role = Role::Waiting(Some(since));
                if now.since_us(since) < HANDOVER_US {
                    return OwnerStep::Nothing;
                }
                self.role = Role::Taking;
                OwnerStep::Take
            }
            Role::Taking => OwnerStep::Nothing,
            Role::Owning {
                epoch,
                seen,
                missed_at,
            } => {
                if let Some(newest) = self.tokens.last().filter(|newest| **newest > epoch) {
                    return self.resign(Resignation::Superseded { epoch: *newest });
                }
                let here = self.tokens.contains(&epoch);
                let missed_at = (seen && !here).then(|| missed_at.unwrap_or(now));
                if missed_at.is_some_and(|at| now.since_us(at) >= CUT_OFF_US) {
                    return self.resign(Resignation::CutOff);
                }
                self.role = Role::Owning {
                    epoch,
                    seen: seen || here,
                    missed_at,
                };
                OwnerStep::Nothing
            }
        }
    }

    fn resign(&mut self, why: Resignation) -> OwnerStep {
        self.role = Role::Waiting(None);
        OwnerStep::Resign(why)
    }

    /// Returns when [`OwnerEvent::Tick`] is due.
    pub fn poll_timeout(&self) -> Option<FleetMicros> {
        match self.role {
            Role::Waiting(since) if self.tokens.is_empty() => {
                Some(since.unwrap_or(FleetMicros(0)).plus_us(HANDOVER_US))
            }
            Role::Owning { missed_at, .. } => Some(missed_at?.plus_us(CUT_OFF_US)),
            Role::Waiting(_) | Role::Taking => None,
        }
    }
}

/// Returns the epoch of the next owner: newer than what the store says, and than every clock that was
/// right so far.
pub fn next_epoch(stored: u32, now: FleetMicros) -> u32 {
    let now_s = u32::try_from(now.0 / 1_000_000).unwrap_or(u32::MAX);
    stored.saturating_add(1).max(now_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn tokens(epochs: &[u32]) -> OwnerEvent {
        OwnerEvent::Tokens(epochs.iter().copied().collect())
    }

    fn at(us: u64) -> FleetMicros {
        FleetMicros(1_795_230_000 * S + us)
    }

    /// Lets time pass until something is to be done; returns when, and what.
    fn wait(ownership: &mut Ownership) -> (u64, OwnerStep) {
        for _ in 0..100 {
            let due = ownership.poll_timeout().expect("it waits for time");
            let step = ownership.handle(OwnerEvent::Tick, due);
            if step != OwnerStep::Nothing {
                return (due.0 - at(0).0, step);
            }
        }
        panic!("nothing happens");
    }

    fn owner(epoch: u32) -> Ownership {
        let mut ownership = Ownership::standby();
        ownership.handle(OwnerEvent::Taken(epoch), at(0));
        ownership.handle(tokens(&[epoch]), at(0));
        ownership
    }

    #[test]
    fn nobody_reaches_for_the_store_while_an_owner_is_there() {
        let mut standby = Ownership::standby();
        assert_eq!(standby.handle(tokens(&[7]), at(0)), OwnerStep::Nothing);
        assert_eq!(standby.poll_timeout(), None);
        assert_eq!(
            standby.handle(OwnerEvent::Tick, at(900 * S)),
            OwnerStep::Nothing
        );
        standby.handle(tokens(&[]), at(1_000 * S));
        // The owner was only away for a moment.
        standby.handle(tokens(&[7]), at(1_000 * S + HANDOVER_US / 2));
        assert_eq!(standby.poll_timeout(), None);
        standby.handle(tokens(&[]), at(2_000 * S));
        let taken = (2_000 * S + HANDOVER_US, OwnerStep::Take);
        assert_eq!(wait(&mut standby), taken);
        assert_eq!(
            standby.handle(OwnerEvent::Taken(8), at(2_002 * S)),
            OwnerStep::Nothing
        );
        assert_eq!(standby.epoch(), Some(8));
    }

    #[test]
    fn a_store_that_is_in_use_is_asked_for_again_and_again() {
        let mut standby = Ownership::standby();
        standby.handle(tokens(&[]), at(0));
        let mut now = HANDOVER_US;
        assert_eq!(wait(&mut standby), (now, OwnerStep::Take));
        for _ in 0..3 {
            assert_eq!(
                standby.handle(OwnerEvent::InUse, at(now)),
                OwnerStep::Nothing
            );
            now += RETRY_US;
            assert_eq!(wait(&mut standby), (now, OwnerStep::Take));
        }
    }

    #[test]
    fn an_owner_that_is_cut_off_resigns_and_one_that_blinks_does_not() {
        let mut owner = owner(7);
        assert_eq!(owner.poll_timeout(), None);
        owner.handle(tokens(&[]), at(10 * S));
        owner.handle(tokens(&[7]), at(10 * S + CUT_OFF_US - 1));
        assert_eq!(owner.poll_timeout(), None);
        owner.handle(tokens(&[]), at(20 * S));
        let resigned = OwnerStep::Resign(Resignation::CutOff);
        assert_eq!(wait(&mut owner), (20 * S + CUT_OFF_US, resigned));
        assert_eq!(owner.epoch(), None);
    }

    #[test]
    fn an_owner_gives_way_to_a_newer_one_and_to_no_older_one() {
        let mut owner = owner(7);
        assert_eq!(owner.handle(tokens(&[3, 7]), at(S)), OwnerStep::Nothing);
        let resigned = OwnerStep::Resign(Resignation::Superseded { epoch: 9 });
        assert_eq!(owner.handle(tokens(&[7, 9]), at(2 * S)), resigned);
        assert_eq!(owner.handle(tokens(&[9]), at(3 * S)), OwnerStep::Nothing);
        assert_eq!(owner.poll_timeout(), None);
    }

    #[test]
    fn a_new_epoch_is_newer_than_the_store_and_than_the_clock() {
        assert_eq!(next_epoch(0, FleetMicros(5 * S)), 5);
        assert_eq!(next_epoch(5, FleetMicros(5 * S)), 6);
        assert_eq!(next_epoch(900, FleetMicros(5 * S)), 901);
        assert_eq!(next_epoch(u32::MAX, FleetMicros(5 * S)), u32::MAX);
    }
}
