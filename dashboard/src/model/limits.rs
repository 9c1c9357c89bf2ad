//! How much the model keeps, with the sums.

/// Nodes. More are counted and not kept.
pub const NODES_MAX: usize = 4_096;

/// Statuses kept for each node: two minutes at 10/s. A sample has 128 bytes, so 500 nodes that move
/// all the time fill 77 MB; idle ones (1/s) a tenth of that in the same two minutes.
pub const SAMPLES_MAX: usize = 1_200;

/// Clock estimates kept for each node: ten minutes at one a second, 24 bytes each.
pub const CLOCKS_MAX: usize = 600;

/// Least time between two kept clock estimates, s.
pub const CLOCK_EVERY_S: f64 = 1.0;

/// Stretches of a node's lane: one for each change of what it does, 64 bytes each.
pub const STRETCHES_MAX: usize = 500;

/// Faults of a node that are marked in its lane.
pub const FAULTS_MAX: usize = 100;

/// Lines of the log.
pub const LOG_LINES_MAX: usize = 10_000;

/// Longest line that is kept, bytes; the rest is cut off with a mark.
pub const LOG_LINE_BYTES_MAX: usize = 2_000;

/// Job records. The oldest are forgotten; the gateway still has them.
pub const JOBS_MAX: usize = 2_000;

/// Jobs sent from this window whose text is kept, to be sent again.
pub const SENT_MAX: usize = 200;

/// Longest kept text of a sent job, bytes. A longer one cannot be sent again from the history.
pub const SENT_BYTES_MAX: usize = 1 << 20;

/// Cancels that are remembered.
pub const CANCELS_MAX: usize = 200;

/// Stops and releases that are remembered.
pub const EFFORTS_MAX: usize = 20;

/// Alarms that are kept. Those that are over and acknowledged are forgotten first.
pub const ALARMS_MAX: usize = 500;

/// Least time between two looks at every node for what comes without a message, s.
pub const ALARMS_EVERY_S: f64 = 0.1;

/// How long a node that came has until its clock is known, s: the gateway's estimate needs some
/// exchanges.
pub const CLOCK_GRACE_S: f64 = 5.0;

/// How old a synchronized start may be for its skew to be worth an alarm, s.
pub const SKEW_NEWS_S: f64 = 600.0;

/// The skew that a synchronized job of this window is promised when neither it nor the gateway
/// says anything, µs.
pub const SKEW_PROMISED_US: f64 = 1_000.0;

/// A node that is there says something at least every second; three silent ones are worth a look, s.
pub const STALE_AFTER_S: f64 = 3.0;
