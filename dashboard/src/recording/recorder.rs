//! Writes a recording while the session goes on, on a thread of its own.

use super::{BYTES_MAX, Head, Line, Thinner, VERSION, to_line};
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
}

impl Recorder {
    /// Makes a new file and begins with this picture.
    ///
    /// # Errors
    /// The file exists already, or cannot be made.
    pub fn start(path: &Path, now: Moment, picture: Vec<Message>) -> io::Result<Self> {
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

    /// Takes what was heard or asked.
    pub fn heard(&mut self, at: Moment, message: &Message) {
        let line = Line {
            at,
            message: Some(message.clone()),
            left_out: self.left_out_since,
        };
        let line = to_line(&line);
        let keeps = self.thinner.keeps(at, message, line.len());
        if keeps && self.send(line) {
            self.left_out_since = 0;
        } else {
            self.left_out += 1;
            self.left_out_since += 1;
        }
    }

    /// Returns whether there was room.
    fn send(&mut self, line: String) -> bool {
        let bytes = self.bytes + line.len() as u64;
        if bytes > BYTES_MAX {
            let why = format!("full: a recording has at most {} MiB", BYTES_MAX >> 20);
            self.shared.fail(why);
            return false;
        }
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
