//! Files that the operator reads and writes: on a thread of their own each, so that the window
//! draws on. What belongs to a panel alone is a wish in its view, and [`Files::serve`] does it once
//! a frame; what the model shall know is a request, and [`Files::ask`] does it.

use crate::{
    export,
    message::{FileOutcome, Message},
    model::{
        Model,
        capture::{self, Capture},
    },
    panels::{chooser::Listing, node::Export},
    recording::{
        self, Recording,
        session::{Session, Wish},
    },
    request::{Request, Ticket},
    view::View,
};
use keys::FleetMicros;
use std::{
    fs::File,
    io::{Read as _, Write as _},
    path::Path,
    sync::{
        Arc,
        mpsc::{Receiver, Sender, channel},
    },
    thread::JoinHandle,
};

/// Works that run at the same time; more are refused.
const WORKS_MAX: usize = 8;

/// Entries of a folder that are listed.
const ENTRIES_MAX: usize = 5_000;

/// What became of a file.
enum Done {
    /// A capture was read.
    Capture(String, Result<Arc<Capture>, String>),
    /// A recording was read.
    Recording(String, Result<Recording, String>),
    /// A plot was written to this file.
    Export(Result<String, String>),
    /// A folder was read.
    Folder(Result<Listing, String>),
    /// What was asked for by a request.
    Asked(Ticket, FileOutcome),
}

/// See the module.
pub struct Files {
    results: Receiver<Done>,
    of_works: Sender<Done>,
    works: Vec<JoinHandle<()>>,
}

impl Default for Files {
    fn default() -> Self {
        let (of_works, results) = channel();
        Self {
            results,
            of_works,
            works: Vec::new(),
        }
    }
}

impl Files {
    /// Begins what the panels want and hands over what is done. Returns what the model is to be
    /// told.
    pub fn serve(
        &mut self,
        ctx: &egui::Context,
        live: &Model,
        session: &mut Session,
        view: &mut View,
    ) -> Vec<Message> {
        for file in ctx.input(|input| input.raw.dropped_files.clone()) {
            let path = file.path();
            if is_capture(path) {
                view.pulses.path = path.display().to_string();
                view.pulses.open_wanted = true;
                view.tab = crate::view::Tab::Pulses;
            }
        }
        if std::mem::take(&mut view.pulses.open_wanted) {
            let path = view.pulses.path.trim().to_owned();
            view.pulses.opening();
            let failed = view.pulses.path.clone();
            let begun = self.begin(ctx, move || {
                let capture = read_text(Path::new(&path), capture::BYTES_MAX)
                    .and_then(|text| Capture::parse(&path, &text));
                Done::Capture(path, capture.map(Arc::new))
            });
            if let Err(why) = begun {
                view.pulses.opened(failed, Err(why));
            }
        }
        if let Some(folder) = view.chooser.wanted.take() {
            let begun = self.begin(ctx, move || Done::Folder(list(&folder)));
            if let Err(why) = begun {
                view.chooser.listed(Err(why));
            }
        }
        session.play(live.now());
        let shown = session.replay().map_or(live, |replay| replay.model());
        self.export(ctx, shown, view);
        match view.recording.wish.take() {
            Some(Wish::Record(path)) => session.record(&path, live),
            Some(Wish::EndRecord) => session.end_record(),
            Some(Wish::Open(path)) => {
                let failed = path.clone();
                let begun = self.begin(ctx, move || {
                    let text = read_text(Path::new(&path), recording::BYTES_MAX);
                    let recording = text.and_then(|text| Recording::parse(&text));
                    Done::Recording(path, recording)
                });
                if let Err(why) = begun {
                    session.opened(failed, Err(why));
                }
            }
            Some(Wish::EndReplay) => {
                session.end_replay();
                // What was chosen in the past is not what is chosen now.
                view.selection.clear();
                view.stop.releasing = None;
            }
            Some(Wish::Seek(at)) => session.seek(at),
            Some(Wish::Speed(speed)) => session.set_speed(speed),
            None => {}
        }
        self.works.retain(|work| !work.is_finished());
        let mut told = Vec::new();
        while let Ok(done) = self.results.try_recv() {
            match done {
                Done::Capture(path, capture) => view.pulses.opened(path, capture),
                Done::Folder(listing) => view.chooser.listed(listing),
                Done::Export(written) => view.node.exported = Some(written),
                Done::Recording(path, recording) => {
                    session.opened(path, recording);
                    view.selection.clear();
                    view.stop.releasing = None;
                }
                Done::Asked(ticket, outcome) => told.push(Message::File { ticket, outcome }),
            }
        }
        told
    }

    /// Begins what a request about a file asks for. Returns whether it was one.
    pub fn ask(&mut self, ctx: &egui::Context, ticket: Ticket, request: &Request) -> bool {
        let begun = match request {
            Request::ReadFile { path } => {
                let path = path.clone();
                self.begin(ctx, move || Done::Asked(ticket, read_job(&path)))
            }
            Request::WriteFile { path, text } => {
                let (path, text) = (path.clone(), text.clone());
                self.begin(ctx, move || Done::Asked(ticket, write_job(&path, &text)))
            }
            _ => return false,
        };
        if let Err(why) = begun {
            let failed = Done::Asked(ticket, FileOutcome::Failed(why));
            self.of_works.send(failed).expect("this end is kept too");
        }
        true
    }

    /// Makes a file of a plot, if that is wanted.
    fn export(&mut self, ctx: &egui::Context, shown: &Model, view: &mut View) {
        let Some(export) = view.node.export.take() else {
            return;
        };
        view.node.exported = None;
        let Some(node) = view.focus.and_then(|id| shown.node(&id)) else {
            return;
        };
        let page = view.node.page;
        let at = FleetMicros(shown.now().0).to_string();
        // Neither colons, for other systems, nor fractions of a second.
        let at: String = at.chars().take(19).filter(|c| *c != ':').collect();
        let name = format!("{}-{}-{at}", node.id(), page.title().to_lowercase());
        let path = Path::new(view.node.folder.trim()).join(name);
        let begun = match export {
            Export::Csv => {
                let path = path.with_extension("csv");
                // At most a thousand lines and a half: quicker made than copied.
                let text = export::csv(node, page).unwrap_or_default();
                self.begin(ctx, move || Done::Export(write_new(&path, text.as_bytes())))
            }
            Export::Png(region) => {
                let (path, of_work) = (path.with_extension("png"), self.of_works.clone());
                let (scale, waker) = (ctx.pixels_per_point(), ctx.clone());
                ctx.request_screenshot(move |image| {
                    let picture = export::png(&image.region(&region, Some(scale)));
                    let written = picture.and_then(|bytes| write_new(&path, &bytes));
                    // Without a receiver the window is gone.
                    let _ = of_work.send(Done::Export(written));
                    waker.request_repaint();
                });
                Ok(())
            }
        };
        if let Err(why) = begun {
            view.node.exported = Some(Err(why));
        }
    }

    /// Waits until everything that was begun is done; the next [`Files::serve`] hands it over.
    pub fn wait(&mut self) {
        for work in self.works.drain(..) {
            // A panic in there has been printed, and nothing comes of it.
            let _ = work.join();
        }
    }

    fn begin(
        &mut self,
        ctx: &egui::Context,
        work: impl FnOnce() -> Done + Send + 'static,
    ) -> Result<(), String> {
        if self.works.len() >= WORKS_MAX {
            return Err("too many files are being read or written".to_owned());
        }
        let (of_work, ctx) = (self.of_works.clone(), ctx.clone());
        let thread = std::thread::Builder::new().name("file".to_owned());
        let begun = thread.spawn(move || {
            // Without a receiver the window is gone.
            let _ = of_work.send(work());
            ctx.request_repaint();
        });
        self.works.push(begun.map_err(|error| error.to_string())?);
        Ok(())
    }
}

/// Returns whether a file is a dump or capture of pins, by its name.
pub fn is_capture(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension
        .is_some_and(|extension| matches!(extension.to_ascii_lowercase().as_str(), "vcd" | "csv"))
}

/// Returns what is in a folder, without what is hidden.
fn list(folder: &Path) -> Result<Listing, String> {
    let fail = |error: std::io::Error| format!("{}: {error}", folder.display());
    let full = folder.canonicalize().map_err(fail)?;
    let mut listing = Listing::default();
    for entry in full.read_dir().map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') {
            continue;
        }
        if listing.folders.len() + listing.files.len() >= ENTRIES_MAX {
            listing.cut = true;
            break;
        }
        // What a link leads to counts.
        match entry.path().is_dir() {
            true => listing.folders.push(name),
            false => listing.files.push(name),
        }
    }
    listing.folders.sort_unstable();
    listing.files.sort_unstable();
    listing.folder = full;
    Ok(listing)
}

/// Reads a job's text.
fn read_job(path: &str) -> FileOutcome {
    match read_text(Path::new(path), keys::job::JOB_BYTES_MAX as u64) {
        Err(why) => FileOutcome::Failed(format!("{path}: {why}")),
        Ok(text) => FileOutcome::Read {
            path: path.to_owned(),
            text,
        },
    }
}

/// Writes a new file and tells its name in full.
fn write_job(path: &str, text: &str) -> FileOutcome {
    match write_new(Path::new(path), text.as_bytes()) {
        Err(why) => FileOutcome::Failed(why),
        Ok(path) => {
            let full = std::fs::canonicalize(&path).map(|full| full.display().to_string());
            FileOutcome::Written {
                path: full.unwrap_or(path),
            }
        }
    }
}

/// Writes a file that does not exist yet and returns its name.
fn write_new(path: &Path, bytes: &[u8]) -> Result<String, String> {
    let name = path.display();
    let fail = |error: std::io::Error| format!("{name}: {error}");
    let mut file = File::create_new(path).map_err(fail)?;
    file.write_all(bytes).map_err(fail)?;
    Ok(name.to_string())
}

/// Reads a text file of at most so many bytes.
fn read_text(path: &Path, bytes_max: u64) -> Result<String, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let mut text = String::new();
    // A file may grow while it is read, and some have no length.
    let mut bounded = file.take(bytes_max + 1);
    let read = bounded.read_to_string(&mut text);
    read.map_err(|error| error.to_string())?;
    if text.len() as u64 > bytes_max {
        return Err(format!("larger than {} MiB", bytes_max >> 20));
    }
    Ok(text)
}
