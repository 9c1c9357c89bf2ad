//! A file to be opened, chosen from the folders of this computer. In this window, because it then
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
}

impl Purpose {
    /// Returns how the names of such files end.
    const fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Job => &["json", "lua"],
            Self::Capture => &["vcd", "csv"],
            Self::Recording => &["jsonl"],
        }
    }

    const fn title(self) -> &'static str {
        match self {
            Self::Job => "Open a job (.json, .lua)",
            Self::Capture => "Open a capture (.vcd, .csv)",
            Self::Recording => "Open a recording (.jsonl)",
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
}

impl ChooserView {
    /// Begins in the folder of this file, or where the program was started.
    pub fn open(&mut self, purpose: Purpose, file: &str) {
        let folder = Path::new(file.trim()).parent();
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
            Some(Ok(listing)) => chosen = listing_ui(ui, purpose, &listing, view),
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
        }
        open = false;
    }
    if !open {
        view.chooser.close();
    }
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
