//! What the node's zenoh client asks of the heap, counted by the allocator: nothing for a message
//! that it sends, the value for one that it receives, and less for the whole session with the
//! buffers of its driver than zenoh-pico's documented 14 KB. With everything full that may ever wait
//! it is what the limits say.

use dhat::HeapStats;
use pico::{Event, PutOptions, Session, SessionConfig, limits};

/// Peak heap of a session with default batches and of its driver, bytes.
const SESSION_BYTES_MAX: usize = 14 * 1024;

/// The same while the network takes nothing and the queue is full: twice the queue, see
/// [`limits::QUEUE_KEEP_BYTES`], and what its priorities keep.
const FULL_BYTES_MAX: usize =
    SESSION_BYTES_MAX + 2 * limits::QUEUE_BYTES_DEFAULT + 8 * limits::QUEUE_KEEP_BYTES;

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

/// Returns how often the heap was asked since the profiler began.
fn taken_count() -> u64 {
    HeapStats::get().total_blocks
}

/// What a router of zenoh 1.10.2 answered: InitAck and OpenAck.
const HANDSHAKE: [&str; 2] = [
    "4b00e109f0ce1d329ca721eaf1bc1943526aab93800a00083130f3207a16f8fbf193a032f57d24931f379693f4c186b7a87a150f68ee2054bdb28eb7a0a7d97d8af653b2ea8e697b062c812701",
    "0600620aafd1fc70",
];

/// The number of its first frame, as in that OpenAck.
const FIRST_SN: u32 = 0x2f | 0x51 << 7 | 0x7c << 14 | 0x70 << 21;

fn unhex(text: &str) -> Vec<u8> {
    let digits = (0..text.len()).step_by(2);
    let byte = |at| u8::from_str_radix(&text[at..at + 2], 16).expect("hexadecimal");
    digits.map(byte).collect()
}

/// A batch with one frame with one value, under a key in full or under a number of ours.
fn value(sn: u32, key: Result<&str, u8>, payload: &[u8]) -> Vec<u8> {
    let mut body = vec![0x25];
    variable(&mut body, sn & (u32::MAX >> 4));
    match key {
        Ok(key) => {
            body.extend([0x3d, 0, key.len() as u8]);
            body.extend_from_slice(key.as_bytes());
        }
        Err(number) => body.extend([0x1d, number]),
    }
    body.push(0x01);
    variable(&mut body, payload.len() as u32);
    body.extend_from_slice(payload);
    [&(body.len() as u16).to_le_bytes()[..], &body].concat()
}

fn variable(bytes: &mut Vec<u8>, mut number: u32) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

#[test]
fn a_sent_message_takes_nothing_from_the_heap_a_received_one_its_value() {
    let answers = HANDSHAKE.map(unhex);
    let key = "fleet/node/left/batch";
    let batches: Vec<Vec<u8>> = (0..300)
        .map(|index: u32| {
            let payload = vec![7; [8, 64, 1_024][index as usize % 3]];
            let key = if index < 150 { Ok(key) } else { Err(1) };
            value(FIRST_SN.wrapping_add(index), key, &payload)
        })
        .collect();
    let payload = [5; 1_024];

    let profiler = dhat::Profiler::builder().testing().build();
    // What the driver has for reading and for writing.
    let input = vec![0_u8; limits::READ_BYTES];
    let mut out = Vec::new();
    let mut session = Session::new(SessionConfig::default(), 7);
    session.declare_subscriber(key).expect("room");
    let publisher = session.declare_publisher("fleet/node/left/status");
    let publisher = publisher.expect("room");
    session.handle_connected(0);
    for answer in &answers {
        session.poll_transmit(0, &mut out);
        session.handle_bytes(0, answer).expect("a true handshake");
    }
    while session.poll_event().is_some() {}
    out.clear();
    session.poll_transmit(0, &mut out);

    let mut sent = [u64::MAX; 6];
    for (index, most) in sent.iter_mut().enumerate() {
        let payload = &payload[..[8, 64, 1_024][index % 3]];
        let options = PutOptions {
            express: index >= 3,
            ..PutOptions::default()
        };
        for round in 0..20 {
            let begun = taken_count();
            session.put(publisher, payload, &options).expect("room");
            out.clear();
            session.poll_transmit(1, &mut out);
            if round > 0 {
                *most = taken_count() - begun;
                assert_eq!(*most, 0, "{} bytes", payload.len());
            }
        }
    }

    let mut received = [0; 2];
    for (index, batch) in batches.iter().enumerate() {
        let begun = taken_count();
        session.handle_bytes(2, batch).expect("a value");
        let event = session.poll_event();
        let Some(Event::Message { sample, .. }) = event else {
            panic!("{event:?}");
        };
        assert_eq!(sample.key, key);
        let count = taken_count() - begun;
        // The first ones make room for all that follow.
        if index >= 3 {
            let most = &mut received[usize::from(index >= 150)];
            *most = count.max(*most);
        }
    }
    let peak_bytes = HeapStats::get().max_bytes;
    let options = PutOptions::default();
    let mut queued = 0;
    while session.put(publisher, &payload, &options).is_ok() {
        queued += 1;
        assert!(queued < 1_000, "the queue has a bound");
    }
    let full_bytes = HeapStats::get().max_bytes;
    drop(profiler);
    drop(input);
    println!(
        "for each message: sent {sent:?}, received {} (key in full) and {} (key by number); \
         heap of a session and its driver at most {peak_bytes} bytes beside {} of itself; \
         {full_bytes} with {queued} messages of 1 KiB that the network does not take",
        received[0],
        received[1],
        size_of::<Session>(),
    );
    assert_eq!(received, [1, 1]);
    assert!(peak_bytes <= SESSION_BYTES_MAX, "{peak_bytes} bytes");
    assert!(full_bytes <= FULL_BYTES_MAX, "{full_bytes} bytes");
    assert!(queued >= 8, "{queued} messages wait");
}
