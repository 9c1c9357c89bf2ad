//! A recording that is shown again: the same messages through the same [`Model::apply`].

use super::Recording;
use crate::{message::Moment, model::Model};

/// Messages that are told to the model at a time, some milliseconds of work. More wait for the next
/// frame, so that STOP ALL waits for no seek.
pub const SLICE: usize = 4_000;

/// See the module.
#[derive(Debug)]
pub struct Replay {
    name: String,
    recording: Recording,
    model: Model,
    next: usize,
    at: Moment,
    /// How many times as fast as it was; zero stands still.
    pub speed: f64,
    moved: Option<Moment>,
}

impl Replay {
    /// Stands at the beginning of a recording.
    pub fn new(name: String, recording: Recording) -> Self {
        let began = recording.began;
        let mut replay = Self {
            name,
            recording,
            model: Model::default(),
            next: 0,
            at: began,
            speed: 0.0,
            moved: None,
        };
        replay.seek(began);
        replay
    }

    /// Moves to a moment of the recording, forwards or back. Where many messages lie between, that
    /// takes several calls of [`Self::play`].
    pub fn seek(&mut self, at: Moment) {
        let at = at.clamp(self.recording.began, self.recording.ended);
        if at < self.at {
            (self.model, self.next) = (Model::default(), 0);
        }
        self.at = at;
        self.work();
    }

    /// Tells the model the next slice of what it does not know yet.
    fn work(&mut self) {
        for _ in 0..SLICE {
            let next = self.recording.messages.get(self.next);
            let Some((heard, message)) = next.filter(|(heard, _)| *heard <= self.at) else {
                self.model.tick(self.at);
                return;
            };
            self.model.apply(*heard, message.clone());
            self.next += 1;
        }
    }

    /// Returns whether the model does not show the moment yet.
    pub fn is_behind(&self) -> bool {
        let next = self.recording.messages.get(self.next);
        next.is_some_and(|(heard, _)| *heard <= self.at)
    }

    /// Returns how much of the way to the moment is done, percent.
    pub fn done_percent(&self) -> usize {
        let messages = &self.recording.messages;
        let all = messages.partition_point(|(heard, _)| *heard <= self.at);
        100 * self.next / all.max(1)
    }

    /// Moves on while it plays. `now` is the present of the live session.
    pub fn play(&mut self, now: Moment) {
        let passed_s = self.moved.map_or(0.0, |moved| now.since_s(moved));
        self.moved = Some(now);
        if self.is_behind() {
            // Its time stands still meanwhile.
            self.work();
        } else if self.speed > 0.0 {
            let on_us = (passed_s * self.speed * 1e6) as u64;
            self.seek(self.at.plus_us(on_us));
            if self.at == self.recording.ended {
                self.speed = 0.0;
            }
        }
    }

    /// Returns the fleet as it was.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Returns the file's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the moment of the recording that is shown.
    pub fn at(&self) -> Moment {
        self.at
    }

    /// Returns the recording.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }
}
