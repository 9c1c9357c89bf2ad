//! The editor of a job's text: in colours, what is wrong underlined.

use crate::{
    request::Language,
    syntax::{self, Kind},
    theme::Tone,
};
use egui::{Response, TextEdit, TextFormat, TextStyle, Ui, text::LayoutJob};
use std::ops::Range;

/// Shows a text to be edited, at least so many rows high, what is wrong with it at `place`.
pub(super) fn editor_ui(
    ui: &mut Ui,
    text: &mut String,
    language: Language,
    place: Option<&Range<usize>>,
    rows: usize,
) -> Response {
    let mut layouter = |ui: &Ui, text: &dyn egui::TextBuffer, width: f32| {
        let mut job = highlighted(ui, language, text.as_str(), place);
        job.wrap.max_width = width;
        ui.fonts_mut(|fonts| fonts.layout_job(job))
    };
    let edit = TextEdit::multiline(text)
        .code_editor()
        .layouter(&mut layouter)
        // The key Tab leads on; else the keyboard alone would never get out of here.
        .lock_focus(false)
        .desired_width(f32::INFINITY)
        .desired_rows(rows);
    ui.add(edit)
}

/// Returns the text in colours, what is wrong underlined.
fn highlighted(ui: &Ui, language: Language, text: &str, wrong: Option<&Range<usize>>) -> LayoutJob {
    let font = TextStyle::Monospace.resolve(ui.style());
    let format = |tone: Tone| TextFormat::simple(font.clone(), tone.color(ui));
    let mut job = LayoutJob::default();
    let mut at = 0;
    for token in syntax::tokens(language, text) {
        job.append(&text[at..token.range.start], 0.0, format(Tone::Plain));
        let mut format = format(match token.kind {
            Kind::Plain => Tone::Plain,
            Kind::Word => Tone::Busy,
            Kind::Number => Tone::Warn,
            Kind::Text => Tone::Good,
            Kind::Comment => Tone::Quiet,
        });
        let is_wrong =
            |wrong: &Range<usize>| wrong.start < token.range.end && token.range.start < wrong.end;
        if wrong.is_some_and(is_wrong) {
            let color = Tone::Bad.color(ui);
            (format.color, format.underline) = (color, egui::Stroke::new(2.0, color));
        }
        job.append(&text[token.range.clone()], 0.0, format);
        at = token.range.end;
    }
    job.append(&text[at..], 0.0, format(Tone::Plain));
    job
}
