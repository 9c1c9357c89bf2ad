//! What the system tells of a process: memory, file descriptors, processor time. Zeros where it
//! does not tell.

use std::fs;

/// Resident memory of this process, KiB.
pub fn resident_kib() -> u64 {
    Usage::of("self").resident_kib
}

/// What a process uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Resident memory, KiB.
    pub resident_kib: u64,
    /// Open file descriptors.
    pub descriptors: u64,
    /// Threads.
    pub threads: u64,
    /// Processor time since its start, ms.
    pub processor_ms: u64,
}

/// What Linux counts processor time in for programs, whatever the kernel's own tick is.
const TICKS_PER_S: u64 = 100;

impl Usage {
    /// Asks for a process by its number, or `self`.
    pub fn of(process: &str) -> Self {
        let folder = format!("/proc/{process}");
        let table = fs::read_to_string(format!("{folder}/status")).unwrap_or_default();
        let line = |name: &str| {
            let line = table.lines().find_map(|line| line.strip_prefix(name));
            let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
            number.unwrap_or(0)
        };
        // Fields 14 and 15, behind the name, which may have blanks in it.
        let stat = fs::read_to_string(format!("{folder}/stat")).unwrap_or_default();
        let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
        let ticks: u64 = fields
            .split_whitespace()
            .skip(11)
            .take(2)
            .filter_map(|field| field.parse::<u64>().ok())
            .sum();
        let descriptors = fs::read_dir(format!("{folder}/fd"));
        Self {
            resident_kib: line("VmRSS:"),
            descriptors: descriptors.map_or(0, |all| all.count() as u64),
            threads: line("Threads:"),
            processor_ms: ticks * 1_000 / TICKS_PER_S,
        }
    }
}
