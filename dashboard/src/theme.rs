//! All colours, sizes and icons. Colour never alone carries meaning: what has a tone has an icon and
//! a word too.

use crate::model::{
    alarms::Cause,
    node::{Concern, Presence},
};
use egui::{Color32, FontFamily, FontId, Response, RichText, Role, TextStyle, Ui, WidgetInfo};
use keys::record::{JobState, NodeWord};

/// Height of a row of a table, points.
pub const ROW_HEIGHT: f32 = 22.0;

/// Size of STOP ALL, points: large enough to hit without aiming.
pub const STOP_ALL_SIZE: egui::Vec2 = egui::vec2(190.0, 52.0);

/// Where STOP ALL ends, points below the top of the window.
pub const STOP_ALL_BOTTOM: f32 = STOP_ALL_SIZE.y + 20.0;

/// What a colour says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Nothing special.
    Plain,
    /// Of no interest now.
    Quiet,
    /// As it should be.
    Good,
    /// At work.
    Busy,
    /// Worth a look.
    Warn,
    /// Needs somebody.
    Bad,
}

/// Usual text, and text of no interest: apart at a glance, and both readable.
const PLAIN_DARK: Color32 = Color32::from_gray(225);
const PLAIN_LIGHT: Color32 = Color32::from_gray(20);
const QUIET_DARK: Color32 = Color32::from_gray(140);
const QUIET_LIGHT: Color32 = Color32::from_gray(105);

impl Tone {
    /// Returns the colour for text on the panels' background; contrast at least 4.5 : 1 in both
    /// themes.
    pub fn color(self, ui: &Ui) -> Color32 {
        let visuals = ui.visuals();
        let pick = |dark, light| if visuals.dark_mode { dark } else { light };
        match self {
            Self::Plain => visuals.text_color(),
            Self::Quiet => pick(QUIET_DARK, QUIET_LIGHT),
            Self::Good => pick(
                Color32::from_rgb(110, 200, 120),
                Color32::from_rgb(20, 110, 40),
            ),
            Self::Busy => pick(
                Color32::from_rgb(100, 180, 250),
                Color32::from_rgb(10, 90, 170),
            ),
            Self::Warn => pick(
                Color32::from_rgb(240, 190, 80),
                Color32::from_rgb(140, 85, 0),
            ),
            Self::Bad => pick(
                Color32::from_rgb(255, 120, 110),
                Color32::from_rgb(180, 20, 20),
            ),
        }
    }
}

/// The colours of one axis after the other in plots; told apart also by the legend's names.
pub fn axis_color(ui: &Ui, axis: usize) -> Color32 {
    const DARK: [Color32; 6] = [
        Color32::from_rgb(100, 180, 250),
        Color32::from_rgb(250, 170, 90),
        Color32::from_rgb(130, 210, 130),
        Color32::from_rgb(230, 130, 200),
        Color32::from_rgb(210, 200, 110),
        Color32::from_rgb(180, 160, 250),
    ];
    const LIGHT: [Color32; 6] = [
        Color32::from_rgb(10, 90, 170),
        Color32::from_rgb(180, 80, 0),
        Color32::from_rgb(20, 120, 40),
        Color32::from_rgb(160, 30, 120),
        Color32::from_rgb(110, 100, 0),
        Color32::from_rgb(90, 60, 180),
    ];
    let colors = if ui.visuals().dark_mode { DARK } else { LIGHT };
    colors[axis % colors.len()]
}

/// Background of a button that stops.
pub const STOP_FILL: Color32 = Color32::from_rgb(190, 20, 20);

/// Text on [`STOP_FILL`].
pub const STOP_TEXT: Color32 = Color32::WHITE;

/// Icon, word and tone of a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Badge {
    /// One glyph.
    pub icon: &'static str,
    /// The word.
    pub word: &'static str,
    /// Its tone.
    pub tone: Tone,
}

impl Badge {
    const fn new(icon: &'static str, word: &'static str, tone: Tone) -> Self {
        Self { icon, word, tone }
    }

    /// Returns icon and word as text in the tone's colour.
    pub fn text(self, ui: &Ui) -> RichText {
        RichText::new(format!("{} {}", self.icon, self.word)).color(self.tone.color(ui))
    }

    /// Shows icon and word.
    pub fn show(self, ui: &mut Ui) -> Response {
        let text = self.text(ui);
        ui.label(text)
    }
}

/// Returns the badge of what a node does.
pub const fn node_badge(word: NodeWord) -> Badge {
    match word {
        NodeWord::Offline => Badge::new("○", "offline", Tone::Quiet),
        NodeWord::Idle => Badge::new("●", "idle", Tone::Good),
        NodeWord::Ready => Badge::new("⌛", "ready", Tone::Busy),
        NodeWord::Running => Badge::new("▶", "running", Tone::Busy),
        NodeWord::Paused => Badge::new("⏸", "paused", Tone::Warn),
        NodeWord::Stopped => Badge::new("⏹", "stopped", Tone::Bad),
        NodeWord::Fault => Badge::new("✖", "fault", Tone::Bad),
    }
}

/// Returns the badge of a reason to look at a node.
pub const fn concern_badge(concern: Concern) -> Badge {
    match concern {
        Concern::Fault => Badge::new("✖", "fault", Tone::Bad),
        Concern::Lost => Badge::new("⚠", "lost", Tone::Bad),
        Concern::Stopped => Badge::new("⏹", "stopped", Tone::Bad),
        Concern::Silent => Badge::new("⚠", "silent", Tone::Warn),
    }
}

/// Returns the badge of what raised an alarm.
pub const fn alarm_badge(cause: Cause) -> Badge {
    match cause {
        Cause::Fault(_) => Badge::new("✖", "fault", Tone::Bad),
        Cause::Lost => Badge::new("⚠", "lost", Tone::Bad),
        Cause::Stopped => Badge::new("⏹", "stopped", Tone::Bad),
        Cause::Silent => Badge::new("⚠", "silent", Tone::Warn),
        Cause::Clock => Badge::new("⌚", "clock", Tone::Warn),
        Cause::Skew(_) => Badge::new("⚠", "skew", Tone::Warn),
        Cause::Link => Badge::new("✖", "link", Tone::Bad),
        Cause::Gateway => Badge::new("✖", "gateway", Tone::Bad),
    }
}

/// Returns the badge of a node's presence.
pub const fn presence_badge(presence: Presence) -> Badge {
    match presence {
        Presence::Alive => Badge::new("●", "alive", Tone::Good),
        Presence::Stale => Badge::new("⚠", "silent", Tone::Warn),
        Presence::Offline => Badge::new("○", "offline", Tone::Quiet),
    }
}

/// Returns the badge of a job's state.
pub const fn job_badge(state: JobState) -> Badge {
    match state {
        JobState::Queued => Badge::new("⌛", "queued", Tone::Plain),
        JobState::Sent => Badge::new("⬈", "sent", Tone::Busy),
        JobState::Running => Badge::new("▶", "running", Tone::Busy),
        JobState::Succeeded => Badge::new("✔", "succeeded", Tone::Good),
        JobState::Failed => Badge::new("✖", "failed", Tone::Bad),
        JobState::Canceled => Badge::new("⏹", "canceled", Tone::Warn),
        JobState::TimedOut => Badge::new("✖", "timed_out", Tone::Bad),
        JobState::Rejected => Badge::new("✖", "rejected", Tone::Bad),
        JobState::Lost => Badge::new("⚠", "lost", Tone::Bad),
    }
}

/// Returns text in a tone.
pub fn toned(ui: &Ui, tone: Tone, text: impl Into<String>) -> RichText {
    RichText::new(text).color(tone.color(ui))
}

/// Returns text about what was and may be no more: slanted too, because a colour alone is easily overlooked.
pub fn aged(ui: &Ui, text: RichText) -> RichText {
    text.color(Tone::Quiet.color(ui)).italics()
}

/// Gives a name, for screen readers and tests, to what has none by itself.
pub fn named(response: &Response, role: Role, name: &str) {
    let enabled = response.enabled();
    response.widget_info(|| WidgetInfo::labeled(role, enabled, name));
}

/// A button that stops something.
pub fn stop_button(text: &str) -> egui::Button<'static> {
    let text = RichText::new(text.to_owned()).color(STOP_TEXT).strong();
    egui::Button::new(text).fill(STOP_FILL)
}

/// Returns the height that a small window has below STOP ALL, points.
pub fn window_room(ctx: &egui::Context) -> f32 {
    (ctx.content_rect().height() - STOP_ALL_BOTTOM).max(0.0)
}

/// A small window over the panels. Wherever it is moved, it never covers STOP ALL.
pub fn window<'a>(ctx: &egui::Context, title: &'a str) -> egui::Window<'a> {
    let all = ctx.content_rect();
    let below = all.with_min_y((all.top() + STOP_ALL_BOTTOM).min(all.bottom()));
    egui::Window::new(title)
        .collapsible(false)
        .pivot(egui::Align2::CENTER_CENTER)
        .default_pos(below.center())
        .constrain_to(below)
}

/// Sets fonts, sizes of text and gaps, once.
pub fn apply(ctx: &egui::Context) {
    let mut fonts = egui::FontDefinitions::default();
    // The proportional fonts lack some icons of states; the monospaced one has them.
    let proportional = fonts.families.entry(FontFamily::Proportional).or_default();
    proportional.push("Hack".to_owned());
    ctx.set_fonts(fonts);
    for (theme, plain) in [
        (egui::Theme::Dark, PLAIN_DARK),
        (egui::Theme::Light, PLAIN_LIGHT),
    ] {
        ctx.style_mut_of(theme, |style| {
            style.visuals.widgets.noninteractive.fg_stroke.color = plain;
        });
    }
    ctx.all_styles_mut(|style| {
        style.text_styles = [
            (TextStyle::Small, 11.0, FontFamily::Proportional),
            (TextStyle::Body, 13.5, FontFamily::Proportional),
            (TextStyle::Button, 13.5, FontFamily::Proportional),
            (TextStyle::Heading, 18.0, FontFamily::Proportional),
            (TextStyle::Monospace, 12.5, FontFamily::Monospace),
        ]
        .map(|(style, size, family)| (style, FontId::new(size, family)))
        .into();
        style.spacing.item_spacing = egui::vec2(8.0, 4.0);
        style.spacing.button_padding = egui::vec2(8.0, 3.0);
        // A drag that ends in a table's cell shall not select the words in it.
        style.interaction.selectable_labels = false;
    });
}
