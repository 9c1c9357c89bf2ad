//! `fleet backup` and `fleet doctor`: copies of the store, and what is in one.

use crate::{
    args::{Backup, Doctor},
    link::{Failure, Link},
    show,
};
use gateway::{
    bus::backup::BACKUP,
    journal::{
        Journal, JournalError,
        check::check,
        copy::{CopyError, CopyFile, Piece},
    },
};

impl From<CopyError> for Failure {
    fn from(error: CopyError) -> Self {
        match error {
            CopyError::Exists(_) => Self::Usage(error.to_string()),
            _ => Self::Failed(Some(error.to_string())),
        }
    }
}

impl From<JournalError> for Failure {
    fn from(error: JournalError) -> Self {
        Self::Failed(Some(error.to_string()))
    }
}

/// `fleet backup`. Without a link: of the store that the line names.
pub(crate) async fn backup(link: Option<&Link>, line: &Backup, json: bool) -> Result<(), Failure> {
    let mut file = CopyFile::create(&line.file)?;
    match (link, &line.store) {
        (Some(link), _) => {
            let key = format!("{}/{BACKUP}", link.keys().prefix());
            let mut is_answered = false;
            link.pour(&key, |bytes| {
                is_answered = true;
                let piece = Piece::decode(bytes).map_err(|words| Failure::Failed(Some(words)))?;
                Ok(file.take(piece)?)
            })
            .await?;
            if !is_answered {
                return Err(Failure::Connection(
                    "no gateway gives a backup: there is none, or it is of an earlier version, or you may not"
                        .to_owned(),
                ));
            }
        }
        (None, Some(store)) => {
            if !store.exists() {
                return Err(Failure::Usage(format!("{}: no such file", store.display())));
            }
            let (journal, _) = Journal::open(store)?;
            let mut taken = Ok(());
            let copied = journal.copier().copy(|piece| {
                taken = file.take(piece);
                taken.is_ok()
            });
            copied.map_err(|error| Failure::Failed(Some(error.to_string())))?;
            taken?;
        }
        (None, None) => unreachable!("a backup is of a gateway or of a store"),
    }
    let rows = file.finish()?;
    let name = line.file.display();
    if json {
        let told = serde_json::json!({"backup": line.file, "rows": rows});
        show::line(&told.to_string());
    } else {
        show::line(&format!("{name}: {rows} rows, read back"));
    }
    Ok(())
}

/// `fleet doctor`
pub(crate) fn doctor(line: &Doctor, json: bool) -> Result<(), Failure> {
    let name = line.file.display();
    if !line.file.exists() {
        return Err(Failure::Usage(format!("{name}: no such file")));
    }
    let found = check(&line.file)?;
    if json {
        let told = serde_json::json!({
            "file": line.file,
            "format": found.format,
            "bytes": found.file_bytes,
            "open_jobs": found.open_jobs,
            "ended_jobs": found.ended_jobs,
            "nodes": found.nodes,
            "cut_off": found.cut_off,
            "wrong": found.wrong,
        });
        show::line(&told.to_string());
    } else {
        show::line(&format!(
            "{name}: format {}, {} KiB, {} jobs that wait or run, {} that have ended, {} nodes",
            found.format,
            found.file_bytes.div_ceil(1_024),
            found.open_jobs,
            found.ended_jobs,
            found.nodes
        ));
        if found.cut_off {
            show::line(
                "  its gateway was cut off; the next start puts that right, nothing is lost",
            );
        }
        for wrong in &found.wrong {
            show::line(&format!("  {wrong}"));
        }
    }
    match found.wrong.len() {
        0 => {
            if !json {
                show::line("  every page and every row can be read");
            }
            Ok(())
        }
        count => Err(Failure::Failed(Some(format!(
            "{count} rows cannot be read, and no gateway will start with this store: go back to a \
             backup, or move the file away and begin anew when every machine is at rest"
        )))),
    }
}
