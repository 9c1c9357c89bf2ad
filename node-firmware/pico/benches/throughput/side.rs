//! The kinds of clients.

use std::{
    io::{ErrorKind, Read as _, Write as _},
    net::{SocketAddr, TcpStream},
    sync::Arc,
    time::Duration,
};

use pico::{
    Congestion, Event, KeyRef, PublisherId, PutOptions, Session, SessionConfig,
    driver::{self, App, Next, Timer as _},
};

use crate::router::{self, Target, Tcp, Wall};

/// Which client, and its longest batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Side {
    Ours(u16),
    /// Ours on a thread that blocks in the socket's read, without a runtime: nothing can be quicker.
    Bare(u16),
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

impl<W: Work> Worker<W> {
    fn new(mut work: W, session: &mut Session) -> Self {
        Self {
            publisher: work.begin(session),
            work,
            wanted: false,
        }
    }

    /// Takes what has come and says what there is to say; returns whether it is over.
    fn turn(&mut self, session: &mut Session) -> bool {
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
        quit
    }
}

impl<W: Work> App for Worker<W> {
    fn poll(&mut self, _now_us: u64, session: &mut Session) -> Next {
        Next {
            wake_at_us: None,
            quit: self.turn(session),
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
    work: impl Work + Send + 'static,
) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        runtime.expect("a runtime").block_on(async move {
            // The address of something that lives: no other session here has it at this time.
            let mark = Arc::new(());
            let mut session = session(batch_bytes, &mark);
            let mut worker = Worker::new(work, &mut session);
            let mut tcp = Tcp {
                target: Target::new(address),
            };
            driver::run(&mut session, &mut tcp, &Wall::new(), &mut worker).await;
        });
    })
}

/// Runs a session of ours on a thread that waits for nothing but bytes.
pub(crate) fn run_bare(
    address: SocketAddr,
    batch_bytes: u16,
    work: impl Work + Send + 'static,
) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        let mark = Arc::new(());
        let mut session = session(batch_bytes, &mark);
        let mut worker = Worker::new(work, &mut session);
        let mut stream = TcpStream::connect(address).expect("the router is there");
        stream.set_nodelay(true).expect("a socket");
        // Now and then it looks whether it is over.
        let looks_every = Some(Duration::from_millis(50));
        stream.set_read_timeout(looks_every).expect("a socket");
        let wall = Wall::new();
        session.handle_connected(wall.now_us());
        let (mut input, mut output) = (vec![0; 1 << 16], Vec::new());
        while !worker.turn(&mut session) {
            session.poll_transmit(wall.now_us(), &mut output);
            stream.write_all(&output).expect("the router reads");
            output.clear();
            match stream.read(&mut input) {
                Ok(0) => panic!("the router hung up"),
                Ok(count) => session
                    .handle_bytes(wall.now_us(), &input[..count])
                    .expect("a router"),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => panic!("{error}"),
            }
            session.handle_timeout(wall.now_us());
        }
    })
}

fn session(batch_bytes: u16, mark: &Arc<()>) -> Session {
    let config = SessionConfig {
        batch_bytes,
        queue_bytes: 4 * usize::from(batch_bytes).max(8192),
        ..SessionConfig::default()
    };
    Session::new(config, Arc::as_ptr(mark) as u64)
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
