//! What is recorded and what is shown again, as the window holds it.

use super::{BYTES_MAX, PARTS_MAX, Recording, picture, recorder::Recorder, replay::Replay};
use crate::{
    message::{Message, Moment},
    model::Model,
    request::{Request, Scope},
};
use std::path::{Path, PathBuf};

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
#[derive(Debug)]
pub struct Session {
    /// Largest file, bytes; the recording goes on in the next one.
    pub part_bytes_max: u64,
    recorder: Option<Recorder>,
    // The first file, and how many there are.
    first: PathBuf,
    part_count: u32,
    replay: Option<Replay>,
    refused: Option<String>,
    failed: Option<String>,
}

impl Default for Session {
    fn default() -> Self {
        Self {
            part_bytes_max: BYTES_MAX,
            recorder: None,
            first: PathBuf::new(),
            part_count: 0,
            replay: None,
            refused: None,
            failed: None,
        }
    }
}

impl Session {
    /// Records what was heard or asked, if a recording runs. `live` is what is known before it.
    pub fn heard(&mut self, at: Moment, message: &Message, live: &Model) {
        let Some(recorder) = &mut self.recorder else {
            return;
        };
        if recorder.heard(at, message) {
            return;
        }
        match self.next_part(at, live) {
            Ok(mut next) => {
                // A message larger than a file is left out.
                if !next.heard(at, message) {
                    next.leave_out();
                }
                self.recorder = Some(next);
            }
            Err(why) => {
                if let Some(recorder) = &mut self.recorder {
                    recorder.fail(why);
                    recorder.leave_out();
                }
            }
        }
    }

    /// Begins the next file of the recording: `day-2.jsonl` after `day.jsonl`.
    fn next_part(&mut self, at: Moment, live: &Model) -> Result<Recorder, String> {
        if self.part_count >= PARTS_MAX {
            return Err(format!("full: a recording has at most {PARTS_MAX} files"));
        }
        if let Some(why) = self.recorder.as_ref().and_then(Recorder::failed) {
            return Err(why);
        }
        self.part_count += 1;
        let stem = self.first.file_stem().unwrap_or_default();
        let mut name = format!("{}-{}", stem.to_string_lossy(), self.part_count);
        if let Some(extension) = self.first.extension() {
            name += &format!(".{}", extension.to_string_lossy());
        }
        let path = self.first.with_file_name(name);
        Recorder::start(&path, at, picture(live), self.part_bytes_max)
            .map_err(|error| format!("{}: {error}", path.display()))
    }

    /// Begins to record into a new file.
    pub fn record(&mut self, path: &str, live: &Model) {
        if self.recorder.is_some() {
            return;
        }
        self.failed = None;
        (self.first, self.part_count) = (PathBuf::from(path), 1);
        let begun = Recorder::start(
            Path::new(path),
            live.now(),
            picture(live),
            self.part_bytes_max,
        );
        match begun {
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
            Request::Setup { node } => format!("question to {node}"),
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
