//! Everything that the node's zenoh client can do, linked for a bare target, to be weighed by
//! `.ci/client-size/run`. It is never executed: its input comes from an address that means nothing.
#![no_std]
#![no_main]

extern crate alloc;

use core::{
    alloc::{GlobalAlloc, Layout},
    future::{Future, pending, ready},
    panic::PanicInfo,
    pin::pin,
    ptr,
    task::{Context, Waker},
};
use pico::{
    Credentials, Encoding, Event, GetOptions, InboundQuery, KeyId, LivelinessId, PublisherId,
    PutOptions, QueryableId, Session, SessionConfig, SubscriberId, TokenId,
    driver::{self, App, Connect, ConnectError, Next, Timer},
};

/// Where everything comes from that the compiler must not know.
const SOMETHING: *mut usize = 0x1000_0000 as *mut usize;

/// Gives what the compiler cannot know.
fn something() -> usize {
    // SAFETY: nothing here is ever executed.
    unsafe { ptr::read_volatile(SOMETHING) }
}

/// Takes what the compiler must not leave out.
fn used<T>(value: T) {
    let address = ptr::from_ref(&value) as usize;
    // SAFETY: nothing here is ever executed.
    unsafe { ptr::write_volatile(SOMETHING, address) };
    core::mem::forget(value);
}

fn bytes() -> &'static [u8] {
    // SAFETY: nothing here is ever executed.
    unsafe { core::slice::from_raw_parts(something() as *const u8, something()) }
}

fn text() -> &'static str {
    core::str::from_utf8(bytes()).unwrap_or("")
}

/// The heap is the board's; here it has no code.
struct NoHeap;

// SAFETY: nothing here is ever executed.
unsafe impl GlobalAlloc for NoHeap {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        (something() + layout.size()) as *mut u8
    }

    unsafe fn dealloc(&self, block: *mut u8, _layout: Layout) {
        used(block);
    }
}

#[global_allocator]
static HEAP: NoHeap = NoHeap;

getrandom::register_custom_getrandom!(no_random);

fn no_random(_bytes: &mut [u8]) -> Result<(), getrandom::Error> {
    Ok(())
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        used(0);
    }
}

struct Stream;

impl embedded_io_async::ErrorType for Stream {
    type Error = core::convert::Infallible;
}

impl embedded_io_async::Read for Stream {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, Self::Error> {
        into.fill(something() as u8);
        Ok(something())
    }
}

impl embedded_io_async::Write for Stream {
    async fn write(&mut self, from: &[u8]) -> Result<usize, Self::Error> {
        used(from);
        Ok(something())
    }

    async fn flush(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

struct Network;

impl Connect for Network {
    type Reader = Stream;
    type Writer = Stream;

    async fn connect(&mut self) -> Result<(Stream, Stream), ConnectError> {
        Ok((Stream, Stream))
    }
}

struct Clock;

impl Timer for Clock {
    fn now_us(&self) -> u64 {
        something() as u64
    }

    fn sleep_until_us(&self, at_us: u64) -> impl Future<Output = ()> {
        used(at_us);
        ready(())
    }
}

#[derive(Default)]
struct Everything {
    key: Option<KeyId>,
    publisher: Option<PublisherId>,
    subscriber: Option<SubscriberId>,
    queryable: Option<QueryableId>,
    token: Option<TokenId>,
    liveliness: Option<LivelinessId>,
    asked: Option<InboundQuery>,
}

impl App for Everything {
    fn poll(&mut self, now_us: u64, session: &mut Session) -> Next {
        while let Some(event) = session.poll_event() {
            if let Event::Query { query, .. } = event {
                self.asked = Some(query);
            }
            used(event);
        }
        self.declare(session);
        let put = PutOptions {
            encoding: Encoding {
                id: something() as u16,
                schema: Some(bytes().into()),
            },
            attachment: Some(bytes().into()),
            express: something() == 0,
            ..PutOptions::default()
        };
        if let Some(publisher) = self.publisher {
            used(session.put(publisher, bytes(), &put));
        }
        used(session.put(text(), bytes(), &put));
        used(session.delete(text(), &put));
        let get = GetOptions::default();
        used(session.get(text(), text(), Some(bytes()), &get, now_us));
        if let Some(query) = &self.asked {
            used(session.reply(query, text(), bytes(), &put));
            used(session.reply_delete(query, text(), &put));
            used(session.reply_error(query, bytes(), &put.encoding));
            used(session.reply_final(query));
        }
        used(session.counters());
        Next {
            wake_at_us: Some(now_us),
            quit: something() == 0,
        }
    }

    fn touched(&self) -> impl Future<Output = ()> {
        pending()
    }
}

impl Everything {
    fn declare(&mut self, session: &mut Session) {
        if let Some(key) = self.key.take() {
            used(session.undeclare_key(key));
        }
        if let Some(publisher) = self.publisher.take() {
            used(session.undeclare_publisher(publisher));
        }
        if let Some(subscriber) = self.subscriber.take() {
            used(session.undeclare_subscriber(subscriber));
        }
        if let Some(queryable) = self.queryable.take() {
            used(session.undeclare_queryable(queryable));
        }
        if let Some(token) = self.token.take() {
            used(session.undeclare_token(token));
        }
        if let Some(liveliness) = self.liveliness.take() {
            used(session.undeclare_liveliness_subscriber(liveliness));
        }
        self.key = session.declare_key(text()).ok();
        self.publisher = session.declare_publisher(text()).ok();
        self.subscriber = session.declare_subscriber(text()).ok();
        self.queryable = session.declare_queryable(text(), something() == 0).ok();
        self.token = session.declare_token(text()).ok();
        self.liveliness = session.declare_liveliness_subscriber(text()).ok();
    }
}

#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.start")]
extern "C" fn _start() -> ! {
    let config = SessionConfig {
        credentials: Some(Credentials {
            user: text().into(),
            password: text().into(),
        }),
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, something() as u64);
    let mut everything = Everything::default();
    let mut network = Network;
    let mut conversation = pin!(driver::run(
        &mut session,
        &mut network,
        &Clock,
        &mut everything
    ));
    loop {
        let mut context = Context::from_waker(Waker::noop());
        used(conversation.as_mut().poll(&mut context));
    }
}
