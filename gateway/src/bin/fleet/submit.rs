//! `fleet submit`, `fleet jobs`, `fleet nodes`, `fleet cancel`: ask and print.

use crate::{
    args::{Export, Jobs, Submit},
    follow::Follower,
    kept,
    link::{Answer, Failure, Link, read},
    manage, show,
    sign::{sign, sign_parts},
    written::Written,
};
use keys::{
    JobId,
    job::JOB_BYTES_MAX,
    record::{JobRecord, JobState, NodeRecord, Receipt},
};
use zenoh::bytes::Encoding;

/// `fleet submit`
pub(crate) async fn submit(link: &Link, submit: &Submit, json: bool) -> Result<(), Failure> {
    let mut written = match (&submit.template, &submit.file) {
        (Some(name), _) => kept::template(link, name).await?,
        (None, Some(file)) => Written::read(file, submit.format)?,
        (None, None) => unreachable!("the command line needs one of them"),
    };
    written.fill_in(&submit.settings, submit.template.is_some())?;
    let name = written.name.clone();
    let (mut payload, mut encoding) = written.encoded(submit.id)?;
    if let (Some(key), Some(node)) = (&submit.sign, &submit.node) {
        if encoding != Encoding::APPLICATION_JSON {
            let script = String::from_utf8_lossy(&payload);
            payload = serde_json::json!({ "lua": script })
                .to_string()
                .into_bytes();
            encoding = Encoding::APPLICATION_JSON;
        }
        payload = sign(link, key, node, &payload).await?;
    }
    if submit.together {
        payload = manage::together(link, submit.label, &name, &payload, &encoding).await?;
        encoding = Encoding::APPLICATION_JSON;
    }
    if let (Some(key), None) = (&submit.sign, &submit.node) {
        if !submit.together && submit.group.is_none() {
            let words = "--sign: a label's jobs are made by the gateway; sign with --together, or one \
                         for each node";
            return Err(Failure::Usage(words.to_owned()));
        }
        payload = sign_parts(link, key, &payload).await?;
    }
    // A router drops a message that is much larger without a word to anybody.
    if payload.len() > JOB_BYTES_MAX {
        let count = payload.len();
        let words =
            format!("the job has {count} bytes; at most {JOB_BYTES_MAX} are taken: split it");
        return Err(Failure::Failed(Some(words)));
    }
    let wishes = wishes(submit);
    let follower = match submit.wait {
        Some(_) => Some(Follower::new(link, !json).await?),
        None => None,
    };
    let prefix = link.keys().prefix();
    let key = match (&submit.group, &submit.node, &submit.label) {
        (Some(group), _, _) => link.keys().group_job(group).as_str().to_owned(),
        (None, Some(node), _) => format!("{prefix}/node/{node}/job"),
        (None, None, Some(label)) if submit.together => {
            link.keys().group_job(label).as_str().to_owned()
        }
        (None, None, Some(label)) => format!("{prefix}/manage/label/{label}/job"),
        (None, None, None) => unreachable!("the command line needs one of them"),
    };
    let answers = link
        .get_with(&key, Some((payload, encoding)), wishes)
        .await?;
    let mut refused = answers.is_empty();
    if refused {
        eprintln!("fleet: no receipt for {key}");
    }
    let mut jobs: Vec<JobId> = Vec::new();
    for answer in &answers {
        match answer {
            Ok(payload) => {
                let receipt: Receipt = read(payload)?;
                jobs.push(receipt.job);
                if follower.is_some() {
                    continue;
                }
                if json {
                    show::json_line(payload);
                } else {
                    show::line(&format!("{} {}", receipt.job, receipt.state));
                }
            }
            Err(error) => {
                refused = true;
                eprintln!("fleet: refused: {error}");
            }
        }
    }
    if let Some(follower) = follower {
        let limit = submit.wait.flatten();
        let ended = follower.wait(&jobs, limit).await?;
        for record in &ended.records {
            print_record(record, json);
            refused |= record.state != JobState::Succeeded;
        }
        if ended.timed_out {
            let open: Vec<&str> = ended
                .records
                .iter()
                .filter(|record| !record.state.is_final())
                .map(|record| record.job.as_str())
                .collect();
            return Err(Failure::TimedOut(format!(
                "not ended in time: {}",
                open.join(", ")
            )));
        }
    }
    if refused {
        return Err(Failure::Failed(None));
    }
    Ok(())
}

/// Returns the attachment that says how important a job is and when it may begin.
fn wishes(submit: &Submit) -> Option<Vec<u8>> {
    let mut wishes = serde_json::Map::new();
    if let Some(priority) = submit.priority {
        wishes.insert("priority".to_owned(), priority.into());
    }
    if submit.when_idle {
        wishes.insert("when_idle".to_owned(), true.into());
    }
    if let Some(at) = submit.at {
        wishes.insert("not_before".to_owned(), at.to_string().into());
    }
    (!wishes.is_empty()).then(|| serde_json::Value::from(wishes).to_string().into_bytes())
}

fn print_record(record: &JobRecord, json: bool) {
    if json {
        show::json_line(&keys::record::to_json(record));
    } else {
        let text = format!(
            "{} {} {}/{} {}",
            record.job,
            record.state,
            record.progress.done,
            record.progress.total,
            show::outcome(record)
        );
        show::line(text.trim_end());
    }
}

/// Sorts answers into payloads and refusals, and prints the latter.
pub(crate) fn accepted(answers: Vec<Answer>) -> (Vec<Vec<u8>>, bool) {
    let mut refused = false;
    let payloads = answers
        .into_iter()
        .filter_map(|answer| {
            answer
                .map_err(|error| {
                    refused = true;
                    eprintln!("fleet: refused: {error}");
                })
                .ok()
        })
        .collect();
    (payloads, refused)
}

pub(crate) fn verdict(refused: bool) -> Result<(), Failure> {
    if refused {
        return Err(Failure::Failed(None));
    }
    Ok(())
}

/// `fleet nodes`
pub(crate) async fn nodes(link: &Link, json: bool) -> Result<(), Failure> {
    let key = link.keys().every_node(keys::NodeTopic::State);
    let (payloads, refused) = accepted(link.get(key.as_str(), None).await?);
    if json {
        payloads.iter().for_each(|payload| show::json_line(payload));
    } else if payloads.is_empty() && !refused {
        show::line("no nodes: the gateway has not seen any yet");
    } else {
        let mut records: Vec<NodeRecord> = payloads
            .iter()
            .map(|payload| read(payload))
            .collect::<Result<_, _>>()?;
        records.sort_by_key(|record| record.node);
        show::print(show::nodes_table(&records));
    }
    verdict(refused)
}

/// `fleet jobs`
pub(crate) async fn jobs(link: &Link, jobs: &Jobs, json: bool) -> Result<(), Failure> {
    let mut selector = format!("{}?limit={}", link.keys().every_job(), jobs.limit);
    if let Some(state) = jobs.state {
        selector += &format!(";state={state}");
    }
    if let Some(node) = jobs.node {
        selector += &format!(";node={node}");
    }
    let (payloads, refused) = accepted(link.get(&selector, None).await?);
    if let Some(export) = jobs.export {
        let records: Vec<JobRecord> = payloads
            .iter()
            .map(|payload| read(payload))
            .collect::<Result<_, _>>()?;
        match export {
            Export::Csv => show::csv(&records),
            Export::Json => show::json_line(&keys::record::to_json(&records)),
        }
        return verdict(refused);
    }
    if json {
        payloads.iter().for_each(|payload| show::json_line(payload));
    } else if payloads.is_empty() && !refused {
        show::line("no such jobs");
    } else {
        let records: Vec<JobRecord> = payloads
            .iter()
            .map(|payload| read(payload))
            .collect::<Result<_, _>>()?;
        show::print(show::jobs_table(&records));
    }
    verdict(refused)
}

/// `fleet cancel`
pub(crate) async fn cancel(link: &Link, job: &str, json: bool) -> Result<(), Failure> {
    let key = format!("{}/job/{job}/cancel", link.keys().prefix());
    let (payloads, refused) = accepted(link.get(&key, None).await?);
    if payloads.is_empty() && !refused {
        return Err(Failure::Failed(Some(format!("no job matches {job}"))));
    }
    for payload in payloads {
        if json {
            show::json_line(&payload);
        } else {
            print_record(&read(&payload)?, false);
        }
    }
    verdict(refused)
}
