//! The keys that act, in one table. Typing never triggers anything: a plain character acts only
//! while no text field has the focus.

use egui::{Context, Event, Key, Modifiers};

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Stop the whole fleet, at once.
    StopAll,
    /// Show or hide this table.
    Help,
    /// Type into the filter of the fleet.
    Filter,
    /// Show the jobs.
    Jobs,
    /// Show the composer.
    Compose,
    /// Show the editor of synchronized jobs.
    GroupJob,
    /// Show the alarms.
    Alarms,
    /// Show what the nodes did over time.
    Timeline,
    /// Show the log.
    Log,
    /// Show the pulse inspector.
    Pulses,
    /// Show recording and replay.
    Recording,
    /// Close what is open: help, the question before a release, the node's page.
    Close,
    /// Select every node that is shown.
    SelectAll,
}

/// How an action is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stroke {
    /// This key with these modifiers, whatever has the focus.
    Key(Modifiers, Key),
    /// A typed character, while no text field has the focus.
    Plain(&'static str),
    /// This key, while no text field has the focus.
    PlainKey(Modifiers, Key),
}

/// Action, stroke, the stroke's name, what it does.
const TABLE: [(Action, Stroke, &str, &str); 15] = [
    (
        Action::StopAll,
        Stroke::Key(Modifiers::NONE, Key::F1),
        "F1",
        "STOP ALL: every node halts at once (a software stop)",
    ),
    (
        Action::StopAll,
        Stroke::Key(Modifiers::CTRL, Key::Space),
        "Ctrl+Space",
        "the same",
    ),
    (
        Action::Filter,
        Stroke::Key(Modifiers::COMMAND, Key::F),
        "Ctrl+F",
        "filter the fleet",
    ),
    (Action::Filter, Stroke::Plain("/"), "/", "the same"),
    (
        Action::SelectAll,
        Stroke::PlainKey(Modifiers::COMMAND, Key::A),
        "Ctrl+A",
        "select every node that is shown",
    ),
    (
        Action::Jobs,
        Stroke::Key(Modifiers::COMMAND, Key::J),
        "Ctrl+J",
        "show the jobs",
    ),
    (
        Action::Compose,
        Stroke::Key(Modifiers::COMMAND, Key::N),
        "Ctrl+N",
        "compose a job for the selection",
    ),
    (
        Action::GroupJob,
        Stroke::Key(Modifiers::COMMAND, Key::G),
        "Ctrl+G",
        "compose a job for several nodes that start together",
    ),
    (
        Action::Alarms,
        Stroke::Key(Modifiers::COMMAND, Key::M),
        "Ctrl+M",
        "show the alarms",
    ),
    (
        Action::Timeline,
        Stroke::Key(Modifiers::COMMAND, Key::T),
        "Ctrl+T",
        "show what the nodes did over time",
    ),
    (
        Action::Log,
        Stroke::Key(Modifiers::COMMAND, Key::L),
        "Ctrl+L",
        "show the log",
    ),
    (
        Action::Pulses,
        Stroke::Key(Modifiers::COMMAND, Key::P),
        "Ctrl+P",
        "show the pulse inspector",
    ),
    (
        Action::Recording,
        Stroke::Key(Modifiers::COMMAND, Key::R),
        "Ctrl+R",
        "show recording and replay",
    ),
    (
        Action::Close,
        Stroke::Key(Modifiers::NONE, Key::Escape),
        "Esc",
        "close what is open",
    ),
    (Action::Help, Stroke::Plain("?"), "?", "show these keys"),
];

/// Returns the name of each stroke and what it does, for the screen.
pub fn table() -> impl Iterator<Item = (&'static str, &'static str)> {
    TABLE.iter().map(|(_, _, name, does)| (*name, *does))
}

fn is_repeated_stroke(event: &Event) -> bool {
    let Event::Key {
        key,
        modifiers,
        pressed: true,
        repeat: true,
        ..
    } = event
    else {
        return false;
    };
    let is_it = |stroke: Stroke| match stroke {
        Stroke::Key(with, of) => of == *key && modifiers.matches_logically(with),
        Stroke::PlainKey(..) | Stroke::Plain(_) => false,
    };
    TABLE.iter().any(|(_, stroke, ..)| is_it(*stroke))
}

/// Returns what was called since the last frame, and takes the strokes away from everybody else.
pub fn pressed(ctx: &Context) -> Vec<Action> {
    let typing = ctx.text_edit_focused();
    ctx.input_mut(|input| {
        // A key that is held down repeats itself, which is no new wish.
        input.events.retain(|event| !is_repeated_stroke(event));
        let mut actions = Vec::new();
        for (action, stroke, _, _) in TABLE {
            let called = match stroke {
                Stroke::Key(modifiers, key) => input.consume_key(modifiers, key),
                Stroke::PlainKey(modifiers, key) => !typing && input.consume_key(modifiers, key),
                Stroke::Plain(character) => {
                    let is_it =
                        |event: &Event| matches!(event, Event::Text(text) if text == character);
                    let called = !typing && input.events.iter().any(is_it);
                    if called {
                        input.events.retain(|event| !is_it(event));
                    }
                    called
                }
            };
            if called && !actions.contains(&action) {
                actions.push(action);
            }
        }
        actions
    })
}
