//! Opens the file of a store: made for its owner alone, checked page by page, and made smaller if it is
//! mostly waste. Says what is wrong with one that cannot be used.

use super::{CACHE_BYTES, COMPACT_BYTES_MIN, JournalError};
use redb::{Database, DatabaseError};
use std::{
    io::Read as _,
    panic::{UnwindSafe, catch_unwind},
    path::Path,
};

/// What a file of the embedded database begins with.
const MAGIC: &[u8; 4] = b"redb";

/// Gives back to the disk what is not used, if that is more than half of a large file.
pub(super) fn compact(database: &mut Database, path: &Path) -> Result<(), redb::Error> {
    let length = std::fs::metadata(path)?.len();
    if length < COMPACT_BYTES_MIN {
        return Ok(());
    }
    let transaction = database.begin_write()?;
    let waste = transaction.stats()?.fragmented_bytes();
    transaction.abort()?;
    if waste > length / 2 {
        database.compact()?;
        let after = std::fs::metadata(path)?.len();
        tracing::info!(
            before_bytes = length,
            after_bytes = after,
            "the store was compacted"
        );
    }
    Ok(())
}

/// Opens a database that may be damaged: it believes some numbers in its file, and panics where they
/// lead nowhere.
pub(super) fn guarded<T>(
    path: &Path,
    open: impl FnOnce() -> Result<T, JournalError> + UnwindSafe,
) -> Result<T, JournalError> {
    catch_unwind(open).unwrap_or_else(|_| {
        let why = "its pages say what cannot be".to_owned();
        let path = path.to_owned();
        Err(JournalError::Damaged { path, why })
    })
}

/// Opens a file, or makes it, and reads all its pages: opening alone believes them.
pub(super) fn open_checked(path: &Path) -> Result<Database, JournalError> {
    make_private(path).map_err(|error| open_error(path, redb::StorageError::Io(error).into()))?;
    let mut database = Database::builder()
        .set_cache_size(CACHE_BYTES)
        .create(path)
        .map_err(|error| open_error(path, error))?;
    match database.check_integrity() {
        Ok(true) => Ok(database),
        Ok(false) => {
            let why = "its pages do not agree with each other".to_owned();
            let path = path.to_owned();
            Err(JournalError::Damaged { path, why })
        }
        Err(error) => Err(open_error(path, error)),
    }
}

/// Makes an empty file that nobody but its owner may read: jobs can be somebody's secret. One that is
/// there keeps its permissions, since somebody may have given them on purpose.
pub(super) fn make_private(path: &Path) -> std::io::Result<()> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    match options.open(path) {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => Err(error),
        _ => Ok(()),
    }
}

pub(super) fn open_error(path: &Path, error: DatabaseError) -> JournalError {
    // What a database says of a file that is none, or that is not what it was.
    let why = match error {
        DatabaseError::DatabaseAlreadyOpen => {
            let path = path.to_owned();
            return JournalError::InUse { path };
        }
        DatabaseError::UpgradeRequired(format) => {
            format!("its database has the old file format {format}")
        }
        DatabaseError::Storage(redb::StorageError::Io(error))
            if matches!(
                error.kind(),
                std::io::ErrorKind::InvalidData | std::io::ErrorKind::UnexpectedEof
            ) =>
        {
            error.to_string()
        }
        DatabaseError::Storage(redb::StorageError::Corrupted(why)) => why,
        error => {
            return JournalError::Failed {
                path: path.to_owned(),
                source: Box::new(error.into()),
            };
        }
    };
    let path = path.to_owned();
    if begins_as_a_database(&path) {
        JournalError::Damaged { path, why }
    } else {
        JournalError::NotAStore { path, why }
    }
}

fn begins_as_a_database(path: &Path) -> bool {
    let mut begin = [0; MAGIC.len()];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut begin));
    read.is_ok() && begin == *MAGIC
}
