//! The zenoh sessions of the gateway: opened, listened to, spoken through, closed.
//!
//! ```text
//!                ┌───────────── this process ──────────────┐
//!  clients ──┐   │  main session (router, or client of the │
//!            ├──▶│    network): jobs, records, orders      │
//!  nodes  ───┘   │       ▲ loopback TCP                    │
//!                │  swift session (client): stop, release, │
//!                │       clock, start                      │
//!                └─────────────────────────────────────────┘
//! ```
//!
//! Two sessions, because a blocking message for a peer that takes nothing holds up all others of
//! the same session until that peer's link is closed. Stops, clock probes and starts must not wait
//! for that: they have a session, and a real-time lane in every link, of their own. Releases are heard by
//! the same session, so that none overtakes the stop that its client sent before it.
//!
//! What is heard is sorted in `ear.rs`. Deliberately absent: any decision about jobs and nodes.

use super::{
    Inbox, WallClock,
    backup::{BACKUP, Backup},
    ear::{Door, Ear, Gets, refuse},
    owners::{self, Owners},
    sizes::low_pass_filter,
    states::StateKeys,
};
use crate::{
    config::{
        CLIENTS_MAX, GATEWAY_USER_DEFAULT, GatewayConfig, MESSAGE_BYTES_MAX, STALLED_PEER_US,
    },
    fleet::{
        event::{Lane, ReplyTo},
        kept::Kind,
    },
    journal::copy::Copier,
    security::{Home, HomeError},
};
use keys::{Keys, NodeId, NodeTopic, Topic, credentials::Credentials, record::JobError, secret};
use std::{
    net::{SocketAddr, TcpListener},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use thiserror::Error;
use tokio::sync::watch;
use zenoh::{
    Session, Wait,
    bytes::{Encoding, ZBytes},
    key_expr::{KeyExpr, keyexpr},
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    qos::{CongestionControl, Priority},
    query::Queryable,
    sample::Locality,
};

/// How often a port that was free and then taken by somebody else is replaced by another one.
const PORT_ATTEMPTS_MAX: usize = 16;

/// How long the router has for taking declarations, and a session for closing.
const ROUTER_PATIENCE: Duration = Duration::from_secs(5);

/// How long another gateway has for answering before this one takes the fleet: one on a busy
/// machine is a rival too. Where there is none, nobody waits for that.
const RIVAL_PATIENCE: Duration = Duration::from_secs(10);

/// The bytes of a job as zenoh keeps them: not copied before they are read.
#[derive(Clone, Debug, Default)]
pub struct Payload(pub(super) ZBytes);

impl Payload {
    /// Returns how many bytes there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns them in one piece.
    pub fn to_bytes(&self) -> std::borrow::Cow<'_, [u8]> {
        self.0.to_bytes()
    }
}

/// Why the network is not there.
#[derive(Debug, Error)]
pub enum BusError {
    /// A locator is not of the form `tcp/HOST:PORT`.
    #[error("{0:?} is no address of the form tcp/HOST:PORT (or tls/HOST:PORT in a secured fleet)")]
    Locator(String),
    /// The folder of a secured fleet cannot be used.
    #[error(transparent)]
    Secure(#[from] HomeError),
    /// The router cannot listen.
    #[error("cannot listen on {listen}: {reason}")]
    Listen {
        /// Where.
        listen: String,
        /// Zenoh's words.
        reason: String,
    },
    /// There is no network to join.
    #[error("cannot connect to {connect}: {reason}")]
    Connect {
        /// Where to.
        connect: String,
        /// Zenoh's words.
        reason: String,
    },
    /// The users file cannot be read.
    #[error("users file {path}: {reason}")]
    Users {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A gateway with the same prefix answers in the network that was joined.
    #[error("another gateway serves the prefix `{0}` in this network")]
    Rival(String),
    /// Zenoh refuses something that it never refuses.
    #[error("zenoh: {0}")]
    Zenoh(String),
}

pub(super) fn zenoh_error(error: zenoh::Error) -> BusError {
    BusError::Zenoh(error.to_string())
}

/// What is declared while the gateway accepts anything. Dropped: undeclared.
#[derive(Default)]
struct Doors {
    subscribers: Vec<Subscriber<()>>,
    queryables: Vec<Queryable<()>>,
    tokens: Vec<LivelinessToken>,
}

/// See the module.
pub struct Bus {
    main: Session,
    swift: Session,
    keys: Keys,
    gets: Arc<Gets>,
    doors: Mutex<Doors>,
    states: StateKeys,
    locators: Vec<String>,
}

impl std::fmt::Debug for Bus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bus")
            .field("prefix", &self.keys.prefix())
            .field("locators", &self.locators)
            .finish_non_exhaustive()
    }
}

impl Bus {
    /// Opens the own router or joins the network. Hears nothing before [`Bus::declare`].
    ///
    /// # Errors
    /// See [`BusError`].
    pub async fn open(config: &GatewayConfig) -> Result<Self, BusError> {
        let own_router = config.connect.is_empty();
        let home = match &config.secure {
            Some(folder) if own_router => Some(Home::open(folder)?),
            _ => None,
        };
        let credentials = match (&config.credentials, &config.users, &home) {
            (Some(given), _, _) => Some(given.clone()),
            (None, Some(file), _) => Some(gateway_entry(file)?),
            (None, None, Some(home)) => Some(home.gateway()),
            (None, None, None) => None,
        };
        let (main, locators) = if own_router {
            open_router(config, home.as_ref()).await?
        } else {
            let main = open_client(&config.connect, credentials.as_ref()).await?;
            (main, config.connect.clone())
        };
        let to: Vec<String> = if own_router {
            locators.iter().map(|locator| reachable(locator)).collect()
        } else {
            config.connect.clone()
        };
        let swift = match open_client(&to, credentials.as_ref()).await {
            Ok(swift) => swift,
            Err(error) => {
                close(&main).await;
                return Err(error);
            }
        };
        let bus = Self {
            main,
            swift,
            keys: config.keys.clone(),
            gets: Arc::new(Gets::new(config.limits)),
            doors: Mutex::default(),
            states: StateKeys::default(),
            locators,
        };
        if !own_router && bus.rival_answers().await? {
            bus.close().await;
            return Err(BusError::Rival(config.keys.prefix().to_owned()));
        }
        Ok(bus)
    }

    /// Returns where clients and nodes connect: where the own router listens, with the ports that
    /// the system chose, or the routers of the network that was joined.
    pub fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Asks for a job: who answers, with whatever, is a gateway.
    async fn rival_answers(&self) -> Result<bool, BusError> {
        let key = format!("{}/job/gateway", self.keys.prefix());
        let replies = self
            .main
            .get(key)
            .allowed_destination(Locality::Remote)
            .timeout(RIVAL_PATIENCE)
            .await
            .map_err(zenoh_error)?;
        while let Ok(reply) = replies.recv_async().await {
            // Zenoh tells a timeout as an error reply in plain text.
            let answer = match reply.result() {
                Ok(_) => true,
                Err(error) => *error.encoding() == Encoding::APPLICATION_JSON,
            };
            if answer {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Declares everything that the gateway hears and answers, and passes it to the inbox.
    ///
    /// # Errors
    /// [`BusError::Zenoh`].
    pub async fn declare(&self, inbox: &Inbox, clock: WallClock) -> Result<(), BusError> {
        let ear = |door: Door| Ear::new(door, inbox, clock, &self.keys, &self.gets);
        let mut doors = Doors::default();
        for (session, door) in [
            (&self.main, Door::Node(NodeTopic::Job)),
            (&self.main, Door::GroupJob),
            (&self.main, Door::JobCancel),
            (&self.main, Door::LabelJob),
            (&self.main, Door::Node(NodeTopic::Status)),
            (&self.main, Door::Node(NodeTopic::Ack)),
            (&self.main, Door::Node(NodeTopic::Report)),
            (&self.main, Door::Node(NodeTopic::Trace)),
            (&self.swift, Door::Node(NodeTopic::Stop)),
            // By the way of the stop, so that it stays behind the stop that its client sent before.
            (&self.swift, Door::Node(NodeTopic::Release)),
            // These lift no stop; and here the clients are told apart.
            (&self.main, Door::Node(NodeTopic::Hold)),
            (&self.main, Door::Node(NodeTopic::Resume)),
            (&self.main, Door::Node(NodeTopic::Speed)),
            (&self.swift, Door::Node(NodeTopic::Clock)),
            (&self.swift, Door::Node(NodeTopic::Start)),
            (&self.swift, Door::Node(NodeTopic::Pace)),
        ] {
            let ear = ear(door);
            let subscriber = session
                .declare_subscriber(door.key(&self.keys))
                // What the gateway itself says on stop, clock and start is for the nodes.
                .allowed_origin(Locality::Remote)
                .callback(move |sample| ear.put(&sample))
                .await
                .map_err(zenoh_error)?;
            doors.subscribers.push(subscriber);
        }
        for (session, door) in [
            (&self.main, Door::Node(NodeTopic::Job)),
            (&self.main, Door::GroupJob),
            (&self.main, Door::JobCancel),
            (&self.swift, Door::Node(NodeTopic::Release)),
            (&self.main, Door::Node(NodeTopic::Hold)),
            (&self.main, Door::Node(NodeTopic::Resume)),
            (&self.main, Door::Node(NodeTopic::Speed)),
            (&self.main, Door::Node(NodeTopic::State)),
            (&self.main, Door::Job),
            (&self.main, Door::LabelJob),
            (&self.main, Door::ManageNode),
            (&self.main, Door::ManageJob),
            (&self.main, Door::Links),
            (&self.main, Door::Keep(Kind::Template)),
            (&self.main, Door::Keep(Kind::Schedule)),
        ] {
            let ear = ear(door);
            let queryable = session
                .declare_queryable(door.key(&self.keys))
                .complete(true)
                .callback(move |query| ear.get(&query))
                .await
                .map_err(zenoh_error)?;
            doors.queryables.push(queryable);
        }
        let door = Door::Node(NodeTopic::Alive);
        let ear = ear(door);
        let alive = self
            .main
            .liveliness()
            .declare_subscriber(door.key(&self.keys))
            .history(true)
            .callback(move |sample| ear.alive(&sample))
            .await
            .map_err(zenoh_error)?;
        doors.subscribers.push(alive);
        *self.doors.lock().unwrap_or_else(PoisonError::into_inner) = doors;
        // Whoever is told after this that the gateway is ready can reach it.
        self.settled(&self.main).await?;
        self.settled(&self.swift).await
    }

    /// Waits until the router knows what this session has declared: it answers what is asked after
    /// the declarations when it has taken them.
    async fn settled(&self, session: &Session) -> Result<(), BusError> {
        let key = self.keys.every_node(NodeTopic::Alive);
        let replies = session
            .liveliness()
            .get(key.as_str())
            .timeout(ROUTER_PATIENCE)
            .await
            .map_err(zenoh_error)?;
        while replies.recv_async().await.is_ok() {}
        Ok(())
    }

    /// Answers a get on [`BACKUP`] with a copy of the store, piece by piece; one at a time.
    ///
    /// # Errors
    /// [`BusError::Zenoh`].
    pub async fn declare_backup(&self, copier: Copier) -> Result<(), BusError> {
        let key = format!("{}/{BACKUP}", self.keys.prefix());
        let backup = Backup::new(key.clone(), copier);
        let queryable = self
            .main
            .declare_queryable(key)
            .complete(true)
            .callback(move |query| backup.answer(query))
            .await
            .map_err(zenoh_error)?;
        let mut doors = self.doors.lock().unwrap_or_else(PoisonError::into_inner);
        doors.queryables.push(queryable);
        Ok(())
    }

    /// Tells the network that this gateway owns the fleet, and keeps `owners` as the network knows
    /// them: by the second session, so that what it sees there is seen by others, too.
    ///
    /// # Errors
    /// [`BusError::Zenoh`].
    pub async fn declare_owner(
        &self,
        epoch: u32,
        owners: watch::Sender<Owners>,
    ) -> Result<(), BusError> {
        let subscriber = owners::watch(&self.swift, &self.keys, owners).await?;
        let token = owners::declare(&self.main, &self.keys, epoch).await?;
        let mut doors = self.doors.lock().unwrap_or_else(PoisonError::into_inner);
        doors.subscribers.push(subscriber);
        doors.tokens.push(token);
        Ok(())
    }

    /// Stops hearing. What already came is not lost.
    pub fn undeclare(&self) {
        let mut doors = self.doors.lock().unwrap_or_else(PoisonError::into_inner);
        *doors = Doors::default();
    }

    /// Puts bytes on a key. On [`Lane::Order`], and on [`Lane::Record`] for a job's record, this
    /// waits until the peer's link takes them, [`STALLED_PEER_US`] at most; a node's record and a
    /// clock probe are dropped instead, the next one says the same.
    pub fn publish(&self, key: &str, payload: Vec<u8>, json: bool, lane: Lane) {
        let (node, topic) = match self.keys.parse(key) {
            Some(Topic::Node { node, topic }) => (NodeId::new(node).ok(), Some(topic)),
            _ => (None, None),
        };
        let latest_wins = matches!(topic, Some(NodeTopic::State | NodeTopic::Clock));
        let congestion = if latest_wins {
            CongestionControl::Drop
        } else {
            CongestionControl::Block
        };
        let (session, priority, express) = match lane {
            Lane::RealTime | Lane::Commit => (&self.swift, Priority::RealTime, true),
            Lane::Order => (&self.main, Priority::Data, false),
            Lane::Record => (&self.main, Priority::Data, false),
        };
        let encoding = if json {
            Encoding::APPLICATION_JSON
        } else {
            Encoding::APPLICATION_OCTET_STREAM.with_schema("postcard")
        };
        let name = match (topic, node) {
            (Some(NodeTopic::State), Some(node)) => self.states.of(session, &self.keys, node),
            _ => KeyExpr::try_from(key).map_err(Into::into),
        };
        let put = name.and_then(|name| {
            session
                .put(name, payload)
                .encoding(encoding)
                .congestion_control(congestion)
                .priority(priority)
                .express(express)
                .wait()
        });
        if let Err(error) = put {
            tracing::error!(key, "not published: {error}");
        }
    }

    /// Gives one reply to a get. `key`: `None` is the error reply.
    pub fn reply(&self, to: ReplyTo, key: Option<&str>, payload: Vec<u8>) {
        let Some(query) = self.gets.get(to) else {
            tracing::error!(?to, "a reply to a get that has ended");
            return;
        };
        let sent = match key {
            None => query
                .reply_err(payload)
                .encoding(Encoding::APPLICATION_JSON)
                .wait(),
            Some(key) => match reply_key(query.key_expr(), key) {
                Some(key) => query
                    .reply(key, payload)
                    .encoding(Encoding::APPLICATION_JSON)
                    .wait(),
                None => return,
            },
        };
        if let Err(error) = sent {
            tracing::debug!("a client left before its reply: {error}");
        }
    }

    /// Gives the error reply to a get and ends it.
    pub fn refuse(&self, to: ReplyTo, error: JobError) {
        if let Some(query) = self.gets.remove(to) {
            refuse(&query, error);
        }
    }

    /// Ends a get.
    pub fn end(&self, to: ReplyTo) {
        self.gets.remove(to);
    }

    /// Closes both sessions; gets that still wait end without a reply.
    pub async fn close(&self) {
        self.undeclare();
        self.gets.end_all();
        close(&self.swift).await;
        close(&self.main).await;
    }
}

/// Sees who owns the fleet, and nothing else: the eyes of a gateway that stands by.
pub(crate) struct Watcher {
    session: Session,
    _subscriber: Subscriber<()>,
}

impl Watcher {
    /// Joins the network and keeps `owners` as it knows them.
    pub(crate) async fn open(
        config: &GatewayConfig,
        owners: watch::Sender<Owners>,
    ) -> Result<Self, BusError> {
        let session = open_client(&config.connect, config.credentials.as_ref()).await?;
        let subscriber = owners::watch(&session, &config.keys, owners).await?;
        Ok(Self {
            session,
            _subscriber: subscriber,
        })
    }

    pub(crate) async fn close(&self) {
        close(&self.session).await;
    }
}

async fn close(session: &Session) {
    match tokio::time::timeout(ROUTER_PATIENCE, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!("closing a session: {error}"),
        Err(_) => tracing::warn!("closing a session took too long"),
    }
}

/// Returns the key under which a record answers a get: its own, if the get's key includes it.
///
/// Zenoh carries only replies on keys that the get's includes. So a job's record answers a cancel
/// on the key of that job's cancel, and a node's record a release on that of the node's release.
/// A record that a wide get (`fleet/node/l*/**`) does not mean is left out.
fn reply_key(asked: &keyexpr, key: &str) -> Option<String> {
    let verb = asked.as_str().rsplit('/').next().unwrap_or_default();
    let parent = key.rsplit_once('/').map_or(key, |(parent, _)| parent);
    // A label's nodes all answer on the one key of its jobs, which names none of them.
    let of_label = asked.as_str().contains("/manage/label/");
    [
        key.to_owned(),
        format!("{key}/{verb}"),
        format!("{parent}/{verb}"),
    ]
    .into_iter()
    .chain(of_label.then(|| asked.as_str().to_owned()))
    .find(|key| {
        keyexpr::new(key.as_str()).is_ok_and(|key| asked.intersects(key) && !key.contains('*'))
    })
}

fn settings(pairs: &[(&str, String)]) -> Result<zenoh::Config, BusError> {
    let mut config = zenoh::Config::default();
    for (key, value) in pairs {
        config
            .insert_json5(key, value)
            .map_err(|error| BusError::Zenoh(format!("{key}: {error}")))?;
    }
    Ok(config)
}

fn json<T: serde::Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).expect("texts and lists of texts are JSON")
}

/// Opens a session in router mode. Returns where it listens.
async fn open_router(
    config: &GatewayConfig,
    home: Option<&Home>,
) -> Result<(Session, Vec<String>), BusError> {
    let wanted = config.listen();
    let mut attempts = 0;
    loop {
        attempts += 1;
        let listen = wanted
            .iter()
            .map(|locator| with_port(locator))
            .collect::<Result<Vec<_>, _>>()?;
        let mut pairs = vec![
            ("mode", json("router")),
            ("listen/endpoints", json(&listen)),
            ("scouting/multicast/enabled", config.scouting.to_string()),
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                STALLED_PEER_US.to_string(),
            ),
            (
                "transport/link/rx/max_message_size",
                MESSAGE_BYTES_MAX.to_string(),
            ),
            (
                "transport/unicast/max_sessions",
                (config.fleet.nodes_max + CLIENTS_MAX).to_string(),
            ),
            ("low_pass_filter", low_pass_filter(&config.keys).to_string()),
        ];
        if let Some(users) = &config.users {
            let file = json(&users.to_string_lossy());
            pairs.push(("transport/auth/usrpwd/dictionary_file", file));
        }
        if let Some(home) = home {
            let settings = home.router_settings(&config.keys)?.into_iter();
            pairs.extend(settings.map(|(key, value)| (key, value.to_string())));
        }
        match zenoh::open(settings(&pairs)?).await {
            Ok(session) => return Ok((session, listen)),
            // Between choosing a port and listening on it somebody else may have taken it.
            Err(_) if listen != wanted && attempts < PORT_ATTEMPTS_MAX => {}
            Err(error) => {
                return Err(BusError::Listen {
                    listen: listen.join(", "),
                    reason: error.to_string(),
                });
            }
        }
    }
}

/// Opens a session in client mode.
async fn open_client(
    connect: &[String],
    credentials: Option<&Credentials>,
) -> Result<Session, BusError> {
    for locator in connect {
        host_and_port(locator)?;
    }
    let mut pairs = vec![
        ("mode", json("client")),
        ("connect/endpoints", json(connect)),
        ("scouting/multicast/enabled", false.to_string()),
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            STALLED_PEER_US.to_string(),
        ),
        (
            "transport/link/rx/max_message_size",
            MESSAGE_BYTES_MAX.to_string(),
        ),
    ];
    if let Some(credentials) = credentials {
        pairs.extend(credentials.zenoh_settings());
    }
    zenoh::open(settings(&pairs)?)
        .await
        .map_err(|error| BusError::Connect {
            connect: connect.join(", "),
            reason: error.to_string(),
        })
}

/// Takes a locator apart: protocol, host, port.
pub(crate) fn host_and_port(locator: &str) -> Result<(&str, &str, u16), BusError> {
    let bad = || BusError::Locator(locator.to_owned());
    let (protocol, address) = locator.split_once('/').ok_or_else(bad)?;
    let (host, port) = address.rsplit_once(':').ok_or_else(bad)?;
    if host.is_empty() || !matches!(protocol, "tcp" | "tls") {
        return Err(bad());
    }
    Ok((protocol, host, port.parse().map_err(|_| bad())?))
}

/// Returns the locator with a port that is free now in place of 0.
fn with_port(locator: &str) -> Result<String, BusError> {
    let (protocol, host, port) = host_and_port(locator)?;
    if port != 0 {
        return Ok(locator.to_owned());
    }
    let free = TcpListener::bind(format!("{host}:0"))
        .and_then(|listener| listener.local_addr())
        .map_err(|error| BusError::Listen {
            listen: locator.to_owned(),
            reason: error.to_string(),
        })?;
    Ok(format!("{protocol}/{host}:{}", free.port()))
}

/// Returns how this process reaches a locator that it listens on.
fn reachable(locator: &str) -> String {
    let Some((protocol, address)) = locator.split_once('/') else {
        return locator.to_owned();
    };
    match address.parse::<SocketAddr>() {
        // The name that is in every certificate that `fleet init` makes.
        Ok(address) if protocol == "tls" => format!("tls/localhost:{}", address.port()),
        Ok(address) if address.ip().is_unspecified() => match address {
            SocketAddr::V4(address) => format!("tcp/127.0.0.1:{}", address.port()),
            SocketAddr::V6(address) => format!("tcp/[::1]:{}", address.port()),
        },
        _ => locator.to_owned(),
    }
}

/// Returns the gateway's own line of the users file.
fn gateway_entry(file: &Path) -> Result<Credentials, BusError> {
    let users = |reason: String| BusError::Users {
        path: file.to_owned(),
        reason,
    };
    let text = secret::read(file).map_err(|error| users(error.to_string()))?;
    text.lines()
        .filter_map(|line| line.split_once(':'))
        .find(|(user, _)| user.trim() == GATEWAY_USER_DEFAULT)
        .map(|(user, password)| Credentials {
            connect: Vec::new(),
            user: user.trim().to_owned(),
            password: password.trim().to_owned(),
            ca: None,
        })
        .ok_or_else(|| {
            users(format!(
                "there must be a line `{GATEWAY_USER_DEFAULT}:PASSWORD`, as which the gateway itself connects"
            ))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_locator_needs_a_host_and_a_port() {
        for bad in [
            "",
            "7447",
            "127.0.0.1:7447",
            "udp/127.0.0.1:7447",
            "tcp/:7447",
            "tcp/localhost",
            "tcp/localhost:x",
            "tcp/localhost:70000",
        ] {
            assert!(host_and_port(bad).is_err(), "{bad}");
        }
        assert_eq!(
            host_and_port("tcp/[::]:7447").expect("legal"),
            ("tcp", "[::]", 7447)
        );
    }

    #[test]
    fn a_record_answers_on_a_key_that_was_asked_for() {
        let key = |asked: &str, key: &str| {
            reply_key(keyexpr::new(asked).expect("legal"), key).unwrap_or_default()
        };
        let job = "fleet/job/part-1";
        assert_eq!(key("fleet/job/*", job), job);
        assert_eq!(key("fleet/**", job), job);
        let cancel = "fleet/job/part-1/cancel";
        assert_eq!(key(cancel, job), cancel);
        assert_eq!(key("fleet/job/part-$*/cancel", job), cancel);
        assert_eq!(key("fleet/job/other/cancel", job), "");
        let state = "fleet/node/left/state";
        let release = "fleet/node/left/release";
        assert_eq!(key(release, state), release);
        assert_eq!(key("fleet/node/*/release", state), release);
        assert_eq!(key("fleet/node/r$*/**", state), "");
    }

    #[test]
    fn the_gateway_reaches_its_own_router_also_when_that_listens_everywhere() {
        assert_eq!(reachable("tcp/0.0.0.0:7447"), "tcp/127.0.0.1:7447");
        assert_eq!(reachable("tcp/[::]:7447"), "tcp/[::1]:7447");
        assert_eq!(reachable("tcp/10.0.0.1:1"), "tcp/10.0.0.1:1");
        assert_eq!(reachable("tcp/plant:1"), "tcp/plant:1");
        assert_eq!(reachable("tls/0.0.0.0:7447"), "tls/localhost:7447");
    }
}
