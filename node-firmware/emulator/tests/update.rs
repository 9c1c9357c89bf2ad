//! Another firmware for an emulated board: into its slots, on trial, back; with the power cut at
//! every step of the flash.

use ed25519_dalek::{Signer, SigningKey};
use emulator::{EmulatedNode, EmulatorConfig, firmware::FACTORY, flash::Flash};
use keys::{
    BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    update::{CHUNK_BYTES_MAX, SIGNED_PREFIX, UpdateMessage, UpdateRefusal, UpdateReply},
};
use sha2::{Digest, Sha256};

const NEW: [u8; 3] = [7, 8, 9];

fn signing_key() -> SigningKey {
    SigningKey::from_bytes(&[7; 32])
}

/// An image as `espflash save-image` makes it, as far as anybody looks.
fn image(version: [u8; 3], bytes: usize) -> Vec<u8> {
    let mut image: Vec<u8> = (0..bytes).map(|index| (index * 31 % 251) as u8).collect();
    image[0] = 0xe9;
    image[32..36].copy_from_slice(&0xabcd_5432_u32.to_le_bytes());
    let [major, minor, patch] = version;
    let text = format!("{major}.{minor}.{patch}\0");
    image[48..48 + text.len()].copy_from_slice(text.as_bytes());
    image
}

fn begin(image: &[u8], key: &SigningKey) -> UpdateMessage<'static> {
    let hash: [u8; 32] = Sha256::digest(image).into();
    UpdateMessage::Begin {
        bytes: image.len() as u32,
        hash,
        signature: key.sign(&[SIGNED_PREFIX, &hash[..]].concat()).to_bytes(),
    }
}

struct Board {
    node: EmulatedNode,
    flash: Flash,
    now: LocalMicros,
    boot: u32,
}

impl Board {
    fn new(flash: Flash) -> Self {
        let config = EmulatorConfig {
            flash: Some(flash.clone()),
            update_key: Some(signing_key().verifying_key().to_bytes()),
            ..EmulatorConfig::new(NodeId::new("left").expect("legal"))
        };
        Self {
            node: EmulatedNode::new(config, 1),
            flash,
            now: LocalMicros(0),
            boot: 1,
        }
    }

    /// Lets time pass, with the restarts that the firmware asks for.
    fn run_for(&mut self, us: u64) {
        let mut left_us = us;
        loop {
            self.node.poll(self.now);
            if self.node.wants_restart() {
                self.reboot();
                continue;
            }
            let due = self.node.poll_timeout().map_or(u64::MAX, |due| due.0);
            let step_us = due.saturating_sub(self.now.0).clamp(1, left_us.max(1));
            if left_us == 0 {
                return;
            }
            self.now = self.now.plus_us(step_us);
            left_us -= step_us.min(left_us);
        }
    }

    fn reboot(&mut self) {
        self.boot += 1;
        self.now = LocalMicros(0);
        self.node.reset(self.boot);
    }

    /// Lets it move: one command in its queue.
    fn order(&mut self, command: Command) {
        let mut writer = BatchWriter::new();
        assert!(writer.push(&command));
        let header = BatchHeader {
            queue: self.node.node().queue(),
            first_command: 0,
            command_count: 1,
            job: JobId::new("job-1").expect("legal"),
            job_end: 1,
        };
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = writer.finish(header, &mut buffer).expect("room");
        self.node.handle(NodeTopic::Batch, bytes, self.now);
    }

    fn say(&mut self, message: &UpdateMessage<'_>) -> UpdateReply {
        self.node.update(message, self.now)
    }

    fn send(&mut self, image: &[u8]) -> UpdateReply {
        let mut reply = self.say(&begin(image, &signing_key()));
        loop {
            let UpdateReply::At { bytes: at } = reply else {
                return reply;
            };
            let rest = &image[at as usize..];
            let bytes = &rest[..rest.len().min(CHUNK_BYTES_MAX)];
            reply = if bytes.is_empty() {
                self.say(&UpdateMessage::Finish)
            } else {
                self.say(&UpdateMessage::Chunk { at, bytes })
            };
        }
    }

    /// Returns version, slot and whether it is on trial.
    fn runs(&mut self) -> ([u8; 3], u8, bool) {
        match self.say(&UpdateMessage::Look) {
            UpdateReply::Runs {
                version,
                slot,
                on_trial,
            } => (version, slot, on_trial),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_signed_image_is_booted_on_trial_and_stays_once_the_router_is_reached() {
    let mut board = Board::new(Flash::blank());
    assert_eq!(board.runs(), (FACTORY, 0, false));
    assert_eq!(board.send(&image(NEW, 20_003)), UpdateReply::Ready);
    board.run_for(1_000_000);
    assert_eq!(board.runs(), (NEW, 1, true));
    assert_eq!(board.node.node().config().firmware, NEW);
    let refused = UpdateReply::Refused(UpdateRefusal::OnTrial);
    assert_eq!(board.send(&image([1, 1, 1], 5_000)), refused);
    board.node.link(true, board.now);
    board.run_for(1);
    assert_eq!(board.runs(), (NEW, 1, false));
    board.reboot();
    board.run_for(100_000_000);
    assert_eq!(board.runs(), (NEW, 1, false));
    // The next one goes into the other slot.
    assert_eq!(board.send(&image([7, 9, 0], 5_000)), UpdateReply::Ready);
    board.run_for(1_000_000);
    assert_eq!(board.runs(), ([7, 9, 0], 0, true));
}

#[test]
fn an_image_that_does_not_reach_the_router_within_a_minute_is_left() {
    let mut board = Board::new(Flash::blank());
    assert_eq!(board.send(&image(NEW, 5_000)), UpdateReply::Ready);
    board.run_for(1_000_000);
    assert_eq!(board.runs(), (NEW, 1, true));
    let left_us = 60_000_000 - board.now.0;
    board.run_for(left_us - 1);
    assert_eq!(board.runs(), (NEW, 1, true));
    board.run_for(2);
    assert_eq!(board.runs(), (FACTORY, 0, false));
    board.run_for(200_000_000);
    assert_eq!(board.runs(), (FACTORY, 0, false));
}

#[test]
fn an_image_that_crashes_on_trial_is_left_at_its_second_boot() {
    let mut board = Board::new(Flash::blank());
    assert_eq!(board.send(&image(NEW, 5_000)), UpdateReply::Ready);
    board.run_for(1_000_000);
    assert_eq!(board.runs(), (NEW, 1, true));
    board.reboot();
    board.run_for(1_000);
    assert_eq!(board.runs(), (FACTORY, 0, false));
}

#[test]
fn nothing_is_taken_while_it_moves() {
    let mut board = Board::new(Flash::blank());
    board.node.link(true, board.now);
    board.order(Command::Move {
        axis: keys::AxisId(0),
        delay_us: 1_000,
        steps: 1_000,
    });
    board.run_for(100_000);
    let moving = UpdateReply::Refused(UpdateRefusal::Moving);
    let before = board.flash.worked_steps();
    assert_eq!(board.send(&image(NEW, 5_000)), moving);
    assert_eq!(board.flash.worked_steps(), before);
    board.run_for(2_000_000);
    assert_eq!(board.send(&image(NEW, 5_000)), UpdateReply::Ready);
}

#[test]
fn a_bad_signature_touches_nothing() {
    let mut board = Board::new(Flash::blank());
    let before = board.flash.worked_steps();
    let thief = SigningKey::from_bytes(&[8; 32]);
    let refused = UpdateReply::Refused(UpdateRefusal::Signature);
    assert_eq!(board.say(&begin(&image(NEW, 5_000), &thief)), refused);
    assert_eq!(board.flash.worked_steps(), before);
}

#[test]
fn a_power_cut_at_any_step_leaves_a_board_that_boots_and_can_be_updated() {
    let new = image(NEW, 9_000);
    // An update, its trial and its end, each step of which may be the last.
    let play = |board: &mut Board| {
        if board.send(&new) == UpdateReply::Ready {
            board.run_for(1_000_000);
            board.node.link(true, board.now);
            board.run_for(1_000);
        }
    };
    let mut whole = Board::new(Flash::blank());
    let begun = whole.flash.worked_steps();
    play(&mut whole);
    assert_eq!(whole.runs(), (NEW, 1, false));
    let steps = whole.flash.worked_steps() - begun;
    // Words of the image are all alike; what comes before and behind it is cut at every step.
    let image_steps = steps.saturating_sub(300);
    let cuts = (0..image_steps).step_by(149).chain(image_steps..steps);
    let mut outcomes = [0; 2];
    for cut in cuts {
        let flash = Flash::blank();
        let mut board = Board::new(flash.clone());
        flash.cut_after(Some(cut));
        play(&mut board);
        assert!(flash.is_cut(), "step {cut} of {steps}");
        flash.cut_after(None);
        let mut board = Board::new(flash);
        // Nobody reaches a router: what is on trial is left.
        board.run_for(70_000_000);
        let (version, slot, on_trial) = board.runs();
        assert!(!on_trial, "step {cut}");
        assert!(
            (version, slot) == (FACTORY, 0) || (version, slot) == (NEW, 1),
            "step {cut}: {version:?} in {slot}"
        );
        outcomes[usize::from(slot)] += 1;
        if slot == 0 {
            play(&mut board);
            assert_eq!(board.runs(), (NEW, 1, false), "step {cut}");
        }
    }
    assert!(outcomes[0] > 0, "{outcomes:?}");
}
