//! Where the stored scripts of an emulated node outlive its restarts: in memory, or in a folder.

use keys::NodeId;
use node::library::{SaveError, ScriptStore};
use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

/// What a script's file ends in.
const EXTENSION: &str = "lua";

/// What a file ends in while it is written.
const UNFINISHED: &str = "unfinished";

/// Lasts as long as the emulator.
#[derive(Debug, Default)]
pub struct MemoryStore {
    scripts: BTreeMap<String, Vec<u8>>,
}

impl ScriptStore for MemoryStore {
    fn load(&mut self, take: &mut dyn FnMut(&str, &[u8])) -> Result<(), SaveError> {
        for (name, text) in &self.scripts {
            take(name, text);
        }
        Ok(())
    }

    fn save(&mut self, name: &str, text: &[u8]) -> Result<(), SaveError> {
        self.scripts.insert(name.to_owned(), text.to_owned());
        Ok(())
    }

    fn remove(&mut self, name: &str) -> Result<(), SaveError> {
        self.scripts.remove(name);
        Ok(())
    }
}

/// One file `NAME.lua` for each script. What goes wrong is told by `tracing`.
#[derive(Debug)]
pub struct FolderStore {
    folder: PathBuf,
}

impl FolderStore {
    /// Opens a folder, and makes it if there is none.
    ///
    /// # Errors
    /// It cannot be made or read.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        fs::read_dir(folder)?;
        Ok(Self {
            folder: folder.to_owned(),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{EXTENSION}"))
    }

    /// Writes beside, then renames: a file of a script's name is always whole.
    fn write(&self, name: &str, text: &[u8]) -> io::Result<()> {
        let beside = self.folder.join(format!("{name}.{UNFINISHED}"));
        let mut file = File::create(&beside)?;
        file.write_all(text)?;
        file.sync_all()?;
        fs::rename(&beside, self.path(name))?;
        self.sync()
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        match fs::remove_file(self.path(name)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            result => result?,
        }
        self.sync()
    }

    /// Makes sure that the folder itself is on the disk.
    fn sync(&self) -> io::Result<()> {
        if cfg!(unix) {
            File::open(&self.folder)?.sync_all()?;
        }
        Ok(())
    }

    fn read(&self, take: &mut dyn FnMut(&str, &[u8])) -> io::Result<()> {
        for entry in fs::read_dir(&self.folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|end| end == UNFINISHED) {
                // Its writing was cut off.
                fs::remove_file(&path)?;
                continue;
            }
            let name = path.file_stem().and_then(|stem| stem.to_str());
            let name = name.filter(|name| {
                path.extension().is_some_and(|end| end == EXTENSION) && NodeId::new(name).is_ok()
            });
            // Other files are none of ours.
            if let Some(name) = name {
                take(name, &fs::read(&path)?);
            }
        }
        Ok(())
    }

    fn told(&self, result: io::Result<()>) -> Result<(), SaveError> {
        result.map_err(|error| {
            tracing::error!("{}: {error}", self.folder.display());
            if error.kind() == io::ErrorKind::StorageFull {
                SaveError::Full
            } else {
                SaveError::Broken
            }
        })
    }
}

impl ScriptStore for FolderStore {
    fn load(&mut self, take: &mut dyn FnMut(&str, &[u8])) -> Result<(), SaveError> {
        let result = self.read(take);
        self.told(result)
    }

    fn save(&mut self, name: &str, text: &[u8]) -> Result<(), SaveError> {
        let result = self.write(name, text);
        self.told(result)
    }

    fn remove(&mut self, name: &str) -> Result<(), SaveError> {
        let result = self.delete(name);
        self.told(result)
    }
}
