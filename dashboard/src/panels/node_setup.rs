//! How a node is set, read-only: what it tells of itself when it is asked, and what it cannot know.

use super::node::{NOT_TOLD, facts_grid};
use crate::{
    message::Answer,
    model::{
        Model,
        node::Node,
        setup::{Asked, SetupState, Told},
    },
    request::{Request, Requests},
    text,
    theme::{self, Tone},
};
use egui::{Label, Ui};
use keys::{
    Features, Setup,
    setup::{
        AxisSetup, EnableSetup, HomingSetup, InputSetup, PlaceSetup, Reaction, SetupOfC, SetupOfD,
    },
};

/// A row: a name and what is set.
type Fact = (String, String);

/// Shows it.
pub(super) fn setup_ui(ui: &mut Ui, model: &Model, node: &Node, requests: &mut Requests) {
    facts_grid(ui, "node", own_facts(node));
    ui.separator();
    ui.horizontal_wrapped(|ui| {
        let (tone, words) = asked(model, node);
        ui.add(Label::new(theme::toned(ui, tone, words)).wrap());
        let again = ui.add_enabled(node.is_there(), egui::Button::new("Ask again"));
        if again.clicked() {
            requests.push(Request::Setup { node: node.id() });
        }
    });
    let Some(told) = node.setup().told() else {
        return;
    };
    for (title, facts) in sections(&told.setup) {
        ui.add_space(6.0);
        ui.label(theme::toned(ui, Tone::Plain, title.clone()).strong());
        facts_grid(ui, &title, facts);
    }
    ui.add_space(6.0);
    let words = "A node counts steps: the steps of a millimetre, for G-code, are in the gateway's \
                 fleet.toml.";
    ui.add(Label::new(theme::toned(ui, Tone::Quiet, words)).wrap());
}

/// Returns what every status tells.
fn own_facts(node: &Node) -> Vec<Fact> {
    let mut facts: Vec<(&str, String)> = vec![("name", node.id().to_string())];
    if let Some(status) = node.latest_status() {
        let [major, minor, patch] = status.firmware;
        facts.push(("firmware", format!("{major}.{minor}.{patch}")));
        facts.push(("axes", status.axes.len().to_string()));
        let depth = status
            .accepted_commands
            .saturating_sub(status.executed_commands);
        let room = depth.saturating_add(u64::from(status.credit_commands));
        facts.push(("queue", format!("room for {room} commands")));
        facts.push(("boot", format!("{:#x}", status.queue.boot)));
        facts.push(("can do", features(status.features)));
    } else if let Some(record) = node.latest_record() {
        facts.push(("firmware", record.firmware.clone()));
        facts.push(("axes", record.position.len().to_string()));
        facts.push(("can do", NOT_TOLD.to_owned()));
    }
    named(facts)
}

fn named(facts: Vec<(&str, String)>) -> Vec<Fact> {
    let facts = facts.into_iter();
    facts.map(|(name, fact)| (name.to_owned(), fact)).collect()
}

/// Returns the names of what a firmware can do.
fn features(features: Features) -> String {
    const NAMES: [(Features, &str); 7] = [
        (Features::BASIC, "moves"),
        (Features::RAMPS, "ramps and lines"),
        (Features::SMOOTH, "smoothstep"),
        (Features::HOMING, "homing"),
        (Features::BARRIERS, "synchronized starts"),
        (Features::LUA, "Lua"),
        (Features::CD, "CD moves"),
    ];
    let known = NAMES.iter().filter(|(feature, _)| features.has(*feature));
    let names: Vec<&str> = known.map(|(_, name)| *name).collect();
    names.join(", ")
}

/// Says whether what is shown holds now, and if nothing is shown, why.
fn asked(model: &Model, node: &Node) -> (Tone, String) {
    let state = node.setup();
    let Some(told) = state.told() else {
        return nothing(node, state);
    };
    let at = format!("{} UTC", text::time_of_day(told.at));
    if !model.link().is_up() || !node.is_there() {
        let words = format!("⚠ as it told at {at}; it cannot be asked now");
        return (Tone::Warn, words);
    }
    if !holds(told, node) {
        let words =
            format!("⚠ as it told at {at}, before it started anew: it may be set differently");
        return (Tone::Warn, words);
    }
    let pending = |asked: &Asked| asked.answer.is_none() && asked.at > told.at;
    let pending = state.asked().is_some_and(pending);
    let words = match pending {
        true => format!("⌛ asking it again; below as it told at {at}"),
        false => format!("as it told at {at}; it is set like this since its start"),
    };
    (Tone::Quiet, words)
}

/// Returns whether it has not started anew since it told.
fn holds(told: &Told, node: &Node) -> bool {
    told.boot.is_some() && told.boot == node.boot()
}

fn nothing(node: &Node, state: &SetupState) -> (Tone, String) {
    let why = match state.asked().map(|asked| &asked.answer) {
        _ if !node.is_there() => "it is not there",
        None => "it was not asked yet",
        Some(None) => return (Tone::Plain, "⌛ asking it".to_owned()),
        Some(Some(Answer::Failed(why))) => why,
        Some(Some(_)) => "its answer cannot be read, the log says why",
    };
    (
        Tone::Quiet,
        format!("axes, switches and link: {NOT_TOLD}: {why}"),
    )
}

/// Returns titles with their rows.
fn sections(setup: &Setup) -> Vec<(String, Vec<Fact>)> {
    let mut sections = vec![("Link".to_owned(), link_facts(setup))];
    for (number, axis) in setup.axes.iter().enumerate() {
        sections.push((format!("Axis {number}"), axis_facts(axis)));
    }
    if let Some(c) = &setup.c {
        sections.push(("Axis C".to_owned(), c_facts(c)));
    }
    if let Some(d) = &setup.d {
        sections.push(("Axis D".to_owned(), d_facts(d)));
    }
    sections.push(("Inputs".to_owned(), input_facts(setup)));
    sections.push(("Outputs and more".to_owned(), output_facts(setup)));
    sections
}

fn link_facts(setup: &Setup) -> Vec<Fact> {
    let link = &setup.link;
    let router = match link.router.as_str() {
        "" => "found by scouting".to_owned(),
        router => router.to_owned(),
    };
    let user = link.user.as_deref().unwrap_or("none");
    let tls = match link.tls {
        true => "on; only to a router whose certificate its authority has signed",
        false => "off",
    };
    let networks = match link.networks.is_empty() {
        true => "none".to_owned(),
        false => {
            let names: Vec<&str> = link.networks.iter().map(|name| name.as_str()).collect();
            names.join(", ")
        }
    };
    let after = text::micros(link.loss_after_us as f64);
    let loss = match link.loss {
        Reaction::GoOn => "it executes what its queue holds".to_owned(),
        Reaction::Decelerate => format!("after {after} it comes to rest by its ramps, stopped"),
        Reaction::Halt => format!("after {after} it halts, stopped"),
    };
    let signers = match setup.signers.len() {
        0 => "no; it executes whatever its gateway sends".to_owned(),
        count => {
            let keys = text::count(count, "key");
            let marks: Vec<&str> = setup.signers.iter().map(|mark| mark.as_str()).collect();
            format!("yes, by one of {keys}: {}", marks.join(", "))
        }
    };
    let update = match &setup.update_key {
        Some(mark) => format!("signed by the key {mark}"),
        None => "not over the network".to_owned(),
    };
    let boot = if setup.boot_script { "yes" } else { "no" };
    named(vec![
        ("runs on", setup.chip.to_string()),
        ("key prefix", setup.prefix.to_string()),
        ("router", router),
        ("user", user.to_owned()),
        ("TLS", tls.to_owned()),
        ("wireless networks", networks),
        ("link lost while it moves", loss),
        ("jobs must be signed", signers),
        ("other firmware", update),
        ("runs the script `boot`", boot.to_owned()),
    ])
}

fn axis_facts(axis: &AxisSetup) -> Vec<Fact> {
    let driver = axis.driver.as_deref().unwrap_or("times of its own");
    let pin = if axis.direction_inverted {
        "low"
    } else {
        "high"
    };
    let limits = match axis.soft_limits {
        None => "none".to_owned(),
        Some(limits) => {
            let [min, max] = [limits.min_steps, limits.max_steps].map(text::steps);
            let from = match limits.from_boot {
                true => "from its start on",
                false => "once it is homed",
            };
            format!("{min} to {max} steps, {from}")
        }
    };
    let mut facts = vec![
        ("driver", driver.to_owned()),
        (
            "step",
            format!(
                "high {} at least, {} when slow; low {} at least",
                nanos(axis.high_ns_min),
                nanos(axis.high_ns),
                nanos(axis.low_ns_min)
            ),
        ),
        (
            "direction",
            format!(
                "{} before a step, {} behind one; the pin is {pin} for positive",
                nanos(axis.dir_setup_ns),
                nanos(axis.dir_hold_ns)
            ),
        ),
        ("fastest", hz(axis.speed_hz_max)),
        ("jump at a corner", hz(axis.junction_hz)),
        ("slow stop", hz_per_s(axis.stop_accel_hz_per_s)),
        ("soft limits", limits),
    ];
    match &axis.homing {
        None => facts.push(("homing", "none".to_owned())),
        Some(homing) => facts.extend(homing_facts(homing)),
    }
    named(facts)
}

fn homing_facts(homing: &HomingSetup) -> [(&'static str, String); 3] {
    let way = if homing.positive {
        "positive"
    } else {
        "negative"
    };
    let count = |steps: u64| text::steps(i64::try_from(steps).unwrap_or(i64::MAX));
    [
        (
            "homing",
            format!(
                "to the switch `{}`, {way}; seek {}, approach {}, {}",
                homing.switch,
                hz(homing.seek_hz),
                hz(homing.approach_hz),
                hz_per_s(homing.accel_hz_per_s)
            ),
        ),
        (
            "homing ways",
            format!(
                "seek at most {}, back off at most {} and {} more steps",
                count(homing.travel_steps_max),
                count(homing.back_off_steps_max),
                count(homing.margin_steps)
            ),
        ),
        (
            "home position",
            format!(
                "the switch is at {}, it ends {} steps off it",
                text::steps(homing.home_position_steps),
                count(homing.pull_off_steps)
            ),
        ),
    ]
}

fn c_facts(c: &SetupOfC) -> Vec<Fact> {
    let mut facts = vec![("scale".to_owned(), scale(c.steps_per_m))];
    let place = |place: &PlaceSetup| {
        let (at, speed) = (
            millis(place.position_um.into()),
            millis(place.speed_um_per_s.into()),
        );
        (
            place.name.to_string(),
            format!("at {at} mm, {speed} mm/s on the way there"),
        )
    };
    facts.extend(c.places.iter().map(place));
    facts
}

fn d_facts(d: &SetupOfD) -> Vec<Fact> {
    let (way, speed) = (millis(d.travel_um.into()), millis(d.speed_um_per_s.into()));
    named(vec![
        ("scale", scale(d.steps_per_m)),
        ("off to on", format!("{way} mm, {speed} mm/s")),
    ])
}

fn input_facts(setup: &Setup) -> Vec<Fact> {
    let input = |input: &InputSetup| {
        let kind = match input.normally_closed {
            true => "normally closed",
            false => "normally open",
        };
        let [pressed, released] = [input.active_us, input.inactive_us].map(|us| match us {
            0 => "at once".to_owned(),
            us => format!("after {}", text::micros(us.into())),
        });
        let words = format!("{kind}; counts as pressed {pressed}, as released {released}");
        (input.of.to_string(), words)
    };
    let mut facts: Vec<Fact> = setup.inputs.iter().map(input).collect();
    if facts.is_empty() {
        return named(vec![("switches", "none".to_owned())]);
    }
    let reaction = |reaction| match reaction {
        Reaction::Halt => "everything halts",
        Reaction::Decelerate => "everything comes to rest by its ramps",
        Reaction::GoOn => "it is noted where",
    };
    facts.extend(named(vec![
        ("an axis at a limit", reaction(setup.limit_stop).to_owned()),
        ("the probe touches", reaction(setup.probe_stop).to_owned()),
    ]));
    facts
}

fn output_facts(setup: &Setup) -> Vec<Fact> {
    let enable = |(number, output): (usize, &EnableSetup)| {
        let axes: Vec<String> = output.axes.iter().map(char::to_string).collect();
        let on = text::micros(output.delay_on_us.into());
        let when = match output.auto {
            true => {
                let off = text::micros(f64::from(output.delay_off_ms) * 1e3);
                format!("on {on} before motion, off after {off} of rest")
            }
            false => format!("on from its start on; {on} until the first step"),
        };
        let place = match output.shift_register {
            true => ", behind the shift register",
            false => "",
        };
        let words = format!("axes {}: {when}{place}", axes.join(", "));
        (format!("enable {number}"), words)
    };
    let mut facts: Vec<Fact> = setup.enables.iter().enumerate().map(enable).collect();
    if facts.is_empty() {
        facts.extend(named(vec![("enable", "none".to_owned())]));
    }
    let lidar = match setup.lidar_wait_ms {
        Some(wait_ms) => format!("a reading is waited for at rest, {wait_ms} ms at most"),
        None => "a reading is not waited for".to_owned(),
    };
    facts.extend(named(vec![
        ("lidar", lidar),
        (
            "ring",
            format!("{} commands", text::steps(setup.ring_commands.into())),
        ),
    ]));
    facts
}

fn nanos(ns: u32) -> String {
    match ns {
        0..1_000 => format!("{ns} ns"),
        _ => format!("{} µs", f64::from(ns) / 1e3),
    }
}

fn hz(hz: u32) -> String {
    format!("{} steps/s", text::steps(hz.into()))
}

fn hz_per_s(hz_per_s: u32) -> String {
    format!("{} steps/s²", text::steps(hz_per_s.into()))
}

/// Returns micrometres as millimetres.
fn millis(um: i64) -> f64 {
    um as f64 / 1e3
}

fn scale(steps_per_m: u32) -> String {
    format!("{} steps/mm", millis(steps_per_m.into()))
}
