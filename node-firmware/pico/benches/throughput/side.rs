//! The two kinds of clients.

use std::{net::SocketAddr, sync::Arc};

use pico::{
    Congestion, Event, KeyRef, PublisherId, PutOptions, Session, SessionConfig,
    driver::{self, App, Next},
};

use crate::router::{self, Target, Tcp, Wall};

/// Which client, and its longest batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Side {
    Ours(u16),
    Rust(u16),
}

/// Opens a client of the zenoh crate with these batches.
pub(crate) async fn open_rust(address: SocketAddr, batch_bytes: u16) -> zenoh::Session {
    router::open_client_with(address, |config| {
        let batch_bytes = batch_bytes.to_string();
        config
            .insert_json5("transport/link/tx/batch_size", &batch_bytes)
            .expect("a known setting");
    })
    .await
}

/// What a client of ours does with a session in a benchmark.
pub(crate) trait Work {
    /// Declares what it needs.
    fn begin(&mut self, session: &mut Session) -> Option<PublisherId>;
    /// A message has come.
    fn received(&mut self);
    /// Says what there is to say; somebody wants it.
    fn speak(&mut self, session: &mut Session, publisher: PublisherId);
    /// Resolves when it is over.
    fn over(&self) -> impl Future<Output = ()>;
    /// It is over.
    fn is_over(&self) -> bool;
}

struct Worker<W> {
    work: W,
    publisher: Option<PublisherId>,
    wanted: bool,
}

impl<W: Work> App for Worker<W> {
    fn poll(&mut self, _now_us: u64, session: &mut Session) -> Next {
        while let Some(event) = session.poll_event() {
            match event {
                Event::Message { .. } => self.work.received(),
                Event::Wanted { wanted, .. } => self.wanted = wanted,
                _ => {}
            }
        }
        let quit = self.work.is_over();
        if let Some(publisher) = self.publisher
            && self.wanted
            && !quit
        {
            self.work.speak(session, publisher);
        }
        Next {
            wake_at_us: None,
            quit,
        }
    }

    fn touched(&self) -> impl Future<Output = ()> {
        self.work.over()
    }
}

/// Runs a session of ours on a thread of its own.
pub(crate) fn run_ours(
    address: SocketAddr,
    batch_bytes: u16,
    mut work: impl Work + Send + 'static,
) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        runtime.expect("a runtime").block_on(async move {
            let config = SessionConfig {
                batch_bytes,
                queue_bytes: 4 * usize::from(batch_bytes).max(8192),
                ..SessionConfig::default()
            };
            // The address of something that lives: no other session here has it at this time.
            let mark = Arc::new(());
            let mut session = Session::new(config, Arc::as_ptr(&mark) as u64);
            let publisher = work.begin(&mut session);
            let mut worker = Worker {
                work,
                publisher,
                wanted: false,
            };
            let mut tcp = Tcp {
                target: Target::new(address),
            };
            driver::run(&mut session, &mut tcp, &Wall::new(), &mut worker).await;
        });
    })
}

/// Puts a value so that it arrives; `false` if the queue is full.
pub(crate) fn put(
    session: &mut Session,
    publisher: PublisherId,
    payload: &[u8],
    express: bool,
) -> bool {
    let options = PutOptions {
        congestion: Congestion::Block,
        express,
        ..PutOptions::default()
    };
    session
        .put(KeyRef::Publisher(publisher), payload, &options)
        .is_ok()
}
