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
    let stop = JogRequest { stop: true, ..bare };
    if line.stop {
        return ask(link, line, &stop, json).await.map(drop);
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
    if line.run.is_none() {
        return ask(link, line, &request, json).await.map(drop);
    }
    // It counts from before the axis is told to move, and while an answer is on its way.
    tokio::select! {
        biased;
        _ = tokio::signal::ctrl_c() => {}
        failure = run(link, line, &request, json) => return Err(failure),
    }
    ask(link, line, &stop, json).await.map(drop)
}

/// Lets an axis run and renews that, until something is in the way.
async fn run(link: &Link, line: &Jog, request: &JogRequest, json: bool) -> Failure {
    let jog = match ask(link, line, request, json).await {
        Ok(jog) => jog,
        Err(failure) => return failure,
    };
    let renew = JogRequest {
        renew: jog,
        ..JogRequest::default()
    };
    let pause = Duration::from_millis(u64::from(line.lease)) / RENEWALS;
    loop {
        tokio::time::sleep(pause).await;
        match send(link, line, &renew).await {
            Ok(bytes) if json => crate::show::json_line(&bytes),
            Ok(_) => {}
            Err(Failure::Failed(Some(error))) => {
                // By a stop, a limit, another hand, or because nobody was heard in time.
                return Failure::Failed(Some(format!("the run has ended: {error}")));
            }
            Err(failure) => return failure,
        }
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
        crate::show::json_line(&bytes);
    } else {
        crate::show::line(&words(line, request, &receipt));
    }
    Ok(receipt.jog)
}

/// What a person reads of an answer.
fn words(line: &Jog, request: &JogRequest, receipt: &JogReceipt<'_>) -> String {
    let (node, at) = (&line.node, receipt.position);
    let Some(axis) = receipt.axis else {
        let what = if receipt.moving { "slow down" } else { "rest" };
        return format!("{node}: all axes {what}");
    };
    match (request.stop, receipt.moving, request.run) {
        (true, true, _) => format!("{node}, axis {axis}: slows down, at {at}"),
        (_, false, _) => format!("{node}, axis {axis}: rests, at {at}"),
        (false, true, Some(_)) => {
            format!("{node}, axis {axis}: runs, from {at}; Ctrl-C brings it to rest")
        }
        (false, true, None) => format!("{node}, axis {axis}: moves, from {at}"),
    }
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
