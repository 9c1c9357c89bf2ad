//! A link over the halves of a byte stream, as the node's zenoh client wants them.
//!
//! ```text
//!   open: handshake on the bare halves ─▶ TlsLink ─▶ shared by TlsReader and TlsWriter
//! ```
//!
//! Both halves need the link for moments between two waits, never across one; [`Share`] says how
//! they come by it.

use crate::{
    error::TlsError,
    link::{TlsConfig, TlsLink},
};
use alloc::{rc::Rc, vec, vec::Vec};
use core::{cell::RefCell, fmt};
use embedded_io_async::{Error, ErrorKind, ErrorType, Read, Write};

/// Bytes that are read at once.
const READ_BYTES: usize = 1024;

/// How two halves come by one link: a cell where one thread has both, a lock elsewhere.
pub trait Share: Clone {
    /// Lends the link. It is not called within itself.
    fn with<T>(&self, use_it: impl FnOnce(&mut TlsLink) -> T) -> T;
}

impl Share for Rc<RefCell<TlsLink>> {
    fn with<T>(&self, use_it: impl FnOnce(&mut TlsLink) -> T) -> T {
        use_it(&mut self.borrow_mut())
    }
}

/// Why a stream ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamError<E> {
    /// The stream below.
    Stream(E),
    /// It was cut: it ended without the router's word that nothing more follows.
    Cut,
    /// TLS.
    Tls(TlsError),
}

impl<E> From<TlsError> for StreamError<E> {
    fn from(error: TlsError) -> Self {
        Self::Tls(error)
    }
}

impl<E: fmt::Debug> fmt::Display for StreamError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stream(error) => write!(f, "the connection failed: {error:?}"),
            Self::Cut => f.write_str("the router hung up without a word"),
            Self::Tls(error) => error.fmt(f),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for StreamError<E> {}

impl<E: Error> Error for StreamError<E> {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Stream(error) => error.kind(),
            Self::Cut => ErrorKind::ConnectionReset,
            Self::Tls(_) => ErrorKind::InvalidData,
        }
    }
}

/// Opens a link. After an error the router was told why, if it still listens.
///
/// # Errors
/// See [`StreamError`].
///
/// # Cancellation safety
/// None: drop the stream, too.
pub async fn open<R, W>(
    config: &TlsConfig,
    reader: &mut R,
    writer: &mut W,
) -> Result<TlsLink, StreamError<R::Error>>
where
    R: Read,
    W: Write<Error = R::Error>,
{
    let mut link = TlsLink::new(config)?;
    let mut out = Vec::new();
    let mut input = vec![0; READ_BYTES];
    loop {
        out.clear();
        link.poll_transmit(&mut out);
        writer.write_all(&out).await.map_err(StreamError::Stream)?;
        if link.is_open() {
            return Ok(link);
        }
        let count = reader.read(&mut input).await.map_err(StreamError::Stream)?;
        if count == 0 || link.is_ended() {
            return Err(StreamError::Cut);
        }
        if let Err(error) = link.handle_bytes(&input[..count]) {
            out.clear();
            link.poll_transmit(&mut out);
            // If it fails, the router does not want to know.
            let _ = writer.write_all(&out).await;
            return Err(error.into());
        }
    }
}

/// What the router says. `read` is cancel-safe if that of the half below is.
pub struct TlsReader<S, R> {
    link: S,
    inner: R,
    input: Vec<u8>,
}

impl<S: Share, R: Read> TlsReader<S, R> {
    /// Takes the half and a share of the link.
    pub fn new(link: S, inner: R) -> Self {
        let input = vec![0; READ_BYTES];
        Self { link, inner, input }
    }
}

impl<S, R: Read> ErrorType for TlsReader<S, R> {
    type Error = StreamError<R::Error>;
}

impl<S: Share, R: Read> Read for TlsReader<S, R> {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            let (count, is_ended) = self
                .link
                .with(|link| (link.receive(buffer), link.is_ended()));
            if count > 0 || is_ended {
                return Ok(count);
            }
            let read = self.inner.read(&mut self.input).await;
            let count = read.map_err(StreamError::Stream)?;
            if count == 0 {
                return Err(StreamError::Cut);
            }
            let bytes = &self.input[..count];
            self.link.with(|link| link.handle_bytes(bytes))?;
        }
    }
}

/// What is said to the router. A `write` that was dropped goes on where it was, so it must be
/// repeated with the same bytes, as `pico::driver` does; then none is lost or said twice.
pub struct TlsWriter<S, W> {
    link: S,
    inner: W,
    /// Records on their way, of which the first `sent_bytes` are gone.
    records: Vec<u8>,
    sent_bytes: usize,
    /// How many bytes of the session are in the last of them.
    taken_bytes: usize,
}

impl<S: Share, W: Write> TlsWriter<S, W> {
    /// Takes the half and a share of the link.
    pub fn new(link: S, inner: W) -> Self {
        Self {
            link,
            inner,
            records: Vec::new(),
            sent_bytes: 0,
            taken_bytes: 0,
        }
    }

    async fn drain(&mut self) -> Result<(), StreamError<W::Error>> {
        while self.sent_bytes < self.records.len() {
            let written = self.inner.write(&self.records[self.sent_bytes..]).await;
            match written.map_err(StreamError::Stream)? {
                0 => return Err(StreamError::Cut),
                count => self.sent_bytes += count,
            }
        }
        self.records.clear();
        self.sent_bytes = 0;
        Ok(())
    }
}

impl<S, W: Write> ErrorType for TlsWriter<S, W> {
    type Error = StreamError<W::Error>;
}

impl<S: Share, W: Write> Write for TlsWriter<S, W> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        if self.taken_bytes == 0 {
            let records = &mut self.records;
            self.taken_bytes = self.link.with(|link| link.send(bytes, records))?;
        }
        self.drain().await?;
        let taken_bytes = core::mem::take(&mut self.taken_bytes);
        Ok(taken_bytes.min(bytes.len()))
    }

    async fn flush(&mut self) -> Result<(), Self::Error> {
        self.drain().await?;
        self.inner.flush().await.map_err(StreamError::Stream)
    }
}
