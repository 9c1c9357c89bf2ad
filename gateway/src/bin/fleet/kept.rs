//! `fleet template` and `fleet schedule`: what the gateway keeps beside jobs.

use crate::{
    args::{Format, pattern, setting},
    link::{Failure, Link, read},
    show,
    submit::{accepted, verdict},
    written::Written,
};
use clap::{Args, Subcommand};
use gateway::fleet::kept::{Schedule, Template};
use keys::GroupId;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::PathBuf;
use zenoh::bytes::Encoding;

#[derive(Debug, Args)]
pub(crate) struct Templates {
    #[command(subcommand)]
    act: TemplateAct,
}

#[derive(Debug, Subcommand)]
enum TemplateAct {
    /// Keep a job with ${NAME} in it.
    Put {
        /// Its name.
        #[arg(value_parser = name)]
        name: GroupId,
        /// The job; `-`: standard input.
        #[arg(value_name = "FILE|-")]
        file: PathBuf,
        /// What it is for.
        #[arg(long, default_value = "")]
        about: String,
        /// What the file is [default: as for `fleet submit`].
        #[arg(long, value_enum)]
        format: Option<Format>,
    },
    /// List them.
    List,
    /// Print one.
    Show {
        /// Its name.
        #[arg(value_parser = name)]
        name: GroupId,
    },
    /// Take one away.
    Delete {
        /// Its name.
        #[arg(value_parser = name)]
        name: GroupId,
    },
}

#[derive(Debug, Args)]
pub(crate) struct Schedules {
    #[command(subcommand)]
    act: ScheduleAct,
}

#[derive(Debug, Subcommand)]
enum ScheduleAct {
    /// Hand in a job again and again.
    Add(Add),
    /// List them.
    List,
    /// Take one away; a job that was handed in stays.
    Delete {
        /// Its name.
        #[arg(value_parser = name)]
        name: GroupId,
    },
}

#[derive(Debug, Args)]
struct Add {
    /// Its name; its jobs are called NAME-YYMMDDhhmm.
    #[arg(value_parser = name)]
    name: GroupId,

    /// The job, in JSON or Lua; `-`: standard input.
    #[arg(value_name = "FILE|-", required_unless_present = "template")]
    file: Option<PathBuf>,

    /// The job is this template, filled in now.
    #[arg(long, conflicts_with = "file", value_parser = name)]
    template: Option<GroupId>,

    /// What stands for ${NAME}; may be given several times.
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = setting)]
    settings: Vec<(String, String)>,

    /// Node, or pattern with `*` or `$*`.
    #[arg(long, value_name = "PATTERN", value_parser = pattern, required_unless_present = "label")]
    node: Option<String>,

    /// Label: a job for each node that has it and is alive.
    #[arg(long, conflicts_with = "node", value_parser = name)]
    label: Option<GroupId>,

    /// Time from one to the next: 90s, 10m, 2h, 1d; a minute at least.
    #[arg(long, value_name = "TIME", value_parser = every, required_unless_present = "daily")]
    every: Option<u64>,

    /// At this time of day, in UTC: 05:00.
    #[arg(long, value_name = "hh:mm", conflicts_with = "every")]
    daily: Option<String>,

    /// The first time, in UTC: 2026-11-22T03:00:00Z [default: one --every from now].
    #[arg(long, value_name = "TIME", value_parser = crate::args::instant)]
    from: Option<keys::FleetMicros>,
}

#[derive(Deserialize)]
struct Named<T> {
    name: GroupId,
    #[serde(flatten)]
    kept: T,
}

fn name(text: &str) -> Result<GroupId, String> {
    GroupId::new(text).map_err(|error| error.to_string())
}

/// Reads `10m`; returns seconds.
fn every(text: &str) -> Result<u64, String> {
    let wrong = || format!("{text:?}: a number and s, m, h or d: 10m");
    let unit = match text.chars().next_back() {
        Some('s') => 1,
        Some('m') => 60,
        Some('h') => 3_600,
        Some('d') => 86_400,
        _ => return Err(wrong()),
    };
    let count: u64 = text[..text.len() - 1].parse().map_err(|_| wrong())?;
    Some(count.saturating_mul(unit))
        .filter(|every_s| (60..=366 * 86_400).contains(every_s))
        .ok_or_else(|| "a minute at least, a year at most".to_owned())
}

const fn word(format: Format) -> &'static str {
    match format {
        Format::Json => "json",
        Format::Lua => "lua",
        Format::Gcode => "gcode",
    }
}

/// Asks for something that is kept; `None`: it was refused, and has been told.
async fn ask(
    link: &Link,
    kind: &str,
    name: &str,
    wish: Option<Value>,
) -> Result<Option<Vec<Vec<u8>>>, Failure> {
    let key = format!("{}/manage/{kind}/{name}", link.keys().prefix());
    let payload = wish.map(|wish| (wish.to_string().into_bytes(), Encoding::APPLICATION_JSON));
    let (payloads, refused) = accepted(link.get(&key, payload).await?);
    Ok((!refused).then_some(payloads))
}

/// Changes something and says so.
async fn change(
    link: &Link,
    kind: &str,
    name: &GroupId,
    wish: &impl Serialize,
    done: &str,
    json: bool,
) -> Result<(), Failure> {
    let wish = serde_json::to_value(wish).map_err(anyhow::Error::from)?;
    let Some(payloads) = ask(link, kind, name.as_str(), Some(wish)).await? else {
        return verdict(true);
    };
    match payloads.first() {
        Some(payload) if json => show::json_line(payload),
        Some(payload) if kind == "schedule" => {
            let next = read::<Named<Schedule>>(payload)?.kept.next();
            show::line(&format!("{kind} {name} {done}; next at {next}"));
        }
        _ => show::line(&format!("{kind} {name} {done}")),
    }
    Ok(())
}

/// Returns a template as a job that is written.
pub(crate) async fn template(link: &Link, name: &GroupId) -> Result<Written, Failure> {
    let payloads = ask(link, "template", name.as_str(), None).await?;
    let Some(payload) = payloads.as_ref().and_then(|payloads| payloads.first()) else {
        return Err(Failure::Failed(None));
    };
    let kept = read::<Named<Template>>(payload)?.kept;
    let format = match kept.format.as_str() {
        "lua" => Format::Lua,
        "gcode" => Format::Gcode,
        _ => Format::Json,
    };
    Ok(Written {
        name: format!("template {name}"),
        text: kept.text.into_bytes(),
        format,
    })
}

/// `fleet template`
pub(crate) async fn templates(link: &Link, line: &Templates, json: bool) -> Result<(), Failure> {
    match &line.act {
        TemplateAct::Put {
            name,
            file,
            about,
            format,
        } => {
            let written = Written::read(file, *format)?;
            let format = word(written.format).to_owned();
            let text = std::str::from_utf8(&written.text);
            let template = Template {
                text: text.map_err(|error| written.wrong(error))?.to_owned(),
                format,
                about: about.clone(),
            };
            change(link, "template", name, &template, "kept", json).await
        }
        TemplateAct::Delete { name } => {
            let wish = json!({ "remove": true });
            change(link, "template", name, &wish, "deleted", json).await
        }
        TemplateAct::Show { name } => {
            let written = template(link, name).await?;
            show::line(String::from_utf8_lossy(&written.text).trim_end());
            Ok(())
        }
        TemplateAct::List => {
            let Some(payloads) = ask(link, "template", "*", None).await? else {
                return verdict(true);
            };
            if json {
                payloads.iter().for_each(|payload| show::json_line(payload));
                return Ok(());
            }
            let mut table = show::table(&["template", "format", "values", "about"]);
            for payload in &payloads {
                let kept: Named<Template> = read(payload)?;
                let Template {
                    text,
                    format,
                    about,
                } = kept.kept;
                let values = values_of(&text).join(" ");
                table.add_row(vec![kept.name.to_string(), format, values, about]);
            }
            none_or(table, payloads.is_empty(), "no templates")
        }
    }
}

/// `fleet schedule`
pub(crate) async fn schedules(link: &Link, line: &Schedules, json: bool) -> Result<(), Failure> {
    match &line.act {
        ScheduleAct::Add(add) => {
            let mut written = match (&add.template, &add.file) {
                (Some(name), _) => template(link, name).await?,
                (None, Some(file)) => Written::read(file, None)?,
                (None, None) => unreachable!("the command line needs one of them"),
            };
            written.fill_in(&add.settings, add.template.is_some())?;
            let job = written.json()?.ok_or_else(|| {
                written.wrong("a schedule has a job in JSON: `fleet check --commands` makes one")
            })?;
            let target = match (&add.node, &add.label) {
                (Some(node), _) => node.clone(),
                (None, label) => label.map(|label| format!("@{label}")).unwrap_or_default(),
            };
            let wish = json!({
                "target": target,
                "job": job,
                "every_s": add.every,
                "daily": add.daily,
                "from": add.from.map(|from| from.to_string()),
            });
            change(link, "schedule", &add.name, &wish, "kept", json).await
        }
        ScheduleAct::Delete { name } => {
            let wish = json!({ "remove": true });
            change(link, "schedule", name, &wish, "deleted", json).await
        }
        ScheduleAct::List => {
            let Some(payloads) = ask(link, "schedule", "*", None).await? else {
                return verdict(true);
            };
            if json {
                payloads.iter().for_each(|payload| show::json_line(payload));
                return Ok(());
            }
            let heads = ["schedule", "for", "every", "next", "done", "missed", "last"];
            let mut table = show::table(&heads);
            for payload in &payloads {
                let kept: Named<Schedule> = read(payload)?;
                let schedule = kept.kept;
                table.add_row(vec![
                    kept.name.to_string(),
                    schedule.target.replace('@', "label "),
                    time(schedule.every_s),
                    schedule.next().to_string(),
                    schedule.done.to_string(),
                    schedule.missed.to_string(),
                    schedule.last.unwrap_or_default(),
                ]);
            }
            none_or(table, payloads.is_empty(), "no schedules")
        }
    }
}

fn none_or(table: comfy_table::Table, is_empty: bool, words: &str) -> Result<(), Failure> {
    if is_empty {
        show::line(words);
    } else {
        show::print(table);
    }
    Ok(())
}

/// Returns the names in `${…}`, each once.
fn values_of(text: &str) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for behind in text.split("${").skip(1) {
        if let Some((name, _)) = behind.split_once('}')
            && !names.contains(&name)
        {
            names.push(name);
        }
    }
    names
}

fn time(every_s: u64) -> String {
    let units = [(86_400, "d"), (3_600, "h"), (60, "m")];
    let unit = units
        .into_iter()
        .find(|(unit_s, _)| every_s.is_multiple_of(*unit_s));
    match unit {
        Some((unit_s, word)) => format!("{}{word}", every_s / unit_s),
        None => format!("{every_s}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_typed_and_shown_in_the_same_way() {
        for text in ["10m", "2h", "1d", "90s"] {
            assert_eq!(every(text).map(time).as_deref(), Ok(text));
        }
        for bad in ["", "m", "10", "59s", "367d", "-1m", "1µ"] {
            assert!(every(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_values_of_a_template_are_listed_once() {
        assert_eq!(values_of("G1 X${x} Z${depth} X${x} ${"), ["x", "depth"]);
    }
}
