//! A job as somebody has written it, in a file or a template, and what is sent of it.

use crate::{args::Format, link::Failure};
use keys::JobId;
use std::{fmt::Display, io::Read, path::Path};
use zenoh::bytes::Encoding;

/// See the module.
#[derive(Debug)]
pub(crate) struct Written {
    /// Where it comes from, for messages.
    pub(crate) name: String,
    pub(crate) text: Vec<u8>,
    pub(crate) format: Format,
}

impl Written {
    /// Reads a file, or standard input if its name is `-`.
    pub(crate) fn read(file: &Path, format: Option<Format>) -> Result<Self, Failure> {
        let is_stdin = file.as_os_str() == "-";
        let name = if is_stdin {
            "standard input".to_owned()
        } else {
            file.display().to_string()
        };
        let usage = |error: &dyn Display| Failure::Usage(format!("{name}: {error}"));
        let mut text = Vec::new();
        if is_stdin {
            std::io::stdin().lock().read_to_end(&mut text)
        } else {
            std::fs::File::open(file).and_then(|mut file| file.read_to_end(&mut text))
        }
        .map_err(|error| usage(&error))?;
        if text.iter().all(u8::is_ascii_whitespace) {
            return Err(usage(&"there is nothing in it"));
        }
        let format = format.unwrap_or_else(|| format_of(file, &text));
        Ok(Self { name, text, format })
    }

    /// Says what is wrong with it.
    pub(crate) fn wrong(&self, error: impl Display) -> Failure {
        Failure::Usage(format!("{}: {error}", self.name))
    }

    /// Puts values in the place of `${NAME}`, if there are any or if it is known to be a template.
    pub(crate) fn fill_in(
        &mut self,
        settings: &[(String, String)],
        is_template: bool,
    ) -> Result<(), Failure> {
        if settings.is_empty() && !is_template {
            return Ok(());
        }
        let text = std::str::from_utf8(&self.text).map_err(|error| self.wrong(error))?;
        let filled = fill_in(text, settings).map_err(|error| self.wrong(error))?;
        self.text = filled.into_bytes();
        Ok(())
    }

    /// Returns it as a job in JSON; `None`: G-code, which only the gateway can read.
    pub(crate) fn json(
        &self,
    ) -> Result<Option<serde_json::Map<String, serde_json::Value>>, Failure> {
        match self.format {
            Format::Gcode => Ok(None),
            Format::Json => {
                let job = serde_json::from_slice(&self.text).map_err(|error| self.wrong(error))?;
                Ok(Some(job))
            }
            Format::Lua => {
                let script = std::str::from_utf8(&self.text).map_err(|error| self.wrong(error))?;
                let job = [("lua".to_owned(), script.into())];
                Ok(Some(job.into_iter().collect()))
            }
        }
    }

    /// Returns what is sent, with the name that was typed.
    pub(crate) fn encoded(self, id: Option<JobId>) -> Result<(Vec<u8>, Encoding), Failure> {
        match (self.format, id) {
            (Format::Lua, None) => Ok((self.text, Encoding::from("text/x-lua"))),
            (Format::Json, None) => Ok((self.text, Encoding::APPLICATION_JSON)),
            (Format::Gcode, None) => Ok((self.text, Encoding::from("text/x-gcode"))),
            (Format::Gcode, Some(id)) => {
                Ok((self.text, Encoding::from(format!("text/x-gcode;id={id}"))))
            }
            (Format::Lua | Format::Json, Some(id)) => {
                let mut job = self.json()?.unwrap_or_default();
                job.insert("id".to_owned(), id.as_str().into());
                let payload = serde_json::Value::from(job).to_string();
                Ok((payload.into_bytes(), Encoding::APPLICATION_JSON))
            }
        }
    }
}

fn fill_in(template: &str, settings: &[(String, String)]) -> Result<String, String> {
    let mut used = vec![false; settings.len()];
    let mut out = String::with_capacity(template.len());
    let mut rest = template;
    while let Some((before, behind)) = rest.split_once("${") {
        out += before;
        let (name, behind) = behind.split_once('}').ok_or("`${` without `}`")?;
        let index = settings.iter().position(|(known, _)| known == name);
        let index = index.ok_or_else(|| format!("${{{name}}} has no value: --set {name}=…"))?;
        out += &settings[index].1;
        used[index] = true;
        rest = behind;
    }
    match used.iter().position(|used| !used) {
        Some(index) => Err(format!("there is no ${{{}}} in it", settings[index].0)),
        None => Ok(out + rest),
    }
}

fn format_of(file: &Path, text: &[u8]) -> Format {
    match file.extension().and_then(|extension| extension.to_str()) {
        Some("json") => Format::Json,
        Some("lua") => Format::Lua,
        Some("gcode" | "nc" | "ngc" | "tap") => Format::Gcode,
        _ => match text.iter().find(|byte| !byte.is_ascii_whitespace()) {
            Some(b'{') => Format::Json,
            _ => Format::Lua,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_template_is_filled_in_whole_or_not_at_all() {
        let set = |pairs: &[(&str, &str)]| -> Vec<(String, String)> {
            let owned = |(name, value): &(&str, &str)| ((*name).to_owned(), (*value).to_owned());
            pairs.iter().map(owned).collect()
        };
        let depth = set(&[("d", "4"), ("x", "${d}")]);
        let filled = fill_in("G1 Z-${d} X${x} ${d}", &depth);
        assert_eq!(
            filled.as_deref(),
            Ok("G1 Z-4 X${d} 4"),
            "a value is no template"
        );
        let error = |text: &str| fill_in(text, &depth).expect_err("not whole");
        assert!(error("${d} ${x} ${y}").contains("--set y="));
        assert!(error("${d}").contains("no ${x}"));
        assert!(error("${d} ${x").contains("without"));
    }

    #[test]
    fn a_file_is_what_its_extension_says_and_else_what_it_looks_like() {
        let format = |file: &str, payload: &[u8]| format_of(Path::new(file), payload);
        assert_eq!(format("a.json", b"x"), Format::Json);
        assert_eq!(format("a.lua", b"{}"), Format::Lua);
        assert_eq!(format("a.gcode", b"G0 X1"), Format::Gcode);
        assert_eq!(format("a.nc", b"%"), Format::Gcode);
        assert_eq!(format("-", b" \n{}"), Format::Json);
        assert_eq!(format("-", b"motor.execute()"), Format::Lua);
        assert_eq!(format("-", b""), Format::Lua);
    }
}
