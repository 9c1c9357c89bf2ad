//! Core 0: the zenoh client. The node is on the other core; what stands in for it here moves
//! messages between the session and two queues.

use crate::{
    flash::CoreFlash,
    plan::{LINK, OUTGOING, Parcel, STOP, WAKE, in_window, now},
    scripts::Shelf,
    secure::{Reader, Writer, secure},
    vitals::Gauges,
};
use alloc::{boxed::Box, rc::Rc, string::ToString, vec, vec::Vec};
use core::{cell::RefCell, future::poll_fn, pin::pin, sync::atomic::Ordering};
use embassy_net::{IpAddress, IpEndpoint, Stack, dns::DnsQueryType, tcp::TcpSocket};
use embassy_time::{Instant, Timer};
use embedded_io_async::{ErrorType, Read, Write};
use esp_hal::system::software_reset;
use heapless::spsc::{Consumer, Producer};
use keys::{
    Keys, LocalMicros, NodeId, NodeTopic, Stop, StopMode, Vitals,
    update::{UpdateMessage, UpdateRefusal, UpdateReply},
};
use node::{
    Inbound, Outbound,
    library::Library,
    run::{Host, NodeLink},
};
use pico::{
    driver::{self, App, Connect, ConnectError, Next},
    session::{Session, SessionConfig},
};
use provision::record::{Record, router_address};
use update::Keeper;

/// From one attempt to restart or to confirm a firmware to the next, µs.
const RETRY_US: u64 = 100_000;

/// Bytes that TCP holds in each direction: two batches of the router's.
pub(crate) const SOCKET_BYTES: usize = 16 * 1024;

/// Stands in for the node.
struct Remote {
    incoming: Producer<'static, Parcel>,
    outgoing: Consumer<'static, Outbound>,
    shelf: Shelf,
    gauges: Gauges,
    /// What the node tells of itself.
    setup: Vec<u8>,
    /// Takes other firmware; `None` if its journal is broken.
    keeper: Option<BoardKeeper>,
}

/// What takes other firmware on a board.
pub(crate) type BoardKeeper = Keeper<CoreFlash>;

impl Host for Remote {
    fn handle(&mut self, now: LocalMicros, inbound: Inbound<'_>) {
        match inbound {
            Inbound::LinkUp => {
                LINK.fetch_or(1, Ordering::AcqRel);
                if let Some(keeper) = self.keeper.as_mut() {
                    keeper.link_up();
                }
            }
            Inbound::LinkDown => {
                let link = LINK.load(Ordering::Acquire);
                LINK.store(link.next_multiple_of(2), Ordering::Release);
                while self.outgoing.dequeue().is_some() {}
            }
            Inbound::Message {
                topic: NodeTopic::Stop,
                payload,
            } => {
                let mode = match Stop::from_payload(payload).mode {
                    StopMode::Decelerate => 1,
                    StopMode::Halt => 2,
                };
                STOP.fetch_max(mode, Ordering::AcqRel);
            }
            Inbound::Message { topic, payload } => {
                let Ok(payload) = heapless::Vec::from_slice(payload) else {
                    // Longer than any order.
                    return;
                };
                let parcel = Parcel {
                    at: now,
                    topic,
                    payload,
                };
                // Full: lost, as on the way here. Whoever sent it waits for an answer.
                let _ = self.incoming.enqueue(parcel);
            }
            // The session says none of these: they come from pins, on the other core.
            Inbound::Lidar { .. }
            | Inbound::StopPin { .. }
            | Inbound::Shift { .. }
            | Inbound::Input(_)
            | Inbound::SignalStrength { .. } => {}
        }
        WAKE.signal(());
    }

    fn poll(&mut self, now: LocalMicros) {
        self.shelf.poll();
        let due = self.keeper.as_mut().filter(|keeper| keeper.is_due(now.0));
        if let Some(keeper) = due
            && in_window(|| keeper.poll(now.0, false)) == Some(true)
        {
            software_reset();
        }
    }

    fn poll_timeout(&self) -> Option<LocalMicros> {
        // Something that moves delays both: then they are looked at again soon.
        let soonest_us = now().0 + RETRY_US;
        let keeper_us = self.keeper.as_ref().and_then(Keeper::poll_timeout);
        let keeper_us = keeper_us.map(|at_us| at_us.max(soonest_us));
        let shelf_us = self.shelf.is_due().then_some(soonest_us);
        keeper_us.into_iter().chain(shelf_us).min().map(LocalMicros)
    }

    fn update(&mut self, now: LocalMicros, message: &UpdateMessage<'_>) -> UpdateReply {
        let Some(keeper) = self.keeper.as_mut() else {
            return UpdateReply::Refused(UpdateRefusal::NoSlot);
        };
        if *message == UpdateMessage::Look {
            return keeper.handle(message, false, now.0);
        }
        in_window(|| keeper.handle(message, false, now.0))
            .unwrap_or(UpdateReply::Refused(UpdateRefusal::Moving))
    }

    fn poll_outbox(&mut self, _now: LocalMicros) -> Option<Outbound> {
        let outbound = self.outgoing.dequeue()?;
        // There is room again.
        WAKE.signal(());
        Some(outbound)
    }

    fn store_script(&mut self, _now: LocalMicros, name: &str, text: Option<&[u8]>) {
        self.shelf.put(name, text);
    }

    fn library(&self) -> &Library {
        self.shelf.library()
    }

    fn vitals(&mut self, now: LocalMicros) -> Vitals {
        self.gauges.read(now)
    }

    fn setup(&self) -> Vec<u8> {
        self.setup.clone()
    }
}

struct LinkApp {
    remote: Remote,
    link: NodeLink,
}

impl App for LinkApp {
    fn poll(&mut self, now_us: u64, session: &mut Session) -> Next {
        let wake_at = self
            .link
            .exchange(&mut self.remote, session, LocalMicros(now_us));
        Next {
            wake_at_us: wake_at.map(|at| at.0),
            quit: false,
        }
    }

    async fn touched(&self) {
        OUTGOING.wait().await;
    }
}

/// The node's clock, the same on both cores.
struct BoardTimer;

impl driver::Timer for BoardTimer {
    fn now_us(&self) -> u64 {
        now().0
    }

    async fn sleep_until_us(&self, at_us: u64) {
        // Both count from boot, embassy's clock in whole microseconds of the same timer.
        let wait_us = at_us.saturating_sub(now().0);
        Timer::at(Instant::now() + embassy_time::Duration::from_micros(wait_us)).await;
    }
}

/// One end of a connection. Reads and writes wait at the same time, so each poll borrows the socket
/// for its own length only: embassy-net keeps no state in the futures that are dropped.
#[derive(Clone)]
pub(crate) struct Half(Rc<RefCell<TcpSocket<'static>>>);

impl ErrorType for Half {
    type Error = embassy_net::tcp::Error;
}

impl Read for Half {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        poll_fn(|context| {
            let mut socket = self.0.borrow_mut();
            let read = pin!(socket.read(buffer));
            read.poll(context)
        })
        .await
    }
}

impl Write for Half {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        poll_fn(|context| {
            let mut socket = self.0.borrow_mut();
            let write = pin!(socket.write(bytes));
            write.poll(context)
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Self::Error> {
        // smoltcp sends without being asked.
        Ok(())
    }
}

struct Tcp {
    stack: Stack<'static>,
    record: &'static Record,
    seed: u64,
    socket: Rc<RefCell<TcpSocket<'static>>>,
}

impl Tcp {
    async fn endpoint(&self) -> Result<IpEndpoint, ConnectError> {
        if self.record.router.is_empty() {
            let seed = Instant::now().as_micros() ^ self.seed;
            return crate::scout::find(self.stack, seed).await;
        }
        let (host, port) = router_address(&self.record.router).ok_or(ConnectError)?;
        if let Ok(address) = host.parse::<core::net::Ipv4Addr>() {
            return Ok(IpEndpoint::new(IpAddress::Ipv4(address), port));
        }
        let found = self.stack.dns_query(host, DnsQueryType::A).await;
        let address = found.ok().and_then(|found| found.first().copied());
        Ok(IpEndpoint::new(address.ok_or(ConnectError)?, port))
    }
}

impl Connect for Tcp {
    type Reader = Reader;
    type Writer = Writer;

    #[expect(
        clippy::await_holding_refcell_ref,
        reason = "nobody else has the socket while it connects"
    )]
    async fn connect(&mut self) -> Result<(Reader, Writer), ConnectError> {
        self.stack.wait_config_up().await;
        let endpoint = self.endpoint().await?;
        {
            let mut socket = self.socket.borrow_mut();
            socket.abort();
            socket.set_nagle_enabled(false);
            socket.connect(endpoint).await.map_err(|_| ConnectError)?;
        }
        secure(self.record, Half(self.socket.clone())).await
    }
}

/// Runs the session for ever. A task of its own: below a handshake of TLS there is no room on the stack
/// for what `main` keeps there.
#[embassy_executor::task]
pub(crate) async fn run(
    stack: Stack<'static>,
    record: &'static Record,
    name: NodeId,
    keys: Keys,
    seed: u64,
    incoming: Producer<'static, Parcel>,
    outgoing: Consumer<'static, Outbound>,
    keeper: Option<BoardKeeper>,
    shelf: Shelf,
    gauges: Gauges,
    setup: Vec<u8>,
) {
    let credentials = record.login.as_ref().map(|login| pico::Credentials {
        user: login.user.to_string(),
        password: login.password.to_string(),
    });
    let config = SessionConfig {
        credentials,
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, seed);
    let link = NodeLink::declare(&mut session, &keys, &name)
        .expect("a session has room for one node's keys");
    let mut app = LinkApp {
        remote: Remote {
            incoming,
            outgoing,
            shelf,
            gauges,
            setup,
            keeper,
        },
        link,
    };
    let receive = Box::leak(vec![0; SOCKET_BYTES].into_boxed_slice());
    let send = Box::leak(vec![0; SOCKET_BYTES].into_boxed_slice());
    let mut tcp = Tcp {
        stack,
        record,
        seed,
        socket: Rc::new(RefCell::new(TcpSocket::new(stack, receive, send))),
    };
    loop {
        driver::run(&mut session, &mut tcp, &BoardTimer, &mut app).await;
    }
}
