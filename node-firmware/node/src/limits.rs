//! Every number of the node, with its reason.

/// Commands that a ring holds when nothing else is said: 4096 records of 32 bytes are 128 KiB of
/// PSRAM.
pub const RING_COMMANDS_DEFAULT: usize = 4096;

/// Time between two statuses while commands are executed: 10 a second.
pub const STATUS_ACTIVE_US: u64 = 100_000;

/// Time between two statuses otherwise: 1 a second.
pub const STATUS_IDLE_US: u64 = 1_000_000;

/// How long the link may be gone before the policy of [`LinkLoss`](crate::LinkLoss) applies.
/// A router that restarts and a WiFi roam take about a second; a machine without anybody who
/// could cancel a job should not move much longer.
pub const LINK_LOSS_AFTER_US_DEFAULT: u64 = 2_000_000;

/// Acks that wait for the link. Four batches may be on their way at a time, each with one ack,
/// and a credit beside them.
pub const ACKS_MAX: usize = 8;

/// Clock replies that wait for the link. An older one than that measures the wait, not the clock.
pub const CLOCK_REPLIES_MAX: usize = 4;

/// Messages about a start that wait for the link. The oldest goes first: what matters is said again.
pub const STARTS_MAX: usize = 4;

/// Answers to requests for jogs that wait for the link. The oldest goes first: who waits longest has
/// given up.
pub const JOG_ANSWERS_MAX: usize = 8;

/// Time between two Ready of a node that waits at a barrier: ten a second, so that a lost one
/// delays a start by no more than a person notices.
pub const READY_US: u64 = 100_000;

/// Least time from the last moment of a confirmation to the start: the lead-in must be loaded.
pub const CONFIRM_MARGIN_US: u64 = 2_000;

/// Time from the word that resumes to the first command behind a rest: the lead-in must be loaded.
pub const RESUME_LEAD_US: u64 = 20_000;

/// How often a start is told.
pub const STARTED_COUNT: u8 = 5;

/// Time between two of them: one second in all, longer than most losses of a WiFi link.
pub const STARTED_US: u64 = 200_000;

/// Log lines that wait for the link or for their turn.
pub const LOG_LINES_MAX: usize = 16;

/// Longest log line; what is longer is cut.
pub const LOG_LINE_BYTES_MAX: usize = 160;

/// Log lines that may leave at once.
pub const LOG_BURST_LINES: u8 = 8;

/// After a burst, one more log line may leave each 200 ms: 5 a second.
pub const LOG_LINE_US: u64 = 200_000;

/// Events that the trace keeps.
pub const TRACE_EVENTS: usize = 64;

/// Events of a job that wait for the link: what happens to one while it is gone.
pub const TOLD_EVENTS_MAX: usize = 8;

const _: () = assert!(keys::trace::TRACE_BYTES_MAX <= OUTBOUND_BYTES_MAX);

/// A credit is told unasked when this part of the ring has become free since it was told last.
/// A quarter: the gateway can send again while three quarters are still to be executed, and a
/// job causes at most four such acks for each filling of the ring.
pub const CREDIT_SHARE: usize = 4;

/// Time between two reports of a script that has ended, until one is answered.
pub const REPORT_US: u64 = 500_000;

/// Barriers of one script: a name of 65 bytes each.
pub const BARRIERS_MAX: usize = 256;

/// A script that has queued nothing for so long has filled the queue behind a barrier as far as it
/// will: one that looks again and again whether it is over never waits for anything.
pub const SCRIPT_QUIET_US: u64 = 100_000;

/// Values that a script has published and that wait for the link.
pub const PUBLICATIONS_MAX: usize = 8;

/// Most bytes of one outbound message: the report of a script is the longest.
pub const OUTBOUND_BYTES_MAX: usize = keys::script::REPORT_BYTES_MAX;

const _: () = assert!(keys::status::STATUS_BYTES_MAX <= OUTBOUND_BYTES_MAX);
const _: () = assert!(script::JSON_BYTES_MAX <= OUTBOUND_BYTES_MAX);

const _: () = assert!(LOG_LINE_BYTES_MAX <= OUTBOUND_BYTES_MAX);
