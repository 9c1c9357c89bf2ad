//! Zenoh sessions: their settings, opened and closed.

use super::{
    sizes::low_pass_filter,
    zenoh::{BusError, ROUTER_PATIENCE},
};
use crate::{
    config::{
        CLIENTS_MAX, GATEWAY_USER_DEFAULT, GatewayConfig, MESSAGE_BYTES_MAX, STALLED_PEER_US,
    },
    security::Home,
};
use keys::{credentials::Credentials, secret};
use std::{
    net::{SocketAddr, TcpListener},
    path::Path,
};
use zenoh::Session;

/// How often a port that was free and then taken by somebody else is replaced by another one.
const PORT_ATTEMPTS_MAX: usize = 16;

pub(super) async fn close(session: &Session) {
    match tokio::time::timeout(ROUTER_PATIENCE, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!("closing a session: {error}"),
        Err(_) => tracing::warn!("closing a session took too long"),
    }
}

fn settings(pairs: &[(&str, String)]) -> Result<zenoh::Config, BusError> {
    let mut config = zenoh::Config::default();
    for (key, value) in pairs {
        config
            .insert_json5(key, value)
            .map_err(|error| BusError::Zenoh(format!("{key}: {error}")))?;
    }
    Ok(config)
}

fn json<T: serde::Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).expect("texts and lists of texts are JSON")
}

/// Opens a session in router mode. Returns where it listens.
pub(super) async fn open_router(
    config: &GatewayConfig,
    home: Option<&Home>,
) -> Result<(Session, Vec<String>), BusError> {
    let wanted = config.listen();
    let mut attempts = 0;
    loop {
        attempts += 1;
        let listen = wanted
            .iter()
            .map(|locator| with_port(locator))
            .collect::<Result<Vec<_>, _>>()?;
        let mut pairs = vec![
            ("mode", json("router")),
            ("listen/endpoints", json(&listen)),
            ("scouting/multicast/enabled", config.scouting.to_string()),
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                STALLED_PEER_US.to_string(),
            ),
            (
                "transport/link/rx/max_message_size",
                MESSAGE_BYTES_MAX.to_string(),
            ),
            (
                "transport/unicast/max_sessions",
                (config.fleet.nodes_max + CLIENTS_MAX).to_string(),
            ),
            ("low_pass_filter", low_pass_filter(&config.keys).to_string()),
        ];
        if let Some(users) = &config.users {
            let file = json(&users.to_string_lossy());
            pairs.push(("transport/auth/usrpwd/dictionary_file", file));
        }
        if let Some(home) = home {
            let settings = home.router_settings(&config.keys)?.into_iter();
            pairs.extend(settings.map(|(key, value)| (key, value.to_string())));
        }
        match zenoh::open(settings(&pairs)?).await {
            Ok(session) => return Ok((session, listen)),
            // Between choosing a port and listening on it somebody else may have taken it.
            Err(_) if listen != wanted && attempts < PORT_ATTEMPTS_MAX => {}
            Err(error) => {
                return Err(BusError::Listen {
                    listen: listen.join(", "),
                    reason: error.to_string(),
                });
            }
        }
    }
}

/// Opens a session in client mode.
pub(super) async fn open_client(
    connect: &[String],
    credentials: Option<&Credentials>,
) -> Result<Session, BusError> {
    for locator in connect {
        host_and_port(locator)?;
    }
    let mut pairs = vec![
        ("mode", json("client")),
        ("connect/endpoints", json(connect)),
        ("scouting/multicast/enabled", false.to_string()),
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            STALLED_PEER_US.to_string(),
        ),
        (
            "transport/link/rx/max_message_size",
            MESSAGE_BYTES_MAX.to_string(),
        ),
    ];
    if let Some(credentials) = credentials {
        pairs.extend(credentials.zenoh_settings());
    }
    zenoh::open(settings(&pairs)?)
        .await
        .map_err(|error| BusError::Connect {
            connect: connect.join(", "),
            reason: error.to_string(),
        })
}

/// Takes a locator apart: protocol, host, port.
pub(crate) fn host_and_port(locator: &str) -> Result<(&str, &str, u16), BusError> {
    let bad = || BusError::Locator(locator.to_owned());
    let (protocol, address) = locator.split_once('/').ok_or_else(bad)?;
    let (host, port) = address.rsplit_once(':').ok_or_else(bad)?;
    if host.is_empty() || !matches!(protocol, "tcp" | "tls") {
        return Err(bad());
    }
    Ok((protocol, host, port.parse().map_err(|_| bad())?))
}

/// Returns the locator with a port that is free now in place of 0.
fn with_port(locator: &str) -> Result<String, BusError> {
    let (protocol, host, port) = host_and_port(locator)?;
    if port != 0 {
        return Ok(locator.to_owned());
    }
    let free = TcpListener::bind(format!("{host}:0"))
        .and_then(|listener| listener.local_addr())
        .map_err(|error| BusError::Listen {
            listen: locator.to_owned(),
            reason: error.to_string(),
        })?;
    Ok(format!("{protocol}/{host}:{}", free.port()))
}

/// Returns how this process reaches a locator that it listens on.
pub(super) fn reachable(locator: &str) -> String {
    let Some((protocol, address)) = locator.split_once('/') else {
        return locator.to_owned();
    };
    match address.parse::<SocketAddr>() {
        // The name that is in every certificate that `fleet init` makes.
        Ok(address) if protocol == "tls" => format!("tls/localhost:{}", address.port()),
        Ok(address) if address.ip().is_unspecified() => match address {
            SocketAddr::V4(address) => format!("tcp/127.0.0.1:{}", address.port()),
            SocketAddr::V6(address) => format!("tcp/[::1]:{}", address.port()),
        },
        _ => locator.to_owned(),
    }
}

/// Returns the gateway's own line of the users file.
pub(super) fn gateway_entry(file: &Path) -> Result<Credentials, BusError> {
    let users = |reason: String| BusError::Users {
        path: file.to_owned(),
        reason,
    };
    let text = secret::read(file).map_err(|error| users(error.to_string()))?;
    text.lines()
        .filter_map(|line| line.split_once(':'))
        .find(|(user, _)| user.trim() == GATEWAY_USER_DEFAULT)
        .map(|(user, password)| Credentials {
            connect: Vec::new(),
            user: user.trim().to_owned(),
            password: password.trim().to_owned(),
            ca: None,
        })
        .ok_or_else(|| {
            users(format!(
                "there must be a line `{GATEWAY_USER_DEFAULT}:PASSWORD`, as which the gateway itself connects"
            ))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_locator_needs_a_host_and_a_port() {
        for bad in [
            "",
            "7447",
            "127.0.0.1:7447",
            "udp/127.0.0.1:7447",
            "tcp/:7447",
            "tcp/localhost",
            "tcp/localhost:x",
            "tcp/localhost:70000",
        ] {
            assert!(host_and_port(bad).is_err(), "{bad}");
        }
        assert_eq!(
            host_and_port("tcp/[::]:7447").expect("legal"),
            ("tcp", "[::]", 7447)
        );
    }

    #[test]
    fn the_gateway_reaches_its_own_router_also_when_that_listens_everywhere() {
        assert_eq!(reachable("tcp/0.0.0.0:7447"), "tcp/127.0.0.1:7447");
        assert_eq!(reachable("tcp/[::]:7447"), "tcp/[::1]:7447");
        assert_eq!(reachable("tcp/10.0.0.1:1"), "tcp/10.0.0.1:1");
        assert_eq!(reachable("tcp/plant:1"), "tcp/plant:1");
        assert_eq!(reachable("tls/0.0.0.0:7447"), "tls/localhost:7447");
    }
}
