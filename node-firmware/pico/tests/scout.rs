//! A real router is found by multicast on the loopback interface.

mod router;

use pico::scout::Scouting;
use router::{PATIENCE, open_router_with};
use std::{
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    time::{Duration, Instant},
};

#[tokio::test(flavor = "multi_thread")]
async fn a_router_that_listens_for_scouts_is_found_and_told_by_its_address() {
    // A group of this test's own: another router on this machine does not answer here.
    let free = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let port = free.local_addr().expect("bound").port();
    let group = SocketAddrV4::new(Ipv4Addr::new(224, 0, 0, 224), port);
    drop(free);
    let (router, address) = open_router_with(|config| {
        let mut set = |key: &str, value: &str| config.insert_json5(key, value).expect("known");
        set("scouting/multicast/enabled", "true");
        set("scouting/multicast/address", &format!("\"{group}\""));
        set("scouting/multicast/interface", "\"127.0.0.1\"");
    })
    .await;
    let found = tokio::task::spawn_blocking(move || scout(group)).await;
    assert_eq!(found.expect("it did not panic"), address);
    router.close().await.expect("closed");
}

fn scout(group: SocketAddrV4) -> SocketAddr {
    // Bound to an address, it asks by that address's interface.
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    socket
        .set_read_timeout(Some(Duration::from_millis(20)))
        .expect("has one");
    let since = Instant::now();
    let mut scouting = Scouting::new(1, 0);
    loop {
        assert!(since.elapsed() < PATIENCE, "no answer");
        let now_us = since.elapsed().as_micros() as u64;
        if let Some(question) = scouting.poll_transmit(now_us) {
            socket.send_to(&question, group).expect("sent");
        }
        let mut bytes = [0; 2_048];
        let Ok((count, from)) = socket.recv_from(&mut bytes) else {
            continue;
        };
        if let Some(found) = scouting.handle_datagram(&bytes[..count], from.ip()) {
            return found;
        }
    }
}
