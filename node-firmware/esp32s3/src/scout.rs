//! Where the router is, when nobody has told: the socket around [`pico::scout`].

use crate::plan::now;
use alloc::vec;
use core::net::SocketAddr;
use embassy_futures::select::{Either, select};
use embassy_net::{
    IpAddress, IpEndpoint, Stack,
    udp::{PacketMetadata, UdpSocket},
};
use embassy_time::{Duration, Timer};
use pico::{
    driver::ConnectError,
    scout::{GROUP, HELLO_BYTES_MAX, Scouting},
};

/// Bytes of a question, with room.
const QUESTION_BYTES_MAX: usize = 16;

/// Asks until a router answers.
///
/// # Errors
/// There is no port to ask from.
///
/// # Cancellation safety
/// Dropped, it has only asked.
pub(crate) async fn find(stack: Stack<'static>, seed: u64) -> Result<IpEndpoint, ConnectError> {
    let (mut from, mut to) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
    let mut incoming = vec![0; HELLO_BYTES_MAX];
    let mut outgoing = [0; QUESTION_BYTES_MAX];
    let mut socket = UdpSocket::new(stack, &mut from, &mut incoming, &mut to, &mut outgoing);
    // Any port: the answer comes to the one that asked.
    socket.bind(0).map_err(|_| ConnectError)?;
    let group = IpEndpoint::new(IpAddress::Ipv4(*GROUP.ip()), GROUP.port());
    let mut scouting = Scouting::new(seed, now().0);
    let mut bytes = vec![0; HELLO_BYTES_MAX];
    loop {
        if let Some(question) = scouting.poll_transmit(now().0) {
            // Not sent: the next one will be.
            let _ = socket.send_to(&question, group).await;
        }
        let wait_us = scouting.poll_timeout().saturating_sub(now().0);
        let due = Timer::after(Duration::from_micros(wait_us));
        if let Either::First(Ok((count, answer))) = select(socket.recv_from(&mut bytes), due).await
            && let Some(SocketAddr::V4(found)) =
                scouting.handle_datagram(&bytes[..count], answer.endpoint.addr.into())
        {
            let address = IpAddress::Ipv4(*found.ip());
            return Ok(IpEndpoint::new(address, found.port()));
        }
    }
}
