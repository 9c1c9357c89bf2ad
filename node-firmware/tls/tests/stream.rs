//! The halves over a stream that takes and gives little at a time, with reads and writes that are
//! dropped all the time, as the node's client drops them.

mod peer;

use embedded_io_async::{ErrorType, Read, Write};
use peer::{Ca, Router, YEARS};
use rustls::version::TLS13;
use std::{
    cell::RefCell,
    convert::Infallible,
    future::{Future, poll_fn},
    pin::pin,
    rc::Rc,
    task::{Context, Poll, Waker},
};
use tls::{
    TlsConfig, TlsError,
    stream::{StreamError, TlsReader, TlsWriter, open},
};

/// A router at the end of a stream.
struct Far {
    router: Router,
    /// What it has said and nobody has read.
    said: Vec<u8>,
    /// Half of the calls wait, so that there is something to drop.
    calls: usize,
    hangs_up: bool,
}

#[derive(Clone)]
struct Half(Rc<RefCell<Far>>);

impl Half {
    fn waits(&self) -> bool {
        let mut far = self.0.borrow_mut();
        far.calls += 1;
        far.calls.wrapping_mul(0x9e37_79b9) >> 16 & 1 == 1
    }
}

impl ErrorType for Half {
    type Error = Infallible;
}

impl Read for Half {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            let waits = self.waits();
            let mut far = self.0.borrow_mut();
            let more = far.router.transmit();
            far.said.extend(more);
            if far.said.is_empty() && far.hangs_up {
                return Poll::Ready(Ok(0));
            }
            if waits || far.said.is_empty() {
                return Poll::Pending;
            }
            let count = far.said.len().min(buffer.len()).min(7 + far.calls % 100);
            buffer[..count].copy_from_slice(&far.said[..count]);
            far.said.drain(..count);
            Poll::Ready(Ok(count))
        })
        .await
    }
}

impl Write for Half {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            if self.waits() {
                return Poll::Pending;
            }
            let mut far = self.0.borrow_mut();
            let count = bytes.len().min(5 + far.calls % 60);
            far.router.handle_bytes(&bytes[..count]);
            Poll::Ready(Ok(count))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Polls until it is ready.
fn finish<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    for _ in 0..100_000 {
        if let Poll::Ready(result) = future.as_mut().poll(&mut context) {
            return result;
        }
    }
    panic!("it waits for ever");
}

/// Polls once and drops it.
fn attempt<T>(future: impl Future<Output = T>) -> Option<T> {
    let mut context = Context::from_waker(Waker::noop());
    match pin!(future).poll(&mut context) {
        Poll::Ready(result) => Some(result),
        Poll::Pending => None,
    }
}

fn far(ca: &Ca) -> Half {
    let router = Router::new(&ca.router(&["plant"], YEARS, &[&TLS13]));
    Half(Rc::new(RefCell::new(Far {
        router,
        said: Vec::new(),
        calls: 0,
        hangs_up: false,
    })))
}

#[test]
fn reads_and_writes_that_are_dropped_lose_nothing_and_say_nothing_twice() {
    let ca = Ca::new();
    let half = far(&ca);
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    let link = finish(open(&config, &mut half.clone(), &mut half.clone())).expect("opened");
    let link = Rc::new(RefCell::new(link));
    let mut reader = TlsReader::new(link.clone(), half.clone());
    let mut writer = TlsWriter::new(link, half.clone());
    let text: Vec<u8> = (0..5_000_u32).map(|at| (at * 31 / 7) as u8).collect();
    let (mut said, mut heard, mut got) = (0, Vec::new(), Vec::new());
    let mut dropped = 0;
    let mut buffer = [0; 100];
    for _ in 0..100_000 {
        let until = text.len().min(said + 700);
        if said < until {
            match attempt(writer.write(&text[said..until])) {
                Some(count) => said += count.expect("taken"),
                None => dropped += 1,
            }
        }
        let mut far = half.0.borrow_mut();
        let more = far.router.heard();
        // The router says it all again.
        for chunk in more.chunks(333) {
            let record = far.router.say(chunk);
            far.said.extend(record);
        }
        heard.extend(more);
        drop(far);
        match attempt(reader.read(&mut buffer)) {
            Some(count) => got.extend_from_slice(&buffer[..count.expect("read")]),
            None => dropped += 1,
        }
        if got.len() == text.len() {
            break;
        }
    }
    assert!(heard == text && got == text);
    assert!(dropped > 100, "{dropped} calls were dropped");
}

#[test]
fn a_stream_that_is_cut_is_told_from_one_that_ends() {
    let ca = Ca::new();
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    for orderly in [true, false] {
        let half = far(&ca);
        let link = finish(open(&config, &mut half.clone(), &mut half.clone())).expect("opened");
        let mut reader = TlsReader::new(Rc::new(RefCell::new(link)), half.clone());
        if orderly {
            half.0.borrow_mut().router.0.send_close_notify();
        }
        half.0.borrow_mut().hangs_up = true;
        let read = finish(reader.read(&mut [0; 10]));
        assert_eq!(
            read,
            if orderly {
                Ok(0)
            } else {
                Err(StreamError::Cut)
            }
        );
    }
    // Cut in the handshake.
    let half = far(&ca);
    half.0.borrow_mut().hangs_up = true;
    half.0.borrow_mut().router = Router::new(&ca.router(&["other"], YEARS, &[&TLS13]));
    let refused = finish(open(&config, &mut half.clone(), &mut half.clone())).map(|_| ());
    assert_eq!(refused, Err(StreamError::Tls(TlsError::WrongName)));
}
