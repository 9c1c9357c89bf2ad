//! A file is chosen from the folders of this computer, with the keyboard or the mouse.

use crate::{
    fixture::fleet,
    screen::{button, do_files, picture_of, show, shows},
};
use dashboard::{
    panels::chooser::{Listing, Purpose},
    view::Tab,
};
use egui::{Key, Modifiers};

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
