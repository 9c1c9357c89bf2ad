//! The file that says where the router is, as whom to come, and whose certificates to trust.

use keys::credentials::Credentials;
use std::path::Path;

/// Reads a credentials file that nobody but its owner may read.
///
/// # Errors
/// It cannot be read, others may read it, or it holds no credentials. The words hold nothing of
/// its content.
pub fn read(path: &Path) -> anyhow::Result<Credentials> {
    let text = keys::secret::read(path)?;
    Credentials::from_json(&text).map_err(|why| anyhow::anyhow!("{}: {why}", path.display()))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    fn file(text: &str, mode: u32) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("alice.json");
        std::fs::write(&path, text).expect("a file");
        let permissions = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(&path, permissions).expect("ours");
        (folder, path)
    }

    const ALICE: &str = r#"{"connect":["tls/plant:7447"],"user":"alice","password":"hush"}"#;

    #[test]
    fn a_file_of_the_owner_alone_is_read() {
        let (_folder, path) = file(ALICE, 0o600);
        let read = read(&path).expect("credentials");
        assert_eq!((read.user.as_str(), read.ca), ("alice", None));
    }

    #[test]
    fn a_file_that_others_may_read_is_refused() {
        for mode in [0o644, 0o640, 0o604, 0o660] {
            let (_folder, path) = file(ALICE, mode);
            let error = format!("{:#}", read(&path).expect_err("exposed"));
            assert!(
                error.contains("chmod 600") && !error.contains("hush"),
                "{error}"
            );
        }
    }

    #[test]
    fn what_is_wrong_is_said_without_the_password() {
        let (_folder, path) = file(&ALICE.replace("user", "usr"), 0o600);
        let error = format!("{:#}", read(&path).expect_err("no user"));
        assert!(
            error.contains("line 1") && !error.contains("hush"),
            "{error}"
        );
        let error = format!("{:#}", read(Path::new("/nowhere")).expect_err("no file"));
        assert!(error.contains("/nowhere"), "{error}");
    }
}
