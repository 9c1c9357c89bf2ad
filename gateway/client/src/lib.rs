//! A fleet of stepper controllers, as a client in Rust sees it: hand in jobs, follow them, stop and
//! release nodes. A thin layer over zenoh; the words are those of the crate [`keys`].
//!
//! ```no_run
//! # async fn example() -> Result<(), client::FleetError> {
//! use client::{Fleet, keys::NodeId};
//!
//! let fleet = Fleet::open("tcp/127.0.0.1:7447").await?;
//! let left = NodeId::new("left").expect("a name");
//! let job = br#"{"id":"part-1","commands":[{"move":{"axis":0,"delay_us":500,"steps":2000}}]}"#;
//! let receipt = fleet.submit(&left, job).await?;
//! let record = fleet.wait(&receipt.job).await?;
//! println!("{} {:?}", record.state, record.result);
//! # Ok(())
//! # }
//! ```
//!
//! Absent on purpose: timeouts of your own (wrap a call in your runtime's; every one may be dropped at
//! any time), and the gateway's arrangements (`PREFIX/manage/…`), which [`Fleet::ask`] and
//! [`Fleet::answers`] reach: the command line `fleet` is written with nothing else.

pub use keys;

use keys::{
    JobId, Keys, NodeId, NodeTopic, StopMode,
    credentials::Credentials,
    job::JOB_BYTES_MAX,
    record::{ErrorCode, ErrorReply, JobError, JobRecord, NodeRecord, Receipt},
};
use serde::de::DeserializeOwned;
use std::{fmt::Display, time::Duration};
use zenoh::{
    Session,
    bytes::Encoding,
    handlers::{RingChannel, RingChannelHandler},
    pubsub::Subscriber,
    qos::{CongestionControl, Priority},
    query::ConsolidationMode,
    sample::Sample,
};

/// Records that may wait for whoever follows.
const RECORDS_WAITING_MAX: usize = 1_024;

/// How long an answer may take, unless [`Fleet::with_patience`] says otherwise.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// One answer to a get: what was said, or the gateway's refusal.
pub type Answer = Result<Vec<u8>, JobError>;

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// Zenoh does not take the address.
    #[error("no address: {0}")]
    Address(String),
    /// The gateway refused, in its own words.
    #[error("{0}")]
    Refused(JobError),
    /// Nobody answers: no gateway, or another prefix.
    #[error("no gateway answers on {0}")]
    NoGateway(String),
    /// There is somebody who could answer, and did not for so long.
    #[error("no answer within {} s", .0.as_secs_f64())]
    Silence(Duration),
    /// Zenoh's word: no connection, or it is gone.
    #[error("zenoh: {0}")]
    Zenoh(String),
    /// An answer that this version does not understand.
    #[error("an answer of another version: {0}")]
    Unreadable(String),
}

fn zenoh_error(error: impl Display) -> FleetError {
    FleetError::Zenoh(error.to_string())
}

/// A connection to a fleet.
#[derive(Clone, Debug)]
pub struct Fleet {
    session: Session,
    keys: Keys,
    patience: Duration,
}

impl Fleet {
    /// Connects to a gateway or router, `tcp/HOST:PORT`, without a user, below the prefix `fleet`.
    ///
    /// # Errors
    /// Nothing that speaks zenoh is there.
    pub async fn open(connect: &str) -> Result<Self, FleetError> {
        Self::open_with(connect, Keys::default(), None).await
    }

    /// Connects with a prefix, and with what `fleet users` wrote for a user of a secured fleet.
    ///
    /// # Errors
    /// Nothing that speaks zenoh is there, or it does not know the user.
    pub async fn open_with(
        connect: &str,
        keys: Keys,
        credentials: Option<&Credentials>,
    ) -> Result<Self, FleetError> {
        let text = |value: &str| serde_json::Value::from(value).to_string();
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", text("client")),
            ("connect/endpoints", format!("[{}]", text(connect))),
            ("scouting/multicast/enabled", "false".to_owned()),
        ] {
            let set = config.insert_json5(key, &value);
            set.map_err(|error| FleetError::Address(error.to_string()))?;
        }
        for (key, value) in credentials.map_or_else(Vec::new, Credentials::zenoh_settings) {
            // The error would quote the secret.
            let set = config.insert_json5(key, &value);
            set.map_err(|_| FleetError::Zenoh(format!("it takes no such value for {key}")))?;
        }
        let session = zenoh::open(config).await.map_err(zenoh_error)?;
        Ok(Self {
            session,
            keys,
            patience: PATIENCE,
        })
    }

    /// Returns the session, for what this crate has no word for.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Returns the keys of the fleet.
    pub fn keys(&self) -> &Keys {
        &self.keys
    }

    /// Returns how long an answer may take.
    pub fn patience(&self) -> Duration {
        self.patience
    }

    /// Sets how long an answer may take.
    #[must_use]
    pub fn with_patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    /// Hands in a job in JSON for one node. With an `id` in it this may be repeated: the job that is
    /// there answers.
    ///
    /// # Errors
    /// The gateway refuses, or does not answer.
    pub async fn submit(&self, node: &NodeId, job: &[u8]) -> Result<Receipt, FleetError> {
        let key = self.keys.node(node, NodeTopic::Job);
        let payload = Some((job, Encoding::APPLICATION_JSON));
        self.one(key.as_str(), payload).await
    }

    /// Hands in a job in G-code for one node, whose machine the gateway knows.
    ///
    /// # Errors
    /// The gateway refuses, with line and column, or does not answer.
    pub async fn submit_gcode(
        &self,
        node: &NodeId,
        program: &str,
        id: Option<&JobId>,
    ) -> Result<Receipt, FleetError> {
        let key = self.keys.node(node, NodeTopic::Job);
        let mut encoding = Encoding::from("text/x-gcode");
        if let Some(id) = id {
            encoding = encoding.with_schema(format!("id={id}"));
        }
        self.one(key.as_str(), Some((program.as_bytes(), encoding)))
            .await
    }

    /// Hands in a synchronized job in JSON: a part for each of its nodes.
    ///
    /// # Errors
    /// The gateway refuses, or does not answer.
    pub async fn submit_together(
        &self,
        group: &keys::GroupId,
        job: &[u8],
    ) -> Result<Receipt, FleetError> {
        let key = self.keys.group_job(group);
        let payload = Some((job, Encoding::APPLICATION_JSON));
        self.one(key.as_str(), payload).await
    }

    /// Returns a job's record.
    ///
    /// # Errors
    /// There is no such job, or nobody answers.
    pub async fn job(&self, job: &JobId) -> Result<JobRecord, FleetError> {
        self.one(self.keys.job(job).as_str(), None).await
    }

    /// Begins to hear a job's records.
    ///
    /// # Errors
    /// There is no such job, or nobody answers.
    pub async fn follow(&self, job: &JobId) -> Result<Follow, FleetError> {
        // Full, it forgets the oldest record. One that kept them all would hold up the thread that
        // brings the session's answers, too.
        let channel = RingChannel::new(RECORDS_WAITING_MAX);
        let changes = self
            .session
            .declare_subscriber(self.keys.job(job).as_str())
            .with(channel)
            .await
            .map_err(zenoh_error)?;
        // Asked for after that, so that no change is missed.
        let first = self.job(job).await?;
        Ok(Follow {
            changes,
            next: Some(first),
            version: 0,
        })
    }

    /// Waits until a job has ended, however it does.
    ///
    /// # Errors
    /// There is no such job, or nobody answers.
    pub async fn wait(&self, job: &JobId) -> Result<JobRecord, FleetError> {
        let mut follow = self.follow(job).await?;
        loop {
            let record = follow.next().await?;
            if record.state.is_final() {
                return Ok(record);
            }
        }
    }

    /// Cancels a job; one that runs is `canceled` when its last pulse is out.
    ///
    /// # Errors
    /// There is no such job, or nobody answers.
    pub async fn cancel(&self, job: &JobId) -> Result<JobRecord, FleetError> {
        self.one(self.keys.job_cancel(job).as_str(), None).await
    }

    /// Returns the record of every node.
    ///
    /// # Errors
    /// Nobody answers.
    pub async fn nodes(&self) -> Result<Vec<NodeRecord>, FleetError> {
        let key = self.keys.every_node(NodeTopic::State);
        let mut nodes: Vec<NodeRecord> = self.ask(key.as_str(), None).await?;
        nodes.sort_by_key(|record| record.node);
        Ok(nodes)
    }

    /// Tells a node to stop. It is a stop by software over a network: [`Fleet::nodes`] says whether it
    /// has.
    ///
    /// # Errors
    /// The connection is gone.
    pub async fn stop(&self, node: &NodeId, mode: StopMode) -> Result<(), FleetError> {
        let key = self.keys.node(node, NodeTopic::Stop);
        self.put_now(key.as_str(), keys::Stop { mode }.to_payload())
            .await
    }

    /// Puts JSON on any key, so that it overtakes everything.
    ///
    /// # Errors
    /// The connection is gone.
    pub async fn put_now(&self, key: &str, payload: &[u8]) -> Result<(), FleetError> {
        self.session
            .put(key, payload)
            .encoding(Encoding::APPLICATION_JSON)
            .priority(Priority::RealTime)
            .congestion_control(CongestionControl::Block)
            .express(true)
            .await
            .map_err(zenoh_error)
    }

    /// Lifts a node's latch; answers when the node has said so.
    ///
    /// # Errors
    /// The gateway says why it cannot be lifted, or does not answer.
    pub async fn release(&self, node: &NodeId) -> Result<NodeRecord, FleetError> {
        let key = self.keys.node(node, NodeTopic::Release);
        self.one(key.as_str(), None).await
    }

    /// Asks on any key and reads each answer. An empty list: nobody has one, or nobody is there.
    ///
    /// # Errors
    /// The first refusal, or no answer in time.
    pub async fn ask<T: DeserializeOwned>(
        &self,
        selector: &str,
        payload: Option<(&[u8], Encoding)>,
    ) -> Result<Vec<T>, FleetError> {
        let payload = payload.map(|(bytes, encoding)| (bytes.to_owned(), encoding));
        let answers = self.answers(selector, payload, None).await?;
        let read = |answer: Answer| read(&answer.map_err(FleetError::Refused)?);
        answers.into_iter().map(read).collect()
    }

    /// Asks on any key, with an attachment or without, and returns answers and refusals as they come.
    ///
    /// # Errors
    /// No answer in time, the connection is gone, or the payload is larger than any job.
    pub async fn answers(
        &self,
        selector: &str,
        payload: Option<(Vec<u8>, Encoding)>,
        attachment: Option<Vec<u8>>,
    ) -> Result<Vec<Answer>, FleetError> {
        // Without consolidation the order of the replies stays.
        let mut get = self
            .session
            .get(selector)
            .consolidation(ConsolidationMode::None)
            .timeout(self.patience);
        if let Some((payload, encoding)) = payload {
            // Zenoh would drop what is much larger without a word, in the router.
            if payload.len() > JOB_BYTES_MAX {
                let count = payload.len();
                let words = format!("{count} bytes; at most {JOB_BYTES_MAX} are taken: split it");
                let error = JobError::new(ErrorCode::TooLarge, words);
                return Err(FleetError::Refused(error));
            }
            get = get.payload(payload).encoding(encoding);
        }
        if let Some(attachment) = attachment {
            get = get.attachment(attachment);
        }
        let replies = get.await.map_err(zenoh_error)?;
        let mut answers = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            match reply.result() {
                Ok(sample) => answers.push(Ok(sample.payload().to_bytes().into_owned())),
                Err(error) => {
                    let refusal = serde_json::from_slice(&error.payload().to_bytes());
                    // What is no refusal is zenoh's own word that the time is over.
                    let ErrorReply { error } =
                        refusal.map_err(|_| FleetError::Silence(self.patience))?;
                    answers.push(Err(error));
                }
            }
        }
        Ok(answers)
    }

    async fn one<T: DeserializeOwned>(
        &self,
        selector: &str,
        payload: Option<(&[u8], Encoding)>,
    ) -> Result<T, FleetError> {
        let mut answers = self.ask(selector, payload).await?;
        let answer = answers.pop();
        answer.ok_or_else(|| FleetError::NoGateway(selector.to_owned()))
    }

    /// Ends the connection.
    ///
    /// # Errors
    /// Zenoh's.
    pub async fn close(self) -> Result<(), FleetError> {
        self.session.close().await.map_err(zenoh_error)
    }
}

/// A job's records as they change; see [`Fleet::follow`].
#[derive(Debug)]
pub struct Follow {
    changes: Subscriber<RingChannelHandler<Sample>>,
    next: Option<JobRecord>,
    version: u64,
}

impl Follow {
    /// Returns the next record, the present one first. Versions grow; a client that is slow may miss
    /// some, but never the last.
    ///
    /// # Errors
    /// The connection is gone.
    ///
    /// # Cancellation safety
    /// May be dropped and called again.
    pub async fn next(&mut self) -> Result<JobRecord, FleetError> {
        loop {
            let record = match self.next.take() {
                Some(record) => record,
                None => {
                    let sample = self.changes.recv_async().await.map_err(zenoh_error)?;
                    read(&sample.payload().to_bytes())?
                }
            };
            if record.version > self.version {
                self.version = record.version;
                return Ok(record);
            }
        }
    }
}

fn read<T: DeserializeOwned>(payload: &[u8]) -> Result<T, FleetError> {
    serde_json::from_slice(payload).map_err(|error| FleetError::Unreadable(error.to_string()))
}
