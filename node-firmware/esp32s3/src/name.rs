//! The node's name in its network, on core 0: the socket around [`periphery::mdns`].

use alloc::vec;
use embassy_futures::select::{Either, select};
use embassy_net::{
    IpAddress, IpEndpoint, Stack,
    udp::{PacketMetadata, UdpSocket},
};
use embassy_time::{Duration, Timer};
use keys::NodeId;
use periphery::mdns::{ANSWER_BYTES_MAX, GROUP, Name, PORT, To};

/// Longest question that is looked at: longer ones ask for many things at once.
const QUESTION_BYTES_MAX: usize = 512;

/// Answers for ever. Without multicast there is no name, and everything else goes on.
#[embassy_executor::task]
pub(crate) async fn answer(stack: Stack<'static>, name: NodeId) {
    let Some(name) = Name::new(name.as_str()) else {
        return;
    };
    let (mut from, mut to) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
    // On the heap: internal RAM is short.
    let mut incoming = vec![0; QUESTION_BYTES_MAX];
    let mut outgoing = vec![0; 2 * ANSWER_BYTES_MAX];
    let mut bytes = vec![0; QUESTION_BYTES_MAX];
    let mut socket = UdpSocket::new(stack, &mut from, &mut incoming, &mut to, &mut outgoing);
    if socket.bind(PORT).is_err() || stack.join_multicast_group(GROUP).is_err() {
        return;
    }
    let everybody = IpEndpoint::new(IpAddress::Ipv4(GROUP), PORT);
    let mut out = [0; ANSWER_BYTES_MAX];
    loop {
        stack.wait_config_up().await;
        let Some(address) = stack.config_v4().map(|config| config.address.address()) else {
            continue;
        };
        for _ in 0..2 {
            let used = name.announce(address, &mut out);
            let _ = socket.send_to(&out[..used], everybody).await;
            Timer::after(Duration::from_secs(1)).await;
        }
        // Another address is told to everybody again.
        while let Either::First(received) =
            select(socket.recv_from(&mut bytes), stack.wait_config_down()).await
        {
            // Longer than is looked at.
            let Ok((count, asker)) = received else {
                continue;
            };
            let port = asker.endpoint.port;
            let answer = name.handle(&bytes[..count], port, address, &mut out);
            if let Some((used, to)) = answer {
                let to = match to {
                    To::Everybody => everybody,
                    To::Asker => asker.endpoint,
                };
                let _ = socket.send_to(&out[..used], to).await;
            }
        }
    }
}
