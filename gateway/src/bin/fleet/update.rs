//! `fleet update`: gives a node another firmware, and waits until it has proved itself.
//!
//! ```text
//!   look ─▶ begin ─▶ chunk … ─▶ finish ─▶ (the node restarts) ─▶ look, until it is not on trial
//! ```
//!
//! Each message is a get that may be asked again: what was lost is found by the node's answer, which
//! says how far it is.

use crate::{
    args::{Common, Update, UpdateKey},
    link::{Failure, Link},
};
use ed25519_dalek::{Signer, SigningKey};
use gateway::security::home::{read_secret, write_secret};
use keys::{
    NodeId, NodeTopic,
    update::{CHUNK_BYTES_MAX, SIGNED_PREFIX, UpdateMessage, UpdateRefusal, UpdateReply},
};
use sha2::{Digest, Sha256};
use std::{
    io::IsTerminal,
    path::Path,
    time::{Duration, Instant},
};
use zenoh::bytes::Encoding;

/// First byte of an image for the chips.
const IMAGE_MAGIC: u8 = 0xe9;

/// How long a node that has an image may take until it has proved itself: its boot, the minute of
/// its trial, and the boot back.
const TRIAL: Duration = Duration::from_secs(120);

/// From one look at a node that restarts to the next.
const LOOK: Duration = Duration::from_millis(500);

/// How often a question is asked before the node counts as gone.
const ATTEMPTS_MAX: u32 = 5;

/// What runs on a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Runs {
    version: [u8; 3],
    slot: u8,
    on_trial: bool,
}

/// Does it.
pub(crate) async fn update(link: &Link, line: &Update, json: bool) -> Result<(), Failure> {
    let Some(file) = &line.image else {
        let runs = look(link, &line.node).await?;
        show(&line.node, runs, None, json);
        return Ok(());
    };
    let key = line
        .key
        .as_deref()
        .ok_or_else(|| Failure::Usage("an image needs --key".into()))?;
    let image = read_image(file)?;
    let key = signing_key(key)?;
    let before = look(link, &line.node).await?;
    send(link, &line.node, &image, &key).await?;
    let after = settle(link, &line.node).await?;
    show(&line.node, after, Some(before), json);
    if after.slot == before.slot {
        let message = format!(
            "{}: the new firmware did not reach the router within a minute, or crashed; \
             the one before runs again",
            line.node
        );
        return Err(Failure::Failed(Some(message)));
    }
    Ok(())
}

/// Makes a pair of keys: one to sign with, one to give to nodes.
pub(crate) fn make_key(line: &UpdateKey, common: &Common) -> Result<(), Failure> {
    let mut seed = [0; 32];
    getrandom::getrandom(&mut seed).map_err(|error| Failure::Failed(Some(error.to_string())))?;
    let public = SigningKey::from_bytes(&seed).verifying_key().to_bytes();
    let public_file = line.file.with_extension("pub");
    if line.file.exists() || public_file.exists() {
        let message = format!("{} is there already", line.file.display());
        return Err(Failure::Usage(message));
    }
    write_secret(&line.file, &format!("{}\n", hex(&seed)))
        .map_err(|error| Failure::Usage(error.to_string()))?;
    std::fs::write(&public_file, format!("{}\n", hex(&public)))?;
    if common.json {
        let said = serde_json::json!({"key": line.file, "public": public_file});
        println!("{said}");
    } else {
        println!("{}  signs: keep it to yourself", line.file.display());
        println!(
            "{}  for nodes: fleet provision PORT --update-key-file {}",
            public_file.display(),
            public_file.display()
        );
    }
    Ok(())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn read_image(file: &Path) -> Result<Vec<u8>, Failure> {
    let usage = |message: String| Failure::Usage(format!("{}: {message}", file.display()));
    let image = std::fs::read(file).map_err(|error| usage(error.to_string()))?;
    if image.first() != Some(&IMAGE_MAGIC) {
        return Err(usage(
            "is no image for a board: `espflash save-image --chip esp32s3 ELF FILE` makes one"
                .into(),
        ));
    }
    Ok(image)
}

fn signing_key(file: &Path) -> Result<SigningKey, Failure> {
    let usage = |message: String| Failure::Usage(format!("--key: {message}"));
    let text = read_secret(file).map_err(|error| usage(error.to_string()))?;
    let seed = crate::provision::key_from_hex(&text)
        .ok_or_else(|| usage("64 hexadecimal digits are wanted; see `fleet update-key`".into()))?;
    Ok(SigningKey::from_bytes(&seed))
}

/// Asks a node; again, if there is no answer.
async fn ask(
    link: &Link,
    node: &NodeId,
    message: &UpdateMessage<'_>,
    attempts: u32,
) -> Result<UpdateReply, Failure> {
    let key = link.keys().node(node, NodeTopic::Update);
    let bytes =
        postcard::to_allocvec(message).map_err(|error| Failure::Failed(Some(error.to_string())))?;
    for _ in 0..attempts {
        let payload = Some((bytes.clone(), Encoding::APPLICATION_OCTET_STREAM));
        // A get that nobody answers in time is an error; one that nobody hears ends at once.
        if let Ok(answers) = link.ask(key.as_str(), payload, None).await
            && let Some(Ok(answer)) = answers.into_iter().next()
        {
            return postcard::from_bytes(&answer).map_err(|_| {
                Failure::Failed(Some(format!("{node}: its answer is of another version")))
            });
        }
        tokio::time::sleep(LOOK).await;
    }
    let message = format!("{node} does not answer; `fleet nodes` lists those that are there");
    Err(Failure::Connection(message))
}

async fn look(link: &Link, node: &NodeId) -> Result<Runs, Failure> {
    match ask(link, node, &UpdateMessage::Look, ATTEMPTS_MAX).await? {
        UpdateReply::Runs {
            version,
            slot,
            on_trial,
        } => Ok(Runs {
            version,
            slot,
            on_trial,
        }),
        reply => Err(refused(node, reply)),
    }
}

fn refused(node: &NodeId, reply: UpdateReply) -> Failure {
    let message = match reply {
        UpdateReply::Refused(refusal) => format!("{node}: {refusal}"),
        reply => format!("{node}: an answer that does not fit: {reply:?}"),
    };
    Failure::Failed(Some(message))
}

async fn send(link: &Link, node: &NodeId, image: &[u8], key: &SigningKey) -> Result<(), Failure> {
    let hash: [u8; 32] = Sha256::digest(image).into();
    let signed = [SIGNED_PREFIX, &hash[..]].concat();
    let begin = UpdateMessage::Begin {
        bytes: u32::try_from(image.len())
            .map_err(|_| Failure::Usage("the image is larger than any slot".into()))?,
        hash,
        signature: key.sign(&signed).to_bytes(),
    };
    let progress = if std::io::stderr().is_terminal() {
        indicatif::ProgressBar::new(image.len() as u64)
    } else {
        indicatif::ProgressBar::hidden()
    };
    let mut reply = ask(link, node, &begin, ATTEMPTS_MAX).await?;
    let mut repeats = 0;
    let mut furthest = 0;
    loop {
        reply = match reply {
            UpdateReply::Ready => {
                progress.finish_and_clear();
                return Ok(());
            }
            UpdateReply::At { bytes } if bytes as usize <= image.len() => {
                // A node that does not get on is given up; one that has forgotten begins anew.
                repeats = if bytes > furthest { 0 } else { repeats + 1 };
                furthest = furthest.max(bytes);
                if repeats > ATTEMPTS_MAX {
                    return Err(Failure::Failed(Some(format!(
                        "{node} does not get beyond {bytes} bytes"
                    ))));
                }
                progress.set_position(u64::from(bytes));
                let rest = &image[bytes as usize..];
                let part = &rest[..rest.len().min(CHUNK_BYTES_MAX)];
                let message = if part.is_empty() {
                    UpdateMessage::Finish
                } else {
                    UpdateMessage::Chunk {
                        at: bytes,
                        bytes: part,
                    }
                };
                ask(link, node, &message, ATTEMPTS_MAX).await?
            }
            // It was restarted in between: from the begin.
            UpdateReply::Refused(UpdateRefusal::NotBegun) if repeats < ATTEMPTS_MAX => {
                repeats += 1;
                ask(link, node, &begin, ATTEMPTS_MAX).await?
            }
            reply => return Err(refused(node, reply)),
        };
    }
}

/// Waits until the node runs something that has proved itself.
async fn settle(link: &Link, node: &NodeId) -> Result<Runs, Failure> {
    let begun = Instant::now();
    // The restart comes half a second behind the answer; until then the one before runs.
    tokio::time::sleep(2 * LOOK).await;
    while begun.elapsed() < TRIAL {
        if let Ok(UpdateReply::Runs {
            version,
            slot,
            on_trial: false,
        }) = ask(link, node, &UpdateMessage::Look, 1).await
        {
            return Ok(Runs {
                version,
                slot,
                on_trial: false,
            });
        }
        tokio::time::sleep(LOOK).await;
    }
    Err(Failure::TimedOut(format!(
        "{node} has the image and is not back after {} s",
        TRIAL.as_secs()
    )))
}

fn show(node: &NodeId, runs: Runs, before: Option<Runs>, json: bool) {
    let text = |[major, minor, patch]: [u8; 3]| format!("{major}.{minor}.{patch}");
    if json {
        let said = serde_json::json!({
            "node": node,
            "firmware": text(runs.version),
            "slot": runs.slot,
            "on_trial": runs.on_trial,
            "before": before.map(|before| text(before.version)),
        });
        println!("{said}");
        return;
    }
    let trial = if runs.on_trial { ", on trial" } else { "" };
    let came = before.map_or(String::new(), |before| {
        format!(
            " (before: {} in slot {})",
            text(before.version),
            before.slot
        )
    });
    println!(
        "{node} runs {} in slot {}{trial}{came}",
        text(runs.version),
        runs.slot
    );
}
