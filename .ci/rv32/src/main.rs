//! Counts the motion core's instructions on a 32-bit machine: qemu's `virt` board executes each
//! case in both lengths, with one count of `minstret` for each instruction (`-icount shift=0`).
//! For each length it prints: case, size, words, instructions of the refills, of planning, ticks of
//! the motion, accesses of the refills to the hardware, units, axes, name.
#![no_std]
#![no_main]

#[path = "../../../node-firmware/rmt/benches/cases/mod.rs"]
#[expect(dead_code, reason = "what a unit is called is the PC's to print")]
mod cases;
#[path = "../../../node-firmware/rmt/benches/run/mod.rs"]
mod run;

use core::{
    arch::{asm, global_asm},
    fmt::{self, Write},
    panic::PanicInfo,
    ptr,
    sync::atomic::AtomicU32,
};
use keys::command::COMMAND_WORDS;

global_asm!(
    ".section .text.start",
    ".globl _start",
    "_start:",
    "la sp, _stack",
    "call main",
);

const MEMORY_WORDS: usize = 4_096 * COMMAND_WORDS;

static MEMORY: [AtomicU32; MEMORY_WORDS] = [const { AtomicU32::new(0) }; MEMORY_WORDS];

/// Serial port of the board.
const SERIAL: *mut u8 = 0x1000_0000 as *mut u8;

/// Writing this here ends the machine.
const POWER: *mut u32 = 0x10_0000 as *mut u32;
const PASS: u32 = 0x5555;
const FAIL: u32 = 0x1_3333;

struct Serial;

impl Write for Serial {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            // SAFETY: the board's serial port, which nothing else uses.
            unsafe { ptr::write_volatile(SERIAL, byte) };
        }
        Ok(())
    }
}

fn instructions() -> u32 {
    let count: u32;
    // SAFETY: reads a counter.
    unsafe { asm!("csrr {}, minstret", out(reg) count) };
    count
}

fn all_instructions() -> u64 {
    loop {
        let (high, again): (u32, u32);
        // SAFETY: reads a counter, whose upper half may change between the two.
        unsafe { asm!("csrr {}, minstreth", out(reg) high) };
        let low = instructions();
        // SAFETY: likewise.
        unsafe { asm!("csrr {}, minstreth", out(reg) again) };
        if high == again {
            return u64::from(high) << 32 | u64::from(low);
        }
    }
}

fn power_off(how: u32) -> ! {
    // SAFETY: the board's power switch.
    unsafe { ptr::write_volatile(POWER, how) };
    loop {}
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let _ = writeln!(Serial, "{info}");
    power_off(FAIL)
}

// SAFETY: nothing else has this name.
#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    for (index, case) in cases::CASES.iter().enumerate() {
        for size in case.sizes {
            let before = all_instructions();
            let run = run::execute(
                &MEMORY,
                case.axis_count,
                case.commands(size),
                case.stops,
                instructions,
            );
            let all = all_instructions() - before;
            let _ = writeln!(
                Serial,
                "{index} {size} {} {} {} {} {} {} {} {}",
                run.words,
                run.refill_instructions,
                all - run.refill_instructions - run.own_instructions,
                run.ticks,
                run.accesses,
                (case.units)(size),
                case.axis_count,
                case.name,
            );
        }
    }
    power_off(PASS)
}
