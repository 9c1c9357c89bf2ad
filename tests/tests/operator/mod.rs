//! An operator without a window: the dashboard's link and model, and what is asked for.

#![allow(dead_code, reason = "each test binary uses its own part of it")]

use dashboard::{
    app::Dashboard,
    link::{Clock, Link, LinkConfig, Place},
    message::Answer,
    model::Model,
    panels::{composer, group_job},
    request::{Language, Request, Target, Ticket},
};
use keys::{Keys, NodeId, credentials::Credentials};
use std::{
    sync::mpsc,
    time::{Duration, Instant},
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(120);

/// Without news the model's time must go on too: ages are part of what it shows.
const TICK: Duration = Duration::from_millis(100);

/// See the module.
pub(crate) struct Operator {
    /// What is known and looked at.
    pub(crate) dashboard: Dashboard,
    link: Link,
    news: mpsc::Receiver<()>,
}

impl Operator {
    /// Connects to a router.
    pub(crate) fn at(locator: &str, credentials: Option<Credentials>) -> Self {
        let (wake, news) = mpsc::sync_channel(1);
        let config = LinkConfig {
            place: Place::At(locator.to_owned()),
            keys: Keys::default(),
            credentials,
        };
        let wake = move || {
            // One that waits is enough.
            let _ = wake.try_send(());
        };
        Self {
            dashboard: Dashboard::default(),
            link: Link::spawn(config, Clock::start(), wake).expect("a thread"),
            news,
        }
    }

    /// Returns what is known.
    pub(crate) fn model(&self) -> &Model {
        &self.dashboard.model
    }

    fn listen(&mut self) {
        // Either there is news, or time has passed; both are looked at.
        let _ = self.news.recv_timeout(TICK);
        for (at, message) in self.link.heard() {
            self.dashboard.model.apply(at, message);
        }
        self.dashboard.model.tick(self.link.now());
    }

    /// Listens until the model shows it.
    pub(crate) fn until(&mut self, what: &str, shows: impl Fn(&Model) -> bool) {
        let began = Instant::now();
        while !shows(&self.dashboard.model) {
            if began.elapsed() > PATIENCE {
                let lines = self.dashboard.model.log().lines().iter();
                let lines: Vec<_> = lines.map(|line| line.text.as_str()).collect();
                panic!("never: {what}\n{}", lines.join("\n"));
            }
            tokio::task::block_in_place(|| self.listen());
        }
    }

    /// Asks for something.
    pub(crate) fn ask(&mut self, request: Request) -> Ticket {
        let ticket = self.dashboard.requests.push(request);
        self.hand_over();
        ticket
    }

    fn hand_over(&mut self) {
        for (ticket, request) in self.dashboard.take_requests(self.link.now()) {
            self.link.ask(ticket, request);
        }
    }

    /// Types a job for a node or a wild chunk into the composer and sends it, as its button does.
    pub(crate) fn submit(&mut self, target: &str, text: &str) -> Ticket {
        let Dashboard {
            model,
            view,
            requests,
            ..
        } = &mut self.dashboard;
        let composer = &mut view.composer;
        (composer.target, composer.text) = (target.to_owned(), text.to_owned());
        composer.language = Language::Json;
        let ticket = composer::send(model, view, requests).expect("the button can be clicked");
        self.hand_over();
        ticket
    }

    /// Types the parts of a synchronized job into its editor and starts it.
    pub(crate) fn start_together(&mut self, group: &str, parts: &[(NodeId, String)]) -> Ticket {
        let Dashboard {
            model,
            view,
            requests,
            ..
        } = &mut self.dashboard;
        view.group_job.group = group.to_owned();
        view.group_job.parts = parts.iter().cloned().collect();
        let ticket = group_job::send(model, view, requests).expect("the button can be clicked");
        self.hand_over();
        ticket
    }

    /// Sends what no editor lets out.
    pub(crate) fn submit_unchecked(&mut self, target: &str, text: &str) -> Ticket {
        self.ask(Request::Submit {
            target: Target::Node(target.to_owned()),
            language: Language::Json,
            text: text.to_owned(),
        })
    }

    /// Closes the link.
    pub(crate) fn leave(self) {
        tokio::task::block_in_place(|| drop(self.link));
    }
}

/// Returns the answer to a job.
pub(crate) fn answer(model: &Model, ticket: Ticket) -> Option<&Answer> {
    let mut sent = model.jobs().sent();
    let sent = sent.find(|sent| sent.ticket == ticket)?;
    sent.answer.as_ref()
}
