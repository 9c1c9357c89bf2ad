//! `fleet provision`: tells a node on a serial port its name, network and router.

use crate::{
    args::Common,
    driver::{self, Driver},
    link::Failure,
    pins::{self, PinArgs},
    tuning::{self, TuningArgs},
};
use clap::{
    Arg, ArgMatches, Args, Command, FromArgMatches,
    builder::{PossibleValuesParser, TypedValueParser as _},
};
use gateway::security::home::read_secret;
use keys::{NodeId, credentials::Credentials};
use provision::{
    Found, Host, Reply, Request, Setting, Tuning,
    dialogue::{SIGNER_SHOWN_BYTES, Shown},
    frame::FRAME_BYTES_MAX,
    machine::{End, SwitchOf, SwitchSettings},
    record::{self, Authority, Login, Network, SIGNERS_MAX},
};
use serialport::SerialPort;
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

// What is read fits into the record.
const _: () = assert!(
    record::AUTHORITY_SUBJECT_BYTES_MAX == tls::authority::SUBJECT_BYTES_MAX
        && record::AUTHORITY_KEY_BYTES_MAX == tls::authority::KEY_BYTES_MAX
);

/// Speed of the line; a USB port takes any.
const BAUD: u32 = 115_200;

/// Longest wait for a byte before the clock is looked at.
const LOOK: Duration = Duration::from_millis(20);

#[derive(Debug, Args)]
pub(crate) struct Provision {
    /// Serial port of the node, for example /dev/ttyACM0.
    #[arg(value_name = "PORT")]
    port: PathBuf,

    /// Name of the node.
    #[arg(long, value_name = "NAME", value_parser = NodeId::new)]
    name: Option<NodeId>,

    /// A WiFi network; what the node knows already stays known.
    #[arg(long, value_name = "SSID")]
    wifi: Option<String>,

    /// File with its password; a newline at its end does not count. Without it the network is open.
    #[arg(long, value_name = "FILE", requires = "wifi")]
    wifi_password_file: Option<PathBuf>,

    /// Where the router or gateway is; by tls/ the node needs --ca, too.
    #[arg(long, value_name = "tcp|tls/HOST:PORT")]
    router: Option<String>,

    /// File that `fleet users` made for this node (DIR/NAME.json): its user and password. Without it:
    /// --user and --password-file. Never the credentials of whoever runs this.
    #[arg(long, value_name = "FILE", conflicts_with = "user")]
    login: Option<PathBuf>,

    /// File with the authority of a secured fleet (DIR/ca.pem): the node speaks TLS 1.3, and only to a
    /// router whose certificate it has signed.
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,

    /// Forget the authority: the node speaks plain TCP.
    #[arg(long, conflicts_with = "ca")]
    no_ca: bool,

    /// File with the public key (ed25519, 64 hexadecimal digits) that firmware must be signed with.
    #[arg(long, value_name = "FILE")]
    update_key_file: Option<PathBuf>,

    #[command(flatten)]
    answers: Answers,

    /// File with the public keys of operators (DIR/signers of a secured fleet): the node executes only
    /// what one of them has signed. They replace those it was told before.
    #[arg(long, value_name = "FILE")]
    signers: Option<PathBuf>,

    /// Forget the operators' keys: the node executes whatever its gateway sends.
    #[arg(long, conflicts_with = "signers")]
    no_signers: bool,

    /// A switch to ground: OF:END=KIND, as in `0:min=nc,home`. OF is an axis, c or d; END is min, max or
    /// home; KIND is no (normally open) or nc (normally closed); `home`: the axis is homed by it. The
    /// probe is `probe=KIND`. Which pin it is on: see node-firmware/README.md. May be repeated.
    #[arg(long, value_name = "OF:END=KIND", value_parser = switch)]
    switch: Vec<SwitchSettings>,

    /// Forget all switches that the node was told before.
    #[arg(long)]
    no_switches: bool,

    /// What the driver of an axis demands: AXIS=DRIVER with a4988, tmc2209, dm556, … or default (a wrong
    /// name lists them all), and what differs behind it, as in `0=tmc2209` or `1=drv8825,setup=1000,inverted`: high, low (shortest),
    /// pulse (high time of slow steps), setup, hold (of the direction), all in ns; stop (steps/s² of a stop
    /// of raw moves), corner (Hz that the speed may jump). What is not named is as that driver has it. May
    /// be repeated.
    #[arg(long, value_name = "AXIS=DRIVER,…", value_parser = driver::read)]
    driver: Vec<Driver>,

    #[command(flatten)]
    pins: PinArgs,

    #[command(flatten)]
    tuning: TuningArgs,

    /// Forget everything that the node was told before.
    #[arg(long)]
    clear: bool,

    /// Boot the node afterwards, so that it takes effect.
    #[arg(long)]
    restart: bool,
}

/// What is asked about a node: an option by this name, or with `=no` behind it.
#[derive(Clone, Copy)]
struct Question {
    name: &'static str,
    help: &'static str,
    setting: fn(bool) -> Setting,
}

const QUESTIONS: [Question; 3] = [
    Question {
        name: "boot-script",
        help: "Let the stored script `boot` run whenever the node starts; `--boot-script=no` forbids it again",
        setting: Setting::BootScript,
    },
    Question {
        name: "cd",
        help: "C and D are connected, with their shift register; `--cd=no`: they are not",
        setting: Setting::HasCd,
    },
    Question {
        name: "lidar",
        help: "The lidar is connected; `--lidar=no`: it is not",
        setting: Setting::HasLidar,
    },
];

/// The answers that were given to [`QUESTIONS`], in their order.
#[derive(Debug)]
struct Answers([Option<bool>; QUESTIONS.len()]);

impl FromArgMatches for Answers {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let answer = |question: Question| matches.get_one(question.name).copied();
        Ok(Self(QUESTIONS.map(answer)))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for Answers {
    fn augment_args(command: Command) -> Command {
        command.args(QUESTIONS.map(|question| {
            Arg::new(question.name)
                .long(question.name)
                .help(question.help)
                .value_name("yes|no")
                .value_parser(PossibleValuesParser::new(["yes", "no"]).map(|word| word == "yes"))
                .num_args(0..=1)
                .require_equals(true)
                .default_missing_value("yes")
        }))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

/// Does it.
pub(crate) async fn provision(common: &Common, line: &Provision) -> Result<(), Failure> {
    let settings = line.settings(common)?;
    let (port, restart, json) = (line.port.clone(), line.restart, common.json);
    let talk = move || talk(&port, settings, restart, json);
    tokio::task::spawn_blocking(talk)
        .await
        .map_err(|error| Failure::Failed(Some(error.to_string())))?
}

impl Provision {
    fn settings(&self, common: &Common) -> Result<Vec<Setting>, Failure> {
        let mut settings = Vec::new();
        if self.clear {
            settings.push(Setting::Clear);
        }
        settings.extend(self.name.map(Setting::Name));
        if let Some(ssid) = &self.wifi {
            let password = match &self.wifi_password_file {
                Some(file) => password(file, "--wifi-password-file")?,
                None => String::new(),
            };
            settings.push(Setting::Network(Network {
                ssid: short(ssid, "--wifi")?,
                password: short(&password, "--wifi-password-file")?,
            }));
        }
        if let Some(router) = &self.router {
            settings.push(Setting::Router(short(router, "--router")?));
        }
        if let Some(file) = &self.login {
            let usage =
                |error: String| Failure::Usage(format!("--login {}: {error}", file.display()));
            let text = read_secret(file).map_err(|error| usage(error.to_string()))?;
            let login = Credentials::from_json(&text).map_err(usage)?;
            settings.push(Setting::Login(Some(Login {
                user: short(&login.user, "--login")?,
                password: short(&login.password, "--login")?,
            })));
        }
        if let Some(file) = &self.ca {
            settings.push(Setting::Authority(Some(authority(file)?)));
        }
        if self.no_ca {
            settings.push(Setting::Authority(None));
        }
        if let (Some(user), Some(file)) = (&common.user, &common.password_file) {
            settings.push(Setting::Login(Some(Login {
                user: short(user, "--user")?,
                password: short(&password(file, "--password-file")?, "--password-file")?,
            })));
        }
        let fleet_keys = common.keys();
        if fleet_keys.prefix() != keys::key::PREFIX_DEFAULT {
            settings.push(Setting::Prefix(short(fleet_keys.prefix(), "--prefix")?));
        }
        if let Some(file) = &self.update_key_file {
            let text = line(file, "--update-key-file")?;
            let key = key_from_hex(&text).ok_or_else(|| {
                Failure::Usage("--update-key-file: 64 hexadecimal digits are wanted".into())
            })?;
            settings.push(Setting::UpdateKey(Some(key)));
        }
        if let Some(file) = &self.signers {
            settings.push(Setting::NoSigners);
            settings.extend(signers(file)?.into_iter().map(Setting::Signer));
        }
        if self.no_signers {
            settings.push(Setting::NoSigners);
        }
        if self.no_switches {
            settings.push(Setting::NoSwitches);
        }
        settings.extend(self.switch.iter().copied().map(Setting::Switch));
        let answers = QUESTIONS.iter().zip(self.answers.0);
        settings.extend(answers.filter_map(|(question, answer)| answer.map(question.setting)));
        settings.extend(self.driver.iter().copied().map(Driver::setting));
        settings.extend(self.pins.settings());
        settings.extend(self.tuning.settings());
        Ok(settings)
    }
}

/// Reads whose switch it is and which: `0:min`, `d:max` or `probe`.
pub(crate) fn place_of(place: &str) -> Option<(SwitchOf, End)> {
    let (of, end) = match place.split_once(':') {
        None if place == "probe" => return Some((SwitchOf::Probe, End::Min)),
        None => return None,
        Some(place) => place,
    };
    let of = match of {
        "c" => SwitchOf::C,
        "d" => SwitchOf::D,
        axis => SwitchOf::Axis(axis.parse().ok()?),
    };
    let end = match end {
        "min" => End::Min,
        "max" => End::Max,
        "home" => End::Home,
        _ => return None,
    };
    Some((of, end))
}

fn switch(text: &str) -> Result<SwitchSettings, String> {
    let parse = || {
        let (place, kind) = text.split_once('=')?;
        let (of, end) = place_of(place)?;
        let (kind, homes) = match kind.strip_suffix(",home") {
            Some(kind) => (kind, true),
            None => (kind, false),
        };
        let normally_closed = match kind {
            "nc" => true,
            "no" => false,
            _ => return None,
        };
        let settings = SwitchSettings {
            of,
            end,
            normally_closed,
            homes,
        };
        settings.is_legal().then_some(settings)
    };
    parse().ok_or_else(|| "no OF:END=KIND like 0:min=nc,home or d:max=no or probe=no".to_owned())
}

/// Names a switch as [`place_of`] reads it.
pub(crate) fn place_named(of: SwitchOf, end: End) -> String {
    let end = match end {
        End::Min => "min",
        End::Max => "max",
        End::Home => "home",
    };
    match of {
        SwitchOf::Axis(axis) => format!("{axis}:{end}"),
        SwitchOf::C => format!("c:{end}"),
        SwitchOf::D => format!("d:{end}"),
        SwitchOf::Probe => "probe".to_owned(),
    }
}

fn named(switch: &SwitchSettings) -> String {
    let place = place_named(switch.of, switch.end);
    let kind = if switch.normally_closed { "nc" } else { "no" };
    let homes = if switch.homes { ",home" } else { "" };
    format!("{place}={kind}{homes}")
}

fn none_or(list: &[String], between: &str) -> String {
    if list.is_empty() {
        "none".to_owned()
    } else {
        list.join(between)
    }
}

fn password(file: &Path, option: &str) -> Result<String, Failure> {
    keys::secret::read_password(file).map_err(|error| Failure::Usage(format!("{option}: {error}")))
}

/// Reads what is no secret.
fn line(file: &Path, option: &str) -> Result<String, Failure> {
    let text = std::fs::read_to_string(file)
        .map_err(|error| Failure::Usage(format!("{option} {}: {error}", file.display())))?;
    Ok(text.trim_end_matches(['\r', '\n']).to_owned())
}

fn authority(file: &Path) -> Result<Authority, Failure> {
    let bad = |why: String| Failure::Usage(format!("--ca {}: {why}", file.display()));
    let text = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    let read = tls::Authority::from_pem(&text).map_err(|error| bad(error.to_string()))?;
    let part = "tls::Authority keeps to these bounds";
    Ok(Authority {
        subject: heapless::Vec::from_slice(read.subject()).expect(part),
        key: heapless::Vec::from_slice(read.key()).expect(part),
    })
}

fn signers(file: &Path) -> Result<Vec<[u8; 32]>, Failure> {
    let bad = |why: &str| Failure::Usage(format!("--signers {}: {why}", file.display()));
    let list = keys::signers::parse(&line(file, "--signers")?).map_err(|why| bad(&why))?;
    match list.len() {
        0 => Err(bad("there is no key in it")),
        1..=SIGNERS_MAX => Ok(list.iter().map(|signer| signer.key.0).collect()),
        _ => Err(bad(&format!("a node knows at most {SIGNERS_MAX} keys"))),
    }
}

fn short<const N: usize>(text: &str, option: &str) -> Result<heapless::String<N>, Failure> {
    let too_long = |_| Failure::Usage(format!("{option}: longer than {N} bytes"));
    heapless::String::try_from(text).map_err(too_long)
}

/// Reads 64 hexadecimal digits.
pub(crate) fn key_from_hex(text: &str) -> Option<[u8; 32]> {
    let text = text.trim();
    if text.len() != 64 || !text.is_ascii() {
        return None;
    }
    let mut key = [0; 32];
    for (index, byte) in key.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * index..2 * index + 2], 16).ok()?;
    }
    Some(key)
}

fn talk(port: &Path, settings: Vec<Setting>, restart: bool, json: bool) -> Result<(), Failure> {
    let name = port.to_string_lossy();
    let mut port = serialport::new(name.as_ref(), BAUD)
        .timeout(LOOK)
        .open()
        .map_err(|error| Failure::Connection(format!("{name}: {error}")))?;
    let Reply::Hello { firmware, .. } = ask(&mut *port, Request::Hello)? else {
        return Err(unexpected());
    };
    if !settings.is_empty() {
        // What somebody else began on this line is not ours.
        ask(&mut *port, Request::Abandon)?;
        for setting in settings {
            ask(&mut *port, Request::Set(setting))?;
        }
        ask(&mut *port, Request::Commit)?;
    }
    let Reply::Record(shown) = ask(&mut *port, Request::Show)? else {
        return Err(unexpected());
    };
    let mut told = Tuning::default();
    if shown.has_tuning
        && let Reply::Tuning(tuning) = ask(&mut *port, Request::ShowTuning)?
    {
        told = tuning;
    }
    let mut lines = Vec::new();
    if shown.has_wiring
        && let Reply::Pins(wiring) = ask(&mut *port, Request::ShowPins)?
    {
        lines = pins::lines(&wiring, &shown.machine);
    }
    if shown.has_drivers
        && let Reply::Axes(axes) = ask(&mut *port, Request::ShowAxes)?
    {
        lines.extend(driver::lines(&axes));
    }
    lines.extend(tuning::lines(&told));
    show(&shown, &lines, firmware, json);
    if restart {
        ask(&mut *port, Request::Restart)?;
    }
    Ok(())
}

fn unexpected() -> Failure {
    Failure::Connection(provision::HostError::Answer.to_string())
}

fn ask(port: &mut dyn SerialPort, request: Request) -> Result<Reply, Failure> {
    let mut host = Host::new(request);
    let begun = Instant::now();
    loop {
        let now_us = u64::try_from(begun.elapsed().as_micros()).unwrap_or(u64::MAX);
        let mut out = [0; FRAME_BYTES_MAX + 2];
        let count = host
            .poll_transmit(now_us, &mut out)
            .map_err(|error| Failure::Connection(error.to_string()))?;
        if let Some(count) = count {
            port.write_all(&out[..count])?;
        }
        let mut bytes = [0; 256];
        let count = match port.read(&mut bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::TimedOut => 0,
            Err(error) => return Err(error.into()),
        };
        let reply = host
            .handle_bytes(&bytes[..count])
            .map_err(|error| Failure::Failed(Some(error.to_string())))?;
        if let Some(reply) = reply {
            return Ok(reply);
        }
    }
}

fn show(shown: &Shown, tuning: &[(&str, String)], firmware: [u8; 3], json: bool) {
    let [major, minor, patch] = firmware;
    let networks: Vec<_> = shown
        .networks
        .iter()
        .map(heapless::String::as_str)
        .collect();
    let signers: Vec<_> = shown.signers.iter().map(hex).collect();
    let switches: Vec<_> = shown.machine.switches.iter().map(named).collect();
    if json {
        let line = serde_json::json!({
            "firmware": format!("{major}.{minor}.{patch}"),
            "node": shown.name,
            "networks": networks,
            "router": shown.router.as_str(),
            "tls": shown.has_authority,
            "login": shown.has_login,
            "axes": shown.axes,
            "update_key": shown.has_update_key,
            "boot_script": shown.boot_script,
            "signers": signers,
            "switches": switches,
            "cd": shown.machine.has_cd,
            "lidar": shown.machine.has_lidar,
            "record": kept(shown.found),
            "tuning": tuning,
        });
        println!("{line}");
        return;
    }
    let said = |set: bool| if set { "set" } else { "none" };
    let name = shown
        .name
        .map_or("none".to_owned(), |name| name.to_string());
    println!("firmware    {major}.{minor}.{patch}");
    match shown.found {
        Found::Nothing | Found::Whole => {}
        Found::Older => {
            println!("record      damaged: the one before is used, tell it again");
        }
        Found::Damaged => {
            println!("record      damaged: the node does nothing, tell it everything again");
        }
    }
    println!("name        {name}");
    println!("networks    {}", networks.join(", "));
    println!("router      {}", shown.router);
    let trusts = if shown.has_authority {
        "the authority that it was told"
    } else {
        "no: plain TCP"
    };
    println!("tls         {trusts}");
    println!("login       {}", said(shown.has_login));
    println!("update key  {}", said(shown.has_update_key));
    println!(
        "boot script {}",
        if shown.boot_script { "allowed" } else { "no" }
    );
    let signers = if signers.is_empty() {
        "none: executes what its gateway sends".to_owned()
    } else {
        signers.join("…, ") + "…"
    };
    println!("signers     {signers}");
    let is_there = |there| if there { "connected" } else { "no" };
    println!("switches    {}", none_or(&switches, " "));
    println!("C and D     {}", is_there(shown.machine.has_cd));
    println!("lidar       {}", is_there(shown.machine.has_lidar));
    // As by default otherwise.
    for (name, words) in tuning {
        println!("{name:<11} {words}");
    }
}

/// What became of the record.
fn kept(found: Found) -> &'static str {
    match found {
        Found::Nothing => "none",
        Found::Whole => "whole",
        Found::Older => "older",
        Found::Damaged => "damaged",
    }
}

fn hex(bytes: &[u8; SIGNER_SHOWN_BYTES]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
