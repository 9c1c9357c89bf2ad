//! One link: the protocol as a state machine. No stream, no clock.

use crate::{authority::Authority, certificate::Verifier, error::TlsError, provider::provider};
use alloc::{string::ToString as _, sync::Arc, vec::Vec};
use core::{fmt, time::Duration};
use rustls::{
    ClientConfig,
    client::{ClientConnectionData, Resumption, UnbufferedClientConnection},
    pki_types::{ServerName, UnixTime},
    time_provider::TimeProvider,
    unbuffered::{ConnectionState, EncodeError, EncodeTlsData, UnbufferedStatus},
    version::TLS13,
};

/// Most bytes that wait for the rest of their record, or of their message of the handshake. A router
/// sends a node batches of at most 2,048 bytes, and its certificates in one go.
pub const RECORD_BYTES_MAX: usize = 8 * 1024;

/// Most bytes of a session in one record (RFC 8446, 5.1).
pub const PLAIN_BYTES_MAX: usize = 16 * 1024;

/// What a record adds to its bytes: its header, its kind, its tag.
pub const OVERHEAD_BYTES: usize = 5 + 1 + 16;

/// Whom to reach, and whom to trust. One serves any number of links.
#[derive(Clone)]
pub struct TlsConfig {
    client: Arc<ClientConfig>,
    name: ServerName<'static>,
}

impl fmt::Debug for TlsConfig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = &self.name;
        f.debug_struct("TlsConfig")
            .field("name", name)
            .finish_non_exhaustive()
    }
}

/// The day, which does not go on: a link is opened within one.
#[derive(Debug)]
struct Day(UnixTime);

impl TimeProvider for Day {
    fn current_time(&self) -> Option<UnixTime> {
        Some(self.0)
    }
}

impl TlsConfig {
    /// Takes the authority, the name or address under which the router is reached, and what day it
    /// is, in seconds since 1970, if that is known.
    ///
    /// A node has no calendar: then the dates of certificates are not checked, but that there is a
    /// day on which all of them are good. What that costs: a key of the router that was stolen works
    /// beyond the certificate's last day. The fleet's own authority signs for twenty years anyway;
    /// against a stolen key helps a new authority, not a date.
    ///
    /// # Errors
    /// [`TlsError::Name`].
    pub fn new(authority: &Authority, name: &str, unix_s: Option<u64>) -> Result<Self, TlsError> {
        let inner = name
            .strip_prefix('[')
            .and_then(|name| name.strip_suffix(']'));
        let name = inner.unwrap_or(name).to_string();
        let name = ServerName::try_from(name).map_err(|_| TlsError::Name)?;
        let today = unix_s.map(|unix_s| UnixTime::since_unix_epoch(Duration::from_secs(unix_s)));
        let epoch = UnixTime::since_unix_epoch(Duration::ZERO);
        let day = Arc::new(Day(today.unwrap_or(epoch)));
        let mut client = ClientConfig::builder_with_details(Arc::new(provider()), day)
            .with_protocol_versions(&[&TLS13])
            .map_err(|error| TlsError::of(&error))?
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(Verifier::new(authority, today)))
            .with_no_client_auth();
        // Each link is a handshake of its own: a ticket costs memory and saves a node little.
        client.resumption = Resumption::disabled();
        Ok(Self {
            client: Arc::new(client),
            name,
        })
    }
}

/// Most bytes of anything that is shared by counting here: memory whose atomic operations do not work
/// may hold larger things, and only them.
pub const SHARED_BYTES_MAX: usize = 504;

// With its two counters, and on any target: a host's pointers are the longest.
const _: () = assert!(size_of::<ClientConfig>() + 2 * size_of::<usize>() <= SHARED_BYTES_MAX);

/// See the module.
pub struct TlsLink {
    connection: UnbufferedClientConnection,
    /// Records that are not whole yet.
    incoming: Vec<u8>,
    /// Bytes of the session, of which the first `taken_bytes` were given away.
    plain: Vec<u8>,
    taken_bytes: usize,
    /// Records of the handshake and alerts, to be sent.
    outgoing: Vec<u8>,
    open: bool,
    peer_ended: bool,
    over: Option<TlsError>,
}

impl fmt::Debug for TlsLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TlsLink")
            .field("open", &self.open)
            .field("peer_ended", &self.peer_ended)
            .field("over", &self.over)
            .finish_non_exhaustive()
    }
}

impl TlsLink {
    /// Begins: the first record is ready to be sent.
    ///
    /// # Errors
    /// There are no random numbers.
    pub fn new(config: &TlsConfig) -> Result<Self, TlsError> {
        let connection =
            UnbufferedClientConnection::new(config.client.clone(), config.name.clone());
        let mut link = Self {
            connection: connection.map_err(|error| TlsError::of(&error))?,
            incoming: Vec::new(),
            plain: Vec::new(),
            taken_bytes: 0,
            outgoing: Vec::new(),
            open: false,
            peer_ended: false,
            over: None,
        };
        link.advance()?;
        Ok(link)
    }

    /// Returns whether the router has proved who it is, and the session can speak.
    pub fn is_open(&self) -> bool {
        self.open && self.over.is_none()
    }

    /// Returns whether the router has said that nothing more follows. A stream that ends without
    /// this was cut.
    pub fn is_ended(&self) -> bool {
        self.peer_ended
    }

    /// Takes bytes of the stream, cut anywhere.
    ///
    /// # Errors
    /// The link is over, now or already. What came before the error can still be received.
    pub fn handle_bytes(&mut self, mut bytes: &[u8]) -> Result<(), TlsError> {
        self.check()?;
        while !bytes.is_empty() && !self.peer_ended {
            let count = bytes.len().min(RECORD_BYTES_MAX - self.incoming.len());
            if count == 0 {
                return Err(self.end(TlsError::TooLong));
            }
            self.incoming.reserve_exact(count);
            self.incoming.extend_from_slice(&bytes[..count]);
            bytes = &bytes[count..];
            self.advance()?;
        }
        Ok(())
    }

    /// Appends what is to be sent of the handshake, and the alert after an error.
    pub fn poll_transmit(&mut self, out: &mut Vec<u8>) {
        out.append(&mut self.outgoing);
        if self.open {
            // There will hardly be any more.
            self.outgoing = Vec::new();
        }
    }

    /// Returns whether there are bytes for the session.
    pub fn has_received(&self) -> bool {
        self.taken_bytes < self.plain.len()
    }

    /// Gives bytes of the session; returns how many, 0 if none have come.
    pub fn receive(&mut self, out: &mut [u8]) -> usize {
        let left = &self.plain[self.taken_bytes..];
        let count = left.len().min(out.len());
        out[..count].copy_from_slice(&left[..count]);
        self.taken_bytes += count;
        if self.taken_bytes == self.plain.len() {
            self.plain.clear();
            self.taken_bytes = 0;
        }
        count
    }

    /// Takes bytes of the session and appends their record, after whatever else is to be sent.
    /// Returns how many it took: at most [`PLAIN_BYTES_MAX`]; 0 while the link is not open.
    ///
    /// # Errors
    /// The link is over, now or already, or the router has ended it.
    pub fn send(&mut self, plain: &[u8], out: &mut Vec<u8>) -> Result<usize, TlsError> {
        self.check()?;
        if self.peer_ended {
            return Err(TlsError::Ended);
        }
        let count = plain.len().min(PLAIN_BYTES_MAX);
        if !self.open || count == 0 {
            return Ok(0);
        }
        self.poll_transmit(out);
        let begin = out.len();
        out.resize(begin + count + OVERHEAD_BYTES, 0);
        // Everything that came was dealt with when it came, so nothing else is next.
        let status = self.connection.process_tls_records(&mut self.incoming);
        let written = match status.state {
            Ok(ConnectionState::WriteTraffic(mut traffic)) => {
                traffic.encrypt(&plain[..count], &mut out[begin..]).ok()
            }
            _ => None,
        };
        out.truncate(begin + written.unwrap_or(0));
        match written {
            Some(_) => Ok(count),
            None => Err(self.end(TlsError::Ended)),
        }
    }

    /// Ends it: appends what tells the router that nothing more follows.
    pub fn close(&mut self, out: &mut Vec<u8>) {
        if self.over.is_some() {
            return;
        }
        self.poll_transmit(out);
        let status = self.connection.process_tls_records(&mut self.incoming);
        if let Ok(ConnectionState::WriteTraffic(mut traffic)) = status.state {
            let mut record = [0; 2 + OVERHEAD_BYTES];
            if let Ok(count) = traffic.queue_close_notify(&mut record) {
                out.extend_from_slice(&record[..count]);
            }
        }
        self.over = Some(TlsError::Ended);
    }

    fn check(&self) -> Result<(), TlsError> {
        self.over.map_or(Ok(()), Err)
    }

    /// Does whatever the bytes so far allow.
    fn advance(&mut self) -> Result<(), TlsError> {
        loop {
            let UnbufferedStatus { mut discard, state } =
                self.connection.process_tls_records(&mut self.incoming);
            let mut waits = false;
            let mut failed = None;
            match state {
                Ok(ConnectionState::ReadTraffic(mut traffic)) => {
                    while let Some(Ok(record)) = traffic.next_record() {
                        discard += record.discard;
                        self.plain.extend_from_slice(record.payload);
                    }
                }
                Ok(ConnectionState::EncodeTlsData(data)) => encode(&mut self.outgoing, data),
                // It waits in `outgoing`, which is sent before anything else.
                Ok(ConnectionState::TransmitTlsData(data)) => data.done(),
                Ok(ConnectionState::WriteTraffic(_)) => {
                    self.open = true;
                    waits = true;
                }
                Ok(ConnectionState::BlockedHandshake) => waits = true,
                Ok(ConnectionState::PeerClosed | ConnectionState::Closed) => {
                    self.peer_ended = true;
                    waits = true;
                }
                Ok(_) => failed = Some(TlsError::Misbehaved),
                Err(error) => failed = Some(TlsError::of(&error)),
            }
            self.incoming.drain(..discard);
            if let Some(error) = failed {
                return Err(self.end(error));
            }
            if waits {
                return Ok(());
            }
        }
    }

    /// Ends it with an error; the alert that tells the router is left in `outgoing`.
    fn end(&mut self, error: TlsError) -> TlsError {
        self.over = Some(error);
        // While an alert waits it comes before anything else; without one rustls must not be asked
        // again after an error.
        while self.connection.wants_write() {
            let status = self.connection.process_tls_records(&mut self.incoming);
            let discard = status.discard;
            match status.state {
                Ok(ConnectionState::EncodeTlsData(data)) => encode(&mut self.outgoing, data),
                _ => break,
            }
            self.incoming.drain(..discard);
        }
        self.incoming = Vec::new();
        error
    }
}

/// Appends a record.
fn encode(out: &mut Vec<u8>, mut data: EncodeTlsData<'_, ClientConnectionData>) {
    let Err(EncodeError::InsufficientSize(error)) = data.encode(&mut []) else {
        return;
    };
    let begin = out.len();
    out.resize(begin + error.required_size, 0);
    let written = data.encode(&mut out[begin..]);
    out.truncate(begin + written.unwrap_or(0));
}
