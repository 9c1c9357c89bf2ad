//! `fleet check`: what a G-code program will do, before anything moves and without a gateway.

use crate::{args::Check, link::Failure, show};
use gateway::{
    job::gcode::{self, Bounds, Machine, Preview},
    settings::Settings,
};
use keys::NodeId;
use std::time::Duration;

/// `fleet check`
pub(crate) fn check(check: &Check, json: bool) -> Result<(), Failure> {
    let machine = machine(check)?;
    let file = check.file.display();
    let text = std::fs::read_to_string(&check.file)
        .map_err(|error| Failure::Usage(format!("{file}: {error}")))?;
    let program = gcode::compile(&text, &machine)
        .map_err(|error| Failure::Failed(Some(format!("{file}: {error}"))))?;
    if check.commands {
        let job = serde_json::json!({ "commands": program.commands });
        show::line(&job.to_string());
    } else if json {
        show::json_line(&keys::record::to_json(&program.preview));
    } else {
        show::line(&format!("{file}: {}", told(&program.preview)));
        for (letter, bounds) in &program.preview.bounds {
            show::line(&format!("  {letter}  {}", extent(bounds)));
        }
    }
    Ok(())
}

fn machine(check: &Check) -> Result<Machine, Failure> {
    let Some(file) = &check.config else {
        let words = "whose machine? Give --config FILE with a section [node.NAME] (`fleet config` prints one)";
        return Err(Failure::Usage(words.to_owned()));
    };
    let machines = Settings::read(file).map_err(Failure::Usage)?.node;
    let known: Vec<&str> = machines.keys().map(NodeId::as_str).collect();
    let file = file.display();
    let usage = |words: String| Failure::Usage(format!("{file}: {words}"));
    match (&check.node, machines.len()) {
        (Some(node), _) => machines.get(node).cloned().ok_or_else(|| {
            usage(format!(
                "no section [node.{node}]; there are: {}",
                known.join(", ")
            ))
        }),
        (None, 1) => Ok(machines.into_values().next().expect("there is one")),
        (None, 0) => Err(usage("no section [node.NAME]".to_owned())),
        (None, _) => Err(usage(format!("--node: one of {}", known.join(", ")))),
    }
}

fn told(preview: &Preview) -> String {
    let seconds = preview.time_s.round() as u64;
    let time = match seconds {
        0 => format!("{:.0} ms", preview.time_s * 1_000.0),
        1..120 => format!("{seconds} s"),
        _ => {
            let time = Duration::from_secs(seconds).as_secs();
            let (hours, minutes) = (time / 3_600, time / 60 % 60);
            format!("{hours}:{minutes:02}:{:02} h", time % 60)
        }
    };
    format!(
        "{} commands, {:.1} mm, about {time} without the approach",
        preview.commands, preview.way_mm
    )
}

fn extent(bounds: &Bounds) -> String {
    let range = |[least, most]: [f64; 2]| format!("{least:.3} to {most:.3} mm");
    match (bounds.machine_mm, bounds.from_begin_mm) {
        (Some(machine), None) => range(machine),
        (None, Some(relative)) => format!("{} from where it is at the beginning", range(relative)),
        (Some(machine), Some(relative)) => format!(
            "{}, and before that {} from where it is at the beginning",
            range(machine),
            range(relative)
        ),
        (None, None) => String::new(),
    }
}
