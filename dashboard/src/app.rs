//! Who calls whom, once a frame: what was heard into the model, the panels on the screen, what was
//! asked to the link.

use crate::{
    files::Files,
    keyboard::{self, Action},
    link::Link,
    message::{Message, Moment},
    model::Model,
    panels::{self, node::Page},
    recording::{replay::Replay, session::Session},
    request::{Request, Requests, Scope, Ticket},
    sound::Sound,
    theme,
    view::{Tab, View},
};
use egui::{CentralPanel, Panel, Ui};
use keys::StopMode;
use std::time::Duration;

/// Least time between two frames that messages cause: 20 frames a second are smooth for numbers.
pub const FRAME_EVERY: Duration = Duration::from_millis(50);

/// Longest time between two frames: ages grow without messages.
pub const FRAME_AT_LEAST_EVERY: Duration = Duration::from_secs(1);

/// Height of the lower panel until the operator changes it, and its least one, points.
const LOWER_DEFAULT: f32 = 230.0;
const LOWER_MIN: f32 = 90.0;

/// Where the view is kept between runs.
const VIEW_KEY: &str = "view";

/// The window without the window: model, view and what was asked. Tests drive this.
#[derive(Default)]
pub struct Dashboard {
    /// What is known.
    pub model: Model,
    /// What is looked at.
    pub view: View,
    /// What was asked and not yet handed over.
    pub requests: Requests,
    /// What is being read and written.
    pub files: Files,
    /// What is recorded and shown again.
    pub session: Session,
    /// What is heard of alarms, if that is wanted.
    pub sound: Sound,
}

impl Dashboard {
    /// Does what is due also while the window is hidden.
    pub fn logic(&mut self, ctx: &egui::Context) {
        panels::alarms::call(ctx, &self.model, &mut self.view, &mut self.sound);
    }

    /// Shows everything.
    pub fn ui(&mut self, ui: &mut Ui) {
        for action in keyboard::pressed(ui.ctx()) {
            self.act(action);
        }
        let Self {
            model,
            view,
            requests,
            files,
            session,
            sound,
        } = self;
        panels::composer::take_dropped(ui, view);
        let now = model.now();
        for message in files.serve(ui.ctx(), model, session, view) {
            session.heard(now, &message, model);
            model.apply(now, message);
            panels::composer::take_opened(model, &mut view.composer);
        }
        panels::composer::take_opened(model, &mut view.composer);
        Panel::top("top").show(ui, |ui| {
            panels::top::top_ui(ui, model, session, view, requests);
        });
        if panels::stop::is_shown(model, view) {
            Panel::top("stop").show(ui, |ui| panels::stop::stop_ui(ui, model, view, requests));
        }
        // Above are STOP ALL and its effect, which are always live.
        if let Some(replay) = session.replay() {
            Panel::top("replay").show(ui, |ui| {
                panels::recording::replay_ui(ui, session, model, view);
            });
            if replay.is_behind() {
                ui.ctx().request_repaint();
            } else if replay.speed > 0.0 {
                ui.ctx().request_repaint_after(FRAME_EVERY);
            }
        }
        // Of the fleet that is there: a recording has what was told then.
        if let Some(node) = view.focus.filter(|_| view.node.page == Page::Setup)
            && session.replay().is_none()
            && model.setup_is_due(&node)
            && !requests.holds(&Request::Setup { node })
        {
            requests.push(Request::Setup { node });
        }
        let model = session.replay().map_or(&*model, Replay::model);
        if model.jobs().is_counting_down(model.now()) {
            ui.ctx().request_repaint_after(FRAME_EVERY);
        }
        Panel::bottom("lower")
            .resizable(true)
            // On a small screen the fleet keeps more than half of the room.
            .default_size((ui.available_height() * 0.45).clamp(LOWER_MIN, LOWER_DEFAULT))
            .min_size(LOWER_MIN)
            .show(ui, |ui| {
                lower_ui(ui, model, session, sound, view, requests);
                // Else the panel would shrink to what is in it.
                ui.take_available_space();
            });
        Panel::left("groups")
            .resizable(true)
            .default_size(210.0)
            .show(ui, |ui| {
                panels::groups::groups_ui(ui, model, view, requests);
            });
        if view.focus.is_some() {
            Panel::right("node")
                .resizable(true)
                .default_size(400.0)
                .show(ui, |ui| panels::node::node_ui(ui, model, view, requests));
        }
        CentralPanel::default().show(ui, |ui| {
            panels::fleet::fleet_ui(ui, model, view);
        });
        panels::release::release_ui(ui, model, view, requests);
        panels::help::help_ui(ui, view);
        panels::chooser::chooser_ui(ui, view, requests);
        panels::composer::open_dropped(ui, view, requests);
    }

    /// Does what a key says.
    fn act(&mut self, action: Action) {
        let view = &mut self.view;
        match action {
            Action::StopAll => {
                let (scope, mode) = (Scope::All, StopMode::Halt);
                self.requests.push(Request::Stop { scope, mode });
            }
            Action::Help => view.help_open = !view.help_open,
            Action::Filter => view.fleet.take_focus = true,
            Action::Jobs => view.tab = Tab::Jobs,
            Action::Compose => {
                view.tab = Tab::Compose;
                view.composer.target_nodes(&view.selection);
            }
            Action::GroupJob => view.tab = Tab::GroupJob,
            Action::Pulses => view.tab = Tab::Pulses,
            Action::Recording => view.tab = Tab::Recording,
            Action::Alarms => view.tab = Tab::Alarms,
            Action::Timeline => view.tab = Tab::Timeline,
            Action::Log => view.tab = Tab::Log,
            Action::Close => {
                if view.help_open {
                    view.help_open = false;
                } else if view.chooser.close() {
                    // That was it.
                } else if view.stop.releasing.take().is_none() {
                    view.focus = None;
                }
            }
            Action::SelectAll => {
                let model = self.session.replay().map_or(&self.model, Replay::model);
                let shown = panels::fleet::shown(model, view);
                view.selection = shown.into_iter().map(|node| node.id()).collect();
            }
        }
    }

    /// Returns what was asked since the last call, after the model has been told at `now`.
    pub fn take_requests(&mut self, now: Moment) -> Vec<(Ticket, Request)> {
        let mut asked = self.requests.take();
        asked.retain(|(_, request)| self.session.lets_out(request));
        for (ticket, request) in &asked {
            let ticket = *ticket;
            let message = match request {
                Request::Stop { scope, mode } => Message::StopAsked {
                    ticket,
                    scope: scope.clone(),
                    mode: *mode,
                },
                Request::Release { scope } => Message::ReleaseAsked {
                    ticket,
                    scope: scope.clone(),
                },
                Request::Submit {
                    target,
                    text,
                    language,
                } => Message::JobAsked {
                    ticket,
                    language: *language,
                    target: target.to_string(),
                    payload: text.clone(),
                },
                Request::Order { node, order } => Message::OrderAsked {
                    ticket,
                    node: *node,
                    order: *order,
                },
                Request::Acknowledge { alarm } => Message::Acknowledged { alarm: *alarm },
                Request::Cancel { job } => Message::CancelAsked { ticket, job: *job },
                Request::Setup { node } => Message::SetupAsked {
                    ticket,
                    node: *node,
                },
                Request::Refresh
                | Request::Connect { .. }
                | Request::ReadFile { .. }
                | Request::WriteFile { .. } => continue,
            };
            self.hear(now, message);
        }
        asked
    }

    /// Takes what happened at this moment.
    pub fn hear(&mut self, at: Moment, message: Message) {
        self.session.heard(at, &message, &self.model);
        self.model.apply(at, message);
    }
}

fn lower_ui(
    ui: &mut Ui,
    model: &Model,
    session: &Session,
    sound: &mut Sound,
    view: &mut View,
    requests: &mut Requests,
) {
    ui.horizontal(|ui| {
        for tab in Tab::ALL {
            ui.selectable_value(&mut view.tab, tab, tab.title());
        }
    });
    ui.separator();
    // What each remembers of its own, such as where it was scrolled to, is not another one's.
    ui.push_id(view.tab.title(), |ui| match view.tab {
        Tab::Jobs => panels::jobs::jobs_ui(ui, model, view, requests),
        Tab::Compose => panels::composer::composer_ui(ui, model, view, requests),
        Tab::GroupJob => panels::group_job::group_job_ui(ui, model, view, requests),
        Tab::Alarms => panels::alarms::alarms_ui(ui, model, sound, view, requests),
        Tab::Timeline => panels::timeline::timeline_ui(ui, model, view),
        Tab::Log => panels::log::log_ui(ui, model, view),
        Tab::Pulses => panels::pulses::pulses_ui(ui, view),
        Tab::Recording => panels::recording::recording_ui(ui, session, view),
    });
}

/// The program in its window.
pub struct App {
    dashboard: Dashboard,
    link: Link,
}

impl App {
    /// Restores the view of the last run.
    pub fn new(creation: &eframe::CreationContext<'_>, link: Link) -> Self {
        theme::apply(&creation.egui_ctx);
        let stored = creation
            .storage
            .and_then(|storage| eframe::get_value(storage, VIEW_KEY));
        let dashboard = Dashboard {
            view: stored.unwrap_or_default(),
            ..Dashboard::default()
        };
        Self { dashboard, link }
    }
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &egui::Context, _frame: &mut eframe::Frame) {
        for (at, message) in self.link.heard() {
            self.dashboard.hear(at, message);
        }
        self.dashboard.model.tick(self.link.now());
        self.dashboard.logic(ctx);
        ctx.request_repaint_after(FRAME_AT_LEAST_EVERY);
    }

    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.dashboard.ui(ui);
        let asked = self.dashboard.take_requests(self.link.now());
        if !asked.is_empty() {
            ui.ctx().request_repaint();
        }
        for (ticket, request) in asked {
            let is_file = self.dashboard.files.ask(ui.ctx(), ticket, &request);
            if !is_file && !request.is_local() {
                self.link.ask(ticket, request);
            }
        }
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        eframe::set_value(storage, VIEW_KEY, &self.dashboard.view);
    }
}
