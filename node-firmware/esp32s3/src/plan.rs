//! Core 1: the node itself. Plans, books, reports; its turns are short, and the refill interrupt
//! comes in between them.
//!
//! ```text
//!   core 0 (link.rs)  ──Parcel──▶ IN  ──▶ Node::handle ┐
//!                     ◀─Outbound─ OUT ◀── Node::poll_outbox
//!                       STOP, LINK: one word each, never full
//! ```
//!
//! A full queue is an answer: what does not fit is dropped by core 0, as if the network had lost it,
//! and the gateway sends it again. A stop has its own word and is never dropped.

use crate::{
    inputs::InputPins,
    lidar,
    outputs::BoardOutputs,
    panic,
    rmt::{RmtBackend, WANTED},
    stop_pin::StopPin,
    watchdog::PlanningWatchdog,
};
use core::sync::atomic::{AtomicBool, AtomicI32, AtomicU8, AtomicU32, Ordering};
use embassy_futures::select::select;
use embassy_sync::{blocking_mutex::raw::CriticalSectionRawMutex, signal::Signal};
use embassy_time::{Duration, Timer};
use heapless::spsc::{Consumer, Producer};
use keys::{
    AxisId, LocalMicros, NodeTopic, Stop, StopMode, batch::ORDER_BYTES_MAX, status::FaultCode,
};
use motion::{StepBackend, limits::CHANNELS};
use node::{Inbound, Node, Outbound};
use periphery::blackbox::Report;
use provision::{Found, store::OLDER};

/// Messages that wait for the node.
pub(crate) const IN_MAX: usize = 8;
/// Messages that wait for the network, 1.5 KB each in internal RAM; the node's own outbox is behind them.
pub(crate) const OUT_MAX: usize = 6;
/// Longest turnless time while something moves, µs: the shortest plan that a ring of single fast
/// steps holds is 960 µs.
const TURN_US: u64 = 400;
/// The same at rest: the stop input is looked at as often.
const REST_US: u64 = 1_000;

/// A message for the node.
#[derive(Clone, Debug)]
pub(crate) struct Parcel {
    /// When it came.
    pub(crate) at: LocalMicros,
    /// The last chunk of its key.
    pub(crate) topic: NodeTopic,
    /// Its bytes.
    pub(crate) payload: heapless::Vec<u8, ORDER_BYTES_MAX>,
}

/// There is something for the node to do.
pub(crate) static WAKE: Signal<CriticalSectionRawMutex, ()> = Signal::new();
/// There is something for the network to send.
pub(crate) static OUTGOING: Signal<CriticalSectionRawMutex, ()> = Signal::new();
/// A stop that came over the network: 0 none, 1 by the ramp, 2 at once.
pub(crate) static STOP: AtomicU8 = AtomicU8::new(0);
/// Changes of the link: odd is up.
pub(crate) static LINK: AtomicU32 = AtomicU32::new(0);
/// Signal strength, dBm; 0: none.
pub(crate) static RSSI_DBM: AtomicI32 = AtomicI32::new(0);
/// Something moves, so the flash must not be written.
pub(crate) static MOVES: AtomicBool = AtomicBool::new(false);
/// A window for the flash: see [`in_window`].
static WINDOW: AtomicU8 = AtomicU8::new(CLOSED);
const CLOSED: u8 = 0;
/// Core 0 wants to write.
const ASKED: u8 = 1;
/// Nothing moves, and nothing begins to before it is closed.
const OPEN: u8 = 2;
/// Something moves.
const REFUSED: u8 = 3;
/// The planning task runs: from then on it is asked.
static RUNS: AtomicBool = AtomicBool::new(false);

/// Calls `write`, on core 0, while nothing moves and nothing begins to. `None`: something moves.
pub(crate) fn in_window<T>(write: impl FnOnce() -> T) -> Option<T> {
    if !RUNS.load(Ordering::Acquire) {
        return Some(write());
    }
    WINDOW.store(ASKED, Ordering::Release);
    WAKE.signal(());
    // The planning task answers within a turn; if it hangs, its watchdog ends this too.
    loop {
        match WINDOW.load(Ordering::Acquire) {
            OPEN => break,
            REFUSED => {
                WINDOW.store(CLOSED, Ordering::Release);
                return None;
            }
            _ => core::hint::spin_loop(),
        }
    }
    let result = write();
    WINDOW.store(CLOSED, Ordering::Release);
    Some(result)
}

/// The node's clock: microseconds since boot.
pub(crate) fn now() -> LocalMicros {
    LocalMicros(crate::rmt::now_ticks() / motion::TICKS_PER_US)
}

/// The planning task.
pub(crate) struct Planning {
    pub(crate) node: &'static mut Node<'static, RmtBackend, BoardOutputs>,
    pub(crate) incoming: Consumer<'static, Parcel>,
    pub(crate) outgoing: Producer<'static, Outbound>,
    pub(crate) stop_pin: StopPin,
    pub(crate) inputs: InputPins,
    pub(crate) watchdog: PlanningWatchdog,
    /// What is said once, when it starts.
    pub(crate) has_psram: bool,
    pub(crate) report: Option<Report>,
    pub(crate) found: Found,
}

impl Planning {
    /// Runs the node for ever.
    pub(crate) async fn run(mut self) -> ! {
        self.tell_report();
        self.tell_record();
        self.tell_memory();
        let mut link = 0;
        let mut rssi_dbm = 0;
        let mut events_kept = (0, 0);
        RUNS.store(true, Ordering::Release);
        loop {
            self.give_window().await;
            self.take_stop();
            self.take_inputs();
            self.take_link(&mut link);
            while let Some(parcel) = self.incoming.dequeue() {
                let payload = &parcel.payload[..];
                let topic = parcel.topic;
                self.node
                    .handle(parcel.at, Inbound::Message { topic, payload });
                self.take_stop();
            }
            let measured_dbm = RSSI_DBM.load(Ordering::Relaxed);
            if core::mem::replace(&mut rssi_dbm, measured_dbm) != measured_dbm {
                let rssi_dbm = i8::try_from(measured_dbm).ok().filter(|dbm| *dbm != 0);
                self.node
                    .handle(now(), Inbound::SignalStrength { rssi_dbm });
            }
            crate::scripts::exchange(self.node, now());
            crate::lua::exchange(self.node);
            let reading_mm = lidar::READING_MM.swap(0, Ordering::AcqRel);
            if reading_mm > 0 {
                self.node.handle(now(), Inbound::Lidar { mm: reading_mm });
            }
            self.node.poll(now());
            while let Some(word) = self.node.outputs_mut().take_shown() {
                // Bounded: a word that is wrong is tried again later only.
                self.node.handle(now(), Inbound::Shift { word });
            }
            self.give_outbound();
            self.keep_events(&mut events_kept);
            let moves = self.node.motion().is_active();
            MOVES.store(moves, Ordering::Release);
            self.node.motion_mut().backend_mut().resume();
            self.watchdog.feed();
            self.wait(moves).await;
        }
    }

    /// Lets core 0 write the flash if nothing moves, and does nothing meanwhile.
    async fn give_window(&self) {
        if WINDOW.load(Ordering::Acquire) != ASKED {
            return;
        }
        if self.node.motion().is_active() {
            WINDOW.store(REFUSED, Ordering::Release);
            return;
        }
        WINDOW.store(OPEN, Ordering::Release);
        while WINDOW.load(Ordering::Acquire) == OPEN {
            // Stopped by the other core in this loop, it holds no lock that the other one wants.
            #[cfg(feature = "dual")]
            core::hint::spin_loop();
            #[cfg(not(feature = "dual"))]
            Timer::after(Duration::from_micros(100)).await;
        }
    }

    async fn wait(&self, moves: bool) {
        if WANTED.swap(false, Ordering::AcqRel) || self.inputs.has_caught() {
            return;
        }
        let latest_us = if moves { TURN_US } else { REST_US };
        let now_us = now().0;
        let due_us = self.node.poll_timeout().map_or(u64::MAX, |due| due.0);
        let wait_us = due_us.saturating_sub(now_us).min(latest_us);
        select(Timer::after(Duration::from_micros(wait_us)), WAKE.wait()).await;
    }

    fn take_stop(&mut self) {
        if let Some(active) = self.stop_pin.poll() {
            self.node.handle(now(), Inbound::StopPin { active });
        }
        let mode = match STOP.swap(0, Ordering::AcqRel) {
            0 => return,
            1 => StopMode::Decelerate,
            _ => StopMode::Halt,
        };
        let payload = Stop { mode }.to_payload();
        let topic = NodeTopic::Stop;
        self.node.handle(now(), Inbound::Message { topic, payload });
    }

    /// Tells the node what its switches did, in order.
    fn take_inputs(&mut self) {
        if !self.inputs.has_caught() {
            return;
        }
        let backend = self.node.motion().backend();
        let counted: [i64; CHANNELS] = core::array::from_fn(|index| {
            let axis = AxisId(index as u8);
            backend
                .counted_steps(axis)
                .unwrap_or_else(|| backend.played_steps(axis))
        });
        let steps = |axis: usize| counted.get(axis).copied().unwrap_or_default();
        while let Some(level) = self.inputs.poll(steps) {
            self.node.handle(now(), Inbound::Input(level));
        }
    }

    fn take_link(&mut self, seen: &mut u32) {
        let link = LINK.load(Ordering::Acquire);
        if link == *seen {
            return;
        }
        if *seen & 1 == 1 {
            self.node.handle(now(), Inbound::LinkDown);
        }
        *seen = link;
        if link & 1 == 1 {
            self.node.handle(now(), Inbound::LinkUp);
        }
    }

    fn give_outbound(&mut self) {
        let mut gave = false;
        while self.outgoing.ready() {
            let Some(outbound) = self.node.poll_outbox(now()) else {
                break;
            };
            gave |= self.outgoing.enqueue(outbound).is_ok();
        }
        if gave {
            OUTGOING.signal(());
        }
    }

    /// Keeps the newest events where the next boot finds them. `kept`: the time of the last one, and how
    /// many there were.
    fn keep_events(&mut self, kept: &mut (u64, usize)) {
        let until_us = kept.0;
        let new = self.node.trace().events();
        for (at, event) in new.filter(|(at, _)| at.0 > until_us) {
            panic::keep_event(kept.1, (at.0 / 1_000) as u32, event.kind() as u8);
            *kept = (at.0, kept.1 + 1);
        }
    }

    /// Tells how much the ring holds, and why.
    fn tell_memory(&mut self) {
        let commands = self.node.ring_commands();
        let place = if self.has_psram {
            "in PSRAM"
        } else {
            "in internal RAM: there is no PSRAM"
        };
        self.node
            .tell(now(), format_args!("queue of {commands} commands {place}"));
    }

    /// Tells that the record is not the one that was written last.
    fn tell_record(&mut self) {
        if self.found == Found::Older {
            self.node.fault(FaultCode::RECORD, now());
            self.node.tell(now(), format_args!("{OLDER}"));
        }
    }

    /// Tells what ended the boot before.
    fn tell_report(&mut self) {
        let Some(report) = self.report.take() else {
            return;
        };
        match &report.panic {
            Some(reason) => {
                self.node.fault(FaultCode::PANIC, now());
                self.node.tell(now(), format_args!("panic: {reason}"));
                self.node
                    .tell(now(), format_args!("stack: {:08x?}", &report.frames[..]));
            }
            None => {
                self.node.fault(FaultCode::RESET, now());
                self.node
                    .tell(now(), format_args!("reset: {}", report.reset));
            }
        }
        self.node.tell(
            now(),
            format_args!("events (ms, kind): {:?}", &report.events[..]),
        );
    }
}
