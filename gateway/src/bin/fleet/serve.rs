//! `fleet serve`: the gateway until a signal.

use crate::{
    args::{Common, Config, Serve},
    link::{Failure, credentials},
    show, supervisor,
};
use gateway::{
    bus::zenoh::BusError,
    config::GatewayConfig,
    service::{self, Ready, Remaining, ServiceError},
    settings::{DEFAULTS, Settings},
    standby,
};

/// `fleet serve`
pub(crate) async fn serve(config: GatewayConfig, serve: &Serve, json: bool) -> Result<(), Failure> {
    let reloads = supervisor::reloads(serve.config.clone());
    let joined = !config.connect.is_empty();
    let warning = unsecured(&config);
    let ready = move |ready: Ready<'_>| {
        let Ready {
            locators,
            http,
            observer,
        } = ready;
        supervisor::ready(&locators.join(", "), observer);
        // In the log and not among what programs read, whatever they read: somebody has to see it.
        if let Some(warning) = warning {
            tracing::warn!("{warning}");
        }
        if json {
            let ready = serde_json::json!({ "ready": true, "locators": locators, "http": http });
            show::line(&ready.to_string());
            return;
        }
        let locators = locators.join(", ");
        if let Some(http) = http {
            show::line(&format!(
                "metrics on http://{http}/metrics, health on /healthz"
            ));
        }
        if joined {
            show::line(&format!("the gateway is ready, connected to {locators}"));
        } else {
            show::line(&format!("the gateway is ready, listening on {locators}"));
        }
    };
    let until = async {
        terminated().await;
        supervisor::stopping();
    };
    let taken = if config.standby {
        if !joined {
            let words =
                "a gateway that stands by needs a network that outlives the other: --connect";
            return Err(Failure::Usage(words.to_owned()));
        }
        if json {
            show::line(&serde_json::json!({ "standing_by": true }).to_string());
        } else {
            show::line("standing by: another gateway serves the fleet, or is about to");
        }
        let taken = tokio::select! {
            taken = standby::stand_by(&config) => taken,
            () = terminated() => return Ok(()),
            () = supervisor::standing_by() => return Ok(()),
        };
        Some(taken.map_err(|error| Failure::Failed(Some(error.to_string())))?)
    } else {
        None
    };
    match service::run(config, taken, ready, until, reloads).await {
        Ok(remaining) => {
            farewell(remaining, json);
            Ok(())
        }
        Err(ServiceError::Bus(
            error @ (BusError::Locator(_) | BusError::Users { .. } | BusError::Secure(_)),
        )) => Err(Failure::Usage(error.to_string())),
        Err(ServiceError::Bus(error @ BusError::Connect { .. })) => {
            Err(Failure::Connection(error.to_string()))
        }
        Err(error) => Err(Failure::Failed(Some(error.to_string()))),
    }
}

/// Returns what has to be said of a fleet that anybody may move.
fn unsecured(config: &GatewayConfig) -> Option<&'static str> {
    let joined = !config.connect.is_empty();
    match (
        joined,
        config.secure.is_some(),
        config.credentials.is_some(),
    ) {
        (false, true, _) | (true, _, true) => None,
        (false, false, _) => Some(
            "unsecured: whoever can connect can move the machines; `fleet init` makes a secured fleet",
        ),
        (true, _, false) => Some(
            "unsecured: this network lets a gateway in without a password; whoever can connect can move the machines",
        ),
    }
}

/// Says what is left undone.
fn farewell(remaining: Remaining, json: bool) {
    let Remaining { waiting, on_nodes } = remaining;
    if json {
        let line = serde_json::json!({ "ended": true, "waiting": waiting, "on_nodes": on_nodes });
        return show::line(&line.to_string());
    }
    let jobs = |count: usize| if count == 1 { "job" } else { "jobs" };
    show::line(&format!(
        "the gateway has ended: {waiting} {} waiting, {on_nodes} {} on nodes; all are kept",
        jobs(waiting),
        jobs(on_nodes)
    ));
}

/// `fleet config`
pub(crate) fn print_config(config: &Config) -> Result<(), Failure> {
    match &config.file {
        None => DEFAULTS.lines().for_each(show::line),
        Some(file) => {
            Settings::read(file).map_err(Failure::Usage)?;
            show::line(&format!(
                "{}: every option is known and in range",
                file.display()
            ));
        }
    }
    Ok(())
}

/// The file's settings, and over them what was said.
pub(crate) fn config(common: &Common, serve: &Serve) -> Result<GatewayConfig, Failure> {
    let settings = match &serve.config {
        Some(file) => Settings::read(file).map_err(Failure::Usage)?,
        None => Settings::default(),
    };
    let mut config = settings.into_config();
    if !serve.listen.is_empty() {
        config.listen.clone_from(&serve.listen);
    }
    if let Some(connect) = &common.connect {
        config.connect = vec![connect.clone()];
    }
    if let Some(keys) = &common.prefix {
        config.keys = keys.clone();
    }
    if let Some(store) = &serve.store {
        config.store.clone_from(store);
    }
    if serve.secure.is_some() {
        config.secure.clone_from(&serve.secure);
    }
    if serve.http.is_some() {
        config.http = serve.http;
    }
    if serve.otlp.is_some() {
        config.otlp.clone_from(&serve.otlp);
    }
    config.users.clone_from(&serve.users);
    config.credentials = credentials(common)?;
    config.scouting |= serve.scouting;
    config.standby |= serve.standby;
    Ok(config)
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
