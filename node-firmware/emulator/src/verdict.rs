//! The oracle's verdict as comments at the end of a value change dump, where whoever looks at the
//! pulses finds it; other viewers pass comments over.
//!
//! ```text
//! $comment stepfleet-verdict good 2 commands, steps [10, 0], start skew at most 0 ticks $end
//! $comment stepfleet-verdict violation 6250 high for 3 ticks only $end      at 6250 units of the file
//! $comment stepfleet-verdict violation - steps are missing $end             about the whole
//! $comment stepfleet-verdict cut $end                 what came later was not recorded, so not judged
//! ```

use crate::{
    oracle::{Summary, Violation},
    vcd::UNITS_PER_TICK,
};
use std::io::{self, Write};

/// How each comment begins.
pub const MARK: &str = "stepfleet-verdict";

/// Writes a verdict behind a dump that is whole. `cut`: see [`Life::cut`](crate::record::Life::cut).
///
/// # Errors
/// Those of `out`.
pub fn write(
    mut out: impl Write,
    verdict: &Result<Summary, Vec<Violation>>,
    cut: bool,
) -> io::Result<()> {
    match verdict {
        Ok(summary) => writeln!(out, "$comment {MARK} good {summary} $end")?,
        Err(violations) => {
            for violation in violations {
                let at = violation
                    .at_ticks
                    .map_or("-".to_owned(), |ticks| (ticks * UNITS_PER_TICK).to_string());
                // A word with a dollar could end the comment.
                let message = violation.message.replace('$', "");
                writeln!(out, "$comment {MARK} violation {at} {message} $end")?;
            }
        }
    }
    if cut {
        writeln!(out, "$comment {MARK} cut $end")?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_is_a_comment_for_each_thing_that_was_found() {
        let found = |at_ticks, message: &str| Violation {
            at_ticks,
            message: message.to_owned(),
        };
        let verdict = Err(vec![found(Some(10), "too $end short"), found(None, "lost")]);
        let mut text = Vec::new();
        write(&mut text, &verdict, true).expect("memory");
        let expected = "$comment stepfleet-verdict violation 6250 too end short $end\n\
                        $comment stepfleet-verdict violation - lost $end\n\
                        $comment stepfleet-verdict cut $end\n";
        assert_eq!(String::from_utf8(text).expect("words"), expected);
    }
}
