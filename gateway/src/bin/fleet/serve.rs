//! `fleet serve`: the gateway until a signal.

use crate::{
    args::{Common, Serve},
    link::{Failure, credentials},
    show,
};
use gateway::{
    bus::zenoh::BusError,
    config::GatewayConfig,
    service::{self, ServiceError},
};

/// `fleet serve`
pub(crate) async fn serve(common: &Common, serve: &Serve) -> Result<(), Failure> {
    let config = GatewayConfig {
        listen: serve.listen.clone(),
        connect: common.connect.iter().cloned().collect(),
        keys: common.prefix.clone(),
        users: serve.users.clone(),
        secure: serve.secure.clone(),
        credentials: credentials(common)?,
        scouting: serve.scouting,
        ..GatewayConfig::new(&serve.store)
    };
    let joined = common.connect.is_some();
    let open = config.secure.is_none();
    let json = common.json;
    let ready = move |locators: &[String]| {
        if json {
            show::line(&serde_json::json!({ "ready": true, "locators": locators }).to_string());
            return;
        }
        let locators = locators.join(", ");
        if joined {
            show::line(&format!("the gateway is ready, connected to {locators}"));
        } else {
            show::line(&format!("the gateway is ready, listening on {locators}"));
            if open {
                show::line(
                    "unsecured: whoever can connect can move the machines; `fleet init` makes a secured fleet",
                );
            }
        }
    };
    match service::run(config, ready, terminated()).await {
        Ok(()) => Ok(()),
        Err(ServiceError::Bus(
            error @ (BusError::Locator(_) | BusError::Users { .. } | BusError::Secure(_)),
        )) => Err(Failure::Usage(error.to_string())),
        Err(ServiceError::Bus(error @ BusError::Connect { .. })) => {
            Err(Failure::Connection(error.to_string()))
        }
        Err(error) => Err(Failure::Failed(Some(error.to_string()))),
    }
}

/// Resolves at Ctrl-C or a request to end.
async fn terminated() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        match signal(SignalKind::terminate()) {
            Ok(mut terminate) => {
                tokio::select! {
                    _ = tokio::signal::ctrl_c() => {}
                    _ = terminate.recv() => {}
                }
                return;
            }
            Err(error) => tracing::warn!("only Ctrl-C ends the gateway cleanly: {error}"),
        }
    }
    if let Err(error) = tokio::signal::ctrl_c().await {
        tracing::error!("no signal can be waited for: {error}");
    }
}
