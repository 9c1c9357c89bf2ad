//! A file to be opened or written, chosen from the folders of this computer. In this window, because it then
//! works with keyboard and screen reader wherever the window itself does; the desktop's own dialog
//! needs a portal on the session's bus, which a panel computer or a remote display does not have. A
//! file can also be typed, or dropped onto the window.

use crate::{
    recording::session::Wish,
    request::Requests,
    theme::{self, Tone},
    view::{Tab, View},
};
use egui::{Role, ScrollArea, Ui};
use std::path::{Path, PathBuf};

/// What the file is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A job's text.
    Job,
    /// Recorded pins.
    Capture,
    /// A recorded session.
    Recording,
    /// A new recording of the session.
    NewRecording,
    /// A new file for the history of jobs.
    NewHistory,
}

impl Purpose {
    /// Returns how the names of such files end.
    const fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Job => &["json", "lua"],
            Self::Capture => &["vcd", "csv"],
            Self::Recording | Self::NewRecording => &["jsonl"],
            Self::NewHistory => &["csv", "json"],
        }
    }

    const fn title(self) -> &'static str {
        match self {
            Self::Job => "Open a job (.json, .lua)",
            Self::Capture => "Open a capture (.vcd, .csv)",
            Self::Recording => "Open a recording (.jsonl)",
            Self::NewRecording => "Record into a new file (.jsonl)",
            Self::NewHistory => "Export into a new file (.csv, .json)",
        }
    }

    /// Returns the name that a new file has until the operator gives another one; `None`: a file is
    /// opened.
    const fn new_name(self) -> Option<&'static str> {
        match self {
            Self::Job | Self::Capture | Self::Recording => None,
            Self::NewRecording => Some("session.jsonl"),
            Self::NewHistory => Some("jobs.csv"),
        }
    }

    /// Returns whether a file of this name is shown.
    fn fits(self, name: &str) -> bool {
        let extension = Path::new(name).extension();
        let extension = extension.map(|extension| extension.to_string_lossy().to_lowercase());
        extension.is_some_and(|extension| self.extensions().contains(&extension.as_str()))
    }
}

/// What is in a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Listing {
    /// The folder, in full.
    pub folder: PathBuf,
    /// Folders in it, by name.
    pub folders: Vec<String>,
    /// Files in it, by name.
    pub files: Vec<String>,
    /// There are more than are listed.
    pub cut: bool,
}

/// What the panel remembers.
#[derive(Clone, Debug, Default)]
pub struct ChooserView {
    purpose: Option<Purpose>,
    /// The folder that is to be read.
    pub wanted: Option<PathBuf>,
    listing: Option<Result<Listing, String>>,
    /// The name of a new file, as typed.
    name: String,
}

impl ChooserView {
    /// Begins in the folder of this file, or where the program was started.
    pub fn open(&mut self, purpose: Purpose, file: &str) {
        let file = Path::new(file.trim());
        let name = file.file_name().map(|name| name.to_string_lossy());
        let name = name.filter(|_| purpose.new_name().is_some());
        self.name = name.map_or(
            purpose.new_name().unwrap_or_default().to_owned(),
            Into::into,
        );
        let folder = file.parent();
        let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
        self.purpose = Some(purpose);
        self.go(folder.unwrap_or(Path::new(".")).to_owned());
    }

    /// Takes what is in a folder.
    pub fn listed(&mut self, listing: Result<Listing, String>) {
        self.listing = Some(listing);
    }

    /// Closes it and returns whether it was open.
    pub fn close(&mut self) -> bool {
        self.purpose.take().is_some()
    }

    fn go(&mut self, folder: PathBuf) {
        self.wanted = Some(folder);
        self.listing = None;
    }
}

/// Shows the folder, if a file is to be chosen.
pub fn chooser_ui(ui: &Ui, view: &mut View, requests: &mut Requests) {
    let Some(purpose) = view.chooser.purpose else {
        return;
    };
    let mut open = true;
    let mut chosen = None;
    theme::window(ui.ctx(), purpose.title())
        .id(egui::Id::unique("chooser"))
        .default_size([440.0, 320.0])
        .open(&mut open)
        .show(ui.ctx(), |ui| match view.chooser.listing.clone() {
            None => {
                ui.label("⌛ reading…");
            }
            Some(Err(why)) => {
                ui.label(theme::toned(ui, Tone::Bad, format!("✖ {why}")));
                if ui.button("Where the program was started").clicked() {
                    view.chooser.go(PathBuf::from("."));
                }
            }
            Some(Ok(listing)) => {
                if purpose.new_name().is_some() {
                    chosen = new_file_ui(ui, &listing, view);
                    ui.separator();
                }
                let clicked = listing_ui(ui, purpose, &listing, view);
                match (clicked, purpose.new_name()) {
                    // A file that is there is never written over; its name is a beginning.
                    (Some(there), Some(_)) => {
                        let name = there.file_name().unwrap_or_default();
                        view.chooser.name = name.to_string_lossy().into_owned();
                    }
                    (Some(there), None) => chosen = Some(there),
                    (None, _) => {}
                }
            }
        });
    if let Some(path) = chosen {
        let path = path.display().to_string();
        match purpose {
            Purpose::Job => {
                view.tab = Tab::Compose;
                view.composer.open_file(path, requests);
            }
            Purpose::Capture => {
                view.pulses.path = path;
                view.pulses.open_wanted = true;
            }
            Purpose::Recording => {
                view.recording.open_path.clone_from(&path);
                view.recording.wish = Some(Wish::Open(path));
            }
            Purpose::NewRecording => view.recording.record_path = path,
            Purpose::NewHistory => view.jobs.export = path,
        }
        open = false;
    }
    if !open {
        view.chooser.close();
    }
}

/// Shows a field for a new file's name and returns the file when it is taken.
fn new_file_ui(ui: &mut Ui, listing: &Listing, view: &mut View) -> Option<PathBuf> {
    let mut taken = None;
    ui.horizontal(|ui| {
        let label = ui.label("Name");
        let edit = egui::TextEdit::singleline(&mut view.chooser.name).desired_width(200.0);
        ui.add(edit).labelled_by(label.id);
        let name = view.chooser.name.trim();
        let there = listing.files.iter().any(|file| file == name)
            || listing.folders.iter().any(|folder| folder == name);
        let fits = !name.is_empty() && !there && !name.contains(['/', '\\']);
        if ui
            .add_enabled(fits, egui::Button::new("Take this name"))
            .clicked()
        {
            taken = Some(listing.folder.join(name));
        }
        if there {
            let words = "✖ it is there already";
            ui.label(theme::toned(ui, Tone::Bad, words));
        }
    });
    taken
}

/// Shows what is in a folder and returns the file that was chosen.
fn listing_ui(
    ui: &mut Ui,
    purpose: Purpose,
    listing: &Listing,
    view: &mut View,
) -> Option<PathBuf> {
    ui.horizontal(|ui| {
        let above = listing.folder.parent();
        let up = ui.add_enabled(above.is_some(), egui::Button::new("⬆"));
        theme::named(&up, Role::Button, "Folder above");
        if let (true, Some(above)) = (up.clicked(), above) {
            view.chooser.go(above.to_owned());
        }
        let words = listing.folder.display().to_string();
        ui.add(egui::Label::new(words).truncate());
    });
    ui.separator();
    let files: Vec<&String> = listing
        .files
        .iter()
        .filter(|name| purpose.fits(name))
        .collect();
    if listing.cut {
        let words = "⚠ too much in here: not all of it is listed";
        ui.label(theme::toned(ui, Tone::Warn, words));
    }
    if files.is_empty() {
        let words = format!(
            "no file that ends in .{}",
            purpose.extensions().join(" or .")
        );
        ui.label(theme::toned(ui, Tone::Quiet, words));
    }
    let mut chosen = None;
    let height = ui.spacing().interact_size.y;
    let count = listing.folders.len() + files.len();
    ScrollArea::vertical()
        .auto_shrink(false)
        .show_rows(ui, height, count, |ui, rows| {
            for row in rows {
                let folder = listing.folders.get(row);
                let (icon, name) = match folder {
                    Some(folder) => ("▸", folder),
                    None => ("·", files[row - listing.folders.len()]),
                };
                let button = egui::Button::new(format!("{icon} {name}")).frame(false);
                let button = ui.add(button.truncate());
                let kind = if folder.is_some() { "Folder" } else { "File" };
                theme::named(&button, Role::Button, &format!("{kind} {name}"));
                if button.clicked() {
                    let path = listing.folder.join(name);
                    match folder {
                        Some(_) => view.chooser.go(path),
                        None => chosen = Some(path),
                    }
                }
            }
        });
    chosen
}
