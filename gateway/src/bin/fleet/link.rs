//! An ordinary zenoh client: the command line speaks to the fleet as anybody else would.

use crate::args::{CONNECT_DEFAULT, Common};
use client::{Fleet, FleetError};
use keys::{Keys, NodeId, Topic, credentials::Credentials, record::ErrorReply, secret};
use serde::de::DeserializeOwned;
use std::{path::Path, time::Duration};
use zenoh::{
    bytes::Encoding,
    handlers::{RingChannel, RingChannelHandler},
    pubsub::Subscriber,
    qos::{CongestionControl, Priority},
    query::ConsolidationMode,
    sample::Sample,
};

pub(crate) use client::Answer;

/// A subscriber that is read with `recv_async`.
pub(crate) type Samples = Subscriber<RingChannelHandler<Sample>>;

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

impl From<FleetError> for Failure {
    fn from(error: FleetError) -> Self {
        match error {
            FleetError::Refused(error) => Self::Failed(Some(error.to_string())),
            FleetError::Silence(patience) => Self::Connection(format!(
                "the gateway did not answer within {} s",
                patience.as_secs_f64()
            )),
            other => Self::Connection(other.to_string()),
        }
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Failed(Some(error.to_string()))
    }
}

/// Longest time for something large: a store of gigabytes by a slow link.
const POUR_MAX: Duration = Duration::from_secs(6 * 3_600);

/// The client that everybody else can have, and words for a terminal.
pub(crate) struct Link {
    fleet: Fleet,
    connect: String,
}

/// Reads `--credentials`, or `--user` and `--password-file`.
pub(crate) fn credentials(common: &Common) -> Result<Option<Credentials>, Failure> {
    if let Some(file) = &common.credentials {
        let usage = |error: String| Failure::Usage(format!("--credentials: {error}"));
        let text = secret::read(file).map_err(|error| usage(error.to_string()))?;
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
    secret::read_password(file).map_err(|error| Failure::Usage(format!("--password-file: {error}")))
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
        let known = connect.starts_with("tcp/") || connect.starts_with("tls/");
        if !known || !connect.contains(':') {
            let message = format!(
                "--connect {connect}: an address has the form tcp/HOST:PORT or tls/HOST:PORT"
            );
            return Err(Failure::Usage(message));
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
        let open = Fleet::open_with(connect, keys, credentials);
        let fleet = match tokio::time::timeout(timeout, open).await {
            Ok(Ok(fleet)) => fleet.with_patience(timeout),
            Ok(Err(FleetError::Address(error))) => {
                return Err(Failure::Usage(format!("--connect {connect}: {error}")));
            }
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
            fleet,
            connect: connect.to_owned(),
        })
    }

    /// Returns the keys of the fleet.
    pub(crate) fn keys(&self) -> &Keys {
        self.fleet.keys()
    }

    /// Returns the longest wait for an answer.
    pub(crate) fn timeout(&self) -> Duration {
        self.fleet.patience()
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
            let probe = format!("{}/job/gateway", self.keys().prefix());
            if self.ask(&probe, None, None).await?.is_empty() {
                return Err(Failure::Connection(format!(
                    "no gateway answers: connected to {}, but nobody there serves the prefix `{}`",
                    self.connect,
                    self.keys().prefix()
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
        Ok(self.fleet.answers(selector, payload, attachment).await?)
    }

    /// Asks for something large and gives each reply to `take` as it comes, behind everything else.
    pub(crate) async fn pour(
        &self,
        selector: &str,
        mut take: impl FnMut(&[u8]) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let replies = self
            .fleet
            .session()
            .get(selector)
            .consolidation(ConsolidationMode::None)
            .priority(Priority::Background)
            .timeout(POUR_MAX)
            .await?;
        loop {
            let silence = || {
                let seconds = self.timeout().as_secs_f64();
                Failure::TimedOut(format!("the gateway said nothing for {seconds} s"))
            };
            let next = tokio::time::timeout(self.timeout(), replies.recv_async()).await;
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
        Ok(self.fleet.put_now(key, payload).await?)
    }

    /// Puts a text on a key, or deletes what is there.
    pub(crate) async fn keep(&self, key: &str, text: Option<&[u8]>) -> Result<(), Failure> {
        match text {
            Some(text) => {
                let put = self
                    .fleet
                    .session()
                    .put(key, text)
                    .encoding(Encoding::TEXT_PLAIN);
                put.congestion_control(CongestionControl::Block).await?;
            }
            None => {
                let delete = self.fleet.session().delete(key);
                delete.congestion_control(CongestionControl::Block).await?;
            }
        }
        Ok(())
    }

    /// Asks whoever is there, and returns keys and payloads.
    pub(crate) async fn texts(&self, selector: &str) -> Result<Vec<(String, Vec<u8>)>, Failure> {
        let replies = self
            .fleet
            .session()
            .get(selector)
            .timeout(self.timeout())
            .await?;
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
        // When it is full the oldest goes. One that kept them all would, when full, hold up the thread
        // that brings the answers, too.
        let channel = RingChannel::new(4_096);
        Ok(self
            .fleet
            .session()
            .declare_subscriber(key)
            .with(channel)
            .await?)
    }

    /// Calls back for each value on a key, as it comes, until what is returned is dropped.
    #[cfg(feature = "demo")]
    pub(crate) async fn listen(
        &self,
        key: &str,
        heard: impl Fn(Sample) + Send + Sync + 'static,
    ) -> Result<Subscriber<()>, Failure> {
        Ok(self
            .fleet
            .session()
            .declare_subscriber(key)
            .callback(heard)
            .await?)
    }

    /// Returns the nodes of this pattern that are there, whether or not there is a gateway.
    pub(crate) async fn alive(&self, pattern: &str) -> Result<Vec<NodeId>, Failure> {
        let key = format!("{}/node/{pattern}/alive", self.keys().prefix());
        let replies = self
            .fleet
            .session()
            .liveliness()
            .get(key)
            .timeout(self.timeout())
            .await?;
        let mut nodes = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result()
                && let Some(Topic::Node { node, .. }) =
                    self.keys().parse(sample.key_expr().as_str())
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
        let _ = tokio::time::timeout(Duration::from_secs(2), self.fleet.session().close()).await;
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
