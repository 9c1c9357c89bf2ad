//! `fleet jog`: moves single axes by hand. The node answers by itself; a run lasts as long as this
//! command, which renews its lease.

use crate::{
    args::Jog,
    link::{Failure, Link},
};
use keys::{
    NodeTopic,
    jog::{JogReceipt, JogRequest, JogWay},
};
use std::time::Duration;
use zenoh::bytes::Encoding;

/// How often a lease is renewed in its time: two may be lost.
const RENEWALS: u32 = 4;

/// Does it.
pub(crate) async fn jog(link: &Link, line: &Jog, json: bool) -> Result<(), Failure> {
    let bare = JogRequest {
        axis: line.axis,
        ..JogRequest::default()
    };
    if line.stop {
        let request = JogRequest { stop: true, ..bare };
        return ask(link, line, &request, json).await.map(drop);
    }
    let by_step = line.step.map(|way| match way {
        JogWay::Forward => 1,
        JogWay::Backward => -1,
    });
    let request = JogRequest {
        to: line.to,
        by: line.by.or(by_step),
        run: line.run,
        speed_hz: Some(line.speed),
        accel: Some(line.accel),
        jerk: line.jerk,
        lease_ms: line.run.map(|_| line.lease),
        ..bare
    };
    let jog = ask(link, line, &request, json).await?;
    if line.run.is_none() {
        return Ok(());
    }
    let renew = JogRequest {
        renew: jog,
        ..JogRequest::default()
    };
    let stop = JogRequest { stop: true, ..bare };
    let pause = Duration::from_millis(u64::from(line.lease)) / RENEWALS;
    loop {
        tokio::select! {
            _ = tokio::signal::ctrl_c() => return ask(link, line, &stop, json).await.map(drop),
            () = tokio::time::sleep(pause) => {}
        }
        // Refused: it is over, by a stop, a limit, or another hand.
        send(link, line, &renew).await?;
    }
}

/// Asks the node and shows what it answers. Returns the number of the jog.
async fn ask(
    link: &Link,
    line: &Jog,
    request: &JogRequest,
    json: bool,
) -> Result<Option<u32>, Failure> {
    let bytes = send(link, line, request).await?;
    let receipt: JogReceipt<'_> = serde_json::from_slice(&bytes)
        .map_err(|error| Failure::Failed(Some(format!("{}: {error}", line.node))))?;
    if json {
        crate::show::line(&String::from_utf8_lossy(&bytes));
    } else {
        let axis = receipt
            .axis
            .map_or("all axes".into(), |axis| format!("axis {axis}"));
        let moves = if receipt.moving { "moves" } else { "rests" };
        crate::show::line(&format!(
            "{}, {axis}: {moves}, at {}",
            line.node, receipt.position
        ));
    }
    Ok(receipt.jog)
}

async fn send(link: &Link, line: &Jog, request: &JogRequest) -> Result<Vec<u8>, Failure> {
    let key = link.keys().node(&line.node, NodeTopic::Jog);
    let bytes =
        serde_json::to_vec(request).map_err(|error| Failure::Failed(Some(error.to_string())))?;
    let payload = Some((bytes, Encoding::APPLICATION_JSON));
    let answers = link.ask(key.as_str(), payload, None).await?;
    match answers.into_iter().next() {
        Some(Ok(bytes)) => Ok(bytes),
        Some(Err(error)) => Err(Failure::Failed(Some(format!("refused: {error}")))),
        None => Err(Failure::Failed(Some(format!(
            "{} does not answer: it is not there, or its firmware cannot be jogged",
            line.node
        )))),
    }
}
