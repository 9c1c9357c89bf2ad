//! TLS around the socket, if the record names an authority to trust. Without one it is plain TCP.

use crate::link::Half;
use embedded_io_async::{Error as _, ErrorKind, ErrorType, Read, Write};
use esp_println::println;
use pico::driver::ConnectError;
use provision::record::Record;

#[cfg(feature = "tls")]
type Link = alloc::rc::Rc<core::cell::RefCell<tls::TlsLink>>;

/// What the router says.
pub(crate) enum Reader {
    Open(Half),
    #[cfg(feature = "tls")]
    Tls(tls::stream::TlsReader<Link, Half>),
}

/// What is said to it.
pub(crate) enum Writer {
    Open(Half),
    #[cfg(feature = "tls")]
    Tls(tls::stream::TlsWriter<Link, Half>),
}

impl ErrorType for Reader {
    type Error = ErrorKind;
}

impl Read for Reader {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        match self {
            Self::Open(half) => half.read(buffer).await.map_err(|error| error.kind()),
            #[cfg(feature = "tls")]
            Self::Tls(reader) => reader.read(buffer).await.map_err(|error| error.kind()),
        }
    }
}

impl ErrorType for Writer {
    type Error = ErrorKind;
}

impl Write for Writer {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        match self {
            Self::Open(half) => half.write(bytes).await.map_err(|error| error.kind()),
            #[cfg(feature = "tls")]
            Self::Tls(writer) => writer.write(bytes).await.map_err(|error| error.kind()),
        }
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        match self {
            Self::Open(half) => half.flush().await.map_err(|error| error.kind()),
            #[cfg(feature = "tls")]
            Self::Tls(writer) => writer.flush().await.map_err(|error| error.kind()),
        }
    }
}

/// Opens the session's stream on a connected socket. A node that was told an authority never speaks
/// in the open. Why a router is refused is said on the serial line.
pub(crate) async fn secure(record: &Record, half: Half) -> Result<(Reader, Writer), ConnectError> {
    if !record.is_consistent() {
        println!("tls: a router by tls/ needs an authority, and an authority a router by tls/");
        return Err(ConnectError);
    }
    let Some(kept) = &record.authority else {
        return Ok((Reader::Open(half.clone()), Writer::Open(half)));
    };
    match encrypted(record, kept, half).await {
        Ok(halves) => Ok(halves),
        Err(why) => {
            println!("tls: {why}");
            Err(ConnectError)
        }
    }
}

#[cfg(feature = "tls")]
async fn encrypted(
    record: &Record,
    kept: &provision::record::Authority,
    half: Half,
) -> Result<(Reader, Writer), alloc::string::String> {
    use alloc::string::ToString as _;
    let authority = tls::Authority::from_parts(&kept.subject, &kept.key);
    let authority = authority.map_err(|error| error.to_string())?;
    let address = provision::record::router_address(&record.router);
    let (host, _) = address.ok_or("the router's address is none")?;
    let config = tls::TlsConfig::new(&authority, host, None).map_err(|error| error.to_string())?;
    let (mut reader, mut writer) = (half.clone(), half);
    let opened = tls::stream::open(&config, &mut reader, &mut writer).await;
    let link = opened.map_err(|error| error.to_string())?;
    let link = Link::new(core::cell::RefCell::new(link));
    Ok((
        Reader::Tls(tls::stream::TlsReader::new(link.clone(), reader)),
        Writer::Tls(tls::stream::TlsWriter::new(link, writer)),
    ))
}

#[cfg(not(feature = "tls"))]
async fn encrypted(
    _record: &Record,
    _kept: &provision::record::Authority,
    _half: Half,
) -> Result<(Reader, Writer), &'static str> {
    Err("this firmware was built without TLS")
}
