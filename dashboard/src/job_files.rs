//! Reading and writing the files that the operator names, away from the window's thread: a file on
//! a slow disk holds nothing up.

use crate::{
    message::{FileOutcome, Message},
    request::{Request, Ticket},
};
use std::{fs, io::Read as _, io::Write as _};

/// Performs a request about a file on a thread of its own and tells the outcome. Returns whether
/// it was one.
pub fn begin(
    ticket: Ticket,
    request: &Request,
    tell: impl FnOnce(Message) + Send + 'static,
) -> bool {
    let work: Box<dyn FnOnce() -> FileOutcome + Send> = match request {
        Request::ReadFile { path } => {
            let path = path.clone();
            Box::new(move || read(&path))
        }
        Request::WriteFile { path, text } => {
            let (path, text) = (path.clone(), text.clone());
            Box::new(move || write(&path, &text))
        }
        _ => return false,
    };
    std::thread::spawn(move || {
        let outcome = work();
        tell(Message::File { ticket, outcome });
    });
    true
}

/// Reads a job's text.
pub fn read(path: &str) -> FileOutcome {
    let most = keys::job::JOB_BYTES_MAX as u64;
    let mut text = String::new();
    let read = fs::File::open(path).and_then(|file| file.take(most + 1).read_to_string(&mut text));
    match read {
        Err(error) => FileOutcome::Failed(format!("{path}: {error}")),
        Ok(_) if text.len() as u64 > most => {
            FileOutcome::Failed(format!("{path}: longer than {most} bytes, the longest job"))
        }
        Ok(_) => FileOutcome::Read {
            path: path.to_owned(),
            text,
        },
    }
}

/// Writes a new file; one that exists is left as it is.
pub fn write(path: &str, text: &str) -> FileOutcome {
    let file = fs::File::create_new(path);
    match file.and_then(|mut file| file.write_all(text.as_bytes())) {
        Err(error) => FileOutcome::Failed(format!("{path}: {error}")),
        Ok(()) => {
            let full = fs::canonicalize(path).map(|full| full.display().to_string());
            FileOutcome::Written {
                path: full.unwrap_or_else(|_| path.to_owned()),
            }
        }
    }
}
