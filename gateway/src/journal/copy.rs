//! A consistent copy of a store that is in use, in pieces that can be sent.
//!
//! ```text
//!   Copier ─▶ Piece 0 · Piece 1 · … · last (how many rows) ─▶ CopyFile ─▶ FILE.part ─▶ FILE
//! ```
//!
//! Promises: a copy is the store as it was at one instant, whatever is written meanwhile; a file has
//! its name only when it is whole, on disk, and was read back; a file that exists is left alone.

use super::{
    FORMAT, FORMAT_KEY, JOBS, Journal, JournalError, KEPT, META, NODES, REQUESTS, open_error,
};
use redb::{Database, Durability, ReadableDatabase, ReadableTable, TableError};
use serde::{Deserialize, Serialize};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// A piece is sent when its rows have so many bytes. One row may be larger: a job of 64 MiB.
pub const PIECE_BYTES: usize = 256 << 10;

/// A row: table (0 requests, 1 jobs, 2 nodes, 3 kept), key, value.
type Row = (u8, String, Vec<u8>);

/// A part of a copy.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Piece {
    /// Its number, from 0.
    pub index: u32,
    /// What is in it.
    pub content: Content,
}

/// What is in a piece.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Content {
    /// Some rows.
    Rows(Vec<Row>),
    /// Nothing follows.
    End {
        /// The layout of the store.
        format: u64,
        /// How many rows there were.
        row_count: u64,
    },
}

impl Piece {
    /// Returns the bytes to send.
    pub fn encode(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("a piece has no part that cannot be")
    }

    /// Reads a piece.
    ///
    /// # Errors
    /// They are no piece, or one of another version.
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        postcard::from_bytes(bytes).map_err(|error| format!("no piece of a backup: {error}"))
    }
}

/// Copies a store that is in use.
#[derive(Clone, Debug)]
pub struct Copier {
    database: Arc<Database>,
}

impl Copier {
    pub(super) fn new(database: Arc<Database>) -> Self {
        Self { database }
    }

    /// Gives the store as it is now, piece by piece, until `take` wants no more. What is written
    /// meanwhile is not in it, and waits for nothing.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn copy(&self, mut take: impl FnMut(Piece) -> bool) -> Result<(), Box<redb::Error>> {
        self.copy_to(&mut take).map_err(Box::new)
    }

    fn copy_to(&self, take: &mut impl FnMut(Piece) -> bool) -> Result<(), redb::Error> {
        let transaction = self.database.begin_read()?;
        let (mut index, mut row_count) = (0, 0);
        let mut rows: Vec<Row> = Vec::new();
        let mut bytes = 0;
        for (number, definition) in (0..).zip([REQUESTS, JOBS, NODES, KEPT]) {
            let table = match transaction.open_table(definition) {
                // Nothing was ever kept in this store.
                Err(TableError::TableDoesNotExist(_)) if number == 3 => continue,
                table => table?,
            };
            for row in table.iter()? {
                let (key, value) = row?;
                let row = (number, key.value().to_owned(), value.value().to_vec());
                bytes += row.1.len() + row.2.len();
                row_count += 1;
                rows.push(row);
                if bytes >= PIECE_BYTES {
                    let content = Content::Rows(std::mem::take(&mut rows));
                    if !take(Piece { index, content }) {
                        return Ok(());
                    }
                    index += 1;
                    bytes = 0;
                }
            }
        }
        if !rows.is_empty() {
            let content = Content::Rows(rows);
            if !take(Piece { index, content }) {
                return Ok(());
            }
            index += 1;
        }
        let format = FORMAT;
        take(Piece {
            index,
            content: Content::End { format, row_count },
        });
        Ok(())
    }
}

/// Why there is no copy.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// Something has that name.
    #[error("{} exists; a backup replaces nothing", .0.display())]
    Exists(PathBuf),
    /// A piece is missing, or is none.
    #[error("the backup is not whole: {0}")]
    Incomplete(String),
    /// The store is of a newer gateway.
    #[error("the gateway's store has format {0}; this program writes {FORMAT}")]
    Newer(u64),
    /// The file cannot be written or read back.
    #[error(transparent)]
    Store(#[from] JournalError),
    /// The file cannot be named.
    #[error("{}: {source}", .path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

/// A store that is made from pieces.
#[derive(Debug)]
pub struct CopyFile {
    database: Database,
    part: PathBuf,
    path: PathBuf,
    index: u32,
    row_count: u64,
    is_whole: bool,
}

impl CopyFile {
    /// Begins beside the file that it will be.
    ///
    /// # Errors
    /// See [`CopyError`].
    pub fn create(path: &Path) -> Result<Self, CopyError> {
        if path.exists() {
            return Err(CopyError::Exists(path.to_owned()));
        }
        let mut part = path.as_os_str().to_owned();
        part.push(".part");
        let part = PathBuf::from(part);
        match std::fs::remove_file(&part) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(CopyError::File { path: part, source });
            }
            _ => {}
        }
        super::make_private(&part).map_err(|source| CopyError::File {
            path: part.clone(),
            source,
        })?;
        let database = Database::create(&part).map_err(|error| open_error(&part, error))?;
        let file = Self {
            database,
            part,
            path: path.to_owned(),
            index: 0,
            row_count: 0,
            is_whole: false,
        };
        // So that a store without rows is one.
        file.write(&[])?;
        Ok(file)
    }

    /// Takes the next piece.
    ///
    /// # Errors
    /// See [`CopyError`]: it is not the next one.
    pub fn take(&mut self, piece: Piece) -> Result<(), CopyError> {
        if self.is_whole || piece.index != self.index {
            let words = format!("piece {} came in place of {}", piece.index, self.index);
            return Err(CopyError::Incomplete(words));
        }
        self.index += 1;
        match piece.content {
            Content::Rows(rows) => {
                self.row_count += rows.len() as u64;
                self.write(&rows)?;
            }
            Content::End { format, .. } if format != FORMAT => {
                return Err(CopyError::Newer(format));
            }
            Content::End { row_count, .. } if row_count != self.row_count => {
                let words = format!("{} rows of {row_count} came", self.row_count);
                return Err(CopyError::Incomplete(words));
            }
            Content::End { .. } => self.is_whole = true,
        }
        Ok(())
    }

    /// Reads the file back and gives it its name. Returns how many rows it has.
    ///
    /// # Errors
    /// See [`CopyError`]. There is no file of that name then.
    pub fn finish(self) -> Result<u64, CopyError> {
        if !self.is_whole {
            let words = format!("it ends after {} rows", self.row_count);
            return Err(CopyError::Incomplete(words));
        }
        drop(self.database);
        // Reads every page.
        drop(Journal::open(&self.part)?);
        std::fs::rename(&self.part, &self.path).map_err(|source| CopyError::File {
            path: self.path,
            source,
        })?;
        Ok(self.row_count)
    }

    fn write(&self, rows: &[Row]) -> Result<(), CopyError> {
        self.write_rows(rows).map_err(|error| {
            CopyError::Store(JournalError::Failed {
                path: self.part.clone(),
                source: Box::new(error),
            })
        })
    }

    fn write_rows(&self, rows: &[Row]) -> Result<(), redb::Error> {
        let mut transaction = self.database.begin_write()?;
        transaction.set_durability(Durability::Immediate)?;
        {
            let mut meta = transaction.open_table(META)?;
            meta.insert(FORMAT_KEY, FORMAT)?;
            let mut requests = transaction.open_table(REQUESTS)?;
            let mut jobs = transaction.open_table(JOBS)?;
            let mut nodes = transaction.open_table(NODES)?;
            let mut kept = transaction.open_table(KEPT)?;
            for (table, key, value) in rows {
                let table = match table {
                    0 => &mut requests,
                    1 => &mut jobs,
                    2 => &mut nodes,
                    _ => &mut kept,
                };
                table.insert(key.as_str(), value.as_slice())?;
            }
        }
        transaction.commit()?;
        Ok(())
    }
}
