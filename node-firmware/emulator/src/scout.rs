//! The router is found by scouting: the socket around [`pico::scout`], as the board has one.

use crate::wall::random;
use pico::scout::{GROUP, HELLO_BYTES_MAX, Scouting};
use std::{
    io,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4},
    time::Duration,
};
use tokio::{net::UdpSocket, time::Instant};

/// Where scouts are sent, and from where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScoutConfig {
    /// Address of this machine whose network is asked; unspecified, the default: the one that the
    /// system takes.
    pub from: Ipv4Addr,
    /// The group that routers listen to; zenoh's own by default.
    pub group: SocketAddrV4,
}

impl Default for ScoutConfig {
    fn default() -> Self {
        Self {
            from: Ipv4Addr::UNSPECIFIED,
            group: GROUP,
        }
    }
}

/// Asks until a router answers, and returns where it listens.
///
/// # Errors
/// There is no network.
pub(crate) async fn find_router(config: ScoutConfig) -> io::Result<SocketAddr> {
    let socket = UdpSocket::bind((config.from, 0)).await?;
    let begun = Instant::now();
    let elapsed_us = || u64::try_from(begun.elapsed().as_micros()).unwrap_or(u64::MAX);
    let mut scouting = Scouting::new(random(), 0);
    // One more byte than an answer has: what is longer shows.
    let mut bytes = [0; HELLO_BYTES_MAX + 1];
    loop {
        if let Some(question) = scouting.poll_transmit(elapsed_us()) {
            socket.send_to(&question, config.group).await?;
        }
        let due = begun + Duration::from_micros(scouting.poll_timeout());
        let answer = tokio::time::timeout_at(due, socket.recv_from(&mut bytes)).await;
        let Ok(answer) = answer else {
            continue;
        };
        let (count, from) = answer?;
        if let Some(found) = scouting.handle_datagram(&bytes[..count], from.ip()) {
            tracing::info!("scouting found a router at tcp/{found}");
            return Ok(found);
        }
    }
}
