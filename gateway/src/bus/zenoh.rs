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
//! for that: they have a session, and a real-time lane in every link, of their own.
//!
//! Stops and releases of clients are heard by one and the same session, so that no release overtakes the
//! stop that its client sent before it: by the router's own, which hears each link first hand and so
//! knows the clients apart ([`limits`](super::limits)); in a network that was joined by the second one,
//! whose link nothing else fills. The router's session hears what the second one says, too: that has
//! stamps of its own, and stops with such a stamp are not taken for a client's.
//!
//! What is heard is sorted in `ear.rs`. Deliberately absent: any decision about jobs and nodes.

use super::{
    Inbox, WallClock,
    backup::{BACKUP, Backup},
    door::Door,
    ear::Ear,
    gets::{Gets, refuse, reply_key},
    owners::{self, Owners},
    sessions::{close, gateway_entry, open_client, open_router, reachable},
    states::StateKeys,
};
use crate::{
    config::GatewayConfig,
    fleet::{
        event::{Lane, ReplyTo},
        kept::Kind,
    },
    journal::copy::Copier,
    security::{Home, HomeError},
};
use keys::{Keys, NodeId, NodeTopic, Topic, record::JobError};
use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use thiserror::Error;
use tokio::sync::watch;
use zenoh::{
    Session, Wait,
    bytes::{Encoding, ZBytes},
    key_expr::KeyExpr,
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    qos::{CongestionControl, Priority},
    query::Queryable,
    sample::Locality,
    time::TimestampId,
};

pub(crate) use super::sessions::host_and_port;

/// How long the router has for taking declarations, and a session for closing.
pub(super) const ROUTER_PATIENCE: Duration = Duration::from_secs(5);

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
    /// With an own router: whose stamps what `swift` says has.
    own_stamps: Option<TimestampId>,
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
            own_stamps: own_router.then(|| swift.zid().into()),
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
        let ear = |door: Door| {
            let own_stamps = self.own_stamps;
            Ear::new(door, inbox, clock, &self.keys, &self.gets, own_stamps)
        };
        let mut doors = Doors::default();
        // Both or none by the same way: a release must stay behind its client's stop.
        let stops = match self.own_stamps {
            Some(_) => &self.main,
            None => &self.swift,
        };
        for (session, door) in [
            (&self.main, Door::Node(NodeTopic::Job)),
            (&self.main, Door::GroupJob),
            (&self.main, Door::JobCancel),
            (&self.main, Door::LabelJob),
            (&self.main, Door::Node(NodeTopic::Status)),
            (&self.main, Door::Node(NodeTopic::Ack)),
            (&self.main, Door::Node(NodeTopic::Report)),
            (&self.main, Door::Node(NodeTopic::Trace)),
            (stops, Door::Node(NodeTopic::Stop)),
            (stops, Door::Node(NodeTopic::Release)),
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
            (stops, Door::Node(NodeTopic::Release)),
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
        let subscriber = owners::watch_owners(&self.swift, &self.keys, owners).await?;
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
    /// waits until the peer's link takes them, [`STALLED_PEER_US`](crate::config::STALLED_PEER_US) at
    /// most; a node's record and a clock probe are dropped instead, the next one says the same.
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
            _ => KeyExpr::try_from(key),
        };
        // The router puts its own stamp on what has none, also on a client's stop.
        let stamp = (topic == Some(NodeTopic::Stop)).then(|| session.new_timestamp());
        let put = name.and_then(|name| {
            session
                .put(name, payload)
                .encoding(encoding)
                .timestamp(stamp)
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
