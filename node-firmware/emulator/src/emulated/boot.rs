//! A boot, and the emulated node as what a link serves.

use super::{Bench, EmulatedNode, splitmix};
use crate::{
    config::{EmulatorConfig, Recording},
    firmware::{self, BootLoader},
    memory::{Borrower, RingMemory, take_plans},
    pulse::VirtualRmt,
};
use keys::{
    LocalMicros, Vitals,
    status::FaultCode,
    update::{UpdateMessage, UpdateReply},
};
use motion::MotionConfig;
use node::{
    Inbound, Node, NodeConfig, Outbound,
    library::Library,
    setup::{self, Surroundings},
};
use provision::{Found, store::OLDER};

impl node::run::Host for EmulatedNode {
    fn handle(&mut self, now: LocalMicros, inbound: Inbound<'_>) {
        match inbound {
            Inbound::Message { topic, payload } => Self::handle(self, topic, payload, now),
            other => self.inbound(other, now),
        }
    }

    fn poll(&mut self, now: LocalMicros) {
        Self::poll(self, now);
    }

    fn poll_timeout(&self) -> Option<LocalMicros> {
        Self::poll_timeout(self)
    }

    fn poll_outbox(&mut self, now: LocalMicros) -> Option<Outbound> {
        Self::poll_outbox(self, now)
    }

    fn store_script(&mut self, now: LocalMicros, name: &str, text: Option<&[u8]>) {
        self.node.store_script(now, name, text);
    }

    fn library(&self) -> &Library {
        self.node.library()
    }

    fn update(&mut self, now: LocalMicros, message: &UpdateMessage<'_>) -> UpdateReply {
        Self::update(self, message, now)
    }

    /// A PC knows nothing of a chip; its clock may have begun anywhere.
    fn vitals(&mut self, now: LocalMicros) -> Vitals {
        let uptime_us = now.0.saturating_sub(self.config.clock_offset_us);
        Vitals {
            at: now,
            uptime_s: u32::try_from(uptime_us / 1_000_000).ok(),
            ..Vitals::default()
        }
    }

    fn setup(&self) -> Vec<u8> {
        let config = &self.config;
        let credentials = config.credentials.as_ref();
        setup::json_of(
            self.node.config(),
            &Surroundings {
                chip: "emulated",
                ring_commands: config.ring_commands,
                router: &config.connect,
                tls: config.authority.is_some(),
                user: credentials.map(|credentials| credentials.user.as_str()),
                networks: &[],
                update_key: config.update_key.as_ref(),
            },
        )
    }
}

pub(super) fn boot_node(
    memory: &RingMemory,
    config: &EmulatorConfig,
    input_levels: u32,
    boot: u32,
    boots: u64,
) -> Borrower {
    let seed = splitmix(config.seed.wrapping_add(boots));
    let mut backend = VirtualRmt::new(config.rmt.clone(), seed);
    let watched = !config.machine.switches.is_empty();
    backend.record_edges(config.record != Recording::Off || watched);
    let node_config = NodeConfig {
        keys: config.keys.clone(),
        motion: MotionConfig {
            input_levels,
            ..config.motion_config()
        },
        link_loss: config.link_loss,
        link_loss_after_us: config.link_loss_after_us,
        script: config.script,
        scripts_elsewhere: config.scripts_elsewhere,
        boot_script: config.boot_script,
        firmware: config.flash.as_ref().map_or(firmware::FACTORY, |flash| {
            BootLoader::boot(flash).version(flash)
        }),
        signers: config.signers.clone(),
        ..NodeConfig::new(config.name, boot)
    };
    let mut node = Node::new(
        memory.words(),
        take_plans(),
        backend,
        Bench::default(),
        node_config,
    );
    if config.found == Found::Older {
        let start = LocalMicros(0);
        node.fault(FaultCode::RECORD, start);
        node.tell(start, format_args!("{OLDER}"));
    }
    Borrower::from(node)
}
