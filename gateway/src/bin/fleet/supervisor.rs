//! What the service manager hears and says: ready, alive, stopping; read the settings again.
//!
//! Without systemd (no `NOTIFY_SOCKET`) all of it says nothing and hears SIGHUP all the same.

use gateway::{job::gcode::Machines, service::Observer, settings::Settings};
use sd_notify::NotifyState;
use std::path::PathBuf;
use tokio::sync::mpsc;

/// Settings that wait to be taken over.
const RELOADS_MAX: usize = 4;

fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!("the service manager does not hear: {error}");
    }
}

/// The gateway is ready: says so, and from now on that it is alive, as often as is wanted, as long as
/// the fleet answers. A fleet that hangs is not alive, however well this task runs.
pub(crate) fn ready(where_it_listens: &str, observer: &Observer) {
    let status = format!("listening on {where_it_listens}");
    notify(&[NotifyState::Ready, NotifyState::Status(&status)]);
    let Some(limit) = sd_notify::watchdog_enabled() else {
        return;
    };
    let observer = observer.clone();
    tokio::spawn(async move {
        let mut beats = tokio::time::interval(limit / 3);
        loop {
            beats.tick().await;
            if observer.is_gone() {
                // The next one has a watch of its own.
                return;
            }
            match observer.snapshot().await {
                Some(_) => notify(&[NotifyState::Watchdog]),
                None => tracing::error!("the fleet does not answer; the watchdog is not fed"),
            }
        }
    });
}

/// The gateway waits until it is needed: for the service manager it runs, and is alive. Never ends.
pub(crate) async fn standing_by() {
    notify(&[NotifyState::Ready, NotifyState::Status("standing by")]);
    let Some(limit) = sd_notify::watchdog_enabled() else {
        return std::future::pending().await;
    };
    let mut beats = tokio::time::interval(limit / 3);
    loop {
        beats.tick().await;
        notify(&[NotifyState::Watchdog]);
    }
}

/// The gateway ends in good order.
pub(crate) fn stopping() {
    notify(&[
        NotifyState::Stopping,
        NotifyState::Status("taking nothing new"),
    ]);
}

/// Reads the settings again at each SIGHUP and gives what can be changed in a running gateway.
#[cfg(unix)]
pub(crate) fn reloads(file: Option<PathBuf>) -> mpsc::Receiver<Machines> {
    use tokio::signal::unix::{SignalKind, signal};
    let (sender, receiver) = mpsc::channel(RELOADS_MAX);
    // From here on, before anybody was told that the gateway is ready: SIGHUP would end it.
    match signal(SignalKind::hangup()) {
        Ok(mut hangups) => {
            tokio::spawn(async move {
                let mut known = file.as_deref().and_then(|file| Settings::read(file).ok());
                while hangups.recv().await.is_some() {
                    if let Ok(now) = NotifyState::monotonic_usec_now() {
                        notify(&[NotifyState::Reloading, now]);
                    }
                    if let Some(machines) = read_again(file.as_deref(), &mut known)
                        && sender.send(machines).await.is_err()
                    {
                        return;
                    }
                    notify(&[NotifyState::Ready]);
                }
            });
        }
        Err(error) => tracing::warn!("settings are read at the start only: {error}"),
    }
    receiver
}

/// Elsewhere nobody can ask for it.
#[cfg(not(unix))]
pub(crate) fn reloads(_file: Option<PathBuf>) -> mpsc::Receiver<Machines> {
    mpsc::channel(RELOADS_MAX).1
}

/// Returns the machines of a file that can be read; what is wrong is told, and nothing changes.
fn read_again(file: Option<&std::path::Path>, known: &mut Option<Settings>) -> Option<Machines> {
    let Some(file) = file else {
        tracing::info!("SIGHUP: there is no settings file (--config)");
        return None;
    };
    let read = match Settings::read(file) {
        Ok(read) => read,
        Err(error) => {
            tracing::error!("SIGHUP: nothing is changed: {error}");
            return None;
        }
    };
    let without_machines = |settings: &Settings| Settings {
        node: Machines::new(),
        ..settings.clone()
    };
    let machines = read.node.clone();
    if known.as_ref().map(&without_machines) != Some(without_machines(&read)) {
        tracing::warn!(
            "SIGHUP: [network], [store] and [fleet] have changed and count from the next start"
        );
    }
    tracing::info!(
        machines = machines.len(),
        "SIGHUP: the sections [node.NAME] were read again"
    );
    *known = Some(read);
    Some(machines)
}
