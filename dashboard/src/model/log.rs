//! What the nodes wrote and what this window did, line by line.

use super::limits::{LOG_LINE_BYTES_MAX, LOG_LINES_MAX};
use crate::message::Moment;
use keys::NodeId;
use std::collections::VecDeque;

/// Who wrote a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A node.
    Node(NodeId),
    /// This program.
    Window,
}

impl Source {
    /// Returns the name for the screen.
    pub fn as_str(&self) -> &str {
        match self {
            Self::Node(node) => node.as_str(),
            Self::Window => "dashboard",
        }
    }
}

/// One line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// When it was heard here.
    pub at: Moment,
    /// Who wrote it.
    pub source: Source,
    /// The words, without control characters.
    pub text: String,
}

/// The last lines, oldest first.
#[derive(Debug, Default)]
pub struct Log {
    lines: VecDeque<Line>,
    count: u64,
}

impl Log {
    /// Takes a line; a text of several becomes several.
    pub fn push(&mut self, at: Moment, source: Source, text: String) {
        for part in text.split('\n') {
            let mut text: String = part.chars().filter(|c| !c.is_control()).collect();
            if text.len() > LOG_LINE_BYTES_MAX {
                let end = text.floor_char_boundary(LOG_LINE_BYTES_MAX);
                text.truncate(end);
                text.push('…');
            }
            if self.lines.len() == LOG_LINES_MAX {
                self.lines.pop_front();
            }
            self.lines.push_back(Line { at, source, text });
            self.count += 1;
        }
    }

    /// Returns the lines, oldest first.
    pub fn lines(&self) -> &VecDeque<Line> {
        &self.lines
    }

    /// Returns how many lines there ever were: tells whether something was added.
    pub fn count(&self) -> u64 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_keeps_the_last_ten_thousand_lines() {
        let mut log = Log::default();
        for number in 0..LOG_LINES_MAX + 5 {
            log.push(Moment(0), Source::Window, number.to_string());
        }
        assert_eq!(log.lines().len(), LOG_LINES_MAX);
        assert_eq!(log.lines()[0].text, "5");
        assert_eq!(log.count(), LOG_LINES_MAX as u64 + 5);
    }

    #[test]
    fn a_line_that_is_none_is_made_one() {
        let mut log = Log::default();
        log.push(Moment(0), Source::Window, "a\u{7}b\nc\u{1b}[2J".to_owned());
        log.push(Moment(0), Source::Window, "é".repeat(2_000));
        let texts: Vec<&str> = log.lines().iter().map(|line| line.text.as_str()).collect();
        assert_eq!(texts[..2], ["ab", "c[2J"]);
        assert_eq!(texts[2].chars().count(), LOG_LINE_BYTES_MAX / 2 + 1);
    }
}
