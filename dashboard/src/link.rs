//! The way to the fleet: one thread with its own zenoh session, an [`Inbox`] in this direction and
//! two bounded channels in the other.
//!
//! ```text
//!  zenoh callbacks ─▶ Inbox ─▶ app::logic        app ─▶ urgent (stops) ─▶┐
//!                                                app ─▶ ordinary ───────▶┴▶ perform ─▶ zenoh
//! ```
//!
//! A stop has its own channel and never waits behind anything else. While there is no session,
//! every request is answered at once with “not sent”: nothing that the operator asked for minutes
//! ago is done later by surprise.

pub mod inbox;
mod perform;
mod refusal;
mod session;

use crate::{
    message::{Answer, Message, Moment},
    request::{Request, Ticket},
};
use inbox::Inbox;
use keys::{Keys, credentials::Credentials};
use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::{Instant, SystemTime, UNIX_EPOCH},
};
use tokio::sync::mpsc;

/// The address when none is set.
pub const CONNECT_DEFAULT: &str = "tcp/localhost:7447";

/// Requests that wait for the link's thread. It takes them at once, so that this many means that
/// it hangs; then a request is answered with “not sent”.
const REQUESTS_MAX: usize = 64;

/// Where the fleet is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// [`CONNECT_DEFAULT`], and if nothing is there, whatever scouting finds.
    Automatic,
    /// Whatever scouting finds.
    Scouted,
    /// This locator and nothing else.
    At(String),
    /// The first of these that answers.
    OneOf(Vec<String>),
}

/// What the link needs to know.
#[derive(Clone)]
pub struct LinkConfig {
    /// Where to connect.
    pub place: Place,
    /// The prefix of the fleet.
    pub keys: Keys,
    /// For routers that ask, and the only certificates that are trusted.
    pub credentials: Option<Credentials>,
}

/// How far the computer's clock may be ahead before that is taken for a sleep, µs.
const SLEEP_US_MIN: u64 = 2_000_000;

/// Tells [`Moment`]s.
#[derive(Clone, Debug)]
pub struct Clock {
    // Shared: all that tell the time tell the same.
    anchor_us: Arc<AtomicU64>,
    started: Instant,
}

impl Clock {
    /// Reads the computer's clock.
    pub fn start() -> Self {
        Self {
            anchor_us: Arc::new(AtomicU64::new(wall_us())),
            started: Instant::now(),
        }
    }

    /// Returns the present.
    pub fn now(&self) -> Moment {
        self.tell(self.started.elapsed().as_micros() as u64, wall_us())
    }

    /// Returns the present, so long after the start by the monotone clock, which stands still while
    /// the computer sleeps.
    fn tell(&self, elapsed_us: u64, wall_us: u64) -> Moment {
        let anchor_us = self.anchor_us.load(Ordering::Relaxed);
        let told_us = anchor_us.saturating_add(elapsed_us);
        if wall_us.saturating_sub(told_us) < SLEEP_US_MIN {
            return Moment(told_us);
        }
        // Another thread may have noticed too; the later one is right.
        let anchor_us = wall_us.saturating_sub(elapsed_us);
        let before_us = self.anchor_us.fetch_max(anchor_us, Ordering::Relaxed);
        Moment(before_us.max(anchor_us).saturating_add(elapsed_us))
    }
}

fn wall_us() -> u64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH);
    since_epoch.map_or(0, |since| since.as_micros() as u64)
}

/// What travels to the link's thread.
type Asked = (Ticket, Request);

/// The link, as the window holds it. Dropping it ends the thread.
pub struct Link {
    inbox: Arc<Inbox>,
    clock: Clock,
    urgent: Option<mpsc::Sender<Asked>>,
    ordinary: Option<mpsc::Sender<Asked>>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// Starts the thread. `wake` is called, from any thread, when something waits in the inbox and
    /// nothing did before.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn spawn(
        config: LinkConfig,
        clock: Clock,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let inbox = Arc::new(Inbox::new(clock.clone(), wake));
        let (urgent, urgent_end) = mpsc::channel(REQUESTS_MAX);
        let (ordinary, ordinary_end) = mpsc::channel(REQUESTS_MAX);
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()?;
        let ends = session::Ends {
            urgent: urgent_end,
            ordinary: ordinary_end,
        };
        let of_thread = Arc::clone(&inbox);
        let thread = std::thread::Builder::new()
            .name("link".to_owned())
            .spawn(move || {
                runtime.block_on(session::run(config, of_thread, ends));
                runtime.shutdown_background();
            })?;
        Ok(Self {
            inbox,
            clock,
            urgent: Some(urgent),
            ordinary: Some(ordinary),
            thread: Some(thread),
        })
    }

    /// Returns what was heard since the last call, in order.
    pub fn heard(&self) -> Vec<(Moment, Message)> {
        self.inbox.take()
    }

    /// Returns the present.
    pub fn now(&self) -> Moment {
        self.clock.now()
    }

    /// Hands a request over and returns at once. The answer comes with what is heard.
    pub fn ask(&self, ticket: Ticket, request: Request) {
        let channel = match request {
            Request::Stop { .. } => &self.urgent,
            _ => &self.ordinary,
        };
        let sent = channel
            .as_ref()
            .is_some_and(|channel| channel.try_send((ticket, request)).is_ok());
        if !sent {
            let answer = Answer::Failed("NOT SENT: the link does not take requests".to_owned());
            self.inbox.push(Message::Answer { ticket, answer });
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        (self.urgent, self.ordinary) = (None, None);
        if let Some(thread) = self.thread.take() {
            // A panic in there has been printed; the window goes anyway.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_is_right_again_after_the_computer_slept_and_never_goes_back() {
        let clock = Clock {
            anchor_us: Arc::new(AtomicU64::new(1_000_000_000)),
            started: Instant::now(),
        };
        let second = 1_000_000;
        let tell = |elapsed_s: u64, wall_s: u64| {
            clock.tell(elapsed_s * second, wall_s * second).0 / second
        };
        assert_eq!(tell(5, 1_005), 1_005);
        // Set back, or a little ahead, by somebody or by the network's time.
        assert_eq!((tell(6, 500), tell(7, 1_008)), (1_006, 1_007));
        // Slept for an hour.
        assert_eq!(tell(8, 4_608), 4_608);
        assert_eq!((tell(9, 4_609), tell(10, 4_000)), (4_609, 4_610));
    }
}
