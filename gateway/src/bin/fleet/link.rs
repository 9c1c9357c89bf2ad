//! An ordinary zenoh client: the command line speaks to the fleet as anybody else would.

use crate::args::{CONNECT_DEFAULT, Common};
use gateway::security::home::read_secret;
use keys::{
    Keys, NodeId, Topic,
    credentials::Credentials,
    record::{ErrorReply, JobError},
};
use serde::de::DeserializeOwned;
use std::{path::Path, time::Duration};
use zenoh::{
    Session,
    bytes::Encoding,
    handlers::FifoChannelHandler,
    pubsub::Subscriber,
    qos::{CongestionControl, Priority},
    query::ConsolidationMode,
    sample::Sample,
};

/// A subscriber that is read with `recv_async`.
pub(crate) type Samples = Subscriber<FifoChannelHandler<Sample>>;

/// Why a command ends with another exit code than 0.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The job or the request failed; the words have been printed, or are here.
    Failed(Option<String>),
    /// A bad option or file.
    Usage(String),
    /// No connection, or no gateway answers.
    Connection(String),
    /// Timed out waiting.
    TimedOut(String),
}

impl Failure {
    /// Returns the exit code, see the help text.
    pub(crate) fn code(&self) -> u8 {
        match self {
            Self::Failed(_) => 1,
            Self::Usage(_) => 2,
            Self::Connection(_) => 3,
            Self::TimedOut(_) => 4,
        }
    }

    /// Returns what is still to be printed.
    pub(crate) fn message(&self) -> Option<&str> {
        match self {
            Self::Failed(message) => message.as_deref(),
            Self::Usage(message) | Self::Connection(message) | Self::TimedOut(message) => {
                Some(message)
            }
        }
    }
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::Failed(Some(format!("{error:#}")))
    }
}

impl From<zenoh::Error> for Failure {
    /// What zenoh refuses after the session is open: the session is gone.
    fn from(error: zenoh::Error) -> Self {
        Self::Connection(format!("zenoh: {error}"))
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Failed(Some(error.to_string()))
    }
}

/// Longest time for something large: a store of gigabytes by a slow link.
const POUR_MAX: Duration = Duration::from_secs(6 * 3_600);

/// One answer to a get.
pub(crate) type Answer = Result<Vec<u8>, JobError>;

/// See the module.
pub(crate) struct Link {
    session: Session,
    keys: Keys,
    connect: String,
    timeout: Duration,
}

/// Reads `--credentials`, or `--user` and `--password-file`.
pub(crate) fn credentials(common: &Common) -> Result<Option<Credentials>, Failure> {
    if let Some(file) = &common.credentials {
        let usage = |error: String| Failure::Usage(format!("--credentials: {error}"));
        let text = read_secret(file).map_err(|error| usage(error.to_string()))?;
        let read = Credentials::from_json(&text);
        let name = file.display();
        return read
            .map(Some)
            .map_err(|error| usage(format!("{name}: {error}")));
    }
    let (Some(user), Some(file)) = (&common.user, &common.password_file) else {
        return Ok(None);
    };
    let password = read_password(file)?;
    Ok(Some(Credentials {
        connect: Vec::new(),
        user: user.clone(),
        password,
        ca: None,
    }))
}

fn read_password(file: &Path) -> Result<String, Failure> {
    let name = file.display();
    let text = std::fs::read_to_string(file)
        .map_err(|error| Failure::Usage(format!("--password-file {name}: {error}")))?;
    let password = text.trim_end_matches(['\r', '\n']);
    if password.is_empty() {
        let message = format!("--password-file {name}: the file is empty");
        return Err(Failure::Usage(message));
    }
    Ok(password.to_owned())
}

impl Link {
    /// Connects as a client.
    pub(crate) async fn open(common: &Common) -> Result<Self, Failure> {
        let credentials = credentials(common)?;
        let named = credentials.as_ref().and_then(|read| read.connect.first());
        let connect = common.connect.as_deref();
        let connect = connect
            .or(named.map(String::as_str))
            .unwrap_or(CONNECT_DEFAULT);
        Self::connect(connect, common.keys(), credentials.as_ref(), common.timeout).await
    }

    /// Connects as a client to this locator.
    pub(crate) async fn connect(
        connect: &str,
        keys: Keys,
        credentials: Option<&Credentials>,
        timeout: Duration,
    ) -> Result<Self, Failure> {
        let text = |value: &str| serde_json::Value::from(value).to_string();
        let mut config = zenoh::Config::default();
        let mut set = |key: &str, value: String| {
            config
                .insert_json5(key, &value)
                .map_err(|error| Failure::Usage(format!("--connect {connect}: {error}")))
        };
        let known = connect.starts_with("tcp/") || connect.starts_with("tls/");
        if !known || !connect.contains(':') {
            let message = format!(
                "--connect {connect}: an address has the form tcp/HOST:PORT or tls/HOST:PORT"
            );
            return Err(Failure::Usage(message));
        }
        set("mode", text("client"))?;
        set("connect/endpoints", format!("[{}]", text(connect)))?;
        set("scouting/multicast/enabled", "false".to_owned())?;
        if let Some(credentials) = credentials {
            for (key, value) in credentials.zenoh_settings() {
                set(key, value)?;
            }
        }
        let no_connection = |why: &str| {
            let whom = match credentials {
                Some(credentials) => format!(" as user {:?}", credentials.user),
                None => String::new(),
            };
            Failure::Connection(format!(
                "cannot connect to {connect}{whom}: {why}\n\
                 Is the gateway running (`fleet serve`), and is --connect its address?"
            ))
        };
        let session = match tokio::time::timeout(timeout, zenoh::open(config)).await {
            Ok(Ok(session)) => session,
            Ok(Err(_)) if credentials.is_none() => {
                return Err(no_connection(
                    "nothing that speaks zenoh answers there, or it asks for a user",
                ));
            }
            Ok(Err(_)) => {
                return Err(no_connection(
                    "nothing that speaks zenoh answers there, or it refuses the password",
                ));
            }
            Err(_) => {
                let why = format!("no answer within {} s", timeout.as_secs_f64());
                return Err(no_connection(&why));
            }
        };
        Ok(Self {
            session,
            keys,
            connect: connect.to_owned(),
            timeout,
        })
    }

    /// Returns the keys of the fleet.
    pub(crate) fn keys(&self) -> &Keys {
        &self.keys
    }

    /// Returns the longest wait for an answer.
    pub(crate) fn timeout(&self) -> Duration {
        self.timeout
    }

    /// Asks the gateway, with a payload or without.
    ///
    /// No answer at all is an empty list if there is a gateway that has nothing to say.
    pub(crate) async fn get(
        &self,
        selector: &str,
        payload: Option<(Vec<u8>, Encoding)>,
    ) -> Result<Vec<Answer>, Failure> {
        self.get_with(selector, payload, None).await
    }

    /// As [`Link::get`], with an attachment.
    pub(crate) async fn get_with(
        &self,
        selector: &str,
        payload: Option<(Vec<u8>, Encoding)>,
        attachment: Option<Vec<u8>>,
    ) -> Result<Vec<Answer>, Failure> {
        let answers = self.ask(selector, payload, attachment).await?;
        if answers.is_empty() {
            // A gateway answers for each job, if only that there is none.
            let probe = format!("{}/job/gateway", self.keys.prefix());
            if self.ask(&probe, None, None).await?.is_empty() {
                return Err(Failure::Connection(format!(
                    "no gateway answers: connected to {}, but nobody there serves the prefix `{}`",
                    self.connect,
                    self.keys.prefix()
                )));
            }
        }
        Ok(answers)
    }

    /// Asks whoever is there.
    pub(crate) async fn ask(
        &self,
        selector: &str,
        payload: Option<(Vec<u8>, Encoding)>,
        attachment: Option<Vec<u8>>,
    ) -> Result<Vec<Answer>, Failure> {
        // Without consolidation the order of the replies stays.
        let mut get = self
            .session
            .get(selector)
            .consolidation(ConsolidationMode::None)
            .timeout(self.timeout);
        if let Some((payload, encoding)) = payload {
            get = get.payload(payload).encoding(encoding);
        }
        if let Some(attachment) = attachment {
            get = get.attachment(attachment);
        }
        let replies = get.await?;
        let mut answers = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            match reply.result() {
                Ok(sample) => answers.push(Ok(sample.payload().to_bytes().into_owned())),
                Err(error) => {
                    let payload = error.payload().to_bytes();
                    match serde_json::from_slice::<ErrorReply>(&payload) {
                        Ok(reply) => answers.push(Err(reply.error)),
                        // Zenoh's own, when the time is over.
                        Err(_) => {
                            return Err(Failure::Connection(format!(
                                "the gateway did not answer within {} s",
                                self.timeout.as_secs_f64()
                            )));
                        }
                    }
                }
            }
        }
        Ok(answers)
    }

    /// Asks for something large and gives each reply to `take` as it comes, behind everything else.
    pub(crate) async fn pour(
        &self,
        selector: &str,
        mut take: impl FnMut(&[u8]) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let replies = self
            .session
            .get(selector)
            .consolidation(ConsolidationMode::None)
            .priority(Priority::Background)
            .timeout(POUR_MAX)
            .await?;
        loop {
            let silence = || {
                let seconds = self.timeout.as_secs_f64();
                Failure::TimedOut(format!("the gateway said nothing for {seconds} s"))
            };
            let next = tokio::time::timeout(self.timeout, replies.recv_async()).await;
            let Ok(reply) = next.map_err(|_| silence())? else {
                return Ok(());
            };
            match reply.result() {
                Ok(sample) => take(&sample.payload().to_bytes())?,
                Err(error) => {
                    let read = serde_json::from_slice::<ErrorReply>(&error.payload().to_bytes());
                    return Err(match read {
                        Ok(reply) => Failure::Failed(Some(reply.error.to_string())),
                        Err(_) => silence(),
                    });
                }
            }
        }
    }

    /// Puts bytes on a key so that they overtake everything.
    pub(crate) async fn put_now(&self, key: &str, payload: &[u8]) -> Result<(), Failure> {
        self.session
            .put(key, payload)
            .encoding(Encoding::APPLICATION_JSON)
            .priority(Priority::RealTime)
            .congestion_control(CongestionControl::Block)
            .express(true)
            .await?;
        Ok(())
    }

    /// Puts a text on a key, or deletes what is there.
    pub(crate) async fn keep(&self, key: &str, text: Option<&[u8]>) -> Result<(), Failure> {
        match text {
            Some(text) => {
                let put = self.session.put(key, text).encoding(Encoding::TEXT_PLAIN);
                put.congestion_control(CongestionControl::Block).await?;
            }
            None => {
                let delete = self.session.delete(key);
                delete.congestion_control(CongestionControl::Block).await?;
            }
        }
        Ok(())
    }

    /// Asks whoever is there, and returns keys and payloads.
    pub(crate) async fn texts(&self, selector: &str) -> Result<Vec<(String, Vec<u8>)>, Failure> {
        let replies = self.session.get(selector).timeout(self.timeout).await?;
        let mut texts = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result() {
                let payload = sample.payload().to_bytes().into_owned();
                texts.push((sample.key_expr().to_string(), payload));
            }
        }
        Ok(texts)
    }

    /// Hears a key from now on.
    pub(crate) async fn subscribe(&self, key: &str) -> Result<Samples, Failure> {
        let channel = zenoh::handlers::FifoChannel::new(4_096);
        Ok(self.session.declare_subscriber(key).with(channel).await?)
    }

    /// Calls back for each value on a key, as it comes, until what is returned is dropped.
    #[cfg(feature = "demo")]
    pub(crate) async fn listen(
        &self,
        key: &str,
        heard: impl Fn(Sample) + Send + Sync + 'static,
    ) -> Result<Subscriber<()>, Failure> {
        Ok(self.session.declare_subscriber(key).callback(heard).await?)
    }

    /// Returns the nodes of this pattern that are there, whether or not there is a gateway.
    pub(crate) async fn alive(&self, pattern: &str) -> Result<Vec<NodeId>, Failure> {
        let key = format!("{}/node/{pattern}/alive", self.keys.prefix());
        let replies = self
            .session
            .liveliness()
            .get(key)
            .timeout(self.timeout)
            .await?;
        let mut nodes = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result()
                && let Some(Topic::Node { node, .. }) = self.keys.parse(sample.key_expr().as_str())
                && let Ok(node) = NodeId::new(node)
            {
                nodes.push(node);
            }
        }
        nodes.sort_unstable();
        nodes.dedup();
        Ok(nodes)
    }

    /// Ends the session.
    pub(crate) async fn close(self) {
        // Whatever goes wrong here, the work is done.
        let _ = tokio::time::timeout(Duration::from_secs(2), self.session.close()).await;
    }
}

/// Reads what a gateway said.
pub(crate) fn read<T: DeserializeOwned>(payload: &[u8]) -> Result<T, Failure> {
    serde_json::from_slice(payload).map_err(|error| {
        Failure::Failed(Some(format!(
            "the gateway's answer is of another version: {error}"
        )))
    })
}
