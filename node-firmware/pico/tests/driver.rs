//! The driver without sockets and without waiting: streams of the test, virtual time.

mod peer;

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    future::{Future, poll_fn},
    pin::pin,
    rc::Rc,
    task::{Context, Poll, Waker},
};

use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use peer::{Grants, Peer, SECOND_US, key, push};
use pico::{
    CloseReason, Event, PutOptions, Session, SessionConfig,
    driver::{App, Connect, ConnectError, Next, Timer, run},
    limits,
};

/// Everything outside of the driver.
struct World {
    now_us: Cell<u64>,
    /// The earliest time that something sleeps for.
    alarm_us: Cell<Option<u64>>,
    /// Something happened since the last look.
    stirred: Cell<bool>,
    peer: RefCell<Peer>,
    /// Bytes under way to the session.
    inbound: RefCell<VecDeque<u8>>,
    hung_up: Cell<bool>,
    /// How many bytes one write takes; 0 blocks.
    write_bytes: Cell<usize>,
    attempts: Cell<u32>,
    /// When an attempt started at this time is through, and how.
    attempt_us: Cell<u64>,
    attempt_succeeds: Cell<bool>,
    polls: RefCell<Vec<u64>>,
    events: RefCell<Vec<Event>>,
    wake_at_us: Cell<Option<u64>>,
    quit: Cell<bool>,
    touch: Cell<bool>,
    puts: RefCell<Vec<Vec<u8>>>,
}

impl World {
    fn new() -> Rc<Self> {
        Rc::new(Self {
            now_us: Cell::new(SECOND_US),
            alarm_us: Cell::new(None),
            stirred: Cell::new(false),
            peer: RefCell::new(Peer::new(Grants::default())),
            inbound: RefCell::default(),
            hung_up: Cell::new(false),
            write_bytes: Cell::new(usize::MAX),
            attempts: Cell::new(0),
            attempt_us: Cell::new(0),
            attempt_succeeds: Cell::new(true),
            polls: RefCell::default(),
            events: RefCell::default(),
            wake_at_us: Cell::new(None),
            quit: Cell::new(false),
            touch: Cell::new(false),
            puts: RefCell::default(),
        })
    }

    fn alarm(&self, at_us: u64) {
        let alarm_us = self
            .alarm_us
            .get()
            .map_or(at_us, |known_us| known_us.min(at_us));
        self.alarm_us.set(Some(alarm_us));
    }

    fn deliver(&self) {
        self.inbound
            .borrow_mut()
            .extend(self.peer.borrow_mut().take_said());
    }
}

#[derive(Clone)]
struct Handle(Rc<World>);

#[derive(Debug)]
struct HungUp;

impl std::fmt::Display for HungUp {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("hung up")
    }
}

impl std::error::Error for HungUp {}

impl embedded_io_async::Error for HungUp {
    fn kind(&self) -> ErrorKind {
        ErrorKind::ConnectionReset
    }
}

impl ErrorType for Handle {
    type Error = HungUp;
}

impl Read for Handle {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, HungUp> {
        poll_fn(|_| {
            let mut inbound = self.0.inbound.borrow_mut();
            let taken_bytes = inbound.len().min(buf.len());
            if taken_bytes == 0 {
                return if self.0.hung_up.get() {
                    Poll::Ready(Ok(0))
                } else {
                    Poll::Pending
                };
            }
            for (place, byte) in buf.iter_mut().zip(inbound.drain(..taken_bytes)) {
                *place = byte;
            }
            self.0.stirred.set(true);
            Poll::Ready(Ok(taken_bytes))
        })
        .await
    }
}

impl Write for Handle {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, HungUp> {
        poll_fn(|_| {
            if self.0.hung_up.get() {
                return Poll::Ready(Err(HungUp));
            }
            let taken_bytes = self.0.write_bytes.get().min(buf.len());
            if taken_bytes == 0 {
                return Poll::Pending;
            }
            self.0.peer.borrow_mut().hear(&buf[..taken_bytes]);
            self.0.deliver();
            self.0.stirred.set(true);
            Poll::Ready(Ok(taken_bytes))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), HungUp> {
        Ok(())
    }
}

impl Connect for Handle {
    type Reader = Self;
    type Writer = Self;

    async fn connect(&mut self) -> Result<(Self, Self), ConnectError> {
        let world = self.0.clone();
        world.attempts.set(world.attempts.get() + 1);
        let grants = world.peer.borrow().grants.clone();
        *world.peer.borrow_mut() = Peer::new(grants);
        world.inbound.borrow_mut().clear();
        world.hung_up.set(false);
        let at_us = world.now_us.get() + world.attempt_us.get();
        self.sleep_until_us(at_us).await;
        if world.attempt_succeeds.get() {
            Ok((self.clone(), self.clone()))
        } else {
            Err(ConnectError)
        }
    }
}

impl Timer for Handle {
    fn now_us(&self) -> u64 {
        self.0.now_us.get()
    }

    fn sleep_until_us(&self, at_us: u64) -> impl Future<Output = ()> {
        poll_fn(move |_| {
            if self.0.now_us.get() >= at_us {
                return Poll::Ready(());
            }
            self.0.alarm(at_us);
            Poll::Pending
        })
    }
}

struct TestApp(Rc<World>);

impl App for TestApp {
    fn poll(&mut self, now_us: u64, session: &mut Session) -> Next {
        self.0.polls.borrow_mut().push(now_us);
        self.0.stirred.set(true);
        while let Some(event) = session.poll_event() {
            self.0.events.borrow_mut().push(event);
        }
        if session.is_open() {
            self.0
                .puts
                .borrow_mut()
                .retain(|payload| session.put("a", payload, &PutOptions::default()).is_err());
        }
        let wake_at_us = self.0.wake_at_us.take().filter(|at_us| {
            if *at_us > now_us {
                self.0.wake_at_us.set(Some(*at_us));
            }
            *at_us > now_us
        });
        Next {
            wake_at_us,
            quit: self.0.quit.get(),
        }
    }

    fn touched(&self) -> impl Future<Output = ()> {
        poll_fn(|_| {
            if self.0.touch.take() {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
    }
}

/// Runs the driver until `until`, letting time pass when nothing happens. `step` is called
/// whenever the driver waits. Returns whether the driver ended.
fn drive(
    world: &Rc<World>,
    session: &mut Session,
    until_us: u64,
    mut step: impl FnMut(&World),
) -> bool {
    let mut connect = Handle(world.clone());
    let timer = Handle(world.clone());
    let mut app = TestApp(world.clone());
    let mut running = pin!(run(session, &mut connect, &timer, &mut app));
    let mut context = Context::from_waker(Waker::noop());
    let mut idle_polls = 0;
    loop {
        world.alarm_us.set(None);
        world.stirred.set(false);
        if running.as_mut().poll(&mut context).is_ready() {
            return true;
        }
        step(world);
        if world.stirred.get() || world.touch.get() {
            idle_polls += 1;
            assert!(idle_polls < 100_000, "the driver spins");
            continue;
        }
        idle_polls = 0;
        let next_us = world.alarm_us.get().unwrap_or(until_us).min(until_us);
        if world.now_us.get() >= until_us {
            return false;
        }
        world.now_us.set(next_us.max(world.now_us.get()));
    }
}

fn puts(world: &World) -> Vec<usize> {
    use zenoh_protocol::{network::NetworkBody, zenoh::PushBody};
    let mut lengths = Vec::new();
    for (_, message) in world.peer.borrow_mut().heard.drain(..) {
        if let NetworkBody::Push(push) = message.body
            && let PushBody::Put(put) = push.payload
        {
            lengths.push(put.payload.to_zslice().len());
        }
    }
    lengths
}

#[test]
fn a_write_taken_byte_by_byte_loses_nothing() {
    let world = World::new();
    world.write_bytes.set(1);
    world
        .puts
        .borrow_mut()
        .extend([vec![1; 10], vec![2; 3000], vec![3; 1]]);
    let mut session = Session::new(SessionConfig::default(), 1);
    assert!(!drive(&world, &mut session, 2 * SECOND_US, |_| {}));
    assert_eq!(*world.events.borrow(), [Event::Opened]);
    assert_eq!(puts(&world), [10, 3000, 1]);
}

#[test]
fn it_reads_while_the_peer_takes_nothing() {
    let world = World::new();
    let mut session = Session::new(SessionConfig::default(), 1);
    session.declare_subscriber("a").unwrap();
    let mut said = 0;
    drive(&world, &mut session, 5 * SECOND_US, |world| {
        if world.events.borrow().contains(&Event::Opened) && said < 500 {
            if said == 0 {
                world.write_bytes.set(0);
                world.puts.borrow_mut().push(vec![0; 5000]);
            }
            said += 1;
            world.peer.borrow_mut().say([push(key("a"), &[0; 1000])]);
            world.deliver();
            world.stirred.set(true);
        }
    });
    let events = world.events.borrow();
    let messages = events
        .iter()
        .filter(|event| matches!(event, Event::Message { .. }));
    assert_eq!(messages.count(), 500);
    assert!(puts(&world).is_empty());
}

#[test]
fn a_connection_attempt_is_not_started_again_by_wake_ups() {
    let world = World::new();
    world.attempt_us.set(3 * SECOND_US);
    world.wake_at_us.set(Some(SECOND_US + 500_000));
    let mut session = Session::new(SessionConfig::default(), 1);
    let mut touches = 0;
    drive(&world, &mut session, 5 * SECOND_US, |world| {
        if touches < 20 {
            touches += 1;
            world.touch.set(true);
        }
    });
    assert_eq!(world.attempts.get(), 1);
    assert_eq!(*world.events.borrow(), [Event::Opened]);
    assert!(world.polls.borrow().len() > 20, "each touch is a poll");
    assert!(
        world.polls.borrow().contains(&(SECOND_US + 500_000)),
        "and so is the wake-up"
    );
}

#[test]
fn an_attempt_that_hangs_is_given_up_and_made_again_after_the_back_off() {
    let world = World::new();
    world.attempt_us.set(u64::MAX / 2);
    let config = SessionConfig {
        connect_timeout_us: 2 * SECOND_US,
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, 1);
    drive(&world, &mut session, 7 * SECOND_US, |_| {});
    assert_eq!(world.attempts.get(), 3);
    assert_eq!(session.counters().failed_connects, 2);
    assert!(world.events.borrow().is_empty());
}

#[test]
fn the_application_is_woken_in_time_while_nothing_can_be_reached() {
    let world = World::new();
    world.attempt_succeeds.set(false);
    let config = SessionConfig {
        backoff_us_min: 10 * SECOND_US,
        backoff_us_max: 10 * SECOND_US,
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, 1);
    world.wake_at_us.set(Some(4_321_000));
    drive(&world, &mut session, 5 * SECOND_US, |_| {});
    assert!(world.polls.borrow().contains(&4_321_000));
}

#[test]
fn a_lost_link_is_made_again() {
    let world = World::new();
    let mut session = Session::new(SessionConfig::default(), 1);
    let mut cuts = 0;
    drive(&world, &mut session, 8 * SECOND_US, |world| {
        let opened = world
            .events
            .borrow()
            .iter()
            .filter(|e| **e == Event::Opened)
            .count();
        if opened > cuts && cuts < 3 {
            cuts += 1;
            world.hung_up.set(true);
            world.stirred.set(true);
        }
    });
    let closed = Event::Closed {
        reason: CloseReason::Lost,
    };
    let lost = [Event::Opened, closed];
    let expected: Vec<Event> = [&lost[..], &lost, &lost, &[Event::Opened]].concat();
    assert_eq!(*world.events.borrow(), expected);
}

#[test]
fn quitting_sends_what_is_queued_tells_the_peer_and_returns() {
    let world = World::new();
    let mut session = Session::new(SessionConfig::default(), 1);
    let ended = drive(&world, &mut session, 60 * SECOND_US, |world| {
        if world.events.borrow().contains(&Event::Opened) && !world.quit.get() {
            world.puts.borrow_mut().push(vec![0; 6000]);
            world.quit.set(true);
            world.touch.set(true);
        }
    });
    assert!(ended);
    assert_eq!(puts(&world), [6000]);
    assert_eq!(world.peer.borrow().heard_close, Some(0));
    assert_eq!(world.now_us.get(), SECOND_US, "it takes no time");
    assert_eq!(
        world.events.borrow().last(),
        Some(&Event::Closed {
            reason: CloseReason::Local
        })
    );
}

#[test]
fn quitting_towards_a_peer_that_takes_nothing_returns_all_the_same() {
    let world = World::new();
    let mut session = Session::new(SessionConfig::default(), 1);
    let ended = drive(&world, &mut session, 60 * SECOND_US, |world| {
        if world.events.borrow().contains(&Event::Opened) && !world.quit.get() {
            world.write_bytes.set(0);
            world.puts.borrow_mut().push(vec![0; 6000]);
            world.quit.set(true);
            world.touch.set(true);
        }
    });
    assert!(ended);
    assert!(world.now_us.get() <= SECOND_US + 2 * limits::CLOSE_TIMEOUT_US);
}

#[test]
fn quitting_without_a_connection_returns_at_once() {
    let world = World::new();
    world.attempt_us.set(u64::MAX / 2);
    let mut session = Session::new(SessionConfig::default(), 1);
    let ended = drive(&world, &mut session, 60 * SECOND_US, |world| {
        world.quit.set(true);
        world.touch.set(true);
    });
    assert!(ended);
    assert_eq!(world.now_us.get(), SECOND_US);
}

#[test]
fn a_peer_that_falls_silent_is_left_and_found_again() {
    let world = World::new();
    let mut session = Session::new(SessionConfig::default(), 1);
    drive(&world, &mut session, 13 * SECOND_US, |_| {});
    let expired = Event::Closed {
        reason: CloseReason::LeaseExpired,
    };
    assert_eq!(
        *world.events.borrow(),
        [Event::Opened, expired, Event::Opened]
    );
}
