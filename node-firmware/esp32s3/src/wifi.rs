//! The network: one of the known stations, again and again; power save off; signal strength.

use crate::plan::RSSI_DBM;
use core::sync::atomic::Ordering;
use embassy_net::{Ipv4Cidr, Runner, StaticConfigV4};
use embassy_time::{Duration, Timer};
use esp_wifi::wifi::{
    AuthenticationMethodConfig, Config, Interface, PowerSaveMode, WifiController,
    sta::StationConfig,
};
use provision::record::{Network, Record};

/// From one attempt to the next.
const RETRY: Duration = Duration::from_secs(2);

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

/// Keeps the station connected.
#[embassy_executor::task]
pub(crate) async fn connect(mut controller: WifiController<'static>, record: &'static Record) {
    // A sleeping station answers a beacon interval later: 100 ms.
    let _ = controller.set_power_saving(PowerSaveMode::None);
    let mut next = 0;
    loop {
        let network = record.networks.get(next % record.networks.len().max(1));
        next += 1;
        let Some(config) = network.and_then(station) else {
            Timer::after(RETRY).await;
            continue;
        };
        if controller.set_config(&config).is_err() || controller.connect_async().await.is_err() {
            esp_println::println!("wifi: no connection");
            Timer::after(RETRY).await;
            continue;
        }
        // The network that worked is the first that is tried again.
        next -= 1;
        while controller.is_connected() {
            let rssi_dbm = controller.rssi().unwrap_or(0);
            RSSI_DBM.store(rssi_dbm, Ordering::Relaxed);
            Timer::after(LOOK).await;
        }
        RSSI_DBM.store(0, Ordering::Relaxed);
    }
}

/// Moves packets.
#[embassy_executor::task]
pub(crate) async fn network(mut runner: Runner<'static, Interface>) {
    runner.run().await;
}
