//! Follows jobs to their end, with bars on a terminal.

use crate::{
    link::{Failure, Link, Samples, read},
    show,
};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use keys::{JobId, record::JobRecord};
use std::{collections::BTreeMap, time::Duration};
use tokio::time::Instant;

/// How often a record that may have been missed is asked for.
const ASK_EVERY: Duration = Duration::from_secs(1);

/// Hears the records of all jobs; made before the jobs are handed in, so that nothing is missed.
pub(crate) struct Follower<'l> {
    link: &'l Link,
    samples: Samples,
    bars: bool,
}

struct Followed {
    record: Option<JobRecord>,
    bar: Option<ProgressBar>,
}

impl<'l> Follower<'l> {
    /// Begins to hear. `bars`: show progress on standard error if that is a terminal.
    pub(crate) async fn new(link: &'l Link, bars: bool) -> Result<Self, Failure> {
        let samples = link.subscribe(link.keys().every_job().as_str()).await?;
        Ok(Self {
            link,
            samples,
            bars,
        })
    }

    /// Waits until each of these jobs has ended, or the time is over; then what is known is given.
    pub(crate) async fn wait(
        self,
        jobs: &[JobId],
        limit: Option<Duration>,
    ) -> Result<Ended, Failure> {
        let bars = MultiProgress::new();
        let mut followed: BTreeMap<JobId, Followed> = jobs
            .iter()
            .map(|job| {
                let bar = self.bars.then(|| bars.add(new_bar(job)));
                (*job, Followed { record: None, bar })
            })
            .collect();
        let deadline = limit.map(|limit| Instant::now() + limit);
        self.ask(&mut followed).await?;
        let mut ask_at = Instant::now() + ASK_EVERY;
        let all_final = |followed: &BTreeMap<JobId, Followed>| {
            followed.values().all(|one| {
                one.record
                    .as_ref()
                    .is_some_and(|record| record.state.is_final())
            })
        };
        let mut timed_out = false;
        while !all_final(&followed) {
            let wake_at = deadline.map_or(ask_at, |deadline| deadline.min(ask_at));
            tokio::select! {
                sample = self.samples.recv_async() => {
                    note(&mut followed, &sample?.payload().to_bytes())?;
                }
                () = tokio::time::sleep_until(wake_at) => {
                    if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                        timed_out = true;
                        break;
                    }
                    self.ask(&mut followed).await?;
                    ask_at = Instant::now() + ASK_EVERY;
                }
            }
        }
        let records = jobs
            .iter()
            .filter_map(|job| followed.get_mut(job).and_then(|one| one.record.take()))
            .collect();
        for one in followed.values() {
            if let Some(bar) = &one.bar {
                bar.abandon();
            }
        }
        Ok(Ended { records, timed_out })
    }

    /// Asks for each record that is not final.
    async fn ask(&self, followed: &mut BTreeMap<JobId, Followed>) -> Result<(), Failure> {
        let open: Vec<JobId> = followed
            .iter()
            .filter(|(_, one)| {
                !one.record
                    .as_ref()
                    .is_some_and(|record| record.state.is_final())
            })
            .map(|(job, _)| *job)
            .collect();
        for job in open {
            let answers = self
                .link
                .get(self.link.keys().job(&job).as_str(), None)
                .await?;
            for answer in answers {
                match answer {
                    Ok(payload) => note(followed, &payload)?,
                    Err(error) => return Err(Failure::Failed(Some(format!("{job}: {error}")))),
                }
            }
        }
        Ok(())
    }
}

/// What became of the jobs.
pub(crate) struct Ended {
    /// Their last records, in the order of the jobs.
    pub(crate) records: Vec<JobRecord>,
    /// The time was over before all had ended.
    pub(crate) timed_out: bool,
}

fn note(followed: &mut BTreeMap<JobId, Followed>, payload: &[u8]) -> Result<(), Failure> {
    let record: JobRecord = read(payload)?;
    let Some(one) = followed.get_mut(&record.job) else {
        return Ok(());
    };
    let older = |known: &JobRecord| known.version >= record.version;
    if one.record.as_ref().is_some_and(older) {
        return Ok(());
    }
    if let Some(bar) = &one.bar {
        bar.set_length(record.progress.total);
        bar.set_position(record.progress.done);
        let what = format!("{} {}", record.state, show::outcome(&record));
        bar.set_message(what.trim_end().to_owned());
    }
    one.record = Some(record);
    Ok(())
}

fn new_bar(job: &JobId) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix:<14} {bar:20.cyan} {pos:>7}/{len:<7} {msg}")
        .expect("the template is legal")
        .progress_chars("━╸─");
    // Without a terminal a bar draws nothing.
    ProgressBar::new(0)
        .with_style(style)
        .with_prefix(job.to_string())
}
