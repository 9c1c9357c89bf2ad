//! The network: one of the known stations; power save off; signal strength. Which station is tried next, and
//! when, is in [`provision::stations`].

use crate::plan::{RSSI_DBM, now};
use core::sync::atomic::Ordering;
use embassy_net::{Ipv4Cidr, Runner, StaticConfigV4};
use embassy_time::{Duration, Timer, with_timeout};
use esp_wifi::wifi::{
    AuthenticationMethodConfig, Config, ConnectionError, DisconnectReason, Interface,
    PowerSaveMode, WifiController, scan::ScanConfig, sta::StationConfig,
};
use provision::{
    record::{Network, Record},
    stations::{Failure, Next, Stations},
};

/// What a scan has heard.
type Heard = heapless::Vec<(usize, i8), 16>;

/// Longest that a scan or an attempt may take.
const LIMIT: Duration = Duration::from_secs(20);

/// Access points that a scan tells, the loudest ones: each takes memory of the heap.
const SCAN_MAX: usize = 16;

/// Longest wait at once.
const WAIT_US_MAX: u64 = 60_000_000;

/// From one look at the signal strength to the next.
const LOOK: Duration = Duration::from_secs(2);

/// Returns how the interface gets its address.
pub(crate) fn address_config(record: &Record) -> embassy_net::Config {
    let Some(fixed) = record.fixed_address else {
        let mut dhcp = embassy_net::DhcpConfig::default();
        dhcp.hostname = record
            .name
            .and_then(|name| heapless_08_string(name.as_str()));
        return embassy_net::Config::dhcpv4(dhcp);
    };
    embassy_net::Config::ipv4_static(StaticConfigV4 {
        address: Ipv4Cidr::new(fixed.address.into(), fixed.prefix_bits),
        gateway: Some(fixed.gateway.into()),
        dns_servers: core::iter::once(fixed.gateway.into()).collect(),
    })
}

/// The host name in the type that embassy-net wants; none if it is too long for DHCP.
fn heapless_08_string<T: for<'a> TryFrom<&'a str>>(text: &str) -> Option<T> {
    T::try_from(text).ok()
}

fn station(network: &Network) -> Option<Config> {
    let ssid = network.ssid.as_str().try_into().ok()?;
    let authentication = if network.password.is_empty() {
        AuthenticationMethodConfig::Open
    } else {
        AuthenticationMethodConfig::Wpa2Personal(network.password.as_str().try_into().ok()?)
    };
    let config = StationConfig::default()
        .with_ssid(ssid)
        .with_authentication(authentication);
    Some(Config::Station(config))
}

/// Returns what is heard of the networks of a record: by number, with the strength.
async fn heard(controller: &mut WifiController<'static>, record: &Record) -> Heard {
    let config = ScanConfig::default().with_max(SCAN_MAX);
    let scan = controller.scan_async(&config);
    // What the radio has begun and does not end is begun anew.
    let Ok(Ok(found)) = with_timeout(LIMIT, scan).await else {
        return Heard::new();
    };
    let mut heard = Heard::new();
    for point in &found {
        let mut networks = record.networks.iter();
        let index = networks.position(|of| of.ssid.as_str() == point.ssid.as_str());
        // More than there is room for: those that come first are the loudest.
        let _ = index.map(|index| heard.push((index, point.signal_strength)));
    }
    heard
}

/// Keeps the station connected.
#[embassy_executor::task]
pub(crate) async fn connect(mut controller: WifiController<'static>, record: &'static Record) {
    // A sleeping station answers a beacon interval later: 100 ms.
    let _ = controller.set_power_saving(PowerSaveMode::None);
    let mut stations = Stations::new(record.networks.len());
    loop {
        match stations.poll(now().0) {
            Next::Scan => {
                let heard = heard(&mut controller, record).await;
                stations.handle_scan(heard, now().0);
            }
            Next::Wait { until_us } => {
                let wait_us = until_us.saturating_sub(now().0).min(WAIT_US_MAX);
                Timer::after(Duration::from_micros(wait_us)).await;
            }
            Next::Try(index) => match attempt(&mut controller, &record.networks[index]).await {
                Ok(()) => stations.handle_up(index),
                Err(why) => {
                    esp_println::println!("wifi: no connection to network {index}: {why:?}");
                    stations.handle_failure(index, why, now().0);
                }
            },
            Next::Stay => {
                while controller.is_connected() {
                    let rssi_dbm = controller.rssi().unwrap_or(0);
                    RSSI_DBM.store(rssi_dbm, Ordering::Relaxed);
                    Timer::after(LOOK).await;
                }
                RSSI_DBM.store(0, Ordering::Relaxed);
                stations.handle_lost();
            }
        }
    }
}

/// Connects to a network.
async fn attempt(
    controller: &mut WifiController<'static>,
    network: &Network,
) -> Result<(), Failure> {
    let config = station(network).ok_or(Failure::Other)?;
    let set = controller.set_config(&config);
    set.map_err(|_| Failure::Other)?;
    match with_timeout(LIMIT, controller.connect_async()).await {
        Ok(Ok(_)) => Ok(()),
        Ok(Err(ConnectionError::Failed(info))) if is_password(info.reason) => {
            Err(Failure::Password)
        }
        Ok(Err(_)) => Err(Failure::Other),
        Err(_) => {
            // Neither yes nor no: what the radio still tries must not disturb the next one.
            let _ = with_timeout(LIMIT, controller.disconnect_async()).await;
            Err(Failure::Other)
        }
    }
}

/// Returns whether an access point says so to a wrong password: it never says it in so many words.
fn is_password(reason: DisconnectReason) -> bool {
    matches!(
        reason,
        DisconnectReason::FourWayHandshakeTimeout
            | DisconnectReason::HandshakeTimeout
            | DisconnectReason::AuthenticationFailed
            | DisconnectReason::MicFailure
    )
}

/// Moves packets.
#[embassy_executor::task]
pub(crate) async fn network(mut runner: Runner<'static, Interface>) {
    runner.run().await;
}
