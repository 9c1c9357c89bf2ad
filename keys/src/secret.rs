//! Files with a secret: a password, a private key, credentials.

use std::{
    borrow::ToOwned as _,
    fmt,
    fs::File,
    io::{self, Read as _},
    path::{Path, PathBuf},
    string::String,
};

/// Largest file that is read, bytes: a certificate chain has a few thousand.
pub const SECRET_BYTES_MAX: u64 = 1 << 20;

/// Why a file with a secret is not used. The words hold nothing of its content.
#[derive(Debug)]
pub enum SecretError {
    /// It cannot be read, or is no text.
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Others than its owner may read it.
    Exposed {
        /// The file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// It has more than [`SECRET_BYTES_MAX`].
    TooLarge(PathBuf),
    /// A password was looked for, and there is none in it.
    Empty(PathBuf),
}

impl fmt::Display for SecretError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable { path, source } => write!(f, "{}: {source}", path.display()),
            Self::Exposed { path, mode } => write!(
                f,
                "{} may be read by others than its owner (mode {mode:03o}); chmod 600",
                path.display()
            ),
            Self::TooLarge(path) => write!(
                f,
                "{}: larger than {SECRET_BYTES_MAX} bytes",
                path.display()
            ),
            Self::Empty(path) => write!(f, "{}: the file is empty", path.display()),
        }
    }
}

impl core::error::Error for SecretError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Unreadable { source, .. } => Some(source),
            _ => None,
        }
    }
}

/// Reads a file that nobody but its owner may read. What is checked is the file that is open, not
/// whatever has its name a moment later. On systems without modes the folder's rights count.
///
/// # Errors
/// See [`SecretError`].
pub fn read(path: &Path) -> Result<String, SecretError> {
    let unreadable = |source| SecretError::Unreadable {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(unreadable)?;
    check_private(path, &file)?;
    let mut text = String::new();
    let mut bounded = file.take(SECRET_BYTES_MAX + 1);
    bounded.read_to_string(&mut text).map_err(unreadable)?;
    if text.len() as u64 > SECRET_BYTES_MAX {
        return Err(SecretError::TooLarge(path.to_owned()));
    }
    Ok(text)
}

/// Reads a file with a password and nothing else; a line end behind it is not part of it.
///
/// # Errors
/// See [`SecretError`].
pub fn read_password(path: &Path) -> Result<String, SecretError> {
    let text = read(path)?;
    let password = text.trim_end_matches(['\r', '\n']);
    if password.is_empty() {
        return Err(SecretError::Empty(path.to_owned()));
    }
    Ok(password.into())
}

/// Refuses an open file that others than its owner may read.
///
/// # Errors
/// [`SecretError::Exposed`], or its permissions cannot be read.
#[cfg(unix)]
pub fn check_private(path: &Path, file: &File) -> Result<(), SecretError> {
    use std::os::unix::fs::PermissionsExt as _;
    let found = file.metadata().map_err(|source| SecretError::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    let mode = found.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        let path = path.to_owned();
        return Err(SecretError::Exposed { path, mode });
    }
    Ok(())
}

/// The lists of other systems are inherited from the folder.
///
/// # Errors
/// None.
#[cfg(not(unix))]
pub fn check_private(_path: &Path, _file: &File) -> Result<(), SecretError> {
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::{format, fs, os::unix::fs::PermissionsExt as _};

    /// A file of its own for each test.
    fn file(name: &str, text: &str, mode: u32) -> PathBuf {
        let name = format!("keys-secret-{}-{name}", std::process::id());
        let path = std::env::temp_dir().join(name);
        fs::write(&path, text).expect("written");
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("ours");
        path
    }

    #[test]
    fn a_password_is_read_from_a_file_of_its_owner_alone() {
        let path = file("owner", "hush\r\n", 0o600);
        assert_eq!(read_password(&path).expect("private"), "hush");
        for mode in [0o640, 0o604, 0o620, 0o644] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("ours");
            let error = format!("{}", read_password(&path).expect_err("exposed"));
            assert!(error.contains(&format!("mode {mode:03o}")), "{error}");
            assert!(!error.contains("hush"), "{error}");
        }
        fs::remove_file(&path).expect("removed");
        assert!(matches!(read(&path), Err(SecretError::Unreadable { .. })));
    }

    #[test]
    fn what_is_checked_is_the_file_that_is_read() {
        let path = file("swapped", "public", 0o644);
        let open = File::open(&path).expect("open");
        fs::remove_file(&path).expect("removed");
        let path = file("swapped", "private", 0o600);
        assert!(check_private(&path, &open).is_err());
        fs::remove_file(&path).expect("removed");
    }

    #[test]
    fn a_file_without_a_password_or_without_an_end_is_none() {
        let path = file("empty", "\n", 0o600);
        assert!(matches!(read_password(&path), Err(SecretError::Empty(_))));
        fs::write(&path, "x".repeat(SECRET_BYTES_MAX as usize + 1)).expect("written");
        assert!(matches!(read(&path), Err(SecretError::TooLarge(_))));
        fs::remove_file(&path).expect("removed");
    }
}
