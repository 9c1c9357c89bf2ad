//! Writes a recording while the session goes on, on a thread of its own.

use super::{Head, Line, Thinner, VERSION, to_line};
use crate::message::{Message, Moment};
use std::{
    fs::OpenOptions,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::Duration,
};

/// Lines that wait to be written; more are left out and counted.
const WAITING_MAX: usize = 16_384;

/// Longest time before a line is on its way to the disk.
const FLUSH_EVERY: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
struct Shared {
    written_bytes: AtomicU64,
    failed: Mutex<Option<String>>,
}

/// See the module. Dropping it ends the file.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    lines: Option<SyncSender<String>>,
    thread: Option<JoinHandle<()>>,
    shared: Arc<Shared>,
    thinner: Thinner,
    left_out: u64,
    // Not yet told to the file.
    left_out_since: u64,
    bytes: u64,
    bytes_max: u64,
}

impl Recorder {
    /// Makes a new file of at most so many bytes and begins with this picture.
    ///
    /// # Errors
    /// The file exists already, or cannot be made.
    pub fn start(
        path: &Path,
        now: Moment,
        picture: Vec<Message>,
        bytes_max: u64,
    ) -> io::Result<Self> {
        // Never over another one.
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let (lines, waiting) = sync_channel(WAITING_MAX);
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || write_all(BufWriter::new(file), &waiting, &of_thread))?;
        let mut recorder = Self {
            path: path.to_owned(),
            lines: Some(lines),
            thread: Some(thread),
            shared,
            thinner: Thinner::default(),
            left_out: 0,
            left_out_since: 0,
            bytes: 0,
            bytes_max,
        };
        recorder.send(to_line(&Head {
            stepfleet_recording: VERSION,
            began: now,
        }));
        for message in picture {
            let line = Line {
                at: now,
                message: Some(message),
                left_out: 0,
            };
            recorder.send(to_line(&line));
        }
        Ok(recorder)
    }

    /// Takes what was heard or asked. Returns whether the file has room for it: else it is as if
    /// nothing had been said, and the next file begins with it.
    pub fn heard(&mut self, at: Moment, message: &Message) -> bool {
        let line = Line {
            at,
            message: Some(message.clone()),
            left_out: self.left_out_since,
        };
        let line = to_line(&line);
        if self.bytes + line.len() as u64 > self.bytes_max {
            return false;
        }
        let keeps = self.thinner.keeps(at, message, line.len());
        if keeps && self.send(line) {
            self.left_out_since = 0;
        } else {
            self.leave_out();
        }
        true
    }

    /// Counts a message that is not written.
    pub(super) fn leave_out(&mut self) {
        self.left_out += 1;
        self.left_out_since += 1;
    }

    /// Writes nothing more, for this reason.
    pub(super) fn fail(&self, why: String) {
        self.shared.fail(why);
    }

    /// Returns whether there was room.
    fn send(&mut self, line: String) -> bool {
        let bytes = self.bytes + line.len() as u64;
        let sent = self
            .lines
            .as_ref()
            .is_some_and(|lines| lines.try_send(line).is_ok());
        if sent {
            self.bytes = bytes;
        }
        sent
    }

    /// Returns the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns how much was written, bytes.
    pub fn written_bytes(&self) -> u64 {
        self.shared.written_bytes.load(Ordering::Relaxed)
    }

    /// Returns how much was taken to be written, bytes.
    pub fn taken_bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns how many messages were left out.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Returns why nothing more is written.
    pub fn failed(&self) -> Option<String> {
        self.shared.lock().clone()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.lines = None;
        if let Some(thread) = self.thread.take() {
            // A panic in there has been printed.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> std::sync::MutexGuard<'_, Option<String>> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn fail(&self, why: String) {
        self.lock().get_or_insert(why);
    }
}

fn write_all(mut out: impl Write, waiting: &Receiver<String>, shared: &Shared) {
    loop {
        let written = match waiting.recv_timeout(FLUSH_EVERY) {
            Ok(line) => out.write_all(line.as_bytes()).map(|()| line.len()),
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => out.flush().map(|()| 0),
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => {
                if let Err(error) = out.flush() {
                    shared.fail(error.to_string());
                }
                return;
            }
        };
        match written {
            Ok(bytes) => {
                shared
                    .written_bytes
                    .fetch_add(bytes as u64, Ordering::Relaxed);
            }
            Err(error) => {
                shared.fail(error.to_string());
                return;
            }
        }
    }
}
