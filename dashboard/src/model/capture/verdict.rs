//! What the emulator's oracle found in the pulses of a dump, as the comments at its end say it:
//!
//! ```text
//! $comment stepfleet-verdict good 2 commands, … $end
//! $comment stepfleet-verdict violation 6250 high for 3 ticks only $end     at 6250 units of the file
//! $comment stepfleet-verdict violation - steps are missing $end            about the whole
//! $comment stepfleet-verdict cut $end
//! ```

/// How the comments begin.
pub(super) const MARK: &str = "stepfleet-verdict";

/// Violations that are kept; the oracle itself lists fewer.
pub const FOUND_MAX: usize = 1_000;

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// What was judged, if all was good.
    pub good: Option<String>,
    /// What was found: where, ps, and what; without a place if it is about the whole.
    pub found: Vec<(Option<u64>, String)>,
    /// Something came later that was not judged.
    pub cut: bool,
}

impl Verdict {
    /// Takes the words of a comment.
    pub(super) fn hear(&mut self, words: &[&str], ps_per_unit: u64) -> Result<(), String> {
        match words {
            ["good", summary @ ..] => self.good = Some(summary.join(" ")),
            ["violation", at, message @ ..] => {
                let at_ps = match *at {
                    "-" => None,
                    units => {
                        let units: Option<u64> = units.parse().ok();
                        let at_ps = units.and_then(|units| units.checked_mul(ps_per_unit));
                        Some(at_ps.ok_or("a verdict without a place")?)
                    }
                };
                if self.found.len() < FOUND_MAX {
                    self.found.push((at_ps, message.join(" ")));
                }
            }
            ["cut"] => self.cut = true,
            // Of a later version.
            _ => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::model::capture::Capture;

    const DUMP: &str = "$timescale 100 ps $end\n$var wire 1 ! step0 $end\n$enddefinitions $end\n\
                        #0\n1!\n#100\n0!\n";

    #[test]
    fn a_verdict_is_read_with_its_places() {
        let text = format!(
            "$comment pins of node left $end\n{DUMP}\
             $comment stepfleet-verdict violation 6250 high for 3 ticks only $end\n\
             $comment stepfleet-verdict violation - steps are missing $end\n\
             $comment stepfleet-verdict cut $end\n"
        );
        let capture = Capture::parse("left.vcd", &text).expect("a capture");
        let verdict = capture.verdict.expect("judged");
        let found = [
            (Some(625_000), "high for 3 ticks only".to_owned()),
            (None, "steps are missing".to_owned()),
        ];
        assert_eq!(
            (verdict.found, verdict.good, verdict.cut),
            (found.to_vec(), None, true)
        );
        let silent = Capture::parse("left.vcd", DUMP).expect("a capture");
        assert_eq!(silent.verdict, None, "nobody judged");
        let wrong = format!("{DUMP}$comment stepfleet-verdict violation soon x $end\n");
        let why = Capture::parse("left.vcd", &wrong).expect_err("no place");
        assert!(why.contains("verdict"), "{why}");
    }
}
