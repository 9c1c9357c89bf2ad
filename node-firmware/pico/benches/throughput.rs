//! Messages a second through an in-process router on loopback, beside the zenoh crate's own
//! client in the same run.
//!
//! ```sh
//! cargo bench -p pico
//! ```
//!
//! All sides share the machine's cores, so only the ratios say something. Both clients send
//! with blocking congestion control, so every message arrives.

#[path = "../tests/router/mod.rs"]
mod router;

use std::{
    future::{Future, pending},
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use pico::{
    Congestion, Event, KeyRef, PublisherId, PutOptions, Session, SessionConfig,
    driver::{self, App, Next},
};
use router::{Target, Tcp, Wall, open_client, open_router};
use zenoh::qos::CongestionControl;

/// Each figure takes about this long.
const ROUND: Duration = Duration::from_secs(2);

/// Publishes as fast as the session takes it, or counts what comes.
struct Load {
    publisher: Option<PublisherId>,
    payload: Vec<u8>,
    end: Instant,
    received: Arc<AtomicU64>,
}

impl App for Load {
    fn poll(&mut self, _now_us: u64, session: &mut Session) -> Next {
        while let Some(event) = session.poll_event() {
            if let Event::Message { .. } = event {
                self.received.fetch_add(1, Ordering::Relaxed);
            }
        }
        let over = Instant::now() >= self.end;
        if let Some(publisher) = self.publisher
            && !over
            && session.is_wanted(publisher)
        {
            let options = PutOptions {
                congestion: Congestion::Block,
                ..PutOptions::default()
            };
            while session
                .put(KeyRef::Publisher(publisher), &self.payload, &options)
                .is_ok()
            {}
        }
        Next {
            wake_at_us: None,
            quit: over,
        }
    }

    fn touched(&self) -> impl Future<Output = ()> {
        let left = self.end.saturating_duration_since(Instant::now());
        async move {
            if left.is_zero() {
                pending::<()>().await;
            }
            tokio::time::sleep(left).await;
        }
    }
}

/// Runs a session of ours on a thread of its own for one round.
fn ours(
    address: SocketAddr,
    batch_bytes: u16,
    publish: bool,
    payload_bytes: usize,
    received: &Arc<AtomicU64>,
) -> std::thread::JoinHandle<()> {
    let received = received.clone();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        runtime.expect("a runtime").block_on(async move {
            let queue_bytes = 4 * usize::from(batch_bytes).max(8192);
            let config = SessionConfig {
                batch_bytes,
                queue_bytes,
                ..SessionConfig::default()
            };
            let mut session = Session::new(config, Arc::as_ptr(&received) as u64);
            let publisher = publish.then(|| session.declare_publisher("load").expect("a key"));
            if !publish {
                session.declare_subscriber("load").expect("a key");
            }
            let end = Instant::now() + ROUND;
            let payload = vec![0; payload_bytes];
            let mut load = Load {
                publisher,
                payload,
                end,
                received,
            };
            let mut tcp = Tcp {
                target: Target::new(address),
            };
            driver::run(&mut session, &mut tcp, &Wall::new(), &mut load).await;
        });
    })
}

/// Which client.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Ours(u16),
    Rust,
}

async fn measure(publisher: Side, subscriber: Side, payload_bytes: usize) -> f64 {
    let (router, address) = open_router().await;
    let received = Arc::new(AtomicU64::new(0));
    let counter = received.clone();
    let their_subscriber = match subscriber {
        Side::Rust => {
            let session = open_client(address).await;
            let count = move |_| {
                counter.fetch_add(1, Ordering::Relaxed);
            };
            let subscriber = session.declare_subscriber("load").callback(count).await;
            Some((subscriber.expect("a subscriber"), session))
        }
        Side::Ours(_) => None,
    };
    let mut threads = Vec::new();
    if let Side::Ours(batch_bytes) = subscriber {
        threads.push(ours(address, batch_bytes, false, payload_bytes, &received));
    }
    let start = Instant::now();
    match publisher {
        Side::Ours(batch_bytes) => {
            let ignored = Arc::new(AtomicU64::new(1));
            threads.push(ours(address, batch_bytes, true, payload_bytes, &ignored));
        }
        Side::Rust => {
            let session = open_client(address).await;
            let payload = vec![0u8; payload_bytes];
            threads.push(std::thread::spawn(move || {
                use zenoh::Wait;
                let publisher = session
                    .declare_publisher("load")
                    .congestion_control(CongestionControl::Block);
                let publisher = publisher.wait().expect("a publisher");
                while start.elapsed() < ROUND {
                    publisher.put(payload.as_slice()).wait().expect("a put");
                }
                drop(publisher);
                session.close().wait().expect("a close");
            }));
        }
    }
    // The middle of the round, without the beginning and the end.
    tokio::time::sleep(ROUND / 4).await;
    let (before, from) = (received.load(Ordering::Relaxed), Instant::now());
    tokio::time::sleep(ROUND / 2).await;
    let rate = (received.load(Ordering::Relaxed) - before) as f64 / from.elapsed().as_secs_f64();
    tokio::task::spawn_blocking(move || {
        for thread in threads {
            thread.join().expect("a side panicked");
        }
    })
    .await
    .expect("joined");
    drop(their_subscriber);
    router.close().await.expect("the router closes");
    rate
}

#[tokio::main]
async fn main() {
    println!("messages/s          payload  batch      ours      zenoh   ratio");
    for payload_bytes in [8, 1024] {
        let rust = measure(Side::Rust, Side::Rust, payload_bytes).await;
        for batch_bytes in [2048, u16::MAX] {
            let side = Side::Ours(batch_bytes);
            for (what, rate) in [
                ("publishing", measure(side, Side::Rust, payload_bytes).await),
                (
                    "subscribing",
                    measure(Side::Rust, side, payload_bytes).await,
                ),
            ] {
                let ratio = rate / rust;
                println!(
                    "{what:12} {payload_bytes:>14} {batch_bytes:>6} {rate:>9.0} {rust:>10.0} {ratio:>7.2}"
                );
            }
        }
    }
}
