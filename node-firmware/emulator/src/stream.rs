//! The way to the router: TCP, with TLS inside if the node was told an authority.

use crate::scout::{ScoutConfig, find_router};
use embedded_io_adapters::tokio_1::FromTokio;
use embedded_io_async::{ErrorType, Read, Write};
use pico::driver::{Connect, ConnectError};
use std::{
    io,
    sync::{Arc, Mutex, PoisonError},
};
use tls::{
    Authority, TlsConfig, TlsLink,
    stream::{Share, StreamError, TlsReader, TlsWriter},
};
use tokio::net::{
    TcpStream,
    tcp::{OwnedReadHalf, OwnedWriteHalf},
};

/// Where the router is and how it is spoken to.
#[derive(Clone, Debug)]
pub(crate) struct Way {
    /// `HOST:PORT`; empty: whatever scouting finds.
    address: String,
    /// TLS, and whom to trust.
    tls: Option<TlsConfig>,
}

/// Why there is no such way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoWay {
    /// Not `tcp/HOST:PORT` or `tls/HOST:PORT`.
    Locator,
    /// TLS without an authority.
    NoAuthority,
    /// An authority without TLS: what was told one does not speak in the open.
    Open,
}

impl Way {
    /// Reads a locator; empty: scouting.
    pub(crate) fn new(locator: &str, authority: Option<&Authority>) -> Result<Self, NoWay> {
        let Some((protocol, address)) = locator.split_once('/') else {
            return match (locator, authority) {
                ("", None) => Ok(Self {
                    address: String::new(),
                    tls: None,
                }),
                ("", Some(_)) => Err(NoWay::Open),
                _ => Err(NoWay::Locator),
            };
        };
        let (host, port) = address.rsplit_once(':').ok_or(NoWay::Locator)?;
        if host.is_empty() || !port.parse::<u16>().is_ok_and(|port| port != 0) {
            return Err(NoWay::Locator);
        }
        let tls = match (protocol, authority) {
            ("tcp", None) => None,
            ("tcp", Some(_)) => return Err(NoWay::Open),
            // As a board, which has no calendar.
            ("tls", Some(authority)) => {
                let config = TlsConfig::new(authority, host, None);
                Some(config.map_err(|_| NoWay::Locator)?)
            }
            ("tls", None) => return Err(NoWay::NoAuthority),
            _ => return Err(NoWay::Locator),
        };
        Ok(Self {
            address: address.to_owned(),
            tls,
        })
    }
}

/// The link that two halves share.
#[derive(Clone)]
pub(crate) struct Shared(Arc<Mutex<TlsLink>>);

impl Share for Shared {
    fn with<T>(&self, use_it: impl FnOnce(&mut TlsLink) -> T) -> T {
        use_it(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

type TcpReader = FromTokio<OwnedReadHalf>;
type TcpWriter = FromTokio<OwnedWriteHalf>;

/// What the router says.
pub(crate) enum Reader {
    Open(TcpReader),
    Tls(Box<TlsReader<Shared, TcpReader>>),
}

/// What is said to it.
pub(crate) enum Writer {
    Open(TcpWriter),
    Tls(Box<TlsWriter<Shared, TcpWriter>>),
}

fn told(error: StreamError<io::Error>) -> io::Error {
    match error {
        StreamError::Stream(error) => error,
        error => io::Error::other(error),
    }
}

impl ErrorType for Reader {
    type Error = io::Error;
}

impl Read for Reader {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Open(reader) => reader.read(buffer).await,
            Self::Tls(reader) => reader.read(buffer).await.map_err(told),
        }
    }
}

impl ErrorType for Writer {
    type Error = io::Error;
}

impl Write for Writer {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Open(writer) => writer.write(bytes).await,
            Self::Tls(writer) => writer.write(bytes).await.map_err(told),
        }
    }

    async fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Open(writer) => writer.flush().await,
            Self::Tls(writer) => writer.flush().await.map_err(told),
        }
    }
}

/// Opens streams to the router.
pub(crate) struct Connector<F> {
    pub(crate) way: Way,
    pub(crate) scout: ScoutConfig,
    /// Is told why a router that was reached is not spoken to.
    pub(crate) refused: F,
}

impl<F: Fn(&str)> Connect for Connector<F> {
    type Reader = Reader;
    type Writer = Writer;

    async fn connect(&mut self) -> Result<(Reader, Writer), ConnectError> {
        let connected = if self.way.address.is_empty() {
            let found = find_router(self.scout).await.map_err(|_| ConnectError)?;
            TcpStream::connect(found).await
        } else {
            TcpStream::connect(&self.way.address).await
        };
        let stream = connected.map_err(|_| ConnectError)?;
        // Stops and clock replies must not wait for more to send.
        stream.set_nodelay(true).map_err(|_| ConnectError)?;
        let (reader, writer) = stream.into_split();
        let (mut reader, mut writer) = (FromTokio::new(reader), FromTokio::new(writer));
        let Some(config) = &self.way.tls else {
            return Ok((Reader::Open(reader), Writer::Open(writer)));
        };
        let link = match tls::stream::open(config, &mut reader, &mut writer).await {
            Ok(link) => Shared(Arc::new(Mutex::new(link))),
            Err(error) => {
                (self.refused)(&error.to_string());
                return Err(ConnectError);
            }
        };
        let reader = Box::new(TlsReader::new(link.clone(), reader));
        let writer = Box::new(TlsWriter::new(link, writer));
        Ok((Reader::Tls(reader), Writer::Tls(writer)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CA: &[u8] = include_bytes!("../../tls/tests/authority.pem");

    #[test]
    fn a_locator_and_an_authority_say_how_the_router_is_spoken_to() {
        let authority = Authority::from_pem(CA).expect("an authority");
        let open = |locator| Way::new(locator, None).map(|way| way.address);
        let secured = |locator| Way::new(locator, Some(&authority)).map(|way| way.address);
        assert_eq!(open("tcp/plant:7448").as_deref(), Ok("plant:7448"));
        assert_eq!(open("").as_deref(), Ok(""));
        assert_eq!(secured("tls/plant:7447").as_deref(), Ok("plant:7447"));
        assert_eq!(secured("tls/[::1]:7447").as_deref(), Ok("[::1]:7447"));
        assert_eq!(open("tls/plant:7447"), Err(NoWay::NoAuthority));
        assert_eq!(secured("tcp/plant:7448"), Err(NoWay::Open));
        assert_eq!(secured(""), Err(NoWay::Open));
        for wrong in ["plant:1", "udp/plant:1", "tcp/plant", "tcp/:1", "tcp/a:0"] {
            assert_eq!(open(wrong), Err(NoWay::Locator), "{wrong}");
        }
    }
}
