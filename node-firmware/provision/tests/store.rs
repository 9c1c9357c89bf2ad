//! A record in flash, with the power cut at every byte, and the dialogue that writes it.

mod flash;

use flash::Flash;
use keys::NodeId;
use provision::{
    Dialogue, Found, Host, HostError, PinFault, PinUse, Record, Refused, Reply, Request, Setting,
    Store,
    chip::PinWhy,
    frame::{FRAME_BYTES_MAX, FrameReader},
    record::{Authority, Login, Network},
    wiring::PinSetting,
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
        // Behind the header it counts; the two marks behind that say so once more.
        let counts_at = cost - 32;
        for power in 0..=cost {
            let mut flash = before.clone();
            flash.power = power;
            let mut store = Store::new(flash).expect("room");
            let result = store.write(&record(name));
            let mut flash = store.into_flash();
            flash.power = usize::MAX;
            let found = read(flash.clone());
            assert!(found == old || found == Some(record(name)), "{power}");
            assert_eq!(result.is_ok(), power >= counts_at);
            // A cut is no decay, and what the cut has left open is made good at the next boot.
            let (was, again) = boot(flash.clone());
            let expected = if found.is_some() {
                Found::Whole
            } else {
                Found::Nothing
            };
            assert_eq!(was, expected, "{power}");
            if found.is_some() {
                assert_eq!(marks(&again).len(), 2, "{power}");
            }
            assert_eq!(read(again), found, "{power}");
            seen_old += usize::from(found == old);
            // And the next write works.
            let mut store = Store::new(flash).expect("room");
            store.write(&record("after")).expect("has power");
            assert_eq!(read(store.into_flash()), Some(record("after")));
        }
        assert!(
            seen_old >= counts_at,
            "the header is the last that is written"
        );
        before = whole;
    }
}

/// Reads as a boot does: what was found, and the flash behind it.
fn boot(flash: Flash) -> (Found, Flash) {
    let store = Store::new(flash).expect("room");
    let dialogue = Dialogue::new(store, [0, 1, 0]).expect("readable");
    let found = dialogue.found();
    assert_eq!(
        dialogue.record() == &Record::default(),
        matches!(found, Found::Nothing | Found::Damaged),
        "what does not count is not there"
    );
    (found, dialogue.into_store().into_flash())
}

/// The marks of finished copies that the flash has of the newest one.
fn marks(flash: &Flash) -> Vec<&[u8]> {
    let all = [4064, 4080, 8160, 8176].map(|at| &flash.bytes[at..at + 16]);
    let number = |mark: &[u8]| u32::from_le_bytes([mark[4], mark[5], mark[6], mark[7]]);
    let written = all
        .into_iter()
        .filter(|mark| mark.iter().any(|byte| *byte != 0xff));
    let newest = written.clone().map(number).max();
    written
        .filter(|mark| Some(number(mark)) == newest)
        .collect()
}

/// A flash with two copies of these records, the second one newer.
fn two(first: &Record, second: &Record) -> Flash {
    let mut store = Store::new(Flash::new(2)).expect("room");
    store.write(first).expect("has power");
    store.write(second).expect("has power");
    store.into_flash()
}

/// The bytes that a copy has before its marks.
fn used(flash: &Flash, copy: usize) -> std::ops::Range<usize> {
    let from = copy * 4096;
    let last = flash.bytes[from..from + 4064]
        .iter()
        .rposition(|byte| *byte != 0xff);
    from..from + last.expect("something is written")
}

#[test]
fn any_flipped_bit_is_noticed_and_the_other_copy_counts_if_it_is_of_the_same_node() {
    let mut tuned = record("one");
    tuned.apply(Setting::HasLidar(true)).expect("fits");
    let mut guarded = record("one");
    guarded.apply(Setting::Signer([7; 32])).expect("fits");
    let mut moved = record("one");
    let pin = PinSetting {
        of: PinUse::Lamp,
        gpio: None,
    };
    moved.apply(Setting::Pin(pin)).expect("fits");
    for (newer, found) in [
        (tuned, Found::Older),
        (record("two"), Found::Damaged),
        (guarded, Found::Damaged),
        (moved, Found::Damaged),
    ] {
        let flash = two(&record("one"), &newer);
        for at in used(&flash, 1) {
            let mut flash = flash.clone();
            flash.bytes[at] ^= 0x10;
            assert_eq!(boot(flash.clone()).0, found, "{at}");
            let stands_in = (found == Found::Older).then(|| record("one"));
            assert_eq!(read(flash), stands_in, "{at}");
        }
    }
}

#[test]
fn a_copy_without_authority_or_signers_never_stands_in_for_one_that_may_have_had_them() {
    let mut open = record("one");
    let mut guarded = record("one");
    guarded
        .apply(Setting::Router(text("tls/10.0.0.1:7447")))
        .expect("fits");
    guarded
        .apply(Setting::Authority(Some(Authority {
            subject: heapless::Vec::from_slice(b"s").expect("short"),
            key: heapless::Vec::from_slice(b"k").expect("short"),
        })))
        .expect("fits");
    let mut signed = record("one");
    signed.apply(Setting::Signer([7; 32])).expect("fits");
    let mut rekeyed = record("one");
    rekeyed
        .apply(Setting::UpdateKey(Some([7; 32])))
        .expect("fits");
    let mut password = record("one");
    let login = Login {
        user: text("left"),
        password: text("new"),
    };
    password.apply(Setting::Login(Some(login))).expect("fits");
    for newer in [guarded, signed, rekeyed, password] {
        let flash = two(&open, &newer);
        // Whatever is left of the newer copy: one mark is enough to know that it was there.
        for wiped in [4096..8192, 4096..8160, 4100..4101] {
            let mut flash = flash.clone();
            flash.bytes[wiped].fill(0xff);
            let (found, flash) = boot(flash);
            assert_eq!(found, Found::Damaged);
            // Told again, it is whole again, also if that is cut: until then nothing counts.
            let mut store = Store::new(flash.clone()).expect("room");
            store.write(&newer).expect("has power");
            let cost = store.into_flash().used - flash.used;
            for power in 0..=cost {
                let mut flash = flash.clone();
                flash.power = power;
                let mut store = Store::new(flash).expect("room");
                let kept = store.write(&newer).is_ok();
                let mut flash = store.into_flash();
                flash.power = usize::MAX;
                let (found, _) = boot(flash.clone());
                assert_eq!(
                    found,
                    if kept { Found::Whole } else { Found::Damaged },
                    "{power}"
                );
                assert_eq!(read(flash), kept.then(|| newer.clone()), "{power}");
            }
        }
    }
    // The other way round it is the same: nobody knows which of them was meant to be.
    open.apply(Setting::NoSigners).expect("fits");
    let mut signed = record("one");
    signed.apply(Setting::Signer([7; 32])).expect("fits");
    let mut flash = two(&signed, &open);
    flash.bytes[4100] ^= 1;
    assert_eq!(boot(flash).0, Found::Damaged);
}

#[test]
fn copies_of_a_firmware_that_knew_no_marks_are_marked_at_the_first_boot() {
    let mut flash = two(&record("one"), &record("two"));
    for copy in [4064..4096, 8160..8192] {
        flash.bytes[copy].fill(0xff);
    }
    assert_eq!(read(flash.clone()), Some(record("two")));
    let (found, mut flash) = boot(flash);
    assert_eq!((found, marks(&flash).len()), (Found::Whole, 2));
    let (_, again) = boot(flash.clone());
    assert_eq!(again.used, flash.used, "once is enough");
    flash.bytes[4096 + 30] ^= 1;
    assert_eq!(boot(flash).0, Found::Damaged);
}

#[test]
fn what_a_boot_found_is_shown_until_it_is_told_again() {
    let mut tuned = record("one");
    tuned.apply(Setting::HasLidar(true)).expect("fits");
    let mut flash = two(&record("one"), &tuned);
    flash.bytes[4096 + 30] ^= 1;
    let mut line = Line::new(flash);
    let found = |line: &mut Line| match line.ask(Request::Show) {
        Ok(Reply::Record(shown)) => shown.found,
        other => panic!("{other:?}"),
    };
    assert_eq!(found(&mut line), Found::Older);
    line.ask(Request::Set(Setting::HasLidar(true)))
        .expect("fits");
    assert_eq!(line.ask(Request::Commit), Ok(Reply::Kept { sequence: 3 }));
    assert_eq!(found(&mut line), Found::Whole);
    assert_eq!(boot(line.node.into_store().into_flash()).0, Found::Whole);
}

#[test]
fn a_board_that_cannot_be_wired_is_not_kept_and_says_which_pin_and_why() {
    let mut line = Line::new(Flash::new(2));
    for setting in settings() {
        line.ask(Request::Set(setting)).expect("fits");
    }
    line.ask(Request::Set(Setting::Axes(3))).expect("fits");
    let pin = |of, gpio| {
        Setting::Pin(PinSetting {
            of,
            gpio: Some(gpio),
        })
    };
    line.ask(Request::Set(pin(PinUse::Step(2), 33)))
        .expect("a number");
    let fault = PinFault {
        of: PinUse::Step(2),
        gpio: Some(33),
        why: PinWhy::Psram,
    };
    let refused = Err(HostError::Refused(Refused::Pins(fault)));
    assert_eq!(line.ask(Request::Commit), refused);
    line.ask(Request::Set(pin(PinUse::Step(2), 8)))
        .expect("a number");
    assert_eq!(line.ask(Request::Commit), Ok(Reply::Kept { sequence: 1 }));
    let Ok(Reply::Pins(wiring)) = line.ask(Request::ShowPins) else {
        panic!("it shows what is kept");
    };
    assert_eq!((wiring.axes(), wiring.pin(PinUse::Step(2))), (3, Some(8)));
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
