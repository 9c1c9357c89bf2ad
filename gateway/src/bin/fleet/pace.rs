//! `fleet hold`, `fleet resume` and `fleet speed`: the receipts come when the nodes have confirmed.

use crate::{
    link::{Failure, Link, read},
    show,
};
use comfy_table::Cell;
use keys::record::PaceReceipt;
use zenoh::bytes::Encoding;

/// Puts one of the three to every node that matches, and shows what they answered.
pub(crate) async fn pace(
    link: &Link,
    pattern: &str,
    word: &str,
    percent: Option<u16>,
    json: bool,
) -> Result<(), Failure> {
    let prefix = link.keys().prefix();
    let payload = percent.map(|percent| {
        let json = format!("{{\"percent\":{percent}}}");
        (json.into_bytes(), Encoding::APPLICATION_JSON)
    });
    let key = format!("{prefix}/node/{pattern}/{word}");
    let answers = link.get(&key, payload).await?;
    if answers.is_empty() {
        return Err(Failure::Failed(Some(format!("no node matches {pattern}"))));
    }
    let mut table = show::table(&["node", "held", "speed"]);
    let mut refused = false;
    let mut confirmed = false;
    for answer in answers {
        match answer {
            Ok(payload) => {
                let receipt = read::<PaceReceipt>(&payload)?;
                confirmed = true;
                if json {
                    show::line(&String::from_utf8_lossy(&payload));
                }
                table.add_row(vec![
                    Cell::new(receipt.node),
                    Cell::new(if receipt.pace.hold { "yes" } else { "no" }),
                    Cell::new(format!("{} %", receipt.pace.percent)),
                ]);
            }
            Err(error) => {
                refused = true;
                eprintln!("fleet: refused: {error}");
            }
        }
    }
    if confirmed && !json {
        show::print(table);
    }
    if refused {
        return Err(Failure::Failed(None));
    }
    Ok(())
}
