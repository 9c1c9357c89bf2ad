//! How a node is set, by its own word: when it was asked for, what it said, and whether that still holds.
//!
//! A node is set at its boot. So what it told before another one is shown as that, and it is asked again.

use crate::{
    message::{Answer, Moment},
    request::Ticket,
};
use keys::Setup;

/// What a node told.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    /// When it was heard.
    pub at: Moment,
    /// In which of its boots; `None`: nobody knows.
    pub boot: Option<u32>,
    /// Its words.
    pub setup: Box<Setup>,
}

/// A question to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// Identifies the request.
    pub ticket: Ticket,
    /// When.
    pub at: Moment,
    /// In which of its boots; `None`: nobody knew.
    pub boot: Option<u32>,
    /// What came of it; `None`: nothing yet.
    pub answer: Option<Answer>,
}

/// See the module.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SetupState {
    told: Option<Told>,
    asked: Option<Asked>,
}

impl SetupState {
    pub(super) fn ask(&mut self, ticket: Ticket, at: Moment, boot: Option<u32>) {
        let answer = None;
        self.asked = Some(Asked {
            ticket,
            at,
            boot,
            answer,
        });
    }

    /// Takes an answer and returns whether it belongs to the question.
    pub(super) fn answer(&mut self, ticket: Ticket, answer: &Answer) -> bool {
        let Some(asked) = self.asked.as_mut().filter(|asked| asked.ticket == ticket) else {
            return false;
        };
        asked.answer = Some(answer.clone());
        true
    }

    pub(super) fn tell(&mut self, at: Moment, boot: Option<u32>, setup: Box<Setup>) {
        self.told = Some(Told { at, boot, setup });
    }

    /// Returns what it told last.
    pub fn told(&self) -> Option<&Told> {
        self.told.as_ref()
    }

    /// Returns the last question.
    pub fn asked(&self) -> Option<&Asked> {
        self.asked.as_ref()
    }

    /// Returns whether it is to be asked: never yet, not in this boot, or not since there is a link.
    pub(super) fn is_due(&self, boot: u32, linked_at: Moment) -> bool {
        let Some(asked) = &self.asked else {
            return true;
        };
        asked.boot != Some(boot) || asked.at < linked_at
    }
}
