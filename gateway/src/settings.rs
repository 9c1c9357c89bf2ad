//! `fleet.toml`: what an operator may set, with unit, range, default and reason.
//!
//! [`DEFAULTS`] is the file with every option commented out at its default; `fleet config` prints
//! it. [`Settings::parse`] refuses what it does not know and what is out of range, and names the
//! line. Command line and environment win over the file.

use crate::{
    collector::Collector, config::GatewayConfig, fleet::FleetConfig, job::gcode::Machines,
};
use keys::Keys;
use serde::{Deserialize, Deserializer, de};
use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
};

/// The file with every option commented out at its default.
pub const DEFAULTS: &str = include_str!("fleet.toml");

/// What stands in the file. `None`: the default.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Where the gateway is and who may connect.
    pub network: Network,
    /// What is kept.
    pub store: Store,
    /// Bounds and times of the fleet.
    pub fleet: Bounds,
    /// What one client may ask for.
    pub client: Client,
    /// Sections `[node.NAME]`: the machines of nodes that take G-code.
    pub node: Machines,
}

/// Section `[network]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    /// Where the own router listens.
    #[serde(deserialize_with = "locators")]
    pub listen: Option<Vec<String>>,
    /// Routers of a zenoh network to join instead.
    #[serde(deserialize_with = "locators")]
    pub connect: Option<Vec<String>>,
    /// Whether to stand by beside another gateway with the same store.
    pub standby: Option<bool>,
    /// Prefix of all keys.
    #[serde(deserialize_with = "prefix")]
    pub prefix: Option<Keys>,
    /// Where metrics and health are served by HTTP.
    pub http: Option<SocketAddr>,
    /// Where the spans of jobs are sent.
    #[serde(deserialize_with = "collector")]
    pub otlp: Option<Collector>,
    /// Folder of a secured fleet.
    pub secure: Option<PathBuf>,
    /// Whether to look for other routers by multicast.
    pub scouting: Option<bool>,
}

/// Section `[store]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Store {
    /// The file.
    pub file: Option<PathBuf>,
    /// Final jobs that are kept.
    #[serde(deserialize_with = "within::<10, 10_000_000, _>")]
    pub keep_jobs: Option<u64>,
    /// Days that final jobs are kept.
    #[serde(deserialize_with = "within::<1, 36_500, _>")]
    pub keep_days: Option<u64>,
}

/// Section `[client]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Client {
    /// Requests, 1/s.
    #[serde(deserialize_with = "within::<1, 1_000_000, _>")]
    pub requests_per_s: Option<u64>,
    /// Bytes of jobs, MiB/s.
    #[serde(deserialize_with = "within::<1, 10_000, _>")]
    pub mib_per_s: Option<u64>,
    /// Gets that wait for their last reply.
    #[serde(deserialize_with = "within::<1, 4_096, _>")]
    pub gets_open: Option<u64>,
}

/// Section `[fleet]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bounds {
    /// Most nodes.
    #[serde(deserialize_with = "within::<1, 100_000, _>")]
    pub nodes: Option<u64>,
    /// Most jobs that wait for one node.
    #[serde(deserialize_with = "within::<1, 1_000_000, _>")]
    pub waiting_jobs: Option<u64>,
    /// Most commands that all waiting jobs hold together.
    #[serde(deserialize_with = "within::<1_000, 1_000_000_000, _>")]
    pub held_commands: Option<u64>,
    /// Silence after which a node is offline, ms.
    #[serde(deserialize_with = "within::<2_000, 600_000, _>")]
    pub silence_ms: Option<u64>,
    /// Shortest time between two records of a job that only progresses, ms.
    #[serde(deserialize_with = "within::<10, 60_000, _>")]
    pub progress_ms: Option<u64>,
    /// How long a release is tried, ms.
    #[serde(deserialize_with = "within::<100, 600_000, _>")]
    pub release_ms: Option<u64>,
}

fn within<'de, const LEAST: u64, const MOST: u64, D: Deserializer<'de>>(
    from: D,
) -> Result<Option<u64>, D::Error> {
    let value = i64::deserialize(from)?;
    let legal = u64::try_from(value).ok();
    let legal = legal.filter(|value| (LEAST..=MOST).contains(value));
    let error = || de::Error::custom(format!("{value} is not within {LEAST} to {MOST}"));
    legal.map(Some).ok_or_else(error)
}

fn locators<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<String>>, D::Error> {
    let list = Vec::<String>::deserialize(from)?;
    for locator in &list {
        crate::bus::zenoh::host_and_port(locator).map_err(de::Error::custom)?;
    }
    Ok(Some(list))
}

fn prefix<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Keys>, D::Error> {
    let text = String::deserialize(from)?;
    Keys::new(&text).map(Some).map_err(de::Error::custom)
}

fn collector<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Collector>, D::Error> {
    let text = String::deserialize(from)?;
    text.parse().map(Some).map_err(de::Error::custom)
}

impl Settings {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// Line, column, the line itself and what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let error = |error: toml::de::Error| error.to_string().trim_end().to_owned();
        let settings: Self = toml::from_str(text).map_err(error)?;
        if settings.network.secure.is_some() && settings.network.connect.is_some() {
            let words = "network: `secure` is of the own router; with `connect` there is none";
            return Err(words.to_owned());
        }
        Ok(settings)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// The file, and what [`Settings::parse`] says.
    pub fn read(path: &Path) -> Result<Self, String> {
        let name = path.display();
        let text = std::fs::read_to_string(path).map_err(|error| format!("{name}: {error}"))?;
        Self::parse(&text).map_err(|error| format!("{name}: {error}"))
    }

    /// Returns the gateway's configuration with these settings and the defaults for the rest.
    pub fn into_config(self) -> GatewayConfig {
        let Self {
            network,
            store,
            fleet,
            client,
            node,
        } = self;
        let file = store.file.unwrap_or_else(|| STORE_DEFAULT.into());
        let mut config = GatewayConfig::new(file);
        config.listen = network.listen.unwrap_or_default();
        config.connect = network.connect.unwrap_or_default();
        config.standby = network.standby.unwrap_or(false);
        config.keys = network.prefix.unwrap_or_default();
        config.secure = network.secure;
        config.http = network.http;
        config.otlp = network.otlp;
        config.scouting = network.scouting.unwrap_or(false);
        config.machines = node;
        let FleetConfig {
            silence_us,
            retention_jobs,
            retention_us,
            waiting_jobs_max,
            held_commands_max,
            nodes_max,
            progress_us,
            release_patience_us,
            ..
        } = &mut config.fleet;
        let us = |ms: u64| 1_000 * ms;
        let count = |count: u64| usize::try_from(count).unwrap_or(usize::MAX);
        set(silence_us, fleet.silence_ms.map(us));
        set(progress_us, fleet.progress_ms.map(us));
        set(release_patience_us, fleet.release_ms.map(us));
        set(retention_jobs, store.keep_jobs.map(count));
        set(
            retention_us,
            store.keep_days.map(|days| 86_400_000_000 * days),
        );
        set(waiting_jobs_max, fleet.waiting_jobs.map(count));
        set(held_commands_max, fleet.held_commands.map(count));
        set(nodes_max, fleet.nodes.map(count));
        let limits = &mut config.limits;
        set(&mut limits.requests_per_s, client.requests_per_s);
        set(
            &mut limits.bytes_per_s,
            client.mib_per_s.map(|mib| mib << 20),
        );
        set(&mut limits.gets_open, client.gets_open.map(count));
        config
    }
}

/// The store when nothing else is said.
pub const STORE_DEFAULT: &str = "fleet.redb";

fn set<T>(place: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *place = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The defaults with every option switched on.
    fn switched_on() -> String {
        let on = |line: &str| match line.strip_prefix("#") {
            Some(rest) if !rest.starts_with([' ', '#']) && !rest.is_empty() => rest.to_owned(),
            _ => line.to_owned(),
        };
        DEFAULTS.lines().map(|line| on(line) + "\n").collect()
    }

    #[test]
    fn the_printed_defaults_are_the_defaults() {
        assert_eq!(Settings::parse(DEFAULTS), Ok(Settings::default()));
        let text = switched_on();
        let settings = Settings::parse(&text).expect("legal");
        let config = settings.clone().into_config();
        let plain = GatewayConfig::new(STORE_DEFAULT);
        assert_eq!(config.fleet, plain.fleet);
        assert_eq!(config.limits, plain.limits);
        assert_eq!(config.listen(), plain.listen());
        assert_eq!(config.store, plain.store);
        assert_eq!(config.scouting, plain.scouting);
        assert_eq!(config.keys, plain.keys);
    }

    #[test]
    fn every_option_stands_in_the_printed_defaults() {
        // Of what excludes each other only one can be switched on.
        let Settings {
            network,
            store,
            fleet,
            client,
            node: _,
        } = Settings::parse(&switched_on()).expect("legal");
        let of_client = [client.requests_per_s, client.mib_per_s, client.gets_open];
        assert!(of_client.iter().all(Option::is_some), "{of_client:?}");
        assert!(network.listen.is_some() && network.prefix.is_some() && network.scouting.is_some());
        for name in ["connect", "standby", "secure", "http", "otlp"] {
            assert!(DEFAULTS.contains(&format!("# {name} = ")), "{name}");
        }
        assert!(store.file.is_some() && store.keep_jobs.is_some() && store.keep_days.is_some());
        let bounds = [
            fleet.nodes,
            fleet.waiting_jobs,
            fleet.held_commands,
            fleet.silence_ms,
            fleet.progress_ms,
            fleet.release_ms,
        ];
        assert!(bounds.iter().all(Option::is_some), "{bounds:?}");
    }

    #[test]
    fn a_wrong_option_names_its_line() {
        for (text, line, words) in [
            ("[fleet]\nnodes = 0\n", 2, "0 is not within 1 to 100000"),
            ("[fleet]\n\nnodse = 1\n", 3, "unknown field `nodse`"),
            ("[fleet]\nnodes = \"many\"\n", 2, "invalid type"),
            (
                "[network]\nlisten = [\"udp/x:1\"]\n",
                2,
                "no address of the form",
            ),
            ("[network]\nprefix = \"*\"\n", 2, ""),
            ("[network]\n\notlp = \"a:4318\"\n", 3, ""),
            ("[stroe]\n", 1, "unknown field `stroe`"),
            ("[store\n", 1, ""),
            (
                "[node.left]\nsteps_per_mm = [0]\n",
                2,
                "0 is not within 0.001",
            ),
            ("[node.left]\nsteps_per_mm = [1, 1, 1, 1, 1]\n", 2, "5 axes"),
            ("[node.Left]\nsteps_per_mm = [80]\n", 1, ""),
            (
                "[node.left]\nsteps_per_mm = [80]\nspeed_mm_min = [900, 9]\naccel_mm_s2 = [9]\n",
                1,
                "`speed_mm_min` has 2 axes and `steps_per_mm` has 1",
            ),
            (
                "[node.left]\nsteps_per_mm = [80]\nspeed_mm_min = [9e6]\naccel_mm_s2 = [9]\n",
                1,
                "steps a second",
            ),
        ] {
            let error = Settings::parse(text).expect_err("illegal");
            assert!(
                error.contains(&format!("line {line},")),
                "{text:?}: {error}"
            );
            assert!(error.contains(words), "{text:?}: {error}");
        }
    }

    #[test]
    fn the_printed_example_of_a_machine_is_one() {
        let (_, example) = DEFAULTS
            .split_once("# [node.left]\n")
            .expect("there is one");
        let lines = example.lines().map(|line| match line.strip_prefix("# ") {
            Some(option) if option.contains(" = ") => option.to_owned() + "\n",
            _ => String::new(),
        });
        let text = format!("[node.left]\n{}", lines.collect::<String>());
        let config = Settings::parse(&text).expect("legal").into_config();
        let machine = config.machines.values().next().expect("one");
        assert_eq!(machine.axis_count(), 3);
        assert!(machine.travel_mm.is_some() && machine.jerk_mm_s3.is_some());
        assert_eq!(machine.offsets_mm[5], [0.0; 3]);
        assert_eq!(
            (machine.arc_tolerance_mm, machine.laser_s_max),
            (0.002, 1_000.0)
        );
    }

    #[test]
    fn a_secured_router_joins_no_other_network() {
        let text = "[network]\nsecure = \"/etc/fleet\"\nconnect = [\"tcp/a:1\"]\n";
        let error = Settings::parse(text).expect_err("both");
        assert!(error.contains("`secure`"), "{error}");
    }

    #[test]
    fn what_the_file_says_reaches_the_gateway() {
        let text = "[store]\nfile = \"/srv/f.redb\"\nkeep_jobs = 50\n[fleet]\nsilence_ms = 9000\n";
        let config = Settings::parse(text).expect("legal").into_config();
        assert_eq!(config.store, PathBuf::from("/srv/f.redb"));
        assert_eq!(config.fleet.retention_jobs, 50);
        assert_eq!(config.fleet.silence_us, 9_000_000);
    }
}
