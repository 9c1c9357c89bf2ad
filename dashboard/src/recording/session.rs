//! What is recorded and what is shown again, as the window holds it.

use super::{Recording, picture, recorder::Recorder, replay::Replay};
use crate::{
    message::{Message, Moment},
    model::Model,
    request::{Request, Scope},
};
use std::path::Path;

/// What the operator wants of recordings.
#[derive(Clone, Debug, PartialEq)]
pub enum Wish {
    /// Record into this new file.
    Record(String),
    /// End the recording.
    EndRecord,
    /// Show this file again.
    Open(String),
    /// Show the live fleet again.
    EndReplay,
    /// Show this moment of the recording.
    Seek(Moment),
    /// Play so many times as fast as it was; zero stands still.
    Speed(f64),
}

/// See the module.
#[derive(Debug, Default)]
pub struct Session {
    recorder: Option<Recorder>,
    replay: Option<Replay>,
    refused: Option<String>,
    failed: Option<String>,
}

impl Session {
    /// Records what was heard or asked, if a recording runs.
    pub fn heard(&mut self, at: Moment, message: &Message) {
        if let Some(recorder) = &mut self.recorder {
            recorder.heard(at, message);
        }
    }

    /// Begins to record into a new file.
    pub fn record(&mut self, path: &str, live: &Model) {
        if self.recorder.is_some() {
            return;
        }
        self.failed = None;
        match Recorder::start(Path::new(path), live.now(), picture(live)) {
            Ok(recorder) => self.recorder = Some(recorder),
            Err(error) => self.failed = Some(format!("{path}: {error}")),
        }
    }

    /// Ends the recording.
    pub fn end_record(&mut self) {
        self.recorder = None;
    }

    /// Takes what was read of a file, to be shown from its beginning.
    pub fn opened(&mut self, name: String, recording: Result<Recording, String>) {
        (self.failed, self.refused) = (None, None);
        match recording {
            Ok(recording) => self.replay = Some(Replay::new(name, recording)),
            Err(why) => self.failed = Some(format!("{name}: {why}")),
        }
    }

    /// Shows the live fleet again.
    pub fn end_replay(&mut self) {
        (self.replay, self.refused) = (None, None);
    }

    /// Moves the replay on. `now` is the present of the live session.
    pub fn play(&mut self, now: Moment) {
        if let Some(replay) = &mut self.replay {
            replay.play(now);
        }
    }

    /// Moves the replay.
    pub fn seek(&mut self, at: Moment) {
        if let Some(replay) = &mut self.replay {
            replay.seek(at);
        }
    }

    /// Sets the replay's speed.
    pub fn set_speed(&mut self, speed: f64) {
        if let Some(replay) = &mut self.replay {
            if speed > 0.0 && replay.at() == replay.recording().ended {
                replay.seek(replay.recording().began);
            }
            replay.speed = speed;
        }
    }

    /// Returns whether a request may leave: while the past is shown nothing but STOP ALL, which
    /// needs no picture of the fleet to be right.
    pub fn lets_out(&mut self, request: &Request) -> bool {
        let words = match request {
            Request::Stop {
                scope: Scope::All, ..
            } => return true,
            _ if self.replay.is_none() => return true,
            Request::ReadFile { .. } | Request::WriteFile { .. } => return true,
            // The alarm of this number is another one now.
            Request::Acknowledge { .. } => "acknowledging".to_owned(),
            Request::Stop { scope, .. } => format!("stop of {scope}"),
            Request::Release { scope } => format!("release of {scope}"),
            Request::Submit { target, .. } => format!("job for {target}"),
            Request::Cancel { job } => format!("cancel of {job}"),
            Request::Order { node, order } => format!("{order} of {node}"),
            Request::Refresh => "refresh".to_owned(),
            Request::Connect { .. } => "connecting elsewhere".to_owned(),
        };
        self.refused = Some(words);
        false
    }

    /// Returns the recording that runs.
    pub fn recorder(&self) -> Option<&Recorder> {
        self.recorder.as_ref()
    }

    /// Returns the recording that is shown.
    pub fn replay(&self) -> Option<&Replay> {
        self.replay.as_ref()
    }

    /// Returns what was asked last and not sent, because it was asked of the past.
    pub fn refused(&self) -> Option<&str> {
        self.refused.as_deref()
    }

    /// Returns why a file could not be made or read.
    pub fn failed(&self) -> Option<&str> {
        self.failed.as_deref()
    }
}
