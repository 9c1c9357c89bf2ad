//! The node on the board: takes the parts, connects them, lets them run. No decisions here.
//!
//! ```text
//!   core 0: wifi.rs · link.rs (zenoh) · lua.rs · serial.rs · lidar.rs     core 1: plan.rs (the node)
//!              └── two queues, plan.rs; a letter at a time, lua.rs ──────────┘
//!                                 core 1's interrupts: refill (rmt.rs), edge (inputs.rs), C (cd.rs)
//! ```
//!
//! On a chip with one core both run there; the refill interrupt comes before either.
#![no_std]
#![no_main]
#![cfg_attr(target_arch = "xtensa", feature(asm_experimental_arch))]

extern crate alloc;

mod board;
#[cfg(feature = "timers")]
mod cd;
mod flash;
mod heap;
mod inputs;
mod lamp;
mod lidar;
mod link;
mod lua;
mod name;
mod outputs;
mod panic;
mod plan;
mod psram;
#[cfg(feature = "timers")]
mod pwm;
mod rmt;
mod scout;
mod scripts;
mod secure;
mod serial;
mod shift;
mod stop_pin;
mod vitals;
mod watchdog;
mod wifi;

use crate::{
    flash::CoreFlash,
    inputs::InputPins,
    link::BoardKeeper,
    outputs::BoardOutputs,
    plan::{IN_MAX, OUT_MAX, Parcel, Planning},
    rmt::RmtBackend,
    serial::RecordFlash,
    shift::ShiftRegister,
    stop_pin::StopPin,
    watchdog::PlanningWatchdog,
};
#[cfg(feature = "dual")]
use core::sync::atomic::Ordering;
use core::{cell::RefCell, sync::atomic::AtomicU32};
use embassy_executor::Spawner;
use embassy_futures::select::{Either, select};
use embassy_net::StackResources;
#[cfg(feature = "counters")]
use esp_hal::pcnt::Pcnt;
use esp_hal::{
    Async, clock::CpuClock, interrupt::Priority, rng::Rng, system::software_reset,
    timer::timg::TimerGroup, usb::usb_serial_jtag::UsbSerialJtag,
};
use esp_rtos::embassy::InterruptExecutor;
use esp_storage::FlashStorage;
use esp_wifi::wifi::{ControllerConfig, Interface, WifiController};
use heapless::{Vec, spsc::Queue};
use keys::{Keys, command::COMMAND_WORDS};
use motion::{MotionConfig, PlanMemory, io::input::INPUTS_MAX};
use node::{
    Node, NodeConfig, Outbound,
    setup::{self, Surroundings},
};
use provision::{Dialogue, Found, PinUse, Record, Store, Wiring, record::NETWORKS_MAX};
use static_cell::{ConstStaticCell, StaticCell};
use update::{Keeper, Layout};

esp_bootloader_esp_idf::esp_app_desc!();

/// Version of the firmware, told in the first line of the node's log.
const FIRMWARE: [u8; 3] = [0, 1, 0];

/// Heap in internal RAM, see `heap.rs`. On the ESP32-S3 it is what the boot loader leaves behind, which
/// static data cannot have: 73,744 bytes. Without PSRAM everything lies in it, the small ring, too.
const HEAP_BYTES: usize = 72 * 1024;

/// Stack of the second core: the deepest way through the planner, a job that changes while it moves, takes
/// 53 KiB by the frames of its functions, and 4 KiB lie below the guard. Lua's C calls are on the first
/// core's stack.
#[cfg(feature = "dual")]
const STACK_BYTES: usize = 64 * 1024;

/// The node on this board.
type BoardNode = Node<'static, RmtBackend, BoardOutputs>;

macro_rules! keep {
    ($type:ty, $value:expr) => {{
        static CELL: StaticCell<$type> = StaticCell::new();
        CELL.init($value)
    }};
}

/// Random bytes for zenoh-keyexpr's hash maps and for the keys of TLS. They are unpredictable while the
/// radio is on, and without it there is no router to talk to.
fn hardware_random(bytes: &mut [u8]) -> Result<(), getrandom::Error> {
    Rng::new().read(bytes);
    Ok(())
}

getrandom::register_custom_getrandom!(hardware_random);

fn random_u64() -> u64 {
    let random = Rng::new();
    u64::from(random.random()) << 32 | u64::from(random.random())
}

fn node_config(record: &Record, boot: u32) -> NodeConfig {
    let name = record.name.expect("only a complete record gets here");
    let mut motion = provision::kit::motion_of(record, board::axes());
    // Without their timers, their commands end at once, as on a node that has none.
    if !cfg!(feature = "timers") {
        motion.cd = None;
    }
    NodeConfig {
        keys: keys_of(record),
        firmware: FIRMWARE,
        script: lua::LIMITS,
        scripts_elsewhere: true,
        boot_script: record.boot_script,
        signers: record.signers.iter().copied().collect(),
        motion,
        ..NodeConfig::new(name, boot)
    }
}

/// Lets the board have the pins that its record says, all outputs low. Returns whether they can be so; else
/// nothing is driven: whatever is behind a pin may be something else than this program believes.
#[inline(never)]
fn wire(record: &Record, found: Found) -> bool {
    if found == Found::Damaged {
        esp_println::println!("the record is damaged: nothing moves, no pin is driven");
        return false;
    }
    if let Err(fault) = provision::wiring::check(&record.wiring, &record.machine, board::CHIP) {
        esp_println::println!("the pins: {fault}");
        return false;
    }
    board::wire(&record.wiring, &record.machine);
    outputs::hold_low();
    true
}

/// What the node says that it runs on.
const CHIP: &str = if cfg!(feature = "esp32c6") {
    "ESP32-C6"
} else if cfg!(feature = "esp32s31") {
    "ESP32-S31"
} else {
    "ESP32-S3"
};

/// Returns what the node tells of itself.
#[inline(never)]
fn setup_of(record: &Record, boot: u32, ring_commands: usize) -> alloc::vec::Vec<u8> {
    let networks = record.networks.iter().map(|network| network.ssid.as_str());
    let networks: Vec<&str, NETWORKS_MAX> = networks.collect();
    let around = Surroundings {
        chip: CHIP,
        ring_commands,
        router: &record.router,
        tls: record.authority.is_some(),
        user: record.login.as_ref().map(|login| login.user.as_str()),
        networks: &networks,
        update_key: record.update_key.as_ref(),
    };
    setup::json_of(&node_config(record, boot), &around)
}

/// Returns the pin of each input, in the order in which motion has them; `None`: a switch that the
/// board has no pin for, or a machine that cannot be.
fn input_pins(config: &MotionConfig, wiring: &Wiring) -> Option<Vec<u8, INPUTS_MAX>> {
    if let Err(error) = config.check() {
        esp_println::println!("the machine: {error}");
        return None;
    }
    let roles = (0..INPUTS_MAX).map_while(|index| config.inputs.get(index));
    let pins = roles.map(|input| wiring.pin(PinUse::of_role(input.role)?));
    pins.collect()
}

/// Returns the pin of each input of a record's machine; `None`: nothing moves.
#[inline(never)]
fn machine_pins(record: &Record, boot: u32) -> Option<Vec<u8, INPUTS_MAX>> {
    let complete = record.is_complete();
    let pins = complete.then(|| input_pins(&node_config(record, boot).motion, &record.wiring));
    pins.flatten()
}

fn keys_of(record: &Record) -> Keys {
    // A prefix that is none was refused when it was set.
    Keys::new(&record.prefix).unwrap_or_default()
}

/// Makes the node where it stays.
#[inline(never)]
fn made_node(
    ring: &'static [AtomicU32],
    backend: RmtBackend,
    outputs: BoardOutputs,
    config: NodeConfig,
) -> &'static mut BoardNode {
    static NODE: StaticCell<BoardNode> = StaticCell::new();
    static PLANS: ConstStaticCell<PlanMemory> = ConstStaticCell::new(PlanMemory::new());
    NODE.uninit().write(Node::new(
        ring,
        PLANS.take().plans(),
        backend,
        outputs,
        config,
    ))
}

/// Makes the dialogue where it stays: it has two records, and is too large to be handed on.
#[inline(never)]
fn made_dialogue(flash: CoreFlash) -> &'static mut Dialogue<RecordFlash> {
    let store = Store::new(RecordFlash::new(flash, update::layout::RECORD))
        .expect("the partition has two erase units");
    keep!(
        Dialogue<RecordFlash>,
        Dialogue::blank(store, FIRMWARE, board::CHIP)
    )
}

/// Copies what it has read to where it stays: the dialogue may change its own.
#[inline(never)]
fn kept_record(dialogue: &Dialogue<RecordFlash>) -> &'static Record {
    keep!(Record, dialogue.record().clone())
}

/// Makes the sockets' memory where it stays.
#[inline(never)]
fn kept_resources() -> &'static mut StackResources<6> {
    keep!(StackResources<6>, StackResources::new())
}

#[embassy_executor::task]
async fn plan_task(planning: Planning) {
    planning.run().await;
}

/// Lets the second core serve its interrupts, and wakes its planning task when the refill interrupt has said
/// so. Timers alone would not do: theirs is an interrupt of the other core, which may have it masked for longer
/// than what is planned lasts.
#[cfg(feature = "dual")]
fn rest() -> ! {
    loop {
        // SAFETY: waits for an interrupt, with all of them let in.
        #[cfg(target_arch = "xtensa")]
        unsafe {
            core::arch::asm!("waiti 0", options(nomem, nostack));
        }
        // SAFETY: waits for an interrupt.
        #[cfg(not(target_arch = "xtensa"))]
        unsafe {
            core::arch::asm!("wfi", options(nomem, nostack));
        }
        if rmt::WANTED.load(Ordering::Acquire) {
            plan::WAKE.signal(());
        }
    }
}

/// The node without a network: only the serial line, and the way back of a firmware on trial.
async fn talk_only(
    port: UsbSerialJtag<'static, Async>,
    dialogue: &'static mut Dialogue<RecordFlash>,
    prompts: bool,
    mut keeper: Option<BoardKeeper>,
) -> ! {
    let talk = serial::run(port, dialogue, prompts);
    match select(talk, serial::keep_trial(&mut keeper)).await {
        Either::First(never) | Either::Second(never) => never,
    }
}

#[esp_rtos::main]
async fn main(spawner: Spawner) -> ! {
    vitals::paint_first();
    let config = esp_hal::Config::default().with_cpu_clock(CpuClock::max());
    let mut parts = esp_hal::init(config);
    // The HAL has switched the boot loader's off.
    watchdog::watch_boot(parts.RTC_TIMER.reborrow());
    // Whatever fails behind this has been tried once, and a firmware that was tried before without success
    // is left before it can fail again. So nothing comes first that a firmware may break. Until the record
    // was read, some ms later, all pins float as they do while the boot loader runs: which of them are
    // outputs, it says.
    let storage = FlashStorage::new(parts.FLASH);
    #[cfg(feature = "dual")]
    let storage = storage.multicore_auto_park();
    let storage = keep!(RefCell<FlashStorage<'static>>, RefCell::new(storage));
    let flash = CoreFlash::new(storage);
    let slot = flash::running_slot(flash);
    let mut keeper = Keeper::boot(flash, Layout::BOARD, slot, FIRMWARE, plan::now().0).ok();
    if keeper
        .as_mut()
        .is_some_and(|keeper| keeper.poll(plan::now().0, false))
    {
        software_reset();
    }

    let dialogue = made_dialogue(flash);
    dialogue.read().expect("the flash we run from is readable");
    let found = dialogue.found();
    let record = kept_record(dialogue);
    let is_wired = wire(record, found);

    #[cfg(feature = "esp32s3")]
    esp_alloc::heap_allocator!(#[esp_hal::ram(reclaimed)] size: HEAP_BYTES);
    #[cfg(not(feature = "esp32s3"))]
    esp_alloc::heap_allocator!(size: HEAP_BYTES);
    let report = panic::take_report();
    if let Some(report) = &report {
        esp_println::println!("the boot before: {report:?}");
    }
    #[cfg(feature = "psram")]
    let ring = psram::ring_memory(parts.PSRAM);
    #[cfg(not(feature = "psram"))]
    let ring = psram::ring_memory();
    let timers = TimerGroup::new(parts.TIMG0);
    esp_rtos::start(timers.timer0, parts.FROM_CPU_INTR0);
    spawner.spawn(watchdog::watch(parts.RTC_TIMER).expect("spawned once"));

    if let Some(keeper) = keeper.as_mut() {
        keeper.trust(record.update_key);
    }
    let boot = random_u64() as u32;
    let pins = is_wired.then(|| machine_pins(record, boot)).flatten();
    // A machine that cannot be is like one that nobody has told: nothing moves.
    let provisioned = pins.is_some();
    spawner.spawn(lamp::show(provisioned).expect("spawned once"));
    let port = UsbSerialJtag::new(parts.USB_DEVICE).into_async();
    let Some(input_pins) = pins else {
        talk_only(port, dialogue, true, keeper).await;
    };
    // The radio before whatever else wants memory: what it takes, it takes here and now.
    let wifi = WifiController::new(parts.WIFI, ControllerConfig::default());

    let shelf = scripts::Shelf::open(flash);
    let setup = setup_of(record, boot, ring.len() / COMMAND_WORDS);
    let (to_node, from_network) = keep!(Queue<Parcel, { IN_MAX + 1 }>, Queue::new()).split();
    let (to_network, from_node) = keep!(Queue<Outbound, { OUT_MAX + 1 }>, Queue::new()).split();
    let has_cd = record.machine.has_cd;
    let outputs = BoardOutputs::new(
        #[cfg(feature = "timers")]
        pwm::PwmChip::new(parts.LEDC),
        has_cd.then(ShiftRegister::new),
    );
    if record.machine.has_lidar {
        spawner.spawn(lidar::read(parts.UART1).expect("spawned once"));
    }
    let plan_interrupt = parts.FROM_CPU_INTR2;
    let pulse_parts = parts.RMT;
    let planning_timers = parts.TIMG1;
    #[cfg(feature = "counters")]
    let counter_parts = parts.PCNT;
    #[cfg(feature = "timers")]
    let timer_parts = parts.MCPWM0;
    let mux_parts = parts.IO_MUX;
    let start_planning = move || {
        // On the core that plans, so that its interrupts are served there.
        #[cfg(feature = "counters")]
        let mut counters = Pcnt::new(counter_parts);
        #[cfg_attr(
            not(feature = "timers"),
            expect(unused_mut, reason = "nothing is added")
        )]
        let mut backend = RmtBackend::new(
            pulse_parts,
            #[cfg(feature = "counters")]
            &counters,
        );
        #[cfg(feature = "timers")]
        if has_cd {
            backend.add_cd(cd::Cd::new(timer_parts, &mut counters));
        }
        // They count for as long as this exists.
        #[cfg(feature = "counters")]
        core::mem::forget(counters);
        let (inputs, levels) = InputPins::new(mux_parts, &input_pins);
        // Made again, on this core's stack: it is large, and the other one's is short.
        let mut config = node_config(record, boot);
        config.motion.input_levels = levels;
        let planning = Planning {
            node: made_node(ring, backend, outputs, config),
            incoming: from_network,
            outgoing: to_network,
            stop_pin: StopPin::new(),
            inputs,
            watchdog: PlanningWatchdog::begin(planning_timers),
            has_psram: ring.len() > psram::SMALL_RING_COMMANDS * COMMAND_WORDS,
            report,
            found,
        };
        let executor = keep!(InterruptExecutor<2>, InterruptExecutor::new(plan_interrupt));
        // Below the refill interrupt.
        let spawner = executor.start(Priority::Priority1);
        spawner.spawn(plan_task(planning).expect("spawned once"));
    };
    #[cfg(feature = "dual")]
    {
        use esp_hal::system::{CpuControl, Stack};
        let stack = keep!(Stack<STACK_BYTES>, Stack::new());
        vitals::paint_second(stack);
        // Without the scheduler, which would run the radio's tasks there on stacks of their own: the
        // planning task is an interrupt, and uses whatever stack it comes upon. This one is the only one.
        let core = CpuControl::new(parts.CPU_CTRL).start_app_core(stack, move || {
            start_planning();
            rest();
        });
        core::mem::forget(core.expect("it does not run yet"));
    }
    #[cfg(not(feature = "dual"))]
    start_planning();
    spawner.spawn(lua::interpret().expect("spawned once"));

    let wifi = match wifi {
        Ok(wifi) => wifi,
        Err(error) => {
            esp_println::println!("no radio: {error:?}");
            talk_only(port, dialogue, false, keeper).await;
        }
    };
    let (stack, runner) = embassy_net::new(
        Interface::station(),
        wifi::address_config(record),
        kept_resources(),
        random_u64(),
    );
    spawner.spawn(wifi::connect(wifi, record).expect("spawned once"));
    spawner.spawn(wifi::network(runner).expect("spawned once"));
    #[cfg(feature = "esp32c6")]
    let gauges = vitals::Gauges::new(parts.TSENS);
    #[cfg(not(feature = "esp32c6"))]
    let gauges = vitals::Gauges::new();
    let name = record.name.expect("it is provisioned");
    spawner.spawn(name::answer(stack, name).expect("spawned once"));
    let link = link::run(
        stack,
        record,
        name,
        keys_of(record),
        random_u64(),
        to_node,
        from_node,
        keeper,
        shelf,
        gauges,
        setup,
    );
    spawner.spawn(link.expect("spawned once"));
    serial::run(port, dialogue, false).await
}
