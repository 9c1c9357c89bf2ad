//! An image over the network. Without the fleet's key no message makes a node ready to boot
//! something, and whatever the flash holds about the slots, one of the two boots.

use super::{Input, flash::Flash};
use keys::update::{UpdateMessage, UpdateReply};
use update::{Boot, Trial, Updater};

/// A public key: the ed25519 base point. Nobody here has the secret one.
const KEY: [u8; 32] = {
    let mut key = [0x66; 32];
    key[0] = 0x58;
    key
};

/// The first byte: is the rest what a flash holds, or messages?
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    if input.byte() & 1 == 0 {
        let Ok(mut trial) = Trial::new(Flash::with(2, input.0)) else {
            return;
        };
        for turn in 0..3_u8 {
            let running = (input.0.len() as u8 ^ turn) & 1;
            let on_trial = match trial.boot(running) {
                Ok(Boot::Run) => false,
                Ok(Boot::OnTrial | Boot::GoBack) => true,
                Err(_) => return,
            };
            // A reset finds what was written.
            let Ok(again) = Trial::new(trial.into_flash()) else {
                panic!("what it wrote cannot be read");
            };
            assert_eq!(again.is_on_trial(), on_trial);
            trial = again;
        }
        let _ = trial.try_other();
        return;
    }
    let mut updater = Updater::new(Flash::with(4, &[]), Some(KEY));
    while !input.is_empty() {
        let moves = input.byte() & 7 == 7;
        let count = usize::from(input.short());
        let Ok(message) = postcard::from_bytes::<UpdateMessage<'_>>(input.bytes(count)) else {
            continue;
        };
        let reply = updater.handle(&message, moves);
        assert_ne!(reply, UpdateReply::Ready, "nobody has signed this");
        assert!(!updater.is_ready());
        let mut buffer = [0; 64];
        let written = postcard::to_slice(&reply, &mut buffer).expect("an answer is short");
        assert_eq!(postcard::from_bytes::<UpdateReply>(written), Ok(reply));
    }
}

/// A transfer without a signature, and a flash after a trial.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seed = vec![1];
    for message in [
        UpdateMessage::Begin {
            bytes: 32,
            hash: [1; 32],
            signature: [2; 64],
        },
        UpdateMessage::Chunk {
            at: 0,
            bytes: &[7; 32],
        },
        UpdateMessage::Finish,
        UpdateMessage::Abandon,
    ] {
        let bytes = postcard::to_allocvec(&message).expect("room");
        seed.push(0);
        seed.extend((bytes.len() as u16).to_le_bytes());
        seed.extend(bytes);
    }
    let mut trial = Trial::new(Flash::with(2, &[])).expect("large enough");
    let _ = trial.try_other();
    let _ = trial.boot(1);
    let mut image = vec![0];
    image.extend_from_slice(&trial.into_flash().0[..64]);
    vec![seed, image]
}
