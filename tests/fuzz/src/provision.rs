//! The serial line of a node: noise harms nothing, a request is answered once, and what was kept is
//! there after the next boot. A flash with anything in it boots too.

use super::{Input, flash::Flash};
use keys::NodeId;
use provision::{
    dialogue::{Dialogue, Reply, Request},
    frame::{self, FRAME_BYTES_MAX, FrameReader},
    host::Host,
    record::{Network, Setting},
    store::Store,
};

/// The first byte: is the rest what a flash holds, raw bytes of the line, or requests in frames?
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    match input.byte() % 3 {
        0 => {
            let flash = Flash::with(2, input.0);
            let store = Store::new(flash).expect("large enough");
            let mut dialogue = Dialogue::new(store, [0, 1, 0]).expect("it can be read");
            let before = dialogue.record().clone();
            // What was found can be kept again as it is.
            if before.is_complete() {
                let reply = dialogue.handle(Request::Commit, true);
                assert!(matches!(reply, Reply::Kept { .. }), "{reply:?}");
                let found = dialogue.into_store().read().expect("it can be read");
                assert_eq!(found, Some(before));
            }
        }
        1 => {
            let mut dialogue = fresh();
            let mut host = Host::new(Request::Hello);
            let mut answer = [0; FRAME_BYTES_MAX + 2];
            for byte in input.0 {
                if let Some(used) = dialogue.handle_byte(*byte, true, &mut answer) {
                    assert!(used <= answer.len());
                    reply_of(&answer[..used]);
                }
            }
            let _ = host.handle_bytes(input.0);
        }
        _ => {
            let mut dialogue = fresh();
            while !input.is_empty() {
                let may_write = input.byte() & 1 == 0;
                let count = usize::from(input.byte());
                let Ok(request) = postcard::from_bytes::<Request>(input.bytes(count)) else {
                    continue;
                };
                let kept = dialogue.record().clone();
                let mut bytes = [0; FRAME_BYTES_MAX + 2];
                let used = frame::write(&request, &mut bytes);
                let mut replies = 0;
                for byte in &bytes[..used] {
                    let mut answer = [0; FRAME_BYTES_MAX + 2];
                    if let Some(used) = dialogue.handle_byte(*byte, may_write, &mut answer) {
                        reply_of(&answer[..used]);
                        replies += 1;
                    }
                }
                assert_eq!(replies, 1, "{request:?}");
                assert!(
                    may_write || dialogue.record() == &kept,
                    "nothing is kept while it moves"
                );
            }
            let last = dialogue.record().clone();
            let found = dialogue.into_store().read().expect("it can be read");
            assert_eq!(found.unwrap_or_default(), last);
        }
    }
}

fn fresh() -> Dialogue<Flash> {
    let store = Store::new(Flash::with(2, &[])).expect("large enough");
    Dialogue::new(store, [0, 1, 0]).expect("it can be read")
}

fn reply_of(bytes: &[u8]) {
    let mut reader = FrameReader::new();
    let replies = bytes
        .iter()
        .filter_map(|byte| reader.handle_byte::<Reply>(*byte));
    assert_eq!(replies.count(), 1, "an answer is one frame");
}

/// A whole conversation, its bytes on the line, and the flash after it.
pub fn seeds() -> Vec<Vec<u8>> {
    let network = Network {
        ssid: "shop".try_into().expect("short"),
        password: "secret-secret".try_into().expect("short"),
    };
    let requests = [
        Request::Hello,
        Request::Set(Setting::Name(NodeId::new("left").expect("legal"))),
        Request::Set(Setting::Network(network)),
        Request::Commit,
        Request::Show,
        Request::Restart,
    ];
    let mut framed = vec![1];
    let mut plain = vec![2];
    let mut dialogue = fresh();
    for request in requests {
        let mut bytes = [0; FRAME_BYTES_MAX + 2];
        let used = frame::write(&request, &mut bytes);
        framed.extend_from_slice(&bytes[..used]);
        let bytes = postcard::to_allocvec(&request).expect("room");
        plain.extend([0, bytes.len() as u8]);
        plain.extend(bytes);
        let _ = dialogue.handle(request, true);
    }
    let flash = dialogue.into_store().into_flash();
    let mut image = vec![0];
    image.extend_from_slice(&flash.0[..256]);
    vec![framed, plain, image]
}
