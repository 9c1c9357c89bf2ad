//! Every setting of the gateway, with unit, default and reason.

use crate::{
    bus::limits::ClientLimits, clock_watch::Wall, collector::Collector, fleet::FleetConfig,
    job::gcode::Machines,
};
use keys::{Keys, credentials::Credentials};
use std::{net::SocketAddr, path::PathBuf};

/// Where the gateway's router listens when nothing else is said: this machine only, zenoh's port.
/// Whoever can connect to an unsecured fleet can move it; so that it is reached from elsewhere, its
/// operator has to say so.
pub const LISTEN_DEFAULT: &str = "tcp/127.0.0.1:7447";

/// Where the router of a secured fleet listens when nothing else is said: every interface, people by
/// TLS and nodes by TCP.
pub const LISTEN_SECURE_DEFAULT: [&str; 2] = ["tls/0.0.0.0:7447", "tcp/0.0.0.0:7448"];

/// The entry of a users file under which the gateway itself connects when nothing else is said.
pub const GATEWAY_USER_DEFAULT: &str = "gateway";

/// How long a blocking message waits for a peer that takes nothing before its link is closed, µs.
///
/// Zenoh's own default is five seconds, and all who send through the same session wait along: an
/// order to one node behind a record for a stalled client. A peer on a network that a fleet can
/// run on takes a 64 KiB batch within a second.
pub const STALLED_PEER_US: u64 = 1_000_000;

/// Links of others than nodes to the gateway's own router. Zenoh's default is 1,000 links for all, which
/// a thousand nodes would use up alone.
pub const CLIENTS_MAX: usize = 1_024;

/// Largest message that the router puts together from fragments, bytes: a job and its envelope.
/// Zenoh's default is 1 GiB, for every link.
///
/// Of a larger one zenoh drops the fragments where it puts them together, with a line at its log level
/// `trace` and none to the sender or to whoever stands above the transport. So the gateway cannot refuse
/// it: a get ends by the client's own timeout. Between [`keys::job::JOB_BYTES_MAX`] and this it can.
pub const MESSAGE_BYTES_MAX: usize = keys::job::JOB_BYTES_MAX + (1 << 20);

/// See the module.
#[derive(Clone, Debug)]
pub struct GatewayConfig {
    /// Where the gateway's own router listens, `tcp/HOST:PORT` or, with `secure`, also
    /// `tls/HOST:PORT`. Empty by default: [`LISTEN_DEFAULT`] or [`LISTEN_SECURE_DEFAULT`]. With port 0 the system chooses one, see [`crate::service::Service::locators`]. Of no
    /// meaning together with `connect`.
    pub listen: Vec<String>,
    /// Routers of a zenoh network to join as a client, `tcp/HOST:PORT`. Empty by default: the
    /// gateway brings its own router.
    pub connect: Vec<String>,
    /// Whether another gateway has the same store and network, and one of the two serves, see
    /// [`crate::fleet::owner`]. Needs `connect`. Off by default.
    pub standby: bool,
    /// The file of jobs and nodes; made if it is not there.
    pub store: PathBuf,
    /// Keys of the fleet; prefix `fleet` by default.
    pub keys: Keys,
    /// Lines `NAME:PASSWORD`: who may connect to the gateway's own router. `None` by default:
    /// everybody.
    pub users: Option<PathBuf>,
    /// The folder of a secured fleet, see [`crate::security`]. `None` by default: everybody may
    /// connect, or those of `users`, and whoever is connected may do everything.
    pub secure: Option<PathBuf>,
    /// As whom the gateway connects: to the network of `connect`, or, with `users`, to its own
    /// router. `None` by default: with `users` the entry [`GATEWAY_USER_DEFAULT`] of that file, with
    /// `secure` that of the folder.
    pub credentials: Option<Credentials>,
    /// Bounds and times; its keys are those of `keys`, whatever it says.
    pub fleet: FleetConfig,
    /// What one client may ask for.
    pub limits: ClientLimits,
    /// Where `/metrics` and `/healthz` are served by HTTP, see [`crate::http`]. `None` by default.
    pub http: Option<SocketAddr>,
    /// Where the spans of jobs are sent. `None` by default. The gateway's log must have a layer that
    /// does it, as the program's has.
    pub otlp: Option<Collector>,
    /// Whether the router looks for others, and lets itself be found, by multicast. Off by
    /// default: a fleet must not grow by what happens to be in the same network.
    pub scouting: bool,
    /// The machines of nodes that take G-code. None by default.
    pub machines: Machines,
    /// The clock on the wall. That of this machine by default.
    pub wall: Wall,
}

impl GatewayConfig {
    /// Returns the defaults with this store.
    pub fn new(store: impl Into<PathBuf>) -> Self {
        Self {
            listen: Vec::new(),
            connect: Vec::new(),
            standby: false,
            store: store.into(),
            keys: Keys::default(),
            users: None,
            secure: None,
            credentials: None,
            fleet: FleetConfig::default(),
            limits: ClientLimits::default(),
            http: None,
            otlp: None,
            scouting: false,
            machines: Machines::new(),
            wall: Wall::default(),
        }
    }

    /// Returns where the own router listens.
    pub fn listen(&self) -> Vec<String> {
        let defaults: &[&str] = match self.secure {
            _ if !self.listen.is_empty() => return self.listen.clone(),
            None => &[LISTEN_DEFAULT],
            Some(_) => &LISTEN_SECURE_DEFAULT,
        };
        defaults
            .iter()
            .map(|locator| (*locator).to_owned())
            .collect()
    }
}
