//! A file is chosen from the folders of this computer, with the keyboard or the mouse.

use crate::{
    fixture::fleet,
    screen::{Window, button, do_files, picture_of, show, shows},
};
use dashboard::{
    panels::chooser::{Listing, Purpose},
    view::Tab,
};
use egui::{Key, Modifiers, Role};
use egui_kittest::kittest::Queryable as _;

#[test]
fn a_job_is_found_two_folders_deep_and_opened() {
    let home = tempfile::tempdir().expect("a folder");
    let jobs = home.path().join("jobs");
    std::fs::create_dir(&jobs).expect("made");
    std::fs::write(jobs.join("square.json"), "{\"commands\":[]}").expect("written");
    std::fs::write(jobs.join("notes.txt"), "no job").expect("written");
    std::fs::write(jobs.join(".hidden.json"), "").expect("written");
    let mut dashboard = fleet();
    dashboard.view.tab = Tab::Compose;
    dashboard.view.composer.file = home.path().join("x.json").display().to_string();
    let mut window = show(dashboard);
    button(&mut window, "Choose job…");
    do_files(&mut window);
    assert!(shows(&window, "no file that ends in .json or .lua"));
    button(&mut window, "Folder jobs");
    do_files(&mut window);
    assert!(!shows(&window, "notes.txt") && !shows(&window, "hidden"));
    button(&mut window, "Folder above");
    do_files(&mut window);
    button(&mut window, "Folder jobs");
    do_files(&mut window);
    button(&mut window, "File square.json");
    do_files(&mut window);
    let composer = &window.state().view.composer;
    assert_eq!(composer.text, "{\"commands\":[]}");
    assert!(composer.file.ends_with("square.json"));
    assert!(!shows(&window, "Folder above"), "it is closed");
}

#[test]
fn a_new_file_gets_a_name_that_is_not_there_yet() {
    let home = tempfile::tempdir().expect("a folder");
    std::fs::write(home.path().join("monday.jsonl"), "").expect("written");
    let mut dashboard = fleet();
    dashboard.view.tab = Tab::Recording;
    dashboard.view.recording.record_path = home.path().join("monday.jsonl").display().to_string();
    let mut window = show(dashboard);
    button(&mut window, "Choose where…");
    do_files(&mut window);
    assert!(shows(&window, "it is there already"));
    let take = |window: &mut Window| button(window, "Take this name");
    take(&mut window);
    assert!(shows(&window, "Folder above"), "nothing was taken");
    window
        .get_by_role_and_label(Role::TextInput, "Name")
        .click();
    window.run_steps(2);
    window.key_press_modifiers(Modifiers::COMMAND, Key::A);
    window.run_steps(2);
    window
        .get_by_role_and_label(Role::TextInput, "Name")
        .type_text("tuesday.jsonl");
    window.run_steps(2);
    take(&mut window);
    let path = &window.state().view.recording.record_path;
    assert_eq!(
        path,
        &home.path().join("tuesday.jsonl").display().to_string()
    );
    assert!(!shows(&window, "Folder above"), "it is closed");
}

#[test]
fn the_history_is_exported_into_a_file_that_was_chosen() {
    let home = tempfile::tempdir().expect("a folder");
    let mut dashboard = fleet();
    dashboard.view.jobs.export = home.path().join("week.csv").display().to_string();
    let mut window = show(dashboard);
    button(&mut window, "Choose where to export");
    do_files(&mut window);
    button(&mut window, "Take this name");
    button(&mut window, "Export CSV");
    do_files(&mut window);
    assert!(home.path().join("week.csv").is_file());
}

#[test]
fn a_folder_that_cannot_be_read_says_why_and_escape_closes() {
    let mut dashboard = fleet();
    dashboard
        .view
        .chooser
        .open(Purpose::Capture, "/nowhere/at/all.vcd");
    let mut window = show(dashboard);
    do_files(&mut window);
    assert!(shows(&window, "✖ /nowhere/at: No such file"));
    window.key_press_modifiers(Modifiers::NONE, Key::Escape);
    window.run_steps(2);
    assert!(!shows(&window, "Where the program was started"));
}

#[test]
fn picture_of_the_choice_of_a_file() {
    picture_of("chooser", || {
        let mut dashboard = fleet();
        dashboard.view.tab = Tab::Recording;
        dashboard.view.chooser.open(Purpose::Recording, "");
        dashboard.view.chooser.wanted = None;
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        dashboard.view.chooser.listed(Ok(Listing {
            folder: "/home/operator/stepfleet".into(),
            folders: names(&["captures", "jobs"]),
            files: names(&["monday.jsonl", "tuesday.jsonl", "notes.txt"]),
            cut: false,
        }));
        dashboard
    });
}
