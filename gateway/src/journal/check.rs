//! What is in a store, and what is wrong with it: `fleet doctor`.
//!
//! Looks at a copy of the file, so that looking changes nothing: opening a database repairs what a
//! cut-off write left behind. Everything that is wrong is told, not only what a gateway would
//! stumble over first.

use super::{FORMAT, Journal, JournalError, guarded, open_error};
use crate::fleet::{Fleet, FleetConfig, Stored};
use keys::FleetMicros;
use redb::{DatabaseError, ReadOnlyDatabase};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// The layout.
    pub format: u64,
    /// Length of the file.
    pub file_bytes: u64,
    /// Jobs that have ended.
    pub ended_jobs: usize,
    /// Jobs that wait or run.
    pub open_jobs: usize,
    /// Nodes that are known.
    pub nodes: usize,
    /// The file was not closed by a gateway: it was killed, or the power went. The next start
    /// repairs that, nothing is lost.
    pub cut_off: bool,
    /// What is wrong, in sentences.
    pub wrong: Vec<String>,
}

/// Looks at a store, or a backup of one.
///
/// # Errors
/// It cannot be looked at: it is in use, no store, of a newer gateway, or damaged as a whole.
pub fn check(path: &Path) -> Result<Findings, JournalError> {
    let failed = |error: std::io::Error| JournalError::Failed {
        path: path.to_owned(),
        source: Box::new(redb::Error::Io(error)),
    };
    let file_bytes = std::fs::metadata(path).map_err(failed)?.len();
    // Held while the file is copied, so that no gateway begins to write meanwhile.
    let (held, cut_off) = guarded(path, || match ReadOnlyDatabase::open(path) {
        Ok(database) => Ok((Some(database), false)),
        Err(DatabaseError::RepairAborted) => Ok((None, true)),
        Err(error) => Err(open_error(path, error)),
    })?;
    let copy = Copy::make(path).map_err(failed)?;
    drop(held);
    let (journal, stored) = Journal::open(&copy.0).map_err(|error| rename(error, path))?;
    drop(journal);
    let mut findings = Findings {
        format: FORMAT,
        file_bytes,
        nodes: stored.nodes.len(),
        cut_off,
        ..Findings::default()
    };
    examine(stored, &mut findings);
    Ok(findings)
}

fn examine(stored: Stored, findings: &mut Findings) {
    let restore = |stored: Stored| {
        let (config, mut effects) = (FleetConfig::default(), Vec::new());
        let fleet = Fleet::restore(config, 0, stored, FleetMicros(0), &mut effects);
        fleet.map_err(|error| error.to_string())
    };
    let requests: HashMap<&str, &Vec<u8>> = stored
        .requests
        .iter()
        .map(|(name, value)| (name.as_str(), value))
        .collect();
    for job in &stored.jobs {
        let request = requests.get(job.0.as_str());
        let one = Stored {
            requests: request
                .map(|value| (job.0.clone(), (*value).clone()))
                .into_iter()
                .collect(),
            jobs: vec![job.clone()],
            ..Stored::default()
        };
        match restore(one) {
            Ok(fleet) => match fleet.jobs().next() {
                Some(job) if job.state().is_final() => findings.ended_jobs += 1,
                _ => findings.open_jobs += 1,
            },
            Err(why) => findings.wrong.push(why),
        }
    }
    for node in &stored.nodes {
        let one = Stored {
            nodes: vec![node.clone()],
            ..Stored::default()
        };
        if let Err(why) = restore(one) {
            findings.wrong.push(why);
        }
    }
    for kept in &stored.kept {
        let one = Stored {
            kept: vec![kept.clone()],
            ..Stored::default()
        };
        if let Err(why) = restore(one) {
            findings.wrong.push(why);
        }
    }
    // What shows only in the whole: two jobs at one place.
    if findings.wrong.is_empty()
        && let Err(why) = restore(stored)
    {
        findings.wrong.push(why);
    }
}

/// A copy that vanishes.
struct Copy(PathBuf);

impl Copy {
    fn make(path: &Path) -> std::io::Result<Self> {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".doctor-{}", std::process::id()));
        let copy = Self(PathBuf::from(name));
        std::fs::copy(path, &copy.0)?;
        Ok(copy)
    }
}

impl Drop for Copy {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.0)
            && error.kind() != std::io::ErrorKind::NotFound
        {
            tracing::warn!("{}: {error}", self.0.display());
        }
    }
}

/// Names the file that was meant.
fn rename(error: JournalError, meant: &Path) -> JournalError {
    let path = meant.to_owned();
    match error {
        JournalError::InUse { .. } => JournalError::InUse { path },
        JournalError::NotAStore { why, .. } => JournalError::NotAStore { path, why },
        JournalError::Newer { found, .. } => JournalError::Newer { path, found },
        JournalError::Damaged { why, .. } => JournalError::Damaged { path, why },
        JournalError::Failed { source, .. } => JournalError::Failed { path, source },
    }
}
