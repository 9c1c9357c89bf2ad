//! What the operator asked for becomes puts and gets; what comes back becomes answers.

use super::{inbox::Inbox, session::inbox_sample};
use crate::{
    message::{Answer, LinkEvent, Message},
    request::{Language, Request, Scope, Target, Ticket},
};
use keys::{
    JobId, Keys, NodeId, NodeTopic, Stop, StopMode, Topic,
    record::{ErrorCode, ErrorReply, JobError, LinkRecord, Receipt},
};
use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use zenoh::{
    Session,
    bytes::Encoding,
    handlers::FifoChannel,
    qos::{CongestionControl, Priority},
    query::ConsolidationMode,
    sample::Sample,
};

/// Longest wait for an answer of the gateway.
const ANSWER_MAX: Duration = Duration::from_secs(5);

/// Replies that wait to be read; more wait in zenoh.
const REPLIES_MAX: usize = 1_024;

/// Job records that are asked for at the start.
const JOBS_ASKED: usize = 500;

/// Performs requests on one session.
#[derive(Clone)]
pub(super) struct Performer {
    session: Session,
    keys: Keys,
    inbox: Arc<Inbox>,
    user: Option<String>,
    gateway: Arc<AtomicBool>,
}

/// One reply: a sample, or the gateway's refusal.
type Reply = Result<Sample, JobError>;

impl Performer {
    pub(super) fn new(
        session: Session,
        keys: Keys,
        inbox: Arc<Inbox>,
        user: Option<String>,
    ) -> Self {
        Self {
            session,
            keys,
            inbox,
            user,
            gateway: Arc::default(),
        }
    }

    /// Returns the session.
    pub(super) fn session(&self) -> &Session {
        &self.session
    }

    /// Begins to perform a request; nothing waits for its end.
    pub(super) fn begin(&self, ticket: Ticket, request: Request) {
        let performer = self.clone();
        tokio::spawn(async move {
            let answer = performer.perform(request).await;
            let answer = answer.unwrap_or_else(|error| Answer::Failed(format!("zenoh: {error}")));
            performer.inbox.push(Message::Answer { ticket, answer });
        });
    }

    /// Begins to ask whether a gateway is there; everything else too when one has come.
    pub(super) fn probe(&self) {
        let performer = self.clone();
        tokio::spawn(async move {
            // A gateway answers for every job, if only that there is none.
            let nobody = JobId::new("gateway").expect("a name");
            let key = performer.keys.job(&nobody);
            let replies = performer.get(key.as_str(), None).await;
            let present = replies.is_ok_and(|replies| !replies.is_empty());
            let event = LinkEvent::Gateway { present };
            performer.inbox.push(Message::Link(event));
            let was = performer.gateway.swap(present, Ordering::Relaxed);
            if present && !was {
                performer.refresh();
            }
            if present {
                performer.ask_travels().await;
            }
        });
    }

    /// Asks how long messages travel to each node. A gateway that does not know the question does not
    /// answer.
    async fn ask_travels(&self) {
        let selector = format!("{}/manage/link/*", self.keys.prefix());
        let replies = self.get(&selector, None).await.unwrap_or_default();
        let links: Vec<LinkRecord> = replies
            .into_iter()
            .flatten()
            .filter_map(|sample| serde_json::from_slice(&sample.payload().to_bytes()).ok())
            .collect();
        if !links.is_empty() {
            self.inbox.push(Message::Travels(links));
        }
    }

    /// Begins to ask for all node records and the newest job records.
    pub(super) fn refresh(&self) {
        let jobs = format!("{}?limit={JOBS_ASKED}", self.keys.every_job());
        let nodes = self.keys.every_node(NodeTopic::State).as_str().to_owned();
        for selector in [nodes, jobs] {
            let performer = self.clone();
            tokio::spawn(async move {
                // Without an answer the next probe finds that out.
                let replies = performer.get(&selector, None).await.unwrap_or_default();
                for sample in replies.into_iter().flatten() {
                    inbox_sample(&performer.keys, &performer.inbox, &sample);
                }
            });
        }
    }

    async fn perform(&self, request: Request) -> zenoh::Result<Answer> {
        match request {
            Request::Stop { scope, mode } => self.stop(&scope, mode).await,
            Request::Release { scope } => {
                let chunks = scope.chunks().into_iter();
                let keys = chunks.map(|chunk| {
                    let key = format!("{}/node/{chunk}/release", self.keys.prefix());
                    (chunk, key)
                });
                let replies = self.get_each(keys.collect(), None).await;
                Ok(self.done(replies))
            }
            Request::Order { node, order } => {
                let (topic, payload) = order.message();
                let key = format!("{}/node/{node}/{topic}", self.keys.prefix());
                let payload = Some((payload, Encoding::APPLICATION_JSON));
                let replies = self.get(&key, payload).await?;
                Ok(self.done(replies))
            }
            Request::Setup { node } => {
                let key = self.keys.node(&node, NodeTopic::Setup);
                let replies = self.get(key.as_str(), None).await?;
                Ok(match replies.is_empty() {
                    true => Answer::Failed(self.no_setup()),
                    false => self.done(replies),
                })
            }
            Request::Cancel { job } => {
                let key = self.keys.job_cancel(&job);
                let replies = self.get(key.as_str(), None).await?;
                Ok(self.done(replies))
            }
            Request::Submit {
                target,
                language,
                text,
            } => self.submit(&target, language, text).await,
            Request::Refresh => {
                self.refresh();
                Ok(Answer::Sent)
            }
            // The session's loop or the window itself has taken it.
            Request::Connect { .. }
            | Request::Acknowledge { .. }
            | Request::ReadFile { .. }
            | Request::WriteFile { .. } => Ok(Answer::Sent),
        }
    }

    async fn stop(&self, scope: &Scope, mode: StopMode) -> zenoh::Result<Answer> {
        for chunk in scope.chunks() {
            let key = format!("{}/node/{chunk}/stop", self.keys.prefix());
            self.session
                .put(key, Stop { mode }.to_payload())
                .encoding(Encoding::APPLICATION_JSON)
                .priority(Priority::RealTime)
                .congestion_control(CongestionControl::Block)
                .express(true)
                .await?;
        }
        Ok(Answer::Sent)
    }

    async fn submit(
        &self,
        target: &Target,
        language: Language,
        text: String,
    ) -> zenoh::Result<Answer> {
        let of_node = |chunk: &str| {
            let key = format!("{}/node/{chunk}/job", self.keys.prefix());
            (chunk.to_owned(), key)
        };
        let keys = match target {
            Target::Node(chunk) => vec![of_node(chunk)],
            Target::Nodes(nodes) => nodes.iter().map(|node| of_node(node.as_str())).collect(),
            Target::Group(group) => {
                let key = self.keys.group_job(group).as_str().to_owned();
                vec![(group.to_string(), key)]
            }
        };
        let encoding = match language {
            Language::Json => Encoding::APPLICATION_JSON,
            Language::Lua => Encoding::from("text/x-lua"),
        };
        let replies = self.get_each(keys, Some((text, encoding))).await;
        if replies.is_empty() {
            return Ok(self.silence());
        }
        let receipts = replies.into_iter().map(|reply| {
            let payload = reply?.payload().to_bytes().into_owned();
            serde_json::from_slice::<Receipt>(&payload).map_err(|error| {
                JobError::new(ErrorCode::Internal, format!("unreadable receipt: {error}"))
            })
        });
        Ok(Answer::Receipts(receipts.collect()))
    }

    /// Counts replies that are records, and hands the records on.
    fn done(&self, replies: Vec<Reply>) -> Answer {
        if replies.is_empty() {
            return self.silence();
        }
        let (mut count, mut refused) = (0, Vec::new());
        for reply in replies {
            match reply {
                Ok(sample) => {
                    count += 1;
                    inbox_sample(&self.keys, &self.inbox, &sample);
                }
                Err(error) => refused.push(error),
            }
        }
        Answer::Done { count, refused }
    }

    /// Says what it may mean that a node does not tell how it is set.
    fn no_setup(&self) -> String {
        let user = match &self.user {
            Some(user) => format!(", or the gateway's rules do not let the user {user} ask"),
            None => String::new(),
        };
        format!("it does not answer: its firmware may be older than this question{user}")
    }

    /// Says what it may mean that nobody answered: a secured router passes over in silence what a
    /// user may not ask for.
    fn silence(&self) -> Answer {
        let present = self.gateway.load(Ordering::Relaxed);
        Answer::Failed(match (present, &self.user) {
            (false, _) => "no gateway answers".to_owned(),
            (true, Some(user)) => format!(
                "refused: no answer although a gateway is there. The user {user} may not do this, \
                 or the gateway is older than this window"
            ),
            (true, None) => "no answer although a gateway is there: it may be older than this \
                             window, or not allow this"
                .to_owned(),
        })
    }

    /// Asks all of them at once, each with a name for a person. One that fails or stays silent
    /// takes nothing from the others; if all are silent, nothing is returned.
    async fn get_each(
        &self,
        keys: Vec<(String, String)>,
        payload: Option<(String, Encoding)>,
    ) -> Vec<Reply> {
        let mut gets = tokio::task::JoinSet::new();
        for (name, key) in keys {
            let (performer, payload) = (self.clone(), payload.clone());
            gets.spawn(async move { (name, performer.get(&key, payload).await) });
        }
        let mut answers = Vec::new();
        while let Some(got) = gets.join_next().await {
            // A panic in there has been printed.
            answers.extend(got);
        }
        gathered(answers)
    }

    async fn get(
        &self,
        selector: &str,
        payload: Option<(String, Encoding)>,
    ) -> zenoh::Result<Vec<Reply>> {
        // Without consolidation nothing is held back until the last reply.
        let mut get = self
            .session
            .get(selector)
            .consolidation(ConsolidationMode::None)
            .with(FifoChannel::new(REPLIES_MAX))
            .timeout(ANSWER_MAX);
        if let Some((payload, encoding)) = payload {
            get = get.payload(payload).encoding(encoding);
        }
        let replies = get.await?;
        let mut answers = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            match reply.into_result() {
                Ok(sample) => answers.push(Ok(sample)),
                Err(error) => {
                    let payload = error.payload().to_bytes();
                    match serde_json::from_slice::<ErrorReply>(&payload) {
                        Ok(reply) => answers.push(Err(reply.error)),
                        // What is no refusal is zenoh's own word that the time is over.
                        Err(_) if answers.is_empty() => break,
                        Err(_) => {
                            let seconds = ANSWER_MAX.as_secs();
                            let words = format!("no answer from all within {seconds} s");
                            answers.push(Err(JobError::new(ErrorCode::Internal, words)));
                        }
                    }
                }
            }
        }
        Ok(answers)
    }
}

/// What each of several questions was answered, with its name for a person.
type Answers<T> = Vec<(String, zenoh::Result<Vec<Result<T, JobError>>>)>;

/// Puts together what several questions were answered.
fn gathered<T>(answers: Answers<T>) -> Vec<Result<T, JobError>> {
    let all_silent = answers
        .iter()
        .all(|(_, got)| got.as_ref().is_ok_and(Vec::is_empty));
    if all_silent {
        return Vec::new();
    }
    let mut replies = Vec::new();
    for (name, got) in answers {
        let wrong = |words: String| JobError::new(ErrorCode::Internal, words);
        match got {
            Ok(got) if got.is_empty() => replies.push(Err(wrong(format!("{name}: no answer")))),
            Ok(got) => replies.extend(got),
            Err(error) => replies.push(Err(wrong(format!("{name}: zenoh: {error}")))),
        }
    }
    replies
}

/// Returns the nodes whose token is there.
pub(super) async fn tokens(
    session: &Session,
    keys: &Keys,
    expression: &str,
) -> zenoh::Result<BTreeSet<NodeId>> {
    let liveliness = session.liveliness();
    let replies = liveliness
        .get(expression)
        .with(FifoChannel::new(REPLIES_MAX))
        .timeout(ANSWER_MAX)
        .await?;
    let mut nodes = BTreeSet::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result()
            && let Some(Topic::Node { node, .. }) = keys.parse(sample.key_expr().as_str())
            && let Ok(node) = NodeId::new(node)
        {
            nodes.insert(node);
        }
    }
    Ok(nodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_fails_or_is_silent_takes_nothing_from_the_others() {
        let answer = |name: &str, got| (name.to_owned(), got);
        let silent = || answer("silent", Ok(Vec::new()));
        let refused = JobError::new(ErrorCode::UnknownNode, "nobody");
        let all = gathered(vec![
            answer("left", Ok(vec![Ok(1)])),
            answer("cut", Err("closed".into())),
            silent(),
            answer("right", Ok(vec![Ok(2), Err(refused.clone())])),
        ]);
        let words = |reply: &Result<i32, JobError>| match reply {
            Ok(number) => number.to_string(),
            Err(error) => error.message.clone(),
        };
        let words: Vec<String> = all.iter().map(words).collect();
        let expected = [
            "1",
            "cut: zenoh: closed",
            "silent: no answer",
            "2",
            "nobody",
        ];
        assert_eq!(words, expected);
        assert_eq!(gathered::<i32>(vec![silent(), silent()]), []);
    }
}
