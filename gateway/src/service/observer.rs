//! Questions about the fleet, also from other tasks.

use crate::observe::Snapshot;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};

/// Questions about the fleet that wait for their answer.
pub(super) const QUESTIONS_MAX: usize = 8;

/// How long the fleet may take for an answer; one that takes longer hangs.
pub const ANSWER_PATIENCE: Duration = Duration::from_secs(2);

/// Who asks what the fleet is like.
pub(super) type Question = oneshot::Sender<Snapshot>;

/// Asks the fleet what it is like.
#[derive(Clone, Debug)]
pub struct Observer {
    pub(super) questions: mpsc::Sender<Question>,
    pub(super) failed: watch::Receiver<bool>,
}

impl Observer {
    /// Returns whether the service that it asked has ended.
    pub fn is_gone(&self) -> bool {
        self.questions.is_closed()
    }

    /// Returns what the fleet is like now; `None` if it does not answer within
    /// [`ANSWER_PATIENCE`] or the store has failed.
    ///
    /// # Cancellation safety
    /// May be dropped; the answer is lost.
    pub async fn snapshot(&self) -> Option<Snapshot> {
        if *self.failed.borrow() {
            return None;
        }
        let (answer, answered) = oneshot::channel();
        let ask = async {
            self.questions.send(answer).await.ok()?;
            answered.await.ok()
        };
        tokio::time::timeout(ANSWER_PATIENCE, ask).await.ok()?
    }
}
