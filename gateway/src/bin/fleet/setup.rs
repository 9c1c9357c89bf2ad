//! How nodes are set, by their own word.

use crate::{
    link::{Failure, Link},
    show,
};
use serde_json::Value;

/// Asks the nodes of a pattern and prints what each tells.
pub(crate) async fn setup(link: &Link, pattern: &str, json: bool) -> Result<(), Failure> {
    let selector = format!("{}/node/{pattern}/setup", link.keys().prefix());
    let mut told = link.texts(&selector).await?;
    if told.is_empty() {
        return Err(Failure::Failed(Some(format!(
            "{pattern}: no node answers; it is not there, its firmware is older than this question, or \
             you may not ask"
        ))));
    }
    told.sort();
    for (number, (key, payload)) in told.iter().enumerate() {
        if json {
            show::json_line(payload);
            continue;
        }
        let read = serde_json::from_slice::<Value>(payload);
        let setup = read.map_err(|error| Failure::Failed(Some(format!("{key}: {error}"))))?;
        if number > 0 {
            show::line("");
        }
        let mut table = show::table(&["setting", "value"]);
        for (name, value) in rows(&setup) {
            table.add_row(vec![name, value]);
        }
        show::print(table);
    }
    Ok(())
}

/// Returns each value with its place, the name first: units are in the places.
fn rows(setup: &Value) -> Vec<(String, String)> {
    let mut rows = Vec::new();
    walk("", setup, &mut rows);
    rows.sort_by_key(|(name, _)| name != "name");
    rows
}

fn walk(place: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let dot = if place.is_empty() { "" } else { "." };
                walk(&format!("{place}{dot}{name}"), value, rows);
            }
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            for (index, item) in items.iter().enumerate() {
                walk(&format!("{place}[{index}]"), item, rows);
            }
        }
        Value::Array(items) => {
            let words: Vec<String> = items.iter().map(word).collect();
            let words = if words.is_empty() {
                "none".to_owned()
            } else {
                words.join(", ")
            };
            rows.push((place.to_owned(), words));
        }
        value => rows.push((place.to_owned(), word(value))),
    }
}

fn word(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_has_a_row_with_its_place_and_the_name_is_the_first() {
        let setup = serde_json::json!({
            "axes": [{"driver": null, "soft_limits": {"min_steps": -5}}, {"driver": "dm556"}],
            "enables": [{"axes": ["0", "c"], "auto": true}],
            "inputs": [],
            "name": "left",
        });
        let rows = rows(&setup);
        let rows: Vec<_> = rows
            .iter()
            .map(|(name, value)| (&**name, &**value))
            .collect();
        let expected = [
            ("name", "left"),
            ("axes[0].driver", "none"),
            ("axes[0].soft_limits.min_steps", "-5"),
            ("axes[1].driver", "dm556"),
            ("enables[0].auto", "yes"),
            ("enables[0].axes", "0, c"),
            ("inputs", "none"),
        ];
        for row in expected {
            assert!(rows.contains(&row), "{row:?} in {rows:?}");
        }
        assert_eq!((rows.len(), rows[0]), (expected.len(), expected[0]));
    }
}
