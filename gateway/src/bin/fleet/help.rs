//! `fleet help`, `fleet completions`, `fleet man`: what can be read and typed.
//!
//! A topic is a page of text beside this file. Whatever is no topic is a command, whose own help is
//! printed.

use crate::{
    args::{Completions, Help, Line},
    link::Failure,
    show,
};
use clap::CommandFactory;

/// Name, subject and page.
pub(crate) const TOPICS: [(&str, &str, &str); 6] = [
    (
        "node",
        "add a node in five minutes",
        include_str!("help/node.txt"),
    ),
    (
        "stop",
        "stop, release and recovery",
        include_str!("help/stop.txt"),
    ),
    (
        "trouble",
        "from symptoms to causes",
        include_str!("help/trouble.txt"),
    ),
    (
        "client",
        "jobs from any zenoh client: shell, Python, Rust, C",
        include_str!("help/client.txt"),
    ),
    (
        "gcode",
        "which G-code is understood, and how",
        include_str!("help/gcode.txt"),
    ),
    (
        "service",
        "the gateway as a service: systemd, settings, logs, metrics",
        include_str!("help/service.txt"),
    ),
];

/// `fleet help`
pub(crate) fn help(help: &Help) -> Result<(), Failure> {
    let mut command = Line::command();
    let Some(topic) = &help.topic else {
        show::line(command.render_long_help().to_string().trim_end());
        show::line("\nTopics, by `fleet help TOPIC`:");
        for (name, subject, _) in TOPICS {
            show::line(&format!("  {name:<10} {subject}"));
        }
        return Ok(());
    };
    if let Some((_, _, page)) = TOPICS.iter().find(|(name, _, _)| name == topic) {
        show::line(page.trim_end());
        return Ok(());
    }
    // So that the common options are there, too.
    command.build();
    let Some(verb) = command.find_subcommand_mut(topic) else {
        let names: Vec<&str> = TOPICS.iter().map(|(name, _, _)| *name).collect();
        return Err(Failure::Usage(format!(
            "no topic and no command `{topic}`; topics are {}",
            names.join(", ")
        )));
    };
    show::line(verb.render_long_help().to_string().trim_end());
    Ok(())
}

/// `fleet completions`
pub(crate) fn completions(completions: &Completions) {
    let mut script = Vec::new();
    clap_complete::generate(
        completions.shell,
        &mut Line::command(),
        "fleet",
        &mut script,
    );
    show::line(String::from_utf8_lossy(&script).trim_end());
}

/// `fleet man`
pub(crate) fn man() -> Result<(), Failure> {
    let mut page = Vec::new();
    let mut write = |command: clap::Command| clap_mangen::Man::new(command).render(&mut page);
    let mut command = Line::command().disable_help_subcommand(true);
    command.build();
    write(command.clone())?;
    for verb in command.get_subcommands() {
        write(verb.clone())?;
    }
    show::line(String::from_utf8_lossy(&page).trim_end());
    Ok(())
}
