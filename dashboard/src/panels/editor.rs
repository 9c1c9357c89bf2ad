//! A job's text in colours.

use crate::{
    request::Language,
    syntax::{self, Kind},
    theme::Tone,
};
use egui::{TextFormat, TextStyle, Ui, text::LayoutJob};
use std::ops::Range;

/// Returns the text in colours, what is wrong underlined.
pub(super) fn highlighted(
    ui: &Ui,
    language: Language,
    text: &str,
    wrong: Option<&Range<usize>>,
) -> LayoutJob {
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
