//! What must survive: one file, one transaction for each group of writes. Owns the file; the
//! values in it are opaque.
//!
//! ```text
//!   meta      "format" → version of this layout
//!   requests  job  → what a client asked for, until the job is final
//!   jobs      job  → its entry
//!   nodes     node → its facts
//!   kept      template/NAME, schedule/NAME → what operators keep; not in stores of before
//! ```
//!
//! Promises: when [`Journal::commit`] returns, all its writes are on disk; when it fails or the
//! power goes, none of them is or all of them are. Two gateways never write the same file. A file
//! that is damaged is refused and left as it is: every page is checked against its checksum before
//! anything is believed.
//!
//! [`copy`] is a consistent copy of a store that is in use, [`check`] tells what is wrong with one.
//! A store of which more than half is waste is made smaller when it is opened.
//!
//! # Formats
//! | format | since | what changed |
//! |---|---|---|
//! | 1 | the first | – |
//!
//! A new format adds a row, a migration within one transaction at the opening, and a store of the
//! format before to `tests/stores`.
//!
//! Absent on purpose: a file format of our own; any thread: the shell decides which one blocks.

pub mod check;
pub mod copy;
mod open;

use crate::fleet::{
    Stored,
    event::{Table, Write},
    owner::next_epoch,
};
use keys::FleetMicros;
use open::{compact, guarded, make_private, open_checked, open_error};
use redb::{
    Database, Durability, ReadableDatabase, ReadableTable, TableDefinition, TableError,
    TableHandle as _,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// The layout that is written. A new one must be able to read every old one.
pub const FORMAT: u64 = 1;

const META: TableDefinition<'_, &str, u64> = TableDefinition::new("meta");
const REQUESTS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("requests");
const JOBS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("jobs");
const NODES: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("nodes");
const KEPT: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("kept");

const FORMAT_KEY: &str = "format";

/// Epoch of the last gateway that had the store.
const EPOCH_KEY: &str = "epoch";

/// Stores smaller than this are not compacted, bytes: there is nothing to be gained.
pub const COMPACT_BYTES_MIN: u64 = 8 << 20;

/// Memory for pages of the store, bytes. What is written is in memory besides, and nothing is read
/// between two starts but for a backup: more is worth nothing. The database's own default is 1 GiB,
/// so that a gateway would grow with its history for weeks.
pub const CACHE_BYTES: usize = 8 << 20;

/// Why the store cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// Another process has the file.
    #[error("the store {} is in use by another gateway", .path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The file is something else.
    #[error("{} is no store of a gateway: {why}", .path.display())]
    NotAStore {
        /// The file.
        path: PathBuf,
        /// How that showed.
        why: String,
    },
    /// The file was written by a later version of this program.
    #[error(
        "the store {} has format {found}; this gateway reads up to {FORMAT}: a newer gateway wrote it",
        .path.display()
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: u64,
    },
    /// It is a store, and a part of it is not what was written.
    #[error(
        "the store {} is damaged: {why}. It was left as it is; `fleet doctor` tells what is in it. \
         Begin with a backup, or with a new store after every machine is at rest",
        .path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How that showed.
        why: String,
    },
    /// The disk or the file failed.
    #[error("the store {} failed: {source}", .path.display())]
    Failed {
        /// The file.
        path: PathBuf,
        /// How.
        #[source]
        source: Box<redb::Error>,
    },
}

/// The durable store.
#[derive(Debug)]
pub struct Journal {
    database: Arc<Database>,
    path: PathBuf,
}

impl Journal {
    /// Opens the store, or makes it if there is no file, and reads everything in it.
    ///
    /// # Errors
    /// Another gateway has it, it is no store, a newer gateway wrote it, or the disk fails. An
    /// existing file that is no store is left as it is.
    pub fn open(path: impl AsRef<Path>) -> Result<(Self, Stored), JournalError> {
        let path = path.as_ref();
        let database = guarded(path, || open_checked(path))?;
        let (mut journal, stored) = Self::from_database(database, path.to_owned())?;
        let database = Arc::get_mut(&mut journal.database).expect("nobody copies it yet");
        compact(database, path).map_err(|error| journal.failed(error))?;
        Ok((journal, stored))
    }

    /// Makes a store that vanishes with the journal, for tests and demonstrations.
    ///
    /// # Errors
    /// The store fails: there is no memory.
    pub fn in_memory() -> Result<(Self, Stored), JournalError> {
        let path = Path::new("(memory)");
        let database = Database::builder()
            .create_with_backend(redb::backends::InMemoryBackend::new())
            .map_err(|error| open_error(path, error))?;
        Self::from_database(database, path.to_owned())
    }

    fn from_database(database: Database, path: PathBuf) -> Result<(Self, Stored), JournalError> {
        let journal = Self {
            database: Arc::new(database),
            path,
        };
        let found = journal.prepare().map_err(|error| journal.failed(error))?;
        match found {
            Format::Ours => {}
            Format::Newer(found) => {
                return Err(JournalError::Newer {
                    path: journal.path,
                    found,
                });
            }
            Format::Foreign => {
                return Err(JournalError::NotAStore {
                    path: journal.path,
                    why: "the database in it belongs to another program".into(),
                });
            }
        }
        let stored = journal.read().map_err(|error| journal.failed(error))?;
        Ok((journal, stored))
    }

    /// Writes all of it in one durable transaction, in order.
    ///
    /// # Errors
    /// The disk fails. None of the writes has happened then, and the journal should not be used
    /// any more.
    pub fn commit(&mut self, writes: &[Write]) -> Result<(), JournalError> {
        if writes.is_empty() {
            return Ok(());
        }
        self.write(writes).map_err(|error| self.failed(error))
    }

    /// Writes a newer epoch into the store and returns it, see [`crate::fleet::owner`].
    ///
    /// # Errors
    /// The disk fails.
    pub fn claim(&mut self, now: FleetMicros) -> Result<u32, JournalError> {
        self.raise_epoch(now).map_err(|error| self.failed(error))
    }

    fn raise_epoch(&self, now: FleetMicros) -> Result<u32, redb::Error> {
        let mut transaction = self.database.begin_write()?;
        transaction.set_durability(Durability::Immediate)?;
        let epoch = {
            let mut meta = transaction.open_table(META)?;
            let stored = meta.get(EPOCH_KEY)?.map_or(0, |epoch| epoch.value());
            let stored = u32::try_from(stored).unwrap_or(u32::MAX);
            let epoch = next_epoch(stored, now);
            meta.insert(EPOCH_KEY, u64::from(epoch))?;
            epoch
        };
        transaction.commit()?;
        Ok(epoch)
    }

    /// Returns what copies the store while it is in use.
    pub fn copier(&self) -> copy::Copier {
        copy::Copier::new(Arc::clone(&self.database))
    }

    /// Returns the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn prepare(&self) -> Result<Format, redb::Error> {
        let mut transaction = self.database.begin_write()?;
        transaction.set_durability(Durability::Immediate)?;
        let is_new = transaction.list_tables()?.next().is_none();
        if is_new {
            transaction.open_table(META)?.insert(FORMAT_KEY, FORMAT)?;
            for table in [REQUESTS, JOBS, NODES, KEPT] {
                transaction.open_table(table)?;
            }
            transaction.commit()?;
            return Ok(Format::Ours);
        }
        let format = match transaction.open_table(META) {
            Ok(meta) => meta.get(FORMAT_KEY)?.map(|format| format.value()),
            Err(redb::TableError::Storage(error)) => return Err(error.into()),
            Err(_) => None,
        };
        transaction.abort()?;
        Ok(match format {
            None => Format::Foreign,
            Some(format) if format > FORMAT => Format::Newer(format),
            Some(_) => Format::Ours,
        })
    }

    fn read(&self) -> Result<Stored, redb::Error> {
        read(&*self.database)
    }

    fn write(&self, writes: &[Write]) -> Result<(), redb::Error> {
        let mut transaction = self.database.begin_write()?;
        transaction.set_durability(Durability::Immediate)?;
        {
            let mut requests = transaction.open_table(REQUESTS)?;
            let mut jobs = transaction.open_table(JOBS)?;
            let mut nodes = transaction.open_table(NODES)?;
            let mut kept = transaction.open_table(KEPT)?;
            for write in writes {
                let (table, key) = match write {
                    Write::Put { table, key, .. } | Write::Remove { table, key } => (table, key),
                };
                let table = match table {
                    Table::Requests => &mut requests,
                    Table::Jobs => &mut jobs,
                    Table::Nodes => &mut nodes,
                    Table::Kept => &mut kept,
                };
                match write {
                    Write::Put { value, .. } => {
                        table.insert(key.as_str(), value.as_slice())?;
                    }
                    Write::Remove { .. } => {
                        table.remove(key.as_str())?;
                    }
                }
            }
        }
        transaction.commit()?;
        Ok(())
    }

    fn failed(&self, error: redb::Error) -> JournalError {
        JournalError::Failed {
            path: self.path.clone(),
            source: Box::new(error),
        }
    }
}

/// Whose database it is.
enum Format {
    Ours,
    Newer(u64),
    Foreign,
}

/// Reads every row.
fn read(database: &impl ReadableDatabase) -> Result<Stored, redb::Error> {
    let transaction = database.begin_read()?;
    let all = |definition: TableDefinition<'_, &str, &[u8]>| -> Result<Vec<(String, Vec<u8>)>, redb::Error> {
        let table = match transaction.open_table(definition) {
            // A gateway that knew nothing of it has written the store.
            Err(TableError::TableDoesNotExist(_)) if definition.name() == KEPT.name() => {
                return Ok(Vec::new());
            }
            table => table?,
        };
        let mut rows = Vec::new();
        for row in table.iter()? {
            let (key, value) = row?;
            rows.push((key.value().to_owned(), value.value().to_vec()));
        }
        Ok(rows)
    };
    Ok(Stored {
        requests: all(REQUESTS)?,
        jobs: all(JOBS)?,
        nodes: all(NODES)?,
        kept: all(KEPT)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(table: Table, key: &str, value: &[u8]) -> Write {
        Write::Put {
            table,
            key: key.into(),
            value: value.into(),
        }
    }

    #[test]
    fn what_was_committed_is_there_after_the_next_start() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("fleet.redb");
        let (mut journal, stored) = Journal::open(&path).expect("opens");
        assert_eq!(stored, Stored::default());
        let writes = [
            put(Table::Jobs, "a", b"1"),
            put(Table::Jobs, "b", b"2"),
            put(Table::Nodes, "left", b"3"),
            put(Table::Jobs, "a", b"4"),
            put(Table::Requests, "a", b"5"),
            put(Table::Kept, "template/a", b"6"),
        ];
        journal.commit(&writes).expect("commits");
        let remove = |key: &str| Write::Remove {
            table: Table::Jobs,
            key: key.into(),
        };
        journal
            .commit(&[remove("b"), remove("never")])
            .expect("commits");
        drop(journal);
        let (_journal, stored) = Journal::open(&path).expect("opens again");
        let expected = Stored {
            requests: vec![("a".into(), b"5".to_vec())],
            jobs: vec![("a".into(), b"4".to_vec())],
            nodes: vec![("left".into(), b"3".to_vec())],
            kept: vec![("template/a".into(), b"6".to_vec())],
        };
        assert_eq!(stored, expected);
    }

    #[test]
    fn a_store_in_memory_begins_empty() {
        let (mut journal, stored) = Journal::in_memory().expect("opens");
        assert_eq!(stored, Stored::default());
        journal
            .commit(&[put(Table::Jobs, "a", b"1")])
            .expect("commits");
    }

    #[test]
    fn whoever_takes_the_store_has_a_newer_epoch_than_all_before() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("fleet.redb");
        let claim = |now_s: u64| {
            let (mut journal, _) = Journal::open(&path).expect("opens");
            journal
                .claim(FleetMicros(now_s * 1_000_000))
                .expect("writes")
        };
        // The second clock is wrong.
        assert_eq!(
            [claim(1_000), claim(7), claim(2_000)],
            [1_000, 1_001, 2_000]
        );
    }

    #[test]
    fn a_second_gateway_is_told_that_the_store_is_in_use() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("fleet.redb");
        let _journal = Journal::open(&path).expect("opens");
        let error = Journal::open(&path).expect_err("it is in use");
        assert!(matches!(error, JournalError::InUse { .. }), "{error}");
        assert!(error.to_string().contains("another gateway"), "{error}");
    }

    #[test]
    fn a_file_that_is_no_store_is_left_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, content) in [
            ("short", b"hello".to_vec()),
            ("long", b"this is a letter to nobody\n".repeat(4_000)),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, &content).expect("writes");
            let error = Journal::open(&path).expect_err("it is no store");
            assert!(matches!(error, JournalError::NotAStore { .. }), "{error}");
            assert_eq!(std::fs::read(&path).expect("reads"), content);
        }
    }

    #[test]
    fn a_database_of_another_program_and_of_a_newer_gateway_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("other.redb");
        let database = Database::create(&path).expect("creates");
        let transaction = database.begin_write().expect("begins");
        let other: TableDefinition<'_, &str, u64> = TableDefinition::new("other");
        transaction.open_table(other).expect("opens");
        transaction.commit().expect("commits");
        drop(database);
        let error = Journal::open(&path).expect_err("another program's");
        assert!(matches!(error, JournalError::NotAStore { .. }), "{error}");

        let path = folder.path().join("newer.redb");
        let database = Database::create(&path).expect("creates");
        let transaction = database.begin_write().expect("begins");
        transaction
            .open_table(META)
            .expect("opens")
            .insert(FORMAT_KEY, FORMAT + 1)
            .expect("inserts");
        transaction.commit().expect("commits");
        drop(database);
        let error = Journal::open(&path).expect_err("newer");
        assert!(
            matches!(error, JournalError::Newer { found: 2, .. }),
            "{error}"
        );
    }

    #[test]
    fn a_folder_that_does_not_exist_is_named() {
        let error = Journal::open("/nowhere/fleet.redb").expect_err("no folder");
        assert!(error.to_string().contains("/nowhere/fleet.redb"), "{error}");
    }
}
