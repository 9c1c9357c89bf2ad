//! How much one client may ask for, so that another one still gets its turn.
//!
//! A client is a link to the gateway's own router. Zenoh reads each link in a task of its own and
//! calls back from there, so the task's name tells which link something came by; nothing that a
//! client writes into a message can change that. What came through routers of others, or outside of
//! such a task, counts as one client.
//!
//! | what | bound | when it is passed |
//! |---|---|---|
//! | jobs, cancels, releases, holds, speeds and reads of one client | [`ClientLimits::requests_per_s`], ten seconds of them at once | a get is answered `not_allowed`; of refused puts one a second leaves a record |
//! | their bytes | [`ClientLimits::bytes_per_s`], and the largest job at once | the same |
//! | gets of one client that wait for their last reply | [`ClientLimits::gets_open`] | answered `not_allowed` |
//! | what one node says | [`NODE_MESSAGES_PER_S`], two seconds of it at once | dropped: a node says again what matters |
//!
//! Stops are not counted: whatever else goes wrong, a stop is carried out.

use keys::{FleetMicros, NodeId};
use std::collections::HashMap;
use tokio::task::Id;

/// Messages of one node, 1/s. One that executes 1,000 single orders a second answers each.
pub const NODE_MESSAGES_PER_S: u64 = 2_000;

/// Clients, and nodes, that are told apart; any more share what one has.
pub const TOLD_APART_MAX: usize = 4_096;

/// Shortest time between two looks for nodes that have been quiet, µs: a look costs as much as they are.
const SWEEP_US: u64 = 1_000_000;

/// What one client may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClientLimits {
    /// Requests, 1/s; ten seconds of them may come at once.
    pub requests_per_s: u64,
    /// Bytes of jobs, 1/s; the largest job, or four seconds of them, may come at once.
    pub bytes_per_s: u64,
    /// Gets that wait for their last reply.
    pub gets_open: usize,
}

impl Default for ClientLimits {
    /// About as many as a gateway on two cores can answer, so that only a flood is refused; the bytes
    /// of a network of 256 Mbit/s; half of all gets that can wait.
    fn default() -> Self {
        Self {
            requests_per_s: 5_000,
            bytes_per_s: 32 << 20,
            gets_open: super::GETS_OPEN_MAX / 2,
        }
    }
}

/// The link that something came by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Client(Option<Id>);

impl Client {
    /// Returns whom this callback is called for.
    pub(super) fn of_this_call() -> Self {
        Self(tokio::task::try_id())
    }
}

/// A bucket that fills at a rate and is emptied by what is taken.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    rate_per_s: u64,
    burst: u64,
    /// What is missing to the brim, millionths.
    missing: u128,
    at: FleetMicros,
}

impl Bucket {
    fn new(rate_per_s: u64, burst: u64, now: FleetMicros) -> Self {
        Self {
            rate_per_s,
            burst,
            missing: 0,
            at: now,
        }
    }

    fn fill(&mut self, now: FleetMicros) {
        let came = u128::from(now.since_us(self.at)) * u128::from(self.rate_per_s);
        self.missing = self.missing.saturating_sub(came);
        self.at = self.at.max(now);
    }

    fn has(&self, amount: u64) -> bool {
        self.missing + u128::from(amount) * 1_000_000 <= u128::from(self.burst) * 1_000_000
    }

    fn take(&mut self, amount: u64) {
        self.missing += u128::from(amount) * 1_000_000;
    }

    fn is_full(&self) -> bool {
        self.missing == 0
    }
}

#[derive(Debug)]
struct Account {
    requests: Bucket,
    bytes: Bucket,
    /// Refused puts that leave a record: one a second.
    told: Bucket,
}

/// What becomes of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// It is taken.
    Taken,
    /// It is refused.
    Refused {
        /// A put that is refused leaves a record too.
        tell: bool,
    },
}

/// Counts what each client and each node sends. Owns no clock.
#[derive(Debug)]
pub(super) struct Limits {
    config: ClientLimits,
    clients: HashMap<Client, Account>,
    gets_open: HashMap<Client, usize>,
    nodes: HashMap<Option<NodeId>, Bucket>,
    /// When nodes that had been quiet were last forgotten.
    swept_at: FleetMicros,
}

impl Limits {
    pub(super) fn new(config: ClientLimits) -> Self {
        Self {
            config,
            clients: HashMap::new(),
            gets_open: HashMap::new(),
            nodes: HashMap::new(),
            swept_at: FleetMicros(0),
        }
    }

    /// Takes a request of so many bytes, or refuses it. A refused one costs nothing.
    pub(super) fn admit(&mut self, client: Client, bytes: usize, now: FleetMicros) -> Admission {
        let client = self.told_apart(client, now);
        let ClientLimits {
            requests_per_s,
            bytes_per_s,
            ..
        } = self.config;
        let account = self.clients.entry(client).or_insert_with(|| {
            let largest = (keys::job::JOB_BYTES_MAX as u64).max(4 * bytes_per_s);
            Account {
                requests: Bucket::new(requests_per_s, 10 * requests_per_s, now),
                bytes: Bucket::new(bytes_per_s, largest, now),
                told: Bucket::new(1, 1, now),
            }
        });
        for bucket in [&mut account.requests, &mut account.bytes, &mut account.told] {
            bucket.fill(now);
        }
        // What is larger than any job is refused for its size, by whoever reads it.
        let bytes = (bytes as u64).min(account.bytes.burst);
        if account.requests.has(1) && account.bytes.has(bytes) {
            account.requests.take(1);
            account.bytes.take(bytes);
            return Admission::Taken;
        }
        let tell = account.told.has(1);
        if tell {
            account.told.take(1);
        }
        Admission::Refused { tell }
    }

    /// A client that cannot be told apart from others shares with them.
    fn told_apart(&mut self, client: Client, now: FleetMicros) -> Client {
        if self.clients.contains_key(&client) || self.clients.len() < TOLD_APART_MAX {
            return client;
        }
        // Whoever has asked for nothing lately is as good as new.
        self.clients.retain(|_, account| {
            account.requests.fill(now);
            account.bytes.fill(now);
            !(account.requests.is_full() && account.bytes.is_full())
        });
        if self.clients.len() < TOLD_APART_MAX {
            client
        } else {
            Client(None)
        }
    }

    /// Takes a get that will wait for replies; `false`: the client has too many already.
    pub(super) fn open_get(&mut self, client: Client) -> bool {
        let open = self.gets_open.entry(client).or_default();
        let may = *open < self.config.gets_open;
        *open += usize::from(may);
        may
    }

    /// A get has had its last reply.
    pub(super) fn close_get(&mut self, client: Client) {
        if let Some(open) = self.gets_open.get_mut(&client) {
            *open = open.saturating_sub(1);
            if *open == 0 {
                self.gets_open.remove(&client);
            }
        }
    }

    /// Takes a message of a node, or drops it (`false`).
    pub(super) fn hear(&mut self, node: NodeId, now: FleetMicros) -> bool {
        let mut known = self.nodes.contains_key(&Some(node)) || self.nodes.len() < TOLD_APART_MAX;
        if !known && now.since_us(self.swept_at) >= SWEEP_US {
            // Names that somebody made up must not take the places of nodes that come later.
            self.swept_at = now;
            self.nodes.retain(|_, bucket| {
                bucket.fill(now);
                !bucket.is_full()
            });
            known = self.nodes.len() < TOLD_APART_MAX;
        }
        let bucket = self
            .nodes
            .entry(known.then_some(node))
            .or_insert_with(|| Bucket::new(NODE_MESSAGES_PER_S, 2 * NODE_MESSAGES_PER_S, now));
        bucket.fill(now);
        let may = bucket.has(1);
        if may {
            bucket.take(1);
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ClientLimits = ClientLimits {
        requests_per_s: 10,
        bytes_per_s: 1_000,
        gets_open: 2,
    };
    const S: u64 = 1_000_000;

    /// Names of clients as zenoh's tasks give them.
    async fn clients() -> [Client; 2] {
        let one = || async { Client::of_this_call() };
        let (a, b) = (tokio::spawn(one()), tokio::spawn(one()));
        [a.await.expect("ran"), b.await.expect("ran")]
    }

    #[tokio::test]
    async fn a_client_gets_ten_seconds_at_once_and_then_its_rate_and_no_other_pays() {
        let [a, b] = clients().await;
        assert_ne!(a, b);
        let mut limits = Limits::new(LIMITS);
        let mut taken = |client, at| {
            let admission = |_: &u32| limits.admit(client, 1, FleetMicros(at)) == Admission::Taken;
            (0..1_000).filter(admission).count()
        };
        assert_eq!(taken(a, 0), 100);
        assert_eq!(taken(a, S), 10);
        assert_eq!(taken(b, S), 100);
        assert_eq!(taken(a, 100 * S), 100);
    }

    #[tokio::test]
    async fn the_largest_job_is_taken_once_and_then_its_bytes_are_counted() {
        let [a, b] = clients().await;
        let mut limits = Limits::new(LIMITS);
        let largest = keys::job::JOB_BYTES_MAX;
        let taken = Admission::Taken;
        assert_eq!(limits.admit(a, largest, FleetMicros(0)), taken);
        let told = Admission::Refused { tell: true };
        assert_eq!(limits.admit(a, 1, FleetMicros(0)), told);
        let quiet = Admission::Refused { tell: false };
        assert_eq!(
            limits.admit(a, 1, FleetMicros(1)),
            quiet,
            "one record a second"
        );
        assert_eq!(limits.admit(a, 500, FleetMicros(S)), taken);
        assert_eq!(
            limits.admit(b, largest + 1, FleetMicros(S)),
            taken,
            "not our business"
        );
    }

    #[tokio::test]
    async fn gets_that_wait_are_counted_by_client() {
        let [a, b] = clients().await;
        let mut limits = Limits::new(LIMITS);
        assert!(limits.open_get(a) && limits.open_get(a));
        assert!(!limits.open_get(a));
        assert!(limits.open_get(b));
        limits.close_get(a);
        assert!(limits.open_get(a));
    }

    #[test]
    fn a_node_that_says_too_much_is_not_heard_and_another_one_is() {
        let mut limits = Limits::new(LIMITS);
        let node = |name| NodeId::new(name).expect("legal");
        let heard = |limits: &mut Limits, name, at| {
            let hear = |_: &u32| limits.hear(node(name), FleetMicros(at));
            (0..10_000).filter(hear).count() as u64
        };
        assert_eq!(heard(&mut limits, "left", 0), 2 * NODE_MESSAGES_PER_S);
        assert_eq!(heard(&mut limits, "left", S), NODE_MESSAGES_PER_S);
        assert_eq!(heard(&mut limits, "right", S), 2 * NODE_MESSAGES_PER_S);
    }

    #[test]
    fn what_is_counted_is_bounded() {
        let mut limits = Limits::new(LIMITS);
        for index in 0..2 * TOLD_APART_MAX {
            let node = NodeId::new(&format!("node-{index}")).expect("legal");
            assert!(limits.hear(node, FleetMicros(0)) || index > TOLD_APART_MAX);
        }
        assert!(limits.nodes.len() <= TOLD_APART_MAX + 1);
    }

    #[test]
    fn names_that_were_made_up_take_no_place_of_a_node_that_comes_later() {
        let mut limits = Limits::new(LIMITS);
        for index in 0..2 * TOLD_APART_MAX {
            let node = NodeId::new(&format!("made-{index}")).expect("legal");
            limits.hear(node, FleetMicros(S));
        }
        // All of them shout on as one; a node is heard as if it were alone.
        let left = NodeId::new("left").expect("legal");
        let at = FleetMicros(10 * S);
        for index in 0..2 * NODE_MESSAGES_PER_S {
            let node = NodeId::new(&format!("more-{index}")).expect("legal");
            limits.hear(node, at);
            assert!(limits.hear(left, at), "{index}");
        }
    }
}
