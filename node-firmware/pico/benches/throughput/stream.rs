//! Messages a second from a publisher to a subscriber.

use std::{
    future::{Future, pending},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use pico::{PublisherId, Session};
use zenoh::{Wait, qos::CongestionControl};

use crate::{
    ROUND,
    router::open_router,
    side::{Side, Work, open_rust, put, run_ours},
};

/// Publishes as fast as the session takes it, or counts what comes.
struct Load {
    publishes: bool,
    payload: Vec<u8>,
    express: bool,
    end: Instant,
    received: Arc<AtomicU64>,
}

impl Work for Load {
    fn begin(&mut self, session: &mut Session) -> Option<PublisherId> {
        if self.publishes {
            return Some(session.declare_publisher("load").expect("a key"));
        }
        session.declare_subscriber("load").expect("a key");
        None
    }

    fn received(&mut self) {
        self.received.fetch_add(1, Ordering::Relaxed);
    }

    fn speak(&mut self, session: &mut Session, publisher: PublisherId) {
        while put(session, publisher, &self.payload, self.express) {}
    }

    fn over(&self) -> impl Future<Output = ()> {
        let left = self.end.saturating_duration_since(Instant::now());
        async move {
            if left.is_zero() {
                pending::<()>().await;
            }
            tokio::time::sleep(left).await;
        }
    }

    fn is_over(&self) -> bool {
        Instant::now() >= self.end
    }
}

pub(crate) async fn measure(
    publisher: Side,
    subscriber: Side,
    payload_bytes: usize,
    express: bool,
) -> f64 {
    let (router, address) = open_router().await;
    let received = Arc::new(AtomicU64::new(0));
    let load = |publishes, received: &Arc<AtomicU64>| Load {
        publishes,
        payload: vec![0; payload_bytes],
        express,
        end: Instant::now() + ROUND,
        received: received.clone(),
    };
    let mut threads = Vec::new();
    let mut their_subscriber = None;
    match subscriber {
        Side::Ours(batch_bytes) => {
            threads.push(run_ours(address, batch_bytes, load(false, &received)));
        }
        Side::Bare(_) => unreachable!("only round trips have it"),
        Side::Rust(batch_bytes) => {
            let session = open_rust(address, batch_bytes).await;
            let counter = received.clone();
            let count = move |_| {
                counter.fetch_add(1, Ordering::Relaxed);
            };
            let subscriber = session.declare_subscriber("load").callback(count).await;
            their_subscriber = Some((subscriber.expect("a subscriber"), session));
        }
    }
    let start = Instant::now();
    match publisher {
        Side::Ours(batch_bytes) => {
            let nothing = Arc::new(AtomicU64::new(0));
            threads.push(run_ours(address, batch_bytes, load(true, &nothing)));
        }
        Side::Bare(_) => unreachable!("only round trips have it"),
        Side::Rust(batch_bytes) => {
            let session = open_rust(address, batch_bytes).await;
            let payload = vec![0u8; payload_bytes];
            threads.push(std::thread::spawn(move || {
                let publisher = session
                    .declare_publisher("load")
                    .congestion_control(CongestionControl::Block)
                    .express(express);
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
