//! Window boot: the command line, the link's thread, the window.

use anyhow::{Context, bail};
use clap::Parser;
use dashboard::{
    app::{App, FRAME_EVERY},
    credentials::read,
    link::{CONNECT_DEFAULT, Clock, Link, LinkConfig, Place},
};
use keys::{Keys, credentials::Credentials, key::PREFIX_DEFAULT};
use std::path::{Path, PathBuf};

/// The operator's window on a fleet.
///
/// Without an address it tries tcp/localhost:7447 and then asks the network by scouting.
#[derive(Debug, Parser)]
#[command(name = "dashboard", version)]
struct Arguments {
    /// The gateway's address.
    #[arg(long, env = "FLEET_CONNECT", value_name = "tcp|tls/HOST:PORT")]
    connect: Option<String>,
    /// Take whatever router scouting finds.
    #[arg(long, conflicts_with = "connect")]
    scout: bool,
    /// The prefix of all keys.
    #[arg(long, env = "FLEET_PREFIX", default_value = PREFIX_DEFAULT)]
    prefix: String,
    /// A file with address, user, password and authority, as `fleet users` writes it. Nobody but
    /// its owner may be allowed to read it.
    #[arg(
        long,
        env = "FLEET_CREDENTIALS",
        value_name = "FILE",
        conflicts_with_all = ["user", "password_file"]
    )]
    credentials: Option<PathBuf>,
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
    let credentials = credentials(arguments)?;
    let named = credentials.as_ref().map(|read| read.connect.clone());
    let named = named.filter(|named| !named.is_empty());
    let place = match (&arguments.connect, arguments.scout, named) {
        (Some(locator), ..) => Place::At(checked(locator)?),
        (None, true, _) => Place::Scouted,
        (None, false, Some(named)) => {
            let named = named.iter().map(|locator| checked(locator));
            Place::OneOf(named.collect::<anyhow::Result<_>>()?)
        }
        (None, false, None) => Place::Automatic,
    };
    Ok(LinkConfig {
        place,
        keys: Keys::new(&arguments.prefix).context("--prefix")?,
        credentials,
    })
}

fn credentials(arguments: &Arguments) -> anyhow::Result<Option<Credentials>> {
    if let Some(file) = &arguments.credentials {
        return read(file).context("--credentials").map(Some);
    }
    let (Some(user), Some(file)) = (&arguments.user, &arguments.password_file) else {
        return Ok(None);
    };
    Ok(Some(Credentials {
        connect: Vec::new(),
        user: user.clone(),
        password: password(file)?,
        ca: None,
    }))
}

fn checked(locator: &str) -> anyhow::Result<String> {
    let known = locator.starts_with("tcp/") || locator.starts_with("tls/");
    if !known || !locator.contains(':') {
        bail!("{locator}: an address has the form {CONNECT_DEFAULT} or tls/HOST:PORT");
    }
    Ok(locator.to_owned())
}

fn password(file: &Path) -> anyhow::Result<String> {
    keys::secret::read_password(file).context("--password-file")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(arguments: &[&str]) -> Result<Place, String> {
        let all = ["dashboard"].iter().chain(arguments);
        let arguments = Arguments::try_parse_from(all).map_err(|error| error.to_string())?;
        let config = link_config(&arguments).map_err(|error| error.to_string())?;
        Ok(config.place)
    }

    #[test]
    fn where_to_connect_is_said_once_and_else_tried() {
        assert_eq!(place(&[]), Ok(Place::Automatic));
        assert_eq!(place(&["--scout"]), Ok(Place::Scouted));
        let named = Place::At("tcp/left:7447".to_owned());
        assert_eq!(place(&["--connect", "tcp/left:7447"]), Ok(named));
        let refused = place(&["--connect", "tcp/left:7447", "--scout"]).expect_err("both");
        assert!(refused.contains("cannot be used with"), "{refused}");
        let refused = place(&["--connect", "left"]).expect_err("no address");
        assert!(refused.contains("tls/HOST:PORT"), "{refused}");
    }
}
