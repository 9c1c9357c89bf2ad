//! One zenoh session after the other: connect, listen, notice the end, connect again.

use super::{
    Asked, CONNECT_DEFAULT, LinkConfig, Place,
    inbox::Inbox,
    perform::{self, Performer},
    refusal,
};
use crate::{
    message::{Answer, LinkEvent, Message},
    request::Request,
};
use keys::{
    Keys, NodeId, NodeTopic, Setup, Status, Topic, Vitals,
    credentials::Credentials,
    record::{JobRecord, NodeRecord, StartPlan},
    version,
};
use std::{
    collections::BTreeSet,
    pin::pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use tokio::{sync::mpsc, time::MissedTickBehavior};
use zenoh::{Session, sample::Sample, sample::SampleKind};

/// Pause between two attempts.
const RETRY_EVERY: Duration = Duration::from_secs(1);

/// Longest wait for a session to close.
const CLOSE_MAX: Duration = Duration::from_secs(1);

/// Longest attempt.
const OPEN_MAX: Duration = Duration::from_secs(5);

/// Time between two looks whether the router is still there.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Looks between two questions whether a gateway is there: every 2 s.
const LOOKS_PER_PROBE: u32 = 8;

/// Looks before a node of the last session that has not come back is gone: 5 s. After a restart of
/// the router they need some time to notice and to connect.
const LOOKS_BEFORE_GONE: u32 = 20;

/// Longest log line that is taken whole, bytes.
const LINE_BYTES_MAX: usize = 16 << 10;

/// The link's ends of the channels.
pub(super) struct Ends {
    pub(super) urgent: mpsc::Receiver<Asked>,
    pub(super) ordinary: mpsc::Receiver<Asked>,
}

impl Ends {
    /// Returns the next request, stops first; `None` when the window is gone.
    ///
    /// # Cancellation safety
    /// Nothing is lost.
    async fn next(&mut self) -> Option<Asked> {
        tokio::select! {
            biased;
            asked = self.urgent.recv() => asked,
            asked = self.ordinary.recv() => asked,
        }
    }
}

/// Why a session or a pause ended.
enum End {
    /// The window is gone.
    Quit,
    /// The operator wants to go elsewhere.
    Move(Option<String>),
    /// The link is down, for this reason.
    Down(String),
}

/// Runs until the window is gone.
pub(super) async fn run(config: LinkConfig, inbox: Arc<Inbox>, mut ends: Ends) {
    let LinkConfig {
        mut place,
        keys,
        credentials,
    } = config;
    let tokens = Arc::new(Mutex::new(Tokens::default()));
    loop {
        let (to, opened) = match refusing(&mut ends, &inbox, async {
            let places: Vec<Option<&str>> = match &place {
                Place::At(locator) => vec![Some(locator.as_str())],
                Place::OneOf(locators) => locators.iter().map(|to| Some(to.as_str())).collect(),
                Place::Scouted => vec![None],
                Place::Automatic => vec![Some(CONNECT_DEFAULT), None],
            };
            open_any(&places, credentials.as_ref(), &inbox).await
        })
        .await
        {
            Ok(Ok((to, session))) => (to, Ok(session)),
            Ok(Err(why)) => (String::new(), Err(End::Down(why))),
            Err(end) => (String::new(), Err(end)),
        };
        let end = match opened {
            Err(end) => end,
            Ok(session) => {
                inbox.push(Message::Link(LinkEvent::Connected { to }));
                let user = credentials.as_ref().map(|known| known.user.as_str());
                let performer = Performer::new(
                    session.clone(),
                    keys.clone(),
                    Arc::clone(&inbox),
                    user.map(str::to_owned),
                );
                let end = listen(&performer, &keys, &inbox, &tokens, &mut ends).await;
                // The session may be dead already.
                let _ = tokio::time::timeout(CLOSE_MAX, session.close()).await;
                end
            }
        };
        let end = match end {
            End::Down(why) => {
                inbox.push(Message::Link(LinkEvent::Down { why }));
                let pause = refusing(&mut ends, &inbox, tokio::time::sleep(RETRY_EVERY)).await;
                match pause {
                    Ok(()) => continue,
                    Err(end) => end,
                }
            }
            end => end,
        };
        match end {
            End::Quit => return,
            End::Move(to) => {
                place = to.map_or(Place::Scouted, Place::At);
                let why = "the operator connects elsewhere".to_owned();
                inbox.push(Message::Link(LinkEvent::Down { why }));
            }
            End::Down(_) => {}
        }
    }
}

/// Tries one place after the other and returns the words for the first that opens.
async fn open_any(
    places: &[Option<&str>],
    credentials: Option<&Credentials>,
    inbox: &Inbox,
) -> Result<(String, Session), String> {
    let mut failures = Vec::new();
    for locator in places {
        let to = locator.unwrap_or("a router found by scouting").to_owned();
        inbox.push(Message::Link(LinkEvent::Connecting { to: to.clone() }));
        match open(*locator, credentials).await {
            Ok(session) => return Ok((to, session)),
            Err(why) => failures.push(why),
        }
    }
    Err(failures.join("; "))
}

/// Waits for the future and refuses what is asked meanwhile.
async fn refusing<T>(
    ends: &mut Ends,
    inbox: &Inbox,
    future: impl Future<Output = T>,
) -> Result<T, End> {
    let mut future = pin!(future);
    loop {
        tokio::select! {
            biased;
            asked = ends.next() => match asked {
                None => return Err(End::Quit),
                Some((_, Request::Connect { to })) => return Err(End::Move(to)),
                Some((ticket, request)) => {
                    let why = match request {
                        Request::Stop { .. } =>
                            "NOT SENT: there is no link. Use the stop buttons of the machines",
                        _ => "not sent: there is no link",
                    };
                    let answer = Answer::Failed(why.to_owned());
                    inbox.push(Message::Answer { ticket, answer });
                }
            },
            output = &mut future => return Ok(output),
        }
    }
}

async fn open(locator: Option<&str>, credentials: Option<&Credentials>) -> Result<Session, String> {
    let text = |value: &str| serde_json::Value::from(value).to_string();
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: String| {
        config
            .insert_json5(key, &value)
            // The value may be a secret.
            .map_err(|_| match key {
                "connect/endpoints" => {
                    format!("{value} is no address: tcp/HOST:PORT or tls/HOST:PORT")
                }
                _ => format!("zenoh refuses the setting {key}"),
            })
    };
    set("mode", text("client"))?;
    match locator {
        Some(locator) => {
            set("connect/endpoints", format!("[{}]", text(locator)))?;
            set("scouting/multicast/enabled", "false".to_owned())?;
        }
        None => set("scouting/multicast/enabled", "true".to_owned())?,
    }
    if let Some(credentials) = credentials {
        for (key, value) in credentials.zenoh_settings() {
            set(key, value)?;
        }
    }
    match (
        tokio::time::timeout(OPEN_MAX, zenoh::open(config)).await,
        locator,
    ) {
        (Ok(Ok(session)), _) => Ok(session),
        (_, Some(locator)) => Err(refusal::why(locator, credentials).await),
        (_, None) => Err("scouting found no router".to_owned()),
    }
}

/// Which liveliness tokens the model was told to be there.
#[derive(Default)]
struct Tokens {
    told: BTreeSet<NodeId>,
    // Of this session.
    seen: BTreeSet<NodeId>,
    // Gone since the last look. A router that goes takes all tokens with it, a moment before that is
    // noticed: then the nodes are not lost, only unheard of.
    leaving: BTreeSet<NodeId>,
    // Gone since the look before.
    left: BTreeSet<NodeId>,
}

impl Tokens {
    /// Begins a session.
    fn begin(&mut self) {
        self.seen.clear();
        self.leaving.clear();
        self.left.clear();
    }

    /// Takes a token's coming or going, and returns whether it is to be told now.
    fn changed(&mut self, node: NodeId, alive: bool) -> bool {
        if alive {
            self.told.insert(node);
            self.seen.insert(node);
            self.leaving.remove(&node);
            self.left.remove(&node);
        } else {
            self.seen.remove(&node);
            self.leaving.insert(node);
        }
        alive
    }

    /// Returns who is gone for certain: the router is there and was at the last look too.
    fn look(&mut self) -> BTreeSet<NodeId> {
        let certain = std::mem::replace(&mut self.left, std::mem::take(&mut self.leaving));
        for node in &certain {
            self.told.remove(node);
        }
        certain
    }
}

fn lock(tokens: &Mutex<Tokens>) -> MutexGuard<'_, Tokens> {
    // Nothing in there is half done when a callback panics.
    tokens.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn listen(
    performer: &Performer,
    keys: &Keys,
    inbox: &Arc<Inbox>,
    tokens: &Arc<Mutex<Tokens>>,
    ends: &mut Ends,
) -> End {
    let session = performer.session();
    lock(tokens).begin();
    if let Err(error) = subscribe(session, keys, inbox, tokens).await {
        return End::Down(format!("zenoh: {error}"));
    }
    let mut looks = 0_u32;
    let mut ticks = tokio::time::interval(LOOK_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            biased;
            asked = ends.next() => match asked {
                None => return End::Quit,
                Some((_, Request::Connect { to })) => return End::Move(to),
                Some((ticket, request)) => performer.begin(ticket, request),
            },
            _ = ticks.tick() => {
                if session.info().routers_zid().await.next().is_none() {
                    return End::Down("the router is gone".to_owned());
                }
                for node in lock(tokens).look() {
                    inbox.push(Message::Alive { node, alive: false });
                }
                if looks.is_multiple_of(LOOKS_PER_PROBE) {
                    performer.probe();
                }
                if inbox.take_incomplete() {
                    performer.refresh();
                }
                looks = looks.wrapping_add(1);
                if looks == LOOKS_BEFORE_GONE {
                    forget_the_gone(session, keys, inbox, tokens).await;
                }
            }
        }
    }
}

/// Tells of nodes that were there in the last session and are not in this one.
async fn forget_the_gone(session: &Session, keys: &Keys, inbox: &Inbox, tokens: &Mutex<Tokens>) {
    let key = keys.every_node(NodeTopic::Alive);
    let Ok(alive) = perform::tokens(session, keys, key.as_str()).await else {
        return;
    };
    let mut tokens = lock(tokens);
    let there = |node: &NodeId| alive.contains(node) || tokens.seen.contains(node);
    let gone: Vec<NodeId> = tokens
        .told
        .iter()
        .filter(|node| !there(node))
        .copied()
        .collect();
    for node in gone {
        tokens.told.remove(&node);
        inbox.push(Message::Alive { node, alive: false });
    }
}

async fn subscribe(
    session: &Session,
    keys: &Keys,
    inbox: &Arc<Inbox>,
    tokens: &Arc<Mutex<Tokens>>,
) -> zenoh::Result<()> {
    let topics = [
        NodeTopic::Status,
        NodeTopic::State,
        NodeTopic::Log,
        NodeTopic::Vitals,
    ];
    let mut expressions: Vec<String> = Vec::new();
    expressions.extend(topics.map(|topic| keys.every_node(topic).as_str().to_owned()));
    expressions.push(keys.every_job().as_str().to_owned());
    expressions.push(keys.every_start_plan().as_str().to_owned());
    for expression in expressions {
        let (keys, inbox) = (keys.clone(), Arc::clone(inbox));
        session
            .declare_subscriber(expression)
            .callback(move |sample| inbox_sample(&keys, &inbox, &sample))
            .background()
            .await?;
    }
    let (of_token, inbox, tokens) = (keys.clone(), Arc::clone(inbox), Arc::clone(tokens));
    session
        .liveliness()
        .declare_subscriber(keys.every_node(NodeTopic::Alive).as_str())
        .history(true)
        .callback(move |sample| {
            if let Some(node) = node_of(&of_token, &sample) {
                let alive = sample.kind() == SampleKind::Put;
                if lock(&tokens).changed(node, alive) {
                    inbox.push(Message::Alive { node, alive });
                }
            }
        })
        .background()
        .await
}

fn node_of(keys: &Keys, sample: &Sample) -> Option<NodeId> {
    match keys.parse(sample.key_expr().as_str())? {
        Topic::Node { node, .. } => NodeId::new(node).ok(),
        _ => None,
    }
}

/// Reads a sample and puts it into the inbox.
pub(super) fn inbox_sample(keys: &Keys, inbox: &Inbox, sample: &Sample) {
    let key = sample.key_expr().as_str();
    let payload = sample.payload().to_bytes();
    let message = match keys.parse(key) {
        Some(Topic::Node { node, topic }) => {
            let Ok(node) = NodeId::new(node) else { return };
            node_message(node, topic, &payload)
        }
        Some(Topic::Job { .. }) => serde_json::from_slice::<JobRecord>(&payload)
            .map(|record| Some(Message::Job(Box::new(record))))
            .map_err(|error| error.to_string()),
        Some(Topic::StartPlan { .. }) => serde_json::from_slice::<StartPlan>(&payload)
            .map(|plan| Some(Message::StartPlan(plan)))
            .map_err(|error| error.to_string()),
        _ => return,
    };
    match message {
        Ok(Some(message)) => inbox.push(message),
        Ok(None) => {}
        Err(why) => inbox.push(Message::Unreadable {
            key: key.to_owned(),
            why,
        }),
    }
}

fn node_message(node: NodeId, topic: NodeTopic, payload: &[u8]) -> Result<Option<Message>, String> {
    Ok(match topic {
        NodeTopic::Status => {
            let status: Status = version::decode(payload).map_err(|error| error.to_string())?;
            let status = Box::new(status);
            Some(Message::Status { node, status })
        }
        NodeTopic::Vitals => {
            let vitals = Vitals::decode(payload).map_err(|error| error.to_string())?;
            Some(Message::Vitals { node, vitals })
        }
        NodeTopic::Setup => {
            let setup = Box::new(Setup::from_json(payload)?);
            Some(Message::Setup { node, setup })
        }
        NodeTopic::State => {
            let record: NodeRecord =
                serde_json::from_slice(payload).map_err(|error| error.to_string())?;
            Some(Message::Node(Box::new(record)))
        }
        NodeTopic::Log => {
            let kept = &payload[..payload.len().min(LINE_BYTES_MAX)];
            let text = String::from_utf8_lossy(kept).into_owned();
            Some(Message::Log { node, text })
        }
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_lost_only_if_the_router_outlives_its_token_by_two_looks() {
        let node = NodeId::new("left").expect("a name");
        let mut tokens = Tokens::default();
        assert!(tokens.changed(node, true), "told at once");
        assert!(!tokens.changed(node, false), "the router may be going too");
        assert!(tokens.look().is_empty());
        assert_eq!(tokens.look(), BTreeSet::from([node]));
        assert!(tokens.look().is_empty(), "told once");
        // Back before the second look: never lost.
        tokens.changed(node, true);
        tokens.changed(node, false);
        tokens.look();
        tokens.changed(node, true);
        assert!(tokens.look().is_empty());
        // The router went too: a new session decides.
        tokens.changed(node, false);
        tokens.look();
        tokens.begin();
        assert!(tokens.look().is_empty());
        assert!(
            tokens.told.contains(&node),
            "to be asked for in the new session"
        );
    }
}
