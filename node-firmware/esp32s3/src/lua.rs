//! Core 0: the interpreter of scripts. What a script calls goes to the node on core 1 as a letter, and
//! the script waits for the answer; meanwhile core 1 owes it nothing but that.
//!
//! ```text
//!   interpret ─ Board::ask ─▶ ASKED ─▶ plan.rs: exchange ─▶ Node::answer_script
//!       ▲  ▲                  TOLD ◀───────────┘  │
//!       │  └─────────────────── WORDS ◀───────────┘ begin, end
//!       └────────────────────── DUE, TURN
//! ```
//!
//! A letter takes a turn of the planning task; so long core 0 waits for it, as it does for a window for
//! the flash. Slices are short, so that the network is served between them.

use crate::{
    plan::{WAKE, now},
    rmt::RmtBackend,
};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use embassy_futures::{select::select, yield_now};
use embassy_sync::{
    blocking_mutex::raw::CriticalSectionRawMutex, channel::Channel, signal::Signal,
};
use embassy_time::{Duration, Timer};
use node::{
    Node, Outputs,
    interpreter::{Asked, Interpreter, Limits, Mail, ToInterpreter, Told},
};

/// What a script may take here: about half of core 0, and the network waits 1 ms at most for a slice
/// without calls. A runaway ends after 40 s.
pub(crate) const LIMITS: Limits = Limits {
    memory_bytes: 1 << 20,
    slice_instructions: 1_000,
    slice_us: 2_000,
    work_max: 200_000,
    runaway_instructions: 20_000_000,
    wall_us: 86_400_000_000,
};

/// A letter to the node: one at a time.
static ASKED: Channel<CriticalSectionRawMutex, (u32, Asked), 1> = Channel::new();
/// Its answer, and that it is there.
static TOLD: Channel<CriticalSectionRawMutex, Option<Told>, 1> = Channel::new();
static ANSWERED: AtomicBool = AtomicBool::new(false);
/// What the interpreter has to know: as many as the node keeps.
static WORDS: Channel<CriticalSectionRawMutex, ToInterpreter, 2> = Channel::new();
/// The run whose wait is over; 0: none.
static DUE: AtomicU32 = AtomicU32::new(0);
/// There is something for the interpreter to do.
static TURN: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// The way to the other core.
struct Board;

impl Mail for Board {
    fn ask(&mut self, run: u32, asked: Asked) -> Option<Told> {
        // There is room: the letter before was answered.
        let _ = ASKED.try_send((run, asked));
        WAKE.signal(());
        // The planning task answers within a turn; if it hangs, its watchdog ends this too.
        // On a word of its own: taking the channel's lock again and again would hold the other core up.
        while !ANSWERED.load(Ordering::Acquire) {
            core::hint::spin_loop();
        }
        ANSWERED.store(false, Ordering::Relaxed);
        TOLD.try_receive().ok().flatten()
    }

    fn due(&mut self) -> u32 {
        DUE.load(Ordering::Acquire)
    }
}

/// Interprets one script after the other, for ever.
#[embassy_executor::task]
pub(crate) async fn interpret() {
    let mut interpreter = Interpreter::new();
    #[cfg(feature = "psram")]
    interpreter.set_heap(crate::heap::LUA_HEAP);
    loop {
        while let Ok(word) = WORDS.try_receive() {
            interpreter.handle(now(), word, &mut Board);
        }
        interpreter.step(now(), &mut Board);
        // The network first, whatever the script does.
        yield_now().await;
        match interpreter.poll_timeout() {
            None => TURN.wait().await,
            Some(due) => {
                let wait_us = due.0.saturating_sub(now().0);
                select(Timer::after(Duration::from_micros(wait_us)), TURN.wait()).await;
            }
        }
    }
}

/// The node's side, in each of its turns.
pub(crate) fn exchange<O: Outputs>(node: &mut Node<'static, RmtBackend, O>) {
    if let Ok((run, asked)) = ASKED.try_receive() {
        let told = node.answer_script(now(), run, asked);
        // There is room: the answer before was taken.
        let _ = TOLD.try_send(told);
        ANSWERED.store(true, Ordering::Release);
    }
    let mut turn = false;
    while !WORDS.is_full() {
        let Some(word) = node.take_script_word() else {
            break;
        };
        turn |= WORDS.try_send(word).is_ok();
    }
    let due = node.script_due();
    turn |= DUE.swap(due, Ordering::AcqRel) != due && due != 0;
    if turn {
        TURN.signal(());
    }
}
