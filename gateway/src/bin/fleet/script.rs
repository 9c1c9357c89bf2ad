//! `fleet script`: the Lua scripts that a node stores, by name. They go to the node itself, past the
//! gateway; what the node says in its log to a change is the answer.

use crate::{
    link::{Failure, Link},
    show,
    sign::{boot_of, next_number},
};
use clap::Args;
use gateway::security::{home::read_secret, signing::Signer};
use keys::{
    NodeId, NodeTopic,
    script::SCRIPT_BYTES_MAX,
    signed_script::{Line, Statement},
};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(crate) struct Script {
    /// The node.
    #[arg(value_name = "NODE", value_parser = NodeId::new)]
    node: NodeId,

    /// Name of the script; without it all are listed.
    #[arg(value_name = "NAME", value_parser = NodeId::new)]
    name: Option<NodeId>,

    /// Store this file under the name.
    #[arg(long, value_name = "FILE", requires = "name")]
    put: Option<PathBuf>,

    /// Remove the script.
    #[arg(long, requires = "name", conflicts_with = "put")]
    remove: bool,

    /// Sign the change with this key, for a node that was told whose signature counts.
    #[arg(long, value_name = "KEY")]
    sign: Option<PathBuf>,
}

/// Does it.
pub(crate) async fn script(link: &Link, line: &Script, json: bool) -> Result<(), Failure> {
    let Some(name) = &line.name else {
        return list(link, &line.node, json).await;
    };
    if line.put.is_none() && !line.remove {
        return print(link, &line.node, name, json).await;
    }
    let text = match &line.put {
        Some(file) => Some(text_of(file)?),
        None => None,
    };
    let text = match &line.sign {
        Some(key) => {
            Some(signed(link, key, &line.node, name, text.as_deref().unwrap_or("")).await?)
        }
        None => text,
    };
    if text
        .as_ref()
        .is_some_and(|text| text.len() > SCRIPT_BYTES_MAX)
    {
        let words = format!("--put: a script has at most {SCRIPT_BYTES_MAX} bytes");
        return Err(Failure::Usage(words));
    }
    change(link, &line.node, name, text.as_deref(), json).await
}

fn text_of(file: &Path) -> Result<String, Failure> {
    let bad = |why: &str| Failure::Usage(format!("--put {}: {why}", file.display()));
    let text = std::fs::read_to_string(file).map_err(|error| bad(&error.to_string()))?;
    if text.is_empty() {
        return Err(bad("it is empty; --remove removes a script"));
    }
    Ok(text)
}

fn key_of(link: &Link, node: &NodeId, name: &str) -> String {
    format!("{}/node/{node}/script/{name}", link.keys().prefix())
}

/// Returns the text as a node with signers takes it; nothing removes the script.
async fn signed(
    link: &Link,
    key: &Path,
    node: &NodeId,
    name: &NodeId,
    text: &str,
) -> Result<String, Failure> {
    let bad = |why: String| Failure::Usage(format!("--sign {}: {why}", key.display()));
    let secret = read_secret(key).map_err(|error| bad(error.to_string()))?;
    let signer = Signer::parse(&secret).map_err(bad)?;
    let statement = Statement {
        node,
        boot: boot_of(link, node).await?,
        name: name.as_str(),
        number: next_number(key)?,
        text,
    };
    Ok(format!("{}{text}", signer.sign_script(&statement)))
}

async fn change(
    link: &Link,
    node: &NodeId,
    name: &NodeId,
    text: Option<&str>,
    json: bool,
) -> Result<(), Failure> {
    if !link.alive(node.as_str()).await?.contains(node) {
        let words = format!("node {node} is not there; a script is stored on a node that is");
        return Err(Failure::Failed(Some(words)));
    }
    let log = link
        .subscribe(link.keys().node(node, NodeTopic::Log).as_str())
        .await?;
    let key = key_of(link, node, name.as_str());
    link.keep(&key, text.map(str::as_bytes)).await?;
    let said = async {
        loop {
            let sample = log.recv_async().await.ok()?;
            let line = String::from_utf8_lossy(&sample.payload().to_bytes()).into_owned();
            if let Some(said) = line.strip_prefix(&format!("script {name} ")) {
                return Some(said.to_owned());
            }
        }
    };
    let said = tokio::time::timeout(link.timeout(), said)
        .await
        .ok()
        .flatten();
    // A log may lose lines: then what the node shows is the answer. A signed nothing shows nothing.
    let said = match said {
        Some(said) => said,
        None => {
            let shown = link.texts(&key).await?.pop().map(|(_, shown)| shown);
            let wanted =
                text.filter(|text| Line::split(text).is_none_or(|(_, signed)| !signed.is_empty()));
            if shown.as_deref() != wanted.map(str::as_bytes) {
                let words = format!("node {node} has not taken it and does not say why");
                return Err(Failure::Failed(Some(words)));
            }
            (if wanted.is_some() {
                "stored"
            } else {
                "removed"
            })
            .to_owned()
        }
    };
    if said.starts_with("not ") {
        return Err(Failure::Failed(Some(format!("script {name} {said}"))));
    }
    if json {
        println!(
            "{}",
            serde_json::json!({"node": node, "script": name, "said": said})
        );
    } else {
        println!("script {name} {said}");
    }
    Ok(())
}

async fn print(link: &Link, node: &NodeId, name: &NodeId, json: bool) -> Result<(), Failure> {
    let found = link.texts(&key_of(link, node, name.as_str())).await?.pop();
    let Some((_, text)) = found else {
        let words = format!("node {node} stores no script {name}, or is not there");
        return Err(Failure::Failed(Some(words)));
    };
    let text = String::from_utf8_lossy(&text);
    if json {
        println!(
            "{}",
            serde_json::json!({"node": node, "script": name, "text": text})
        );
    } else {
        print!("{text}");
    }
    Ok(())
}

async fn list(link: &Link, node: &NodeId, json: bool) -> Result<(), Failure> {
    let mut found = link.texts(&key_of(link, node, "*")).await?;
    if found.is_empty() && !link.alive(node.as_str()).await?.contains(node) {
        return Err(Failure::Failed(Some(format!("node {node} is not there"))));
    }
    found.sort();
    let mut table = show::table(&["name", "bytes", "signed with"]);
    for (key, text) in found {
        let name = key.rsplit('/').next().unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let signer = Line::split(&text).map(|(line, _)| keys::job::Hex(line.key).to_string());
        if json {
            let line = serde_json::json!({"name": name, "bytes": text.len(), "signed": signer});
            println!("{line}");
        } else {
            let signer = signer.map_or(String::new(), |key| format!("{}…", &key[..8]));
            table.add_row(vec![name.to_owned(), text.len().to_string(), signer]);
        }
    }
    if !json {
        println!("{table}");
    }
    Ok(())
}
