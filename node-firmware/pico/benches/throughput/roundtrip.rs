//! From a put through the router to somebody who puts it back, and through the router again.

use std::{
    future::{Future, pending},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use pico::{PublisherId, Session};
use tokio::sync::Notify;
use zenoh::{Wait, qos::CongestionControl};

use crate::{
    ROUND,
    router::{PATIENCE, open_router},
    side::{Side, Work, open_rust, put, run_bare, run_ours},
};

/// Round trips at the beginning that are not counted.
const WARM: usize = 50;

/// Sends one at a time and takes the time until it is back, or sends back what comes.
struct Player {
    serves: bool,
    payload: Vec<u8>,
    express: bool,
    sent_at: Option<Instant>,
    owed: usize,
    end: Instant,
    result: Arc<Mutex<Vec<f64>>>,
    over: Arc<Over>,
}

/// Told to who sends back, when nobody waits for it any more.
#[derive(Default)]
struct Over {
    is: AtomicBool,
    comes: Notify,
}

impl Work for Player {
    fn begin(&mut self, session: &mut Session) -> Option<PublisherId> {
        let (own, other) = keys(self.serves);
        session.declare_subscriber(other).expect("a key");
        Some(session.declare_publisher(own).expect("a key"))
    }

    fn received(&mut self) {
        if let Some(sent_at) = self.sent_at.take() {
            let took_us = sent_at.elapsed().as_secs_f64() * 1e6;
            self.result.lock().expect("no panic").push(took_us);
        } else {
            self.owed += 1;
        }
    }

    fn speak(&mut self, session: &mut Session, publisher: PublisherId) {
        if self.serves {
            if self.sent_at.is_none() {
                self.sent_at = Some(Instant::now());
                put(session, publisher, &self.payload, self.express);
            }
        } else {
            while self.owed > 0 && put(session, publisher, &self.payload, self.express) {
                self.owed -= 1;
            }
        }
    }

    fn over(&self) -> impl Future<Output = ()> {
        let left = self.end.saturating_duration_since(Instant::now());
        let serves = self.serves;
        let over = self.over.clone();
        async move {
            if !serves {
                over.comes.notified().await;
            } else if left.is_zero() {
                pending::<()>().await;
            } else {
                tokio::time::sleep(left).await;
            }
        }
    }

    fn is_over(&self) -> bool {
        if self.serves {
            return Instant::now() >= self.end;
        }
        self.over.is.load(Ordering::Relaxed)
    }
}

/// The keys of who serves and who returns, own one first.
fn keys(serves: bool) -> (&'static str, &'static str) {
    if serves {
        ("there", "back")
    } else {
        ("back", "there")
    }
}

/// Median of a round trip, µs.
pub(crate) async fn measure(side: Side, payload_bytes: usize, express: bool) -> f64 {
    let (router, address) = open_router().await;
    let result = Arc::new(Mutex::new(Vec::new()));
    let mut times = match side {
        Side::Ours(batch_bytes) | Side::Bare(batch_bytes) => {
            let over = Arc::<Over>::default();
            let player = |serves| Player {
                serves,
                payload: vec![0; payload_bytes],
                express,
                sent_at: None,
                owed: 0,
                end: Instant::now() + ROUND,
                result: result.clone(),
                over: over.clone(),
            };
            let run = |player| match side {
                Side::Bare(_) => run_bare(address, batch_bytes, player),
                _ => run_ours(address, batch_bytes, player),
            };
            let (returns, serves) = (run(player(false)), run(player(true)));
            let threads = tokio::task::spawn_blocking(move || {
                serves.join().expect("a side panicked");
                over.is.store(true, Ordering::Relaxed);
                over.comes.notify_one();
                returns.join().expect("a side panicked");
            });
            threads.await.expect("joined");
            std::mem::take(&mut *result.lock().expect("no panic"))
        }
        Side::Rust(batch_bytes) => {
            let returns = open_rust(address, batch_bytes).await;
            let serves = open_rust(address, batch_bytes).await;
            let echo = publisher(&returns, keys(false).0, express);
            let payload = vec![0u8; payload_bytes];
            let answer = payload.clone();
            let echoing = returns
                .declare_subscriber(keys(true).0)
                .callback(move |_| echo.put(answer.as_slice()).wait().expect("a put"))
                .await;
            let echoing = echoing.expect("a subscriber");
            // As ours do it: who takes a message sends the next one in the same thread.
            let there = Arc::new(publisher(&serves, keys(true).0, express));
            let (ended, ends) = std::sync::mpsc::channel();
            let end = Instant::now() + ROUND;
            let round = Arc::new(Mutex::new((Instant::now(), Vec::new())));
            let (next, taken) = (there.clone(), round.clone());
            let again = payload.clone();
            let listening = serves
                .declare_subscriber(keys(true).1)
                .callback(move |_| {
                    let mut round = taken.lock().expect("no panic");
                    let (sent_at, times) = &mut *round;
                    times.push(sent_at.elapsed().as_secs_f64() * 1e6);
                    *sent_at = Instant::now();
                    drop(round);
                    if Instant::now() < end {
                        next.put(again.as_slice()).wait().expect("a put");
                    } else {
                        // Nobody waits any more if it took too long.
                        let _ = ended.send(());
                    }
                })
                .await;
            let listening = listening.expect("a subscriber");
            let over = tokio::task::spawn_blocking(move || {
                // Until both sides know of each other a put may reach nobody.
                while !there.matching_status().wait().expect("open").matching() {
                    std::thread::yield_now();
                }
                round.lock().expect("no panic").0 = Instant::now();
                there.put(payload.as_slice()).wait().expect("a put");
                ends.recv_timeout(ROUND + PATIENCE)
                    .expect("the last one comes back");
                std::mem::take(&mut round.lock().expect("no panic").1)
            });
            let times = over.await.expect("joined");
            drop((echoing, listening));
            times
        }
    };
    router.close().await.expect("the router closes");
    times.drain(..WARM.min(times.len()));
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}

fn publisher<'a>(
    session: &zenoh::Session,
    key: &'static str,
    express: bool,
) -> zenoh::pubsub::Publisher<'a> {
    session
        .declare_publisher(key)
        .congestion_control(CongestionControl::Block)
        .express(express)
        .wait()
        .expect("a publisher")
}
