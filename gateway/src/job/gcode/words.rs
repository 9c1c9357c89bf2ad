//! One line of text → its words, by the crate `gcode`.
//!
//! The crate reads values as `f32` and goes on after errors; here the value is read again from the
//! text as `f64`, and the first error ends it. Lines are given to it one by one: a parenthesis that
//! is not closed must not swallow the lines behind it.

use super::Wrong;
use gcode::core::{
    BlockVisitor, CommandVisitor, ControlFlow, Diagnostics, Number, ProgramVisitor, Span,
    TokenType, Value,
};

/// Digits of a code's number before the point at most; the crate counts in tenths of 32 bits.
const CODE_DIGITS_MAX: usize = 6;

/// A letter and its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Word {
    /// In upper case.
    pub(super) letter: char,
    /// As written.
    pub(super) value: f64,
    /// Character in the line, from 1.
    pub(super) column: usize,
}

/// Reads a line.
///
/// # Errors
/// The first place that is no word, number or comment.
pub(super) fn read(line: &str) -> Result<Vec<Word>, Wrong> {
    let mut reader = Reader {
        line,
        words: Vec::new(),
        code: None,
        wrong: None,
    };
    // The crate leaves out a code whose number it cannot count, without a word that could be heard.
    if let Some(at) = uncountable_code(line) {
        return Err(Wrong::new(column(line, at), "no code has such a number"));
    }
    gcode::core::parse(line, &mut reader);
    match reader.wrong {
        None => Ok(reader.words),
        Some(wrong) => Err(wrong),
    }
}

/// Finds a code whose number is not a few digits with one more behind the point.
fn uncountable_code(line: &str) -> Option<usize> {
    let bytes = line.as_bytes();
    let mut depth = 0_u32;
    for (at, byte) in bytes.iter().enumerate() {
        match byte {
            b'(' => depth += 1,
            b')' => depth = depth.saturating_sub(1),
            b';' if depth == 0 => return None,
            b'G' | b'g' | b'M' | b'm' | b'T' | b't' | b'N' | b'n' | b'O' | b'o' if depth == 0 => {
                let rest = line[at + 1..].trim_start();
                let end = rest.find(|letter: char| !letter.is_ascii_digit() && letter != '.');
                let (whole, tenth) = rest[..end.unwrap_or(rest.len())]
                    .split_once('.')
                    .unwrap_or((&rest[..end.unwrap_or(rest.len())], ""));
                if whole.len() > CODE_DIGITS_MAX || tenth.len() > 1 {
                    return Some(at);
                }
            }
            _ => {}
        }
    }
    None
}

fn column(line: &str, at: usize) -> usize {
    line.get(..at).map_or(at, |before| before.chars().count()) + 1
}

struct Reader<'l> {
    line: &'l str,
    words: Vec<Word>,
    /// A code that is being read, and the number of words before it.
    code: Option<(char, Number, usize)>,
    wrong: Option<Wrong>,
}

impl Reader<'_> {
    fn fail(&mut self, at: usize, message: String) {
        let column = column(self.line, at);
        let first = self
            .wrong
            .as_ref()
            .is_none_or(|wrong| column < wrong.column);
        if first {
            self.wrong = Some(Wrong { column, message });
        }
    }

    fn word(&mut self, letter: char, span: Span) {
        let text = self.line.get(span.start..span.end()).unwrap_or_default();
        let number: String = text
            .chars()
            .skip(1)
            .filter(|letter| !letter.is_whitespace())
            .collect();
        match number.parse::<f64>() {
            Ok(value) if value.is_finite() => {
                let word = Word {
                    letter: letter.to_ascii_uppercase(),
                    value,
                    column: column(self.line, span.start),
                };
                self.words.push(word);
            }
            _ => self.fail(span.start, format!("`{text}` is no word with a number")),
        }
    }

    fn begin(&mut self, letter: char, number: Number) {
        self.code = Some((letter, number, self.words.len()));
    }
}

impl Diagnostics for Reader<'_> {
    fn emit_unknown_content(&mut self, text: &str, span: Span) {
        self.fail(span.start, format!("`{text}` is not understood"));
    }

    fn emit_unexpected(&mut self, actual: &str, expected: &[TokenType], span: Span) {
        let message = match expected {
            [TokenType::Number] => format!("`{}`: a number is missing", actual.trim_end()),
            _ => format!("`{}` is not understood", actual.trim_end()),
        };
        self.fail(span.start, message);
    }

    fn emit_parse_int_error(&mut self, value: &str, _error: std::num::ParseIntError, span: Span) {
        self.fail(span.start, format!("`{value}` is no line number"));
    }
}

impl ProgramVisitor for Reader<'_> {
    fn start_block(&mut self) -> ControlFlow<impl BlockVisitor + '_> {
        ControlFlow::Continue(Block(self))
    }
}

struct Block<'r, 'l>(&'r mut Reader<'l>);

struct Code<'r, 'l>(&'r mut Reader<'l>);

macro_rules! pass_on {
    ($name:ident) => {
        impl Diagnostics for $name<'_, '_> {
            fn emit_unknown_content(&mut self, text: &str, span: Span) {
                self.0.emit_unknown_content(text, span);
            }
            fn emit_unexpected(&mut self, actual: &str, expected: &[TokenType], span: Span) {
                self.0.emit_unexpected(actual, expected, span);
            }
            fn emit_parse_int_error(
                &mut self,
                value: &str,
                error: std::num::ParseIntError,
                span: Span,
            ) {
                self.0.emit_parse_int_error(value, error, span);
            }
        }
    };
}
pass_on!(Block);
pass_on!(Code);

impl BlockVisitor for Block<'_, '_> {
    fn comment(&mut self, value: &str, span: Span) {
        if value.starts_with('(') && !value.ends_with(')') {
            let message = "a comment that is not closed in its line";
            self.0.fail(span.start, message.to_owned());
        }
    }

    fn word_address(&mut self, letter: char, _value: Value<'_>, span: Span) {
        self.0.word(letter, span);
    }

    fn start_general_code(&mut self, number: Number) -> ControlFlow<impl CommandVisitor + '_> {
        self.0.begin('G', number);
        ControlFlow::Continue(Code(self.0))
    }

    fn start_miscellaneous_code(
        &mut self,
        number: Number,
    ) -> ControlFlow<impl CommandVisitor + '_> {
        self.0.begin('M', number);
        ControlFlow::Continue(Code(self.0))
    }

    fn start_tool_change_code(&mut self, number: Number) -> ControlFlow<impl CommandVisitor + '_> {
        self.0.begin('T', number);
        ControlFlow::Continue(Code(self.0))
    }
}

impl CommandVisitor for Code<'_, '_> {
    fn argument(&mut self, letter: char, _value: Value<'_>, span: Span) {
        self.0.word(letter, span);
    }

    fn end_command(self, span: Span) {
        let Some((letter, number, index)) = self.0.code.take() else {
            return;
        };
        let minor = number.minor().map_or(0, std::num::NonZeroU32::get);
        let word = Word {
            letter,
            value: f64::from(number.major() * 10 + minor) / 10.0,
            column: column(self.0.line, span.start),
        };
        self.0.words.insert(index, word);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(line: &str) -> Vec<String> {
        let words = read(line).expect("words");
        let text = |word: &Word| format!("{}{}@{}", word.letter, word.value, word.column);
        words.iter().map(text).collect()
    }

    #[test]
    fn words_come_in_the_order_of_the_line_with_their_columns() {
        assert_eq!(
            texts("N10 g1x10Y -.5 (a (b) c) F1000 M3S5 ; end"),
            ["G1@5", "X10@7", "Y-0.5@10", "F1000@26", "M3@32", "S5@34"]
        );
        assert_eq!(texts("S5 M3"), ["S5@1", "M3@4"]);
        assert_eq!(texts("G91.1 T2"), ["G91.1@1", "T2@7"]);
        assert_eq!(texts(" % ; nothing"), [""; 0]);
    }

    #[test]
    fn values_keep_all_their_digits() {
        let words = read("X1234567.890625").expect("a word");
        assert_eq!(words[0].value, 1_234_567.890_625);
    }

    #[test]
    fn what_is_no_word_is_named_with_its_column() {
        for (line, column, part) in [
            ("G1 X", 4, "a number is missing"),
            ("G1 X#5", 4, "a number is missing"),
            ("G1 X1 =", 7, "not understood"),
            ("G1 (open", 4, "not closed"),
            ("/G1 X1", 1, "not understood"),
            ("G4294967295", 1, "no code"),
            ("G54.10", 1, "no code"),
            ("X1 G1.01", 4, "no code"),
            ("ä G1", 1, "not understood"),
            ("G1 X--1", 4, "a number is missing"),
            ("G1 X1.2.3", 8, "not understood"),
            ("5", 1, "not understood"),
        ] {
            let wrong = read(line).expect_err(line);
            assert_eq!(wrong.column, column, "{line}: {}", wrong.message);
            assert!(wrong.message.contains(part), "{line}: {}", wrong.message);
        }
    }
}
