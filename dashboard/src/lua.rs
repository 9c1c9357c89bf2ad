//! Whether a script is Lua 5.4: what its writer should look at before it is sent. Nothing is run, and
//! no name is known: a function that does not exist is found by the node alone.

use std::ops::Range;

/// Longest script that is looked at, bytes. The parser goes as deep as its brackets do, and each of
/// these bytes may open one.
const BYTES_MAX: usize = 16 << 10;

/// Room for the deepest of them; what is not needed is never touched.
const STACK_BYTES: usize = 512 << 20;

/// What is wrong first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    /// Where, bytes.
    pub place: Range<usize>,
    /// What, with the line.
    pub words: String,
}

/// What is known of a script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is Lua.
    Good,
    /// It is none, as far as this program can tell; a node has the last word.
    Wrong(Wrong),
    /// It is too long to be looked at here.
    Unknown,
}

/// Looks at a script.
pub fn check(script: &str) -> Verdict {
    if script.len() > BYTES_MAX {
        return Verdict::Unknown;
    }
    let look = || std::thread::Builder::new().stack_size(STACK_BYTES);
    std::thread::scope(|scope| {
        let looking = look().spawn_scoped(scope, || parse(script));
        // Without a thread, or after a panic in the parser, nothing is known.
        let verdict = looking.ok().and_then(|looking| looking.join().ok());
        verdict.unwrap_or(Verdict::Unknown)
    })
}

fn parse(script: &str) -> Verdict {
    let parsed = full_moon::parse_fallible(script, full_moon::LuaVersion::lua54());
    let errors = parsed.errors().iter();
    let Some(error) = errors.min_by_key(|error| error.range().0.bytes()) else {
        return Verdict::Good;
    };
    let (from, to) = error.range();
    let start = script.floor_char_boundary(from.bytes());
    let end = script.floor_char_boundary(to.bytes()).max(start);
    let words = format!("line {}: {}", from.line(), error.error_message());
    Verdict::Wrong(Wrong {
        place: start..end,
        words,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_node_takes_is_good() {
        for script in [
            "",
            "motor.queue_move(0, 500, 2000)\nmotor.execute()\n",
            "local x <const> = 7 // 2 | 1 << 3\ngoto over\n::over::\nreturn x, 'ä', [[long]]",
            "for i = 1, 3 do print(i) end -- remark\nrepeat until not (1 ~= 2)",
        ] {
            assert_eq!(check(script), Verdict::Good, "{script}");
        }
    }

    #[test]
    fn what_is_wrong_is_found_with_its_place() {
        let script = "local a = 1\nif a == 1 the\n  print(a)\nend";
        let Verdict::Wrong(wrong) = check(script) else {
            panic!("a word is misspelled");
        };
        assert!(wrong.words.starts_with("line 2: "), "{}", wrong.words);
        assert_eq!(&script[wrong.place], "the");
        for script in ["print('never ends", "end", "x = = 1", "é"] {
            assert!(matches!(check(script), Verdict::Wrong(_)), "{script}");
        }
    }

    #[test]
    fn what_is_deep_or_long_does_no_harm() {
        for part in [
            "(",
            "{",
            "not ",
            "- ",
            "a..",
            "a^",
            "function()",
            "do ",
            "f{",
            "-",
        ] {
            let deep = part.repeat(BYTES_MAX / part.len());
            // Whatever is said of it.
            let _ = check(&format!("x={}", &deep[..deep.len() - 2]));
            let _ = check(&deep);
        }
        assert_eq!(check(&"-".repeat(BYTES_MAX + 1)), Verdict::Unknown);
    }
}
