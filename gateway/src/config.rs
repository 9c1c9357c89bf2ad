//! Every setting of the gateway, with unit, default and reason.

use keys::Keys;
use std::path::PathBuf;

/// Where the gateway's router listens when nothing else is said: every interface, zenoh's port.
pub const LISTEN_DEFAULT: &str = "tcp/0.0.0.0:7447";

/// The entry of a users file under which the gateway itself connects when nothing else is said.
pub const GATEWAY_USER_DEFAULT: &str = "gateway";

/// How long a blocking message waits for a peer that takes nothing before its link is closed, µs.
///
/// Zenoh's own default is five seconds, and all who send through the same session wait along: an
/// order to one node behind a record for a stalled client. A peer on a network that a fleet can
/// run on takes a 64 KiB batch within a second.
pub const STALLED_PEER_US: u64 = 1_000_000;

/// Largest message that the router puts together from fragments, bytes: a job and its envelope.
/// Zenoh's default is 1 GiB, for every link.
pub const MESSAGE_BYTES_MAX: usize = keys::job::JOB_BYTES_MAX + (1 << 20);

/// Name and password of a client of a router that asks for them.
#[derive(Clone, PartialEq, Eq)]
pub struct Credentials {
    /// The name.
    pub user: String,
    /// The password.
    pub password: String,
}

impl std::fmt::Debug for Credentials {
    /// Leaves the password out.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Credentials")
            .field("user", &self.user)
            .finish_non_exhaustive()
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct GatewayConfig {
    /// Where the gateway's own router listens, `tcp/HOST:PORT`; [`LISTEN_DEFAULT`] by default.
    /// With port 0 the system chooses one, see [`crate::service::Service::locators`]. Of no
    /// meaning together with `connect`.
    pub listen: Vec<String>,
    /// Routers of a zenoh network to join as a client, `tcp/HOST:PORT`. Empty by default: the
    /// gateway brings its own router.
    pub connect: Vec<String>,
    /// The file of jobs and nodes; made if it is not there.
    pub store: PathBuf,
    /// Keys of the fleet; prefix `fleet` by default.
    pub keys: Keys,
    /// Lines `NAME:PASSWORD`: who may connect to the gateway's own router. `None` by default:
    /// everybody.
    pub users: Option<PathBuf>,
    /// As whom the gateway connects: to the network of `connect`, or, with `users`, to its own
    /// router. `None` by default: with `users` the entry [`GATEWAY_USER_DEFAULT`] of that file.
    pub credentials: Option<Credentials>,
    /// Whether the router looks for others, and lets itself be found, by multicast. Off by
    /// default: a fleet must not grow by what happens to be in the same network.
    pub scouting: bool,
}

impl GatewayConfig {
    /// Returns the defaults with this store.
    pub fn new(store: impl Into<PathBuf>) -> Self {
        Self {
            listen: vec![LISTEN_DEFAULT.to_owned()],
            connect: Vec::new(),
            store: store.into(),
            keys: Keys::default(),
            users: None,
            credentials: None,
            scouting: false,
        }
    }
}
