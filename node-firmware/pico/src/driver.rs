//! The shell around a [`Session`]: connects, reads, writes, waits. The only async file.
//!
//! ```text
//!   back-off ─▶ connect ─▶ ┌ read ─▶ handle_bytes      ┐
//!      ▲                   │ poll_transmit ─▶ write    │ all at once,
//!      │                   │ sleep ─▶ handle_timeout   │ then App::poll
//!      └── lost, refused ──└ App::touched              ┘
//! ```
//!
//! Promises: it reads while a write waits, so two sides that both send cannot block each other; a
//! write that was taken in part goes on where it stopped; a connection attempt is not restarted by
//! a wake-up; the application is polled after everything that happened, also while there is no
//! connection.
//!
//! No future here needs to be `Send`, and the traits do not demand it. With a [`Connect`], [`Timer`]
//! and [`App`] whose futures are `Send` the future of [`run`] is too, so it can be spawned on a
//! threaded runtime as well as polled by an executor on the chip.

use alloc::{vec, vec::Vec};
use core::{
    fmt,
    future::{Future, pending, poll_fn},
    pin::pin,
    task::Poll,
};

use embassy_futures::select::{Either3, select, select3};
use embedded_io_async::{Read, Write};

use crate::{limits, session::Session};

/// No byte stream could be opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConnectError;

impl fmt::Display for ConnectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no byte stream to the router could be opened")
    }
}

impl core::error::Error for ConnectError {}

/// Opens byte streams to the router.
pub trait Connect {
    /// Reads from it. `read` must be cancel-safe: a dropped call has taken nothing.
    type Reader: Read;
    /// Writes to it. `write` must be cancel-safe, and send without being flushed.
    type Writer: Write;

    /// Opens one. The call is dropped when it takes longer than the session allows.
    fn connect(
        &mut self,
    ) -> impl Future<Output = Result<(Self::Reader, Self::Writer), ConnectError>>;
}

/// A clock that can wait.
pub trait Timer {
    /// Microseconds of a clock that does not run backwards.
    fn now_us(&self) -> u64;
    /// Resolves when the clock shows `at_us`; at once if it does already.
    fn sleep_until_us(&self, at_us: u64) -> impl Future<Output = ()>;
}

/// When the application wants to be polled again.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Next {
    /// At this time at the latest, by the [`Timer`]'s clock. It must lie ahead, or the driver
    /// does nothing but poll.
    pub wake_at_us: Option<u64>,
    /// Close the session for good and return.
    pub quit: bool,
}

/// What lives on the session.
pub trait App {
    /// Called after anything happened: takes events from the session and says what is to be said.
    fn poll(&mut self, now_us: u64, session: &mut Session) -> Next;
    /// Resolves when [`App::poll`] should be called for a reason that the driver cannot see. It
    /// is dropped and called anew around every poll, so it must remember a reason that arrives
    /// in between.
    fn touched(&self) -> impl Future<Output = ()>;
}

/// Runs a session until the application quits and the peer has been told, which takes no longer
/// than twice [`limits::CLOSE_TIMEOUT_US`].
///
/// # Cancellation safety
/// Dropping it drops the stream. The session is then as after a lost connection once
/// [`Session::handle_disconnected`] is called, and can be run again.
pub async fn run<C: Connect, T: Timer, A: App>(
    session: &mut Session,
    connect: &mut C,
    timer: &T,
    app: &mut A,
) {
    loop {
        match establish(session, connect, timer, app).await {
            Attempt::Stream(reader, writer) => converse(session, reader, writer, timer, app).await,
            Attempt::Failed => session.handle_connect_failed(timer.now_us()),
            Attempt::Finished => return,
        }
    }
}

enum Attempt<R, W> {
    Stream(R, W),
    Failed,
    Finished,
}

fn poll_app<A: App>(session: &mut Session, app: &mut A, now_us: u64) -> Option<u64> {
    let next = app.poll(now_us, session);
    if next.quit {
        session.close(now_us);
    }
    next.wake_at_us
}

fn earliest(first_us: Option<u64>, second_us: Option<u64>) -> Option<u64> {
    first_us.into_iter().chain(second_us).min()
}

async fn sleep_until<T: Timer>(timer: &T, at_us: Option<u64>) {
    match at_us {
        Some(at_us) => timer.sleep_until_us(at_us).await,
        None => pending().await,
    }
}

/// Waits for the back-off and makes one attempt.
async fn establish<C: Connect, T: Timer, A: App>(
    session: &mut Session,
    connect: &mut C,
    timer: &T,
    app: &mut A,
) -> Attempt<C::Reader, C::Writer> {
    let mut wake_at_us = poll_app(session, app, timer.now_us());
    while !session.wants_connection(timer.now_us()) {
        if session.is_finished() {
            return Attempt::Finished;
        }
        let at_us = earliest(wake_at_us, session.poll_timeout());
        select(sleep_until(timer, at_us), app.touched()).await;
        wake_at_us = poll_app(session, app, timer.now_us());
    }
    let give_up_at_us = timer
        .now_us()
        .saturating_add(session.config().connect_timeout_us);
    let mut attempt = pin!(connect.connect());
    loop {
        let at_us = earliest(wake_at_us, Some(give_up_at_us));
        let happened = select3(attempt.as_mut(), sleep_until(timer, at_us), app.touched()).await;
        match happened {
            Either3::First(Ok((reader, writer))) => return Attempt::Stream(reader, writer),
            Either3::First(Err(ConnectError)) => return Attempt::Failed,
            Either3::Second(()) | Either3::Third(()) => {}
        }
        let now_us = timer.now_us();
        if now_us >= give_up_at_us {
            return Attempt::Failed;
        }
        wake_at_us = poll_app(session, app, now_us);
        if session.is_finished() {
            return Attempt::Finished;
        }
    }
}

/// Carries one conversation until its stream ends.
async fn converse<R: Read, W: Write, T: Timer, A: App>(
    session: &mut Session,
    mut reader: R,
    mut writer: W,
    timer: &T,
    app: &mut A,
) {
    let read_bytes = usize::from(session.config().batch_bytes).max(limits::READ_BYTES);
    let mut input = vec![0; read_bytes];
    let mut output: Vec<u8> = Vec::new();
    let mut written_bytes = 0;
    let mut give_up_at_us = None;
    session.handle_connected(timer.now_us());
    let mut wake_at_us = poll_app(session, app, timer.now_us());
    loop {
        if session.is_finished() {
            break;
        }
        let now_us = timer.now_us();
        if written_bytes == output.len() {
            output.clear();
            written_bytes = 0;
            session.poll_transmit(now_us, &mut output);
        }
        if session.is_over() {
            let at_us = now_us.saturating_add(limits::CLOSE_TIMEOUT_US);
            let at_us = *give_up_at_us.get_or_insert(at_us);
            let nothing_left = session.wants_disconnect() && output.is_empty();
            if nothing_left || now_us >= at_us {
                break;
            }
        }
        let at_us = earliest(earliest(wake_at_us, session.poll_timeout()), give_up_at_us);
        let (read, written) = {
            let wants_bytes = session.wants_bytes();
            let mut reading = pin!(async {
                if !wants_bytes {
                    pending::<()>().await;
                }
                reader.read(&mut input).await
            });
            let mut writing = pin!(async {
                if written_bytes == output.len() {
                    pending::<()>().await;
                }
                writer.write(&output[written_bytes..]).await
            });
            let mut waking = pin!(select(sleep_until(timer, at_us), app.touched()));
            // All are polled every time: a peer that always sends cannot keep us from writing,
            // nor the other way round.
            poll_fn(|context| {
                let read = reading.as_mut().poll(context);
                let written = writing.as_mut().poll(context);
                let woken = waking.as_mut().poll(context).is_ready();
                if read.is_pending() && written.is_pending() && !woken {
                    return Poll::Pending;
                }
                Poll::Ready((read, written))
            })
            .await
        };
        let now_us = timer.now_us();
        match read {
            Poll::Ready(Ok(0) | Err(_)) => break,
            Poll::Ready(Ok(taken_bytes)) => {
                if session.handle_bytes(now_us, &input[..taken_bytes]).is_err() {
                    break;
                }
            }
            Poll::Pending => {}
        }
        // After the read: what the peer said before it hung up still counts.
        match written {
            Poll::Ready(Ok(0) | Err(_)) => break,
            Poll::Ready(Ok(taken_bytes)) => written_bytes += taken_bytes,
            Poll::Pending => {}
        }
        session.handle_timeout(now_us);
        wake_at_us = poll_app(session, app, now_us);
    }
    session.handle_disconnected(timer.now_us());
}
