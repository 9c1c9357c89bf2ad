//! `fleet watch`: nodes and jobs as they change.

use crate::{
    link::{Answer, Failure, Link, read},
    show,
};
use keys::{
    FleetMicros, JobId, NodeId, NodeTopic,
    record::{JobRecord, NodeRecord},
};
use std::{
    collections::BTreeMap,
    io::{IsTerminal, Write},
    pin::pin,
    time::Duration,
};
use tokio::time::{Instant, MissedTickBehavior};

/// Time between two pictures.
const REDRAW_EVERY: Duration = Duration::from_millis(200);

/// Time between two questions that only show whether the gateway is still there.
const ASK_EVERY: Duration = Duration::from_secs(2);

/// Jobs in the picture.
const JOBS_SHOWN: usize = 12;

/// Jobs that are remembered; the oldest are forgotten.
const JOBS_KEPT: usize = 1_000;

const ENTER_SCREEN: &str = "\x1b[?1049h\x1b[?25l";
const LEAVE_SCREEN: &str = "\x1b[?25h\x1b[?1049l";
const HOME: &str = "\x1b[H";
const CLEAR_LINE_REST: &str = "\x1b[K";
const CLEAR_BELOW: &str = "\x1b[J";

#[derive(Default)]
struct Picture {
    nodes: BTreeMap<NodeId, NodeRecord>,
    jobs: BTreeMap<(FleetMicros, JobId), JobRecord>,
    changed: bool,
    /// Why what is shown may be out of date.
    silence: Option<String>,
}

impl Picture {
    fn node(&mut self, payload: &[u8]) -> Result<(), Failure> {
        let record: NodeRecord = read(payload)?;
        self.changed |= self.nodes.insert(record.node, record.clone()) != Some(record);
        Ok(())
    }

    fn job(&mut self, payload: &[u8]) -> Result<(), Failure> {
        let record: JobRecord = read(payload)?;
        let key = (record.created, record.job);
        if self
            .jobs
            .get(&key)
            .is_some_and(|known| known.version >= record.version)
        {
            return Ok(());
        }
        self.jobs.insert(key, record);
        if self.jobs.len() > JOBS_KEPT {
            self.jobs.pop_first();
        }
        self.changed = true;
        Ok(())
    }

    /// Takes the answers to a question that is asked only to see whether anybody answers.
    fn heard(&mut self, answers: Result<Vec<Answer>, Failure>, aloud: bool) -> Result<(), Failure> {
        let silence = match answers {
            Ok(answers) => {
                for payload in answers.iter().flatten() {
                    self.node(payload)?;
                }
                None
            }
            Err(failure) => failure.message().map(str::to_owned),
        };
        if self.silence != silence {
            if aloud {
                let words = silence.as_deref().unwrap_or("the gateway answers again");
                eprintln!("fleet: {words}");
            }
            self.silence = silence;
            self.changed = true;
        }
        Ok(())
    }

    fn text(&self) -> String {
        let jobs = self.jobs.values().rev().take(JOBS_SHOWN);
        let warning = self.silence.as_ref().map_or(String::new(), |silence| {
            format!("OUT OF DATE: {silence}\n\n")
        });
        format!(
            "{warning}{}\n\n{}",
            show::text(show::nodes_table(self.nodes.values())),
            show::text(show::jobs_table(jobs))
        )
    }
}

/// Restores the screen however the command ends.
struct Screen;

impl Screen {
    fn enter() -> Self {
        print_now(ENTER_SCREEN);
        Self
    }

    fn draw(&self, text: &str) {
        let mut out = HOME.to_owned();
        for line in text.lines() {
            out += line;
            out += CLEAR_LINE_REST;
            out += "\r\n";
        }
        out += CLEAR_BELOW;
        print_now(&out);
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        print_now(LEAVE_SCREEN);
    }
}

fn print_now(text: &str) {
    let mut out = std::io::stdout().lock();
    // A terminal that is gone needs no picture.
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// `fleet watch`
pub(crate) async fn watch(link: &Link, limit: Option<Duration>, json: bool) -> Result<(), Failure> {
    let states = link.keys().every_node(NodeTopic::State);
    let nodes = link.subscribe(states.as_str()).await?;
    let jobs = link.subscribe(link.keys().every_job().as_str()).await?;
    let mut picture = Picture::default();
    let screen = (!json && std::io::stdout().is_terminal()).then(Screen::enter);
    let tell = |payload: &[u8]| {
        if json {
            show::json_line(payload);
        }
    };
    for payload in link.get(states.as_str(), None).await?.iter().flatten() {
        tell(payload);
        picture.node(payload)?;
    }
    let selector = format!("{}?limit={JOBS_SHOWN}", link.keys().every_job());
    for payload in link.get(&selector, None).await?.iter().flatten() {
        tell(payload);
        picture.job(payload)?;
    }
    let mut redraw = tokio::time::interval(REDRAW_EVERY);
    redraw.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut ask_at = Instant::now() + ASK_EVERY;
    let mut asking = None;
    let mut end = pin!(async {
        match limit {
            Some(limit) => tokio::time::sleep(limit).await,
            None => std::future::pending().await,
        }
    });
    let mut interrupted = pin!(tokio::signal::ctrl_c());
    loop {
        let may_ask = asking.is_none();
        let answers = async {
            match asking.as_mut() {
                Some(answers) => answers.await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            sample = nodes.recv_async() => {
                let payload = sample?.payload().to_bytes().into_owned();
                tell(&payload);
                picture.node(&payload)?;
            }
            sample = jobs.recv_async() => {
                let payload = sample?.payload().to_bytes().into_owned();
                tell(&payload);
                picture.job(&payload)?;
            }
            answers = answers => {
                asking = None;
                ask_at = Instant::now() + ASK_EVERY;
                picture.heard(answers, screen.is_none())?;
            }
            () = tokio::time::sleep_until(ask_at), if may_ask => {
                asking = Some(Box::pin(link.get(states.as_str(), None)));
            }
            _ = redraw.tick(), if !json => {
                if std::mem::take(&mut picture.changed) {
                    match &screen {
                        Some(screen) => screen.draw(&format!("{}\n\nCtrl-C ends", picture.text())),
                        None => show::line(&picture.text()),
                    }
                }
            }
            () = &mut end => return Ok(()),
            result = &mut interrupted => return Ok(result?),
        }
    }
}
