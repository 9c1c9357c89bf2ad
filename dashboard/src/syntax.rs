//! The words of a job's text, for colours, and the place of what is wrong in it.
//!
//! Made for text that is being typed: nothing here fails, whatever the text is.

use crate::request::Language;
use std::ops::Range;

/// What a piece of text is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Brackets, operators, names.
    Plain,
    /// The name of a field, or a word of the language.
    Word,
    /// A number.
    Number,
    /// A string.
    Text,
    /// A remark.
    Comment,
}

/// A piece of text without blanks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// Where, bytes.
    pub range: Range<usize>,
    /// What.
    pub kind: Kind,
}

/// Words of Lua, reference manual 5.4, section 3.1.
const LUA_WORDS: [&str; 22] = [
    "and", "break", "do", "else", "elseif", "end", "false", "for", "function", "goto", "if", "in",
    "local", "nil", "not", "or", "repeat", "return", "then", "true", "until", "while",
];

/// Returns the tokens of a text, in order.
pub fn tokens(language: Language, text: &str) -> Vec<Token> {
    let bytes = text.as_bytes();
    let mut tokens = Vec::new();
    let mut at = 0;
    while let Some(byte) = bytes.get(at).copied() {
        if byte.is_ascii_whitespace() {
            at += 1;
            continue;
        }
        let (end, kind) = match (language, byte) {
            (Language::Json, b'"') => {
                let end = string_end(bytes, at);
                let next = bytes[end..].iter().find(|byte| !byte.is_ascii_whitespace());
                let is_name = next == Some(&b':');
                (end, if is_name { Kind::Word } else { Kind::Text })
            }
            (Language::Lua, b'"' | b'\'') => (string_end(bytes, at), Kind::Text),
            (Language::Lua, b'-') if bytes[at..].starts_with(b"--") => {
                let long = long_bracket_end(text, at + 2);
                (long.unwrap_or_else(|| line_end(bytes, at)), Kind::Comment)
            }
            (Language::Lua, b'[') => match long_bracket_end(text, at) {
                Some(end) => (end, Kind::Text),
                None => (at + 1, Kind::Plain),
            },
            (Language::Json, b'-') | (_, b'0'..=b'9') => {
                let in_number = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'.';
                (run_end(bytes, at + 1, in_number), Kind::Number)
            }
            (_, b'a'..=b'z' | b'A'..=b'Z' | b'_') => {
                let in_name = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
                let end = run_end(bytes, at, in_name);
                (end, word_kind(language, &text[at..end]))
            }
            _ => (
                at + text[at..].chars().next().map_or(1, char::len_utf8),
                Kind::Plain,
            ),
        };
        let range = at..end;
        at = end;
        tokens.push(Token { range, kind });
    }
    tokens
}

fn word_kind(language: Language, word: &str) -> Kind {
    let known = match language {
        Language::Json => matches!(word, "true" | "false" | "null"),
        Language::Lua => LUA_WORDS.contains(&word),
    };
    if known { Kind::Word } else { Kind::Plain }
}

fn run_end(bytes: &[u8], from: usize, belongs: impl Fn(u8) -> bool) -> usize {
    let run = bytes[from..].iter().take_while(|byte| belongs(**byte));
    from + run.count()
}

fn line_end(bytes: &[u8], from: usize) -> usize {
    run_end(bytes, from, |byte| byte != b'\n')
}

/// A string ends at its own quote, or with the line: what is being typed has no end yet.
fn string_end(bytes: &[u8], from: usize) -> usize {
    let quote = bytes[from];
    let mut at = from + 1;
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'\\' if bytes.get(at + 1).is_some_and(u8::is_ascii) => at += 2,
            b'\n' => return at,
            byte if *byte == quote => return at + 1,
            _ => at += 1,
        }
    }
    bytes.len()
}

/// Returns the end of `[[…]]`, `[=[…]=]` and so on, if one begins here.
fn long_bracket_end(text: &str, from: usize) -> Option<usize> {
    let rest = text.get(from..)?.strip_prefix('[')?;
    let level = rest.bytes().take_while(|byte| *byte == b'=').count();
    rest[level..].strip_prefix('[')?;
    let close = format!("]{}]", "=".repeat(level));
    let end = rest.find(&close).map(|at| from + 1 + at + close.len());
    Some(end.unwrap_or(text.len()))
}

/// Returns what the words of an error of the `keys` crate mean in a JSON text: the value at
/// `commands[3].move.delay_us`, or as far as the way there goes; else the place that line and
/// column name.
pub fn error_place(text: &str, message: &str) -> Option<Range<usize>> {
    let by_column = || by_line_and_column(text, message);
    let Some((path, _)) = message.split_once(": ") else {
        return by_column();
    };
    let is_path = |c: char| c.is_ascii_alphanumeric() || "_-.[]".contains(c);
    // Of a text that is no JSON only line and column are true.
    let is_json = serde_json::from_str::<serde::de::IgnoredAny>(text).is_ok();
    if !is_json || !path.chars().all(is_path) {
        return by_column();
    }
    by_path(text, path).or_else(by_column)
}

fn by_path(text: &str, path: &str) -> Option<Range<usize>> {
    let tokens = tokens(Language::Json, text);
    let word = |index: usize| tokens.get(index).map(|token| &text[token.range.clone()]);
    let mut found = None;
    let mut at = 0;
    let path = path.replace('[', ".[");
    for step in path.split('.').filter(|step| !step.is_empty()) {
        let list = step
            .strip_prefix('[')
            .and_then(|step| step.strip_suffix(']'));
        let wanted = list.and_then(|index| index.parse::<usize>().ok());
        let mut item = at + 1;
        let mut count = 0;
        let value = loop {
            match word(item) {
                None | Some("}" | "]") => break None,
                Some(",") => item += 1,
                Some(name) => {
                    let value = if wanted.is_some() { item } else { item + 2 };
                    let here = match wanted {
                        Some(wanted) => wanted == count,
                        None => name.trim_matches('"') == step,
                    };
                    if here {
                        break Some((item, value));
                    }
                    count += 1;
                    item = value_end(&word, value);
                }
            }
        };
        let Some((item, value)) = value else { break };
        let last = value_end(&word, value) - 1;
        found = Some(tokens.get(item)?.range.start..tokens.get(last)?.range.end);
        at = value;
    }
    found
}

/// Returns the number of the token after the value that begins here.
fn value_end<'t>(word: &impl Fn(usize) -> Option<&'t str>, from: usize) -> usize {
    let mut depth = 0_usize;
    let mut at = from;
    loop {
        match word(at) {
            Some("{" | "[") => depth += 1,
            Some("}" | "]") => depth = depth.saturating_sub(1),
            Some(_) => {}
            None => return at.max(from + 1),
        }
        at += 1;
        if depth == 0 {
            return at;
        }
    }
}

fn by_line_and_column(text: &str, message: &str) -> Option<Range<usize>> {
    let (_, place) = message.rsplit_once(" at line ")?;
    let (line, column) = place.split_once(" column ")?;
    let (line, column): (usize, usize) = (line.parse().ok()?, column.parse().ok()?);
    let lines = text.split_inclusive('\n').take(line.checked_sub(1)?);
    let start: usize = lines.map(str::len).sum();
    let at = (start + column.saturating_sub(1)).min(text.len());
    // The column is where reading ended: on the wrong token, or right behind it.
    let tokens = tokens(Language::Json, text);
    let on = tokens.iter().rev().find(|token| token.range.start <= at);
    on.map(|token| token.range.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use keys::job::JobRequest;

    fn marked(text: &str) -> &str {
        let error = JobRequest::from_json(text.as_bytes()).expect_err("something is wrong");
        &text[error_place(text, &error.message).expect("a place")]
    }

    #[test]
    fn the_value_that_is_wrong_is_marked() {
        let text = r#"{"commands":[{"pause":{"ms":5}},
            {"move":{"axis":0,"delay_us":0,"steps":[1]}}]}"#;
        assert_eq!(marked(&text.replace("[1]", "1")), r#""delay_us":0"#);
        assert_eq!(marked(text), r#""steps":[1]"#);
        let unknown = r#"{"commands":[{"pause":{"ms":5,"m":1}}]}"#;
        assert_eq!(marked(unknown), r#""m":1"#);
        let missing = r#"{"commands":[{"pause":{}}]}"#;
        assert!(marked(missing).starts_with(r#""pause":"#));
    }

    #[test]
    fn what_is_no_json_is_marked_where_reading_ended() {
        assert_eq!(marked("{\"commands\":[\n  {\"pause\":{\"ms\":}}\n]}"), "}");
        assert_eq!(marked("{\"commands\":["), "[");
    }

    #[test]
    fn lua_has_words_numbers_strings_and_remarks() {
        let text = "local n = 0x1F -- ü\nprint('a\\'b', [[x\ny]]) --[=[ ]] ]=] end";
        let kinds: Vec<(&str, Kind)> = tokens(Language::Lua, text)
            .into_iter()
            .filter(|token| token.kind != Kind::Plain)
            .map(|token| (&text[token.range], token.kind))
            .collect();
        let expected = [
            ("local", Kind::Word),
            ("0x1F", Kind::Number),
            ("-- ü", Kind::Comment),
            ("'a\\'b'", Kind::Text),
            ("[[x\ny]]", Kind::Text),
            ("--[=[ ]] ]=]", Kind::Comment),
            ("end", Kind::Word),
        ];
        assert_eq!(kinds, expected);
    }

    #[test]
    fn nothing_that_is_typed_breaks_it() {
        let text = "{\"ü\\ü\":[-é,\"\\\n'[[--[[\\'\"";
        for end in (0..=text.len()).filter(|end| text.is_char_boundary(*end)) {
            for language in [Language::Json, Language::Lua] {
                let tokens = tokens(language, &text[..end]);
                for token in tokens {
                    assert!(text.get(token.range).is_some(), "cut inside a character");
                }
            }
            let path = "commands[9].move.x: wrong at line 7 column 9";
            let _ = error_place(&text[..end], path);
        }
    }
}
