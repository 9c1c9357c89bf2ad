//! A record in flash, with the power cut at every byte, and the dialogue that writes it.

mod flash;

use flash::Flash;
use keys::NodeId;
use provision::{
    Dialogue, Host, HostError, Record, Refused, Reply, Request, Setting, Store,
    frame::{FRAME_BYTES_MAX, FrameReader},
    record::{Login, Network},
};

fn text<const N: usize>(text: &str) -> heapless::String<N> {
    heapless::String::try_from(text).expect("short")
}

fn record(name: &str) -> Record {
    let mut record = Record::default();
    for setting in [
        Setting::Name(NodeId::new(name).expect("legal")),
        Setting::Network(Network {
            ssid: text("shop"),
            password: text("correct horse"),
        }),
        Setting::Router(text("tcp/10.0.0.1:7447")),
    ] {
        record.apply(setting).expect("fits");
    }
    record
}

fn read(flash: Flash) -> Option<Record> {
    Store::new(flash).expect("room").read().expect("readable")
}

#[test]
fn a_power_cut_at_every_byte_leaves_the_old_record_or_the_new_one() {
    let mut before = Flash::new(2);
    for name in ["one", "two", "three"] {
        // What it costs without a cut.
        let mut store = Store::new(before.clone()).expect("room");
        store.write(&record(name)).expect("has power");
        let whole = store.into_flash();
        let cost = whole.used - before.used;
        let old = read(before.clone());
        let mut seen_old = 0;
        for power in 0..=cost {
            let mut flash = before.clone();
            flash.power = power;
            let mut store = Store::new(flash).expect("room");
            let result = store.write(&record(name));
            let mut flash = store.into_flash();
            flash.power = usize::MAX;
            let found = read(flash.clone());
            assert!(found == old || found == Some(record(name)), "{power}");
            assert_eq!(result.is_ok(), power == cost);
            seen_old += usize::from(found == old);
            // And the next write works.
            let mut store = Store::new(flash).expect("room");
            store.write(&record("after")).expect("has power");
            assert_eq!(read(store.into_flash()), Some(record("after")));
        }
        assert!(seen_old >= cost, "the header is the last that is written");
        before = whole;
    }
}

#[test]
fn any_flipped_bit_is_noticed_and_the_other_copy_counts() {
    let mut store = Store::new(Flash::new(2)).expect("room");
    store.write(&record("one")).expect("has power");
    store.write(&record("two")).expect("has power");
    let flash = store.into_flash();
    let bytes = flash.bytes[4096..].iter().rposition(|byte| *byte != 0xff);
    for at in 0..bytes.expect("something is written") {
        let mut flash = flash.clone();
        flash.bytes[4096 + at] ^= 0x10;
        assert_eq!(read(flash), Some(record("one")), "{at}");
    }
}

#[test]
fn noise_is_no_record() {
    assert_eq!(read(Flash::new(2)), None);
    let mut flash = Flash::new(2);
    flash.bytes.fill(0);
    assert_eq!(read(flash), None);
    assert!(Store::new(Flash::new(1)).is_err());
}

/// Both ends of a line that has boot messages on it and loses some bytes.
struct Line {
    node: Dialogue<Flash>,
    now_us: u64,
    may_write: bool,
    lose_each: usize,
    carried: usize,
    heard: Vec<u8>,
}

impl Line {
    fn new(flash: Flash) -> Self {
        let store = Store::new(flash).expect("room");
        Self {
            node: Dialogue::new(store, [1, 2, 3]).expect("readable"),
            now_us: 0,
            may_write: true,
            lose_each: usize::MAX,
            carried: 0,
            heard: Vec::new(),
        }
    }

    fn ask(&mut self, request: Request) -> Result<Reply, HostError> {
        let mut host = Host::new(request);
        loop {
            let mut out = [0; FRAME_BYTES_MAX + 2];
            let mut answer = [0; FRAME_BYTES_MAX + 2];
            if let Some(count) = host.poll_transmit(self.now_us, &mut out)? {
                let mut back = b"I (30) boot: ESP-IDF v5.5\r\n".to_vec();
                for byte in &out[..count] {
                    self.carried += 1;
                    if self.carried.is_multiple_of(self.lose_each) {
                        continue;
                    }
                    let may_write = self.may_write;
                    if let Some(count) = self.node.handle_byte(*byte, may_write, &mut answer) {
                        back.extend_from_slice(&answer[..count]);
                    }
                }
                self.heard.extend_from_slice(&back);
                if let Some(reply) = host.handle_bytes(&back)? {
                    return Ok(reply);
                }
            }
            self.now_us += 100_000;
        }
    }
}

fn settings() -> [Setting; 4] {
    [
        Setting::Name(NodeId::new("left").expect("legal")),
        Setting::Network(Network {
            ssid: text("shop"),
            password: text("correct horse"),
        }),
        Setting::Router(text("tcp/10.0.0.1:7447")),
        Setting::Login(Some(Login {
            user: text("left"),
            password: text("battery staple"),
        })),
    ]
}

#[test]
fn a_dialogue_over_a_lossy_line_provisions_a_node() {
    let mut line = Line::new(Flash::new(2));
    line.lose_each = 90;
    let hello = line.ask(Request::Hello).expect("is there");
    assert!(matches!(
        hello,
        Reply::Hello {
            firmware: [1, 2, 3],
            name: None,
            complete: false
        }
    ));
    for setting in settings() {
        assert_eq!(line.ask(Request::Set(setting)), Ok(Reply::Done));
    }
    assert_eq!(line.ask(Request::Commit), Ok(Reply::Kept { sequence: 1 }));
    let found = read(line.node.into_store().into_flash()).expect("kept");
    assert_eq!(found.name.map(|name| name.to_string()), Some("left".into()));
    assert_eq!(found.networks[0].password, "correct horse");
    assert!(found.is_complete());
}

#[test]
fn what_scripts_may_and_who_signs_is_told_kept_and_shown() {
    let mut line = Line::new(Flash::new(2));
    let told = [
        Setting::BootScript(true),
        Setting::Signer([0xab; 32]),
        Setting::Signer([0xcd; 32]),
    ];
    for setting in settings().into_iter().chain(told) {
        assert_eq!(line.ask(Request::Set(setting)), Ok(Reply::Done));
    }
    line.ask(Request::Commit).expect("complete");
    let Ok(Reply::Record(shown)) = line.ask(Request::Show) else {
        panic!("it shows what is kept");
    };
    assert!(shown.boot_script);
    assert_eq!(shown.signers, [[0xab; 4], [0xcd; 4]]);
    let found = read(line.node.into_store().into_flash()).expect("kept");
    assert!(found.boot_script);
    assert_eq!(found.signers, [[0xab; 32], [0xcd; 32]]);
}

#[test]
fn the_longest_answer_fits_into_a_frame() {
    let mut line = Line::new(Flash::new(2));
    let long =
        |letter: char, count: usize| -> String { core::iter::repeat_n(letter, count).collect() };
    line.ask(Request::Set(Setting::Name(
        NodeId::new(&long('n', 32)).expect("legal"),
    )))
    .expect("fits");
    for letter in ['a', 'b', 'c', 'd'] {
        let network = Network {
            ssid: text(&long(letter, 32)),
            password: text(&long('p', 63)),
        };
        line.ask(Request::Set(Setting::Network(network)))
            .expect("fits");
    }
    let router = format!("tcp/{}:65535", long('r', 54));
    line.ask(Request::Set(Setting::Router(text(&router))))
        .expect("fits");
    for key in 1..=8 {
        line.ask(Request::Set(Setting::Signer([key; 32])))
            .expect("fits");
    }
    line.ask(Request::Commit).expect("complete");
    let Ok(Reply::Record(shown)) = line.ask(Request::Show) else {
        panic!("it shows what is kept");
    };
    assert_eq!((shown.networks.len(), shown.signers.len()), (4, 8));
}

#[test]
fn secrets_never_come_back() {
    let mut line = Line::new(Flash::new(2));
    for setting in settings() {
        line.ask(Request::Set(setting)).expect("fits");
    }
    line.ask(Request::Commit).expect("complete");
    let Ok(Reply::Record(shown)) = line.ask(Request::Show) else {
        panic!("it shows what is kept");
    };
    assert!(shown.has_login && shown.networks[0] == "shop");
    for secret in ["correct horse", "battery staple"] {
        let found = line
            .heard
            .windows(secret.len())
            .any(|window| window == secret.as_bytes());
        assert!(!found, "{secret}");
    }
}

#[test]
fn nothing_is_kept_without_a_commit_nor_while_it_moves_nor_incomplete() {
    let mut line = Line::new(Flash::new(2));
    let [name, network, ..] = settings();
    line.ask(Request::Set(name)).expect("fits");
    let incomplete = Err(HostError::Refused(Refused::Incomplete));
    assert_eq!(line.ask(Request::Commit), incomplete);
    line.ask(Request::Set(network)).expect("fits");
    line.may_write = false;
    let moving = Err(HostError::Refused(Refused::Moving));
    assert_eq!(line.ask(Request::Commit), moving);
    assert_eq!(line.ask(Request::Restart), moving);
    assert_eq!(read(line.node.into_store().into_flash()), None);
}

#[test]
fn a_silent_line_is_said_to_be_silent() {
    let mut line = Line::new(Flash::new(2));
    line.lose_each = 1;
    assert_eq!(line.ask(Request::Hello), Err(HostError::Silent));
}

#[test]
fn random_bytes_neither_panic_nor_change_anything() {
    let mut line = Line::new(Flash::new(2));
    let mut answer = [0; FRAME_BYTES_MAX + 2];
    let mut random = 7_u64;
    let mut reader = FrameReader::new();
    for _ in 0..200_000 {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let byte = (random >> 56) as u8;
        assert_eq!(line.node.handle_byte(byte, true, &mut answer), None);
        assert_eq!(reader.handle_byte::<Reply>(byte), None);
    }
}
