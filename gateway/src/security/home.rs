//! The folder of a secured fleet: made once, read at every start of the gateway.

use super::{
    access, certificates,
    signing::Signer,
    users::{self, GATEWAY, Role, User},
};
use keys::{
    Keys, NodeId,
    credentials::Credentials,
    secret::{self, SecretError},
    signers::{self, SignerKey},
};
use serde_json::Value;
use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};
use thiserror::Error;

/// Port of the router for people: TLS.
pub const TLS_PORT: u16 = 7447;

/// Port of the router for nodes: plain TCP, by name and password.
pub const NODES_PORT: u16 = 7448;

const CA: &str = "ca.pem";
const CA_KEY: &str = "ca.key";
const ROUTER: &str = "router.pem";
const ROUTER_KEY: &str = "router.key";
const USERS: &str = "users";
const HOSTS: &str = "hosts";
const SIGNERS: &str = "signers";
/// Says that jobs need a signature, whoever can give one.
const SIGNING: &str = "signing";
/// The users as the router reads them, written at every start.
const DICTIONARY: &str = "router-users";

/// Files that nobody but their owner may read.
const SECRETS: [&str; 3] = [CA_KEY, ROUTER_KEY, USERS];

/// Why the folder of a secured fleet cannot be made or used.
#[derive(Debug, Error)]
pub enum HomeError {
    /// There is a fleet in it.
    #[error("{} has a fleet in it already; `fleet users` changes who may connect", .0.display())]
    Exists(PathBuf),
    /// There is no fleet in it.
    #[error("{} is no folder of a secured fleet (`fleet init` makes one): {why}", .folder.display())]
    NoFleet {
        /// The folder.
        folder: PathBuf,
        /// How that showed.
        why: String,
    },
    /// A file with a secret cannot be read, or others than its owner may read it.
    #[error(transparent)]
    Secret(#[from] SecretError),
    /// The users file is wrong.
    #[error("{}: {why}", .path.display())]
    Users {
        /// The file.
        path: PathBuf,
        /// The line and what is wrong.
        why: String,
    },
    /// A user of this name exists, or does not.
    #[error("{0}")]
    User(String),
    /// A name under which the router is reached cannot be in a certificate.
    #[error("no certificate for {hosts}: {why}")]
    Hosts {
        /// The names.
        hosts: String,
        /// What is wrong.
        why: String,
    },
    /// A file cannot be read or written.
    #[error("{}: {source}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The system has no random numbers.
    #[error("no random numbers: {0}")]
    Random(#[from] getrandom::Error),
}

/// The folder of a secured fleet.
#[derive(Debug)]
pub struct Home {
    folder: PathBuf,
    users: Vec<User>,
    /// Names and addresses under which clients reach the router.
    hosts: Vec<String>,
    ca: String,
}

impl Home {
    /// Makes a fleet in a folder that has none: authority, router's certificate, and the user as
    /// which the gateway connects. `hosts`: names and addresses under which clients reach the
    /// router; `localhost` is always one.
    ///
    /// # Errors
    /// See [`HomeError`]. A folder with a fleet is left as it is.
    pub fn init(folder: &Path, hosts: &[String]) -> Result<Self, HomeError> {
        if folder.join(USERS).exists() || folder.join(CA_KEY).exists() {
            return Err(HomeError::Exists(folder.to_owned()));
        }
        let mut all = hosts.to_vec();
        for own in ["localhost", "127.0.0.1"] {
            if !all.iter().any(|host| host == own) {
                all.push(own.to_owned());
            }
        }
        let made = certificates::make(&all).map_err(|error| HomeError::Hosts {
            hosts: all.join(", "),
            why: error.to_string(),
        })?;
        make_folder(folder)?;
        write(&folder.join(CA_KEY), &made.ca_key, true)?;
        write(&folder.join(CA), &made.ca, false)?;
        write(&folder.join(ROUTER_KEY), &made.router_key, true)?;
        write(&folder.join(ROUTER), &made.router, false)?;
        write(&folder.join(HOSTS), &(all.join("\n") + "\n"), false)?;
        let name = NodeId::new(GATEWAY).expect("it is a name");
        let mut home = Self {
            folder: folder.to_owned(),
            users: vec![User::new(name, Role::Gateway)?],
            hosts: all,
            ca: made.ca,
        };
        home.save()?;
        Ok(home)
    }

    /// Opens the folder of a fleet.
    ///
    /// # Errors
    /// See [`HomeError`]; also when somebody else may read a secret in it.
    pub fn open(folder: &Path) -> Result<Self, HomeError> {
        let no_fleet = |why: String| HomeError::NoFleet {
            folder: folder.to_owned(),
            why,
        };
        for secret in SECRETS {
            let path = folder.join(secret);
            if !path.exists() {
                return Err(no_fleet(format!("there is no {secret}")));
            }
            // Zenoh reads them by their names; nobody but the owner of the folder can exchange them.
            secret::read(&path)?;
        }
        let path = folder.join(USERS);
        let users =
            users::parse(&secret::read(&path)?).map_err(|why| HomeError::Users { path, why })?;
        if !users.iter().any(|user| user.role == Role::Gateway) {
            return Err(no_fleet("its users have no gateway".to_owned()));
        }
        let hosts = read(&folder.join(HOSTS))?;
        Ok(Self {
            folder: folder.to_owned(),
            users,
            hosts: hosts.lines().map(str::to_owned).collect(),
            ca: read(&folder.join(CA))?,
        })
    }

    /// Returns who may connect.
    pub fn users(&self) -> &[User] {
        &self.users
    }

    /// Adds a user, and writes a file with the credentials to hand out. Returns that file.
    ///
    /// # Errors
    /// See [`HomeError`]: the name is taken, or nothing can be written.
    pub fn add(&mut self, name: NodeId, role: Role) -> Result<PathBuf, HomeError> {
        if self.users.iter().any(|user| user.name == name) {
            return Err(HomeError::User(format!("there is a user {name} already")));
        }
        let user = User::new(name, role)?;
        let path = self.folder.join(format!("{name}.json"));
        write(&path, &self.credentials(&user).to_json(), true)?;
        self.users.push(user);
        self.save()?;
        Ok(path)
    }

    /// Takes a user away, and the file with the credentials if it is still there.
    ///
    /// # Errors
    /// See [`HomeError`]: there is no such user, it is the gateway, or nothing can be written.
    pub fn revoke(&mut self, name: &NodeId) -> Result<(), HomeError> {
        let user = self.users.iter().find(|user| user.name == *name);
        match user.map(|user| user.role) {
            None => return Err(HomeError::User(format!("there is no user {name}"))),
            Some(Role::Gateway) => {
                let words = "without the gateway there is no fleet".to_owned();
                return Err(HomeError::User(words));
            }
            Some(_) => {}
        }
        self.users.retain(|user| user.name != *name);
        self.save()?;
        let path = self.folder.join(format!("{name}.json"));
        match fs::remove_file(&path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(HomeError::File { path, source })
            }
            _ => Ok(()),
        }
    }

    /// Returns what a user needs to connect: people by TLS, nodes by TCP.
    pub fn credentials(&self, user: &User) -> Credentials {
        let at = |host: &String| match user.role {
            // An address of the sixth version stands in brackets.
            _ if host.contains(':') => format!("[{host}]"),
            _ => host.clone(),
        };
        let hosts = self.hosts.iter().map(at);
        let connect = match user.role {
            Role::Node => hosts
                .map(|host| format!("tcp/{host}:{NODES_PORT}"))
                .collect(),
            _ => hosts.map(|host| format!("tls/{host}:{TLS_PORT}")).collect(),
        };
        Credentials {
            connect,
            user: user.name.to_string(),
            password: user.password.clone(),
            ca: Some(self.ca.clone()),
        }
    }

    /// Returns as whom the gateway connects to its own router.
    pub fn gateway(&self) -> Credentials {
        let mut users = self.users.iter();
        let user = users.find(|user| user.role == Role::Gateway);
        self.credentials(user.expect("it was there when the folder was opened"))
    }

    /// Returns zenoh's settings of the router, by name. Writes the users where the router reads them.
    ///
    /// # Errors
    /// See [`HomeError`]: nothing can be written.
    pub fn router_settings(&self, keys: &Keys) -> Result<Vec<(&'static str, Value)>, HomeError> {
        let dictionary = self.folder.join(DICTIONARY);
        let line = |user: &User| format!("{}:{}\n", user.name, user.password);
        let lines: String = self.users.iter().map(line).collect();
        write(&dictionary, &lines, true)?;
        let path = |name: &str| Value::from(self.folder.join(name).to_string_lossy());
        Ok(vec![
            ("transport/auth/usrpwd/dictionary_file", path(DICTIONARY)),
            ("transport/link/tls/listen_certificate", path(ROUTER)),
            ("transport/link/tls/listen_private_key", path(ROUTER_KEY)),
            ("access_control", access::access_control(keys, &self.users)),
        ])
    }

    /// Returns the signing keys that there are.
    ///
    /// # Errors
    /// See [`HomeError`]: the list is wrong.
    pub fn signers(&self) -> Result<Vec<SignerKey>, HomeError> {
        Ok(self.signing()?.unwrap_or_default())
    }

    /// Returns whose signature counts; `None`: jobs need none.
    ///
    /// A fleet that had a key once goes on asking for signatures, whatever becomes of the list, until
    /// [`Home::sign_no_more`]: revoking the last key, or losing the file, must not open the door.
    ///
    /// # Errors
    /// See [`HomeError`]: the list is wrong, or nothing can be written.
    pub fn signing(&self) -> Result<Option<Vec<SignerKey>>, HomeError> {
        let path = self.folder.join(SIGNERS);
        if !path.exists() {
            return Ok(self.folder.join(SIGNING).exists().then(Vec::new));
        }
        // Also for a fleet whose keys are older than this file.
        self.mark_signing()?;
        let read = signers::parse(&read(&path)?);
        read.map(Some).map_err(|why| HomeError::Users { path, why })
    }

    fn mark_signing(&self) -> Result<(), HomeError> {
        let mark = self.folder.join(SIGNING);
        if mark.exists() {
            return Ok(());
        }
        let words = "Jobs need a signature, also when nobody is left who can sign.\n\
                     `fleet keys DIR off` ends that.\n";
        write(&mark, words, false)
    }

    /// Lets jobs without a signature in again, from the gateway's next start. Keys that there are do
    /// not count any more.
    ///
    /// # Errors
    /// See [`HomeError`]: the fleet asks for no signatures, or a file cannot be removed.
    pub fn sign_no_more(&mut self) -> Result<(), HomeError> {
        if self.signing()?.is_none() {
            let words = "this fleet asks for no signatures".to_owned();
            return Err(HomeError::User(words));
        }
        // The list first: what is cut off between the two still asks for signatures.
        for name in [SIGNERS, SIGNING] {
            let path = self.folder.join(name);
            match fs::remove_file(&path) {
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(HomeError::File { path, source });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Makes a signing key. Returns the file with the private half, to be handed to its owner.
    ///
    /// # Errors
    /// See [`HomeError`]: the name is taken, or nothing can be written.
    pub fn add_signer(&mut self, name: NodeId) -> Result<PathBuf, HomeError> {
        let mut signers = self.signers()?;
        if signers.iter().any(|signer| signer.name == name) {
            return Err(HomeError::User(format!("there is a key of {name} already")));
        }
        let signer = Signer::new()?;
        let path = self.folder.join(format!("{name}.key"));
        write(&path, &signer.secret(), true)?;
        let key = signer.public();
        signers.push(SignerKey { name, key });
        self.mark_signing()?;
        write(&self.folder.join(SIGNERS), &signers::print(&signers), false)?;
        Ok(path)
    }

    /// Takes a signing key away, and the file with its private half if it is still there.
    ///
    /// # Errors
    /// See [`HomeError`]: there is no such key, or nothing can be written.
    pub fn revoke_signer(&mut self, name: &NodeId) -> Result<(), HomeError> {
        let mut signers = self.signers()?;
        let before = signers.len();
        signers.retain(|signer| signer.name != *name);
        if signers.len() == before {
            return Err(HomeError::User(format!("there is no key of {name}")));
        }
        write(&self.folder.join(SIGNERS), &signers::print(&signers), false)?;
        let path = self.folder.join(format!("{name}.key"));
        match fs::remove_file(&path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(HomeError::File { path, source })
            }
            _ => Ok(()),
        }
    }

    fn save(&mut self) -> Result<(), HomeError> {
        write(&self.folder.join(USERS), &users::print(&self.users), true)
    }
}

/// Reads a file with a secret.
///
/// # Errors
/// It cannot be read, or others than its owner may read it.
pub fn read_secret(path: &Path) -> Result<String, HomeError> {
    Ok(secret::read(path)?)
}

/// Writes a file with a secret, for its owner only.
///
/// # Errors
/// It cannot be written.
pub fn write_secret(path: &Path, text: &str) -> Result<(), HomeError> {
    write(path, text, true)
}

fn read(path: &Path) -> Result<String, HomeError> {
    fs::read_to_string(path).map_err(|source| HomeError::File {
        path: path.to_owned(),
        source,
    })
}

fn make_folder(folder: &Path) -> Result<(), HomeError> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder).map_err(|source| HomeError::File {
        path: folder.to_owned(),
        source,
    })
}

/// Writes a file as a whole or not at all; a secret is never readable by others, not even at first.
fn write(path: &Path, text: &str, secret: bool) -> Result<(), HomeError> {
    let failed = |source| HomeError::File {
        path: path.to_owned(),
        source,
    };
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    let new = PathBuf::from(name);
    // Left over from a write that was cut off, perhaps with other permissions.
    match fs::remove_file(&new) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(failed(error)),
        _ => {}
    }
    let mut options = fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, if secret { 0o600 } else { 0o644 });
    #[cfg(not(unix))]
    let _ = secret;
    let mut file = options.open(&new).map_err(failed)?;
    file.write_all(text.as_bytes()).map_err(failed)?;
    file.sync_all().map_err(failed)?;
    drop(file);
    fs::rename(&new, path).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> NodeId {
        NodeId::new(text).expect("legal")
    }

    #[test]
    fn a_fleet_is_made_once_and_its_users_come_and_go() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path().join("plant");
        let mut home = Home::init(&folder, &["plant.local".into()]).expect("made");
        let file = home.add(name("alice"), Role::Operator).expect("added");
        let text = read_secret(&file).expect("private");
        let alice = Credentials::from_json(&text).expect("credentials");
        assert_eq!(alice.connect[0], "tls/plant.local:7447");
        let node = home.add(name("left"), Role::Node).expect("added");
        let left = Credentials::from_json(&read_secret(&node).expect("private"));
        assert_eq!(
            left.expect("credentials").connect[0],
            "tcp/plant.local:7448"
        );

        let mut again = Home::open(&folder).expect("opens");
        assert_eq!(again.users(), home.users());
        assert!(matches!(
            again.add(name("alice"), Role::Viewer),
            Err(HomeError::User(_))
        ));
        again.revoke(&name("alice")).expect("revoked");
        assert!(!file.exists());
        assert!(again.revoke(&name("alice")).is_err());
        assert!(again.revoke(&name("gateway")).is_err());
        assert_eq!(Home::open(&folder).expect("opens").users().len(), 2);
        assert!(matches!(
            Home::init(&folder, &[]),
            Err(HomeError::Exists(_))
        ));
    }

    #[test]
    fn a_fleet_that_signs_goes_on_asking_for_signatures_until_it_is_told_otherwise() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut home = Home::init(folder.path(), &[]).expect("made");
        let asked = |home: &Home| home.signing().expect("read").map(|keys| keys.len());
        assert_eq!(asked(&home), None);
        assert!(home.sign_no_more().is_err(), "it does not");
        home.add_signer(name("alice")).expect("made");
        assert_eq!(asked(&home), Some(1));
        home.revoke_signer(&name("alice")).expect("revoked");
        assert_eq!(asked(&home), Some(0), "the last one is revoked");
        fs::remove_file(folder.path().join(SIGNERS)).expect("removed");
        let mut home = Home::open(folder.path()).expect("opens");
        assert_eq!(asked(&home), Some(0), "the list is lost");
        home.sign_no_more().expect("told");
        assert_eq!(asked(&home), None);
        // A list from before there was a mark.
        home.add_signer(name("bob")).expect("made");
        fs::remove_file(folder.path().join(SIGNING)).expect("removed");
        assert_eq!(asked(&home), Some(1));
        fs::remove_file(folder.path().join(SIGNERS)).expect("removed");
        assert_eq!(asked(&home), Some(0));
    }

    #[test]
    fn a_folder_without_a_fleet_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = Home::open(folder.path()).expect_err("nothing there");
        assert!(error.to_string().contains("fleet init"), "{error}");
    }

    #[test]
    #[cfg(unix)]
    fn a_secret_that_others_may_read_is_refused() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().expect("a folder");
        Home::init(folder.path(), &[]).expect("made");
        let users = folder.path().join("users");
        fs::set_permissions(&users, fs::Permissions::from_mode(0o640)).expect("set");
        let error = Home::open(folder.path()).expect_err("exposed");
        assert!(error.to_string().contains("mode 640"), "{error}");
    }
}
