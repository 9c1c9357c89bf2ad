//! What is known about the way to the fleet.

use crate::message::{LinkEvent, Moment};

/// Where the link is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Nothing was tried yet.
    #[default]
    Unused,
    /// It tries to connect.
    Connecting,
    /// A router answers.
    Up,
    /// It could not connect or was cut, and will try again.
    Down,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct LinkState {
    phase: Phase,
    since: Moment,
    to: String,
    why: Option<String>,
    gateway: Option<bool>,
}

impl LinkState {
    /// Takes an event and returns the words for the log, if something changed.
    pub(super) fn apply(&mut self, at: Moment, event: LinkEvent) -> Option<String> {
        match event {
            LinkEvent::Connecting { to } => {
                // Retries would fill the log, and “down since” is what an operator wants to know.
                self.to = to;
                if self.phase != Phase::Down {
                    (self.phase, self.since) = (Phase::Connecting, at);
                }
                None
            }
            LinkEvent::Connected { to } => {
                (self.phase, self.since) = (Phase::Up, at);
                (self.why, self.gateway) = (None, None);
                let words = format!("connected to {to}");
                self.to = to;
                Some(words)
            }
            LinkEvent::Gateway { present } => {
                let changed = self.gateway != Some(present);
                self.gateway = Some(present);
                let words = if present {
                    "the gateway answers"
                } else {
                    "no gateway answers: jobs cannot be sent; stops still reach the nodes"
                };
                changed.then(|| words.to_owned())
            }
            LinkEvent::Down { why } => {
                let changed = self.phase != Phase::Down || self.why.as_ref() != Some(&why);
                if self.phase != Phase::Down {
                    (self.phase, self.since) = (Phase::Down, at);
                }
                self.gateway = None;
                let words = format!("no link: {why}");
                self.why = Some(why);
                changed.then_some(words)
            }
        }
    }

    /// Returns where it is.
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Returns whether messages arrive and requests leave.
    pub fn is_up(&self) -> bool {
        self.phase == Phase::Up
    }

    /// Returns since when it is in this phase.
    pub fn since(&self) -> Moment {
        self.since
    }

    /// Returns where it leads or tries to.
    pub fn to(&self) -> &str {
        &self.to
    }

    /// Returns why it is down.
    pub fn why(&self) -> Option<&str> {
        self.why.as_deref()
    }

    /// Returns whether a gateway serves the prefix; `None` while that is not known.
    pub fn gateway(&self) -> Option<bool> {
        self.gateway
    }
}
