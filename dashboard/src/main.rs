//! Window boot: the command line, the link's thread, the window.

use anyhow::{Context, bail};
use clap::Parser;
use dashboard::{
    app::{App, FRAME_EVERY},
    link::{CONNECT_DEFAULT, Clock, Credentials, Link, LinkConfig, Place},
};
use keys::{Keys, key::PREFIX_DEFAULT};
use std::path::{Path, PathBuf};

/// The operator's window on a fleet.
///
/// Without an address it tries tcp/localhost:7447 and then asks the network by scouting.
#[derive(Debug, Parser)]
#[command(name = "dashboard", version)]
struct Arguments {
    /// The gateway's address.
    #[arg(long, env = "FLEET_CONNECT", value_name = "tcp/HOST:PORT")]
    connect: Option<String>,
    /// Take whatever router scouting finds.
    #[arg(long, conflicts_with = "connect")]
    scout: bool,
    /// The prefix of all keys.
    #[arg(long, env = "FLEET_PREFIX", default_value = PREFIX_DEFAULT)]
    prefix: String,
    /// The user, where the router asks for one.
    #[arg(long, env = "FLEET_USER", requires = "password_file")]
    user: Option<String>,
    /// A file with the user's password.
    #[arg(long, env = "FLEET_PASSWORD_FILE", requires = "user")]
    password_file: Option<PathBuf>,
    /// A file for settings and layout instead of the user's own.
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let config = link_config(&arguments)?;
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("Stepfleet")
            .with_app_id("stepfleet-dashboard")
            .with_inner_size([1_440.0, 860.0])
            .with_min_inner_size([720.0, 420.0]),
        persistence_path: arguments.settings,
        ..eframe::NativeOptions::default()
    };
    let start = move |creation: &eframe::CreationContext<'_>| {
        let context = creation.egui_ctx.clone();
        let wake = move || context.request_repaint_after(FRAME_EVERY);
        let link = Link::spawn(config, Clock::start(), wake)?;
        let app: Box<dyn eframe::App> = Box::new(App::new(creation, link));
        Ok(app)
    };
    eframe::run_native("stepfleet-dashboard", options, Box::new(start))
        .map_err(|error| anyhow::anyhow!("no window: {error}"))
}

fn link_config(arguments: &Arguments) -> anyhow::Result<LinkConfig> {
    let place = match (&arguments.connect, arguments.scout) {
        (Some(locator), _) => Place::At(checked(locator)?),
        (None, true) => Place::Scouted,
        (None, false) => Place::Automatic,
    };
    let credentials = match (&arguments.user, &arguments.password_file) {
        (Some(user), Some(file)) => Some(Credentials {
            user: user.clone(),
            password: password(file)?,
        }),
        _ => None,
    };
    Ok(LinkConfig {
        place,
        keys: Keys::new(&arguments.prefix).context("--prefix")?,
        credentials,
    })
}

fn checked(locator: &str) -> anyhow::Result<String> {
    if !locator.starts_with("tcp/") || !locator.contains(':') {
        bail!("--connect {locator}: an address has the form {CONNECT_DEFAULT}");
    }
    Ok(locator.to_owned())
}

fn password(file: &Path) -> anyhow::Result<String> {
    let name = file.display();
    let text = std::fs::read_to_string(file).with_context(|| format!("--password-file {name}"))?;
    let password = text.trim_end_matches(['\r', '\n']);
    if password.is_empty() {
        bail!("--password-file {name}: the file is empty");
    }
    Ok(password.to_owned())
}
