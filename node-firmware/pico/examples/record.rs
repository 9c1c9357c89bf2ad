//! Records conversations with a router of the zenoh crate for the test `captures.rs`.
//!
//! ```sh
//! cargo run -p pico --example record -- node-firmware/pico/tests/captures
//! ```
//!
//! Between two lines it waits until the router has been silent for a while, so a recording takes
//! some seconds; the replay waits for nothing.

#[path = "../tests/script/mod.rs"]
mod script;

use std::{
    error::Error,
    fmt::Write as _,
    io::{Read, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    time::Duration,
};

use pico::{InboundQuery, Session, SessionConfig};
use script::{NOW_US, SEED, act, batches, event_line, hex, set};
use zenoh::{Wait, qos::CongestionControl};

/// Silence after which the router is taken to have said everything.
const SILENCE: Duration = Duration::from_millis(400);

const CONVERSATION: &[&str] = &[
    "router token alive/router",
    "router offer shelf/book",
    "do subscribe fleet/node/left/*",
    "do publish fleet/node/left/status",
    "do watch alive/*",
    "do token alive/left",
    "do offer ask/*",
    "router subscribe fleet/node/*/status",
    "do put fleet/node/left/status all well",
    "do put-long fleet/node/left/status 5000",
    "do delete fleet/node/left/status",
    "router put fleet/node/*/stop now",
    "router put-long fleet/node/left/batch 3500",
    "router put fleet/node/left/batch after",
    "do get shelf/book page=3",
    "do get shelf/cat",
    "router get ask/time",
    "do answer ask/time noon",
    "router forget",
    "do close",
];

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let directory = std::env::args().nth(1).ok_or("usage: record DIRECTORY")?;
    let users = std::env::temp_dir().join(format!("pico-record-{}", std::process::id()));
    std::fs::write(&users, "n1:secret\n")?;
    let users = users
        .to_str()
        .ok_or("a temporary directory without a name")?;
    let runtime = tokio::runtime::Runtime::new()?;
    let _inside = runtime.enter();
    for (name, settings, user_file) in [
        ("qos", &["set qos"][..], None),
        ("flat", &["set flat"], None),
        ("password", &["set qos", "set user n1 secret"], Some(users)),
        (
            "wrong_password",
            &["set qos", "set user n1 wrong"],
            Some(users),
        ),
    ] {
        let text = record(settings, user_file)?;
        std::fs::write(format!("{directory}/{name}.txt"), text)?;
        println!("{name}.txt");
    }
    std::fs::remove_file(users)?;
    Ok(())
}

/// Things of the router's side that live until they are forgotten.
#[derive(Default)]
struct Held(Vec<Box<dyn std::any::Any>>);

fn record(
    settings: &[&str],
    user_file: Option<&str>,
) -> Result<String, Box<dyn Error + Send + Sync>> {
    let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    let router = open_router(address, user_file)?;
    let mut config = SessionConfig::default();
    let mut text = String::from("# Recorded against zenoh 1.10.2 by examples/record.rs.\n");
    for setting in settings {
        writeln!(text, "{setting}")?;
        set(
            &mut config,
            setting.strip_prefix("set ").ok_or("a setting")?,
        );
    }
    let mut session = Session::new(config, SEED);
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(SILENCE))?;
    session.handle_connected(NOW_US);
    let mut input = Vec::new();
    let mut asked: Vec<InboundQuery> = Vec::new();
    let mut held = Held::default();
    exchange(&mut session, &mut stream, &mut input, &mut asked, &mut text)?;
    if session.is_open() {
        for line in CONVERSATION {
            writeln!(text, "{line}")?;
            match line.split_once(' ') {
                Some(("do", rest)) => act(&mut session, &mut asked, rest),
                Some(("router", rest)) => router_acts(&router, &mut held, rest)?,
                _ => return Err("a line that nobody does".into()),
            }
            exchange(&mut session, &mut stream, &mut input, &mut asked, &mut text)?;
        }
    }
    router.close().wait()?;
    Ok(text)
}

fn open_router(
    address: SocketAddr,
    user_file: Option<&str>,
) -> Result<zenoh::Session, Box<dyn Error + Send + Sync>> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"router\"")?;
    config.insert_json5("listen/endpoints", &format!("[\"tcp/{address}\"]"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    if let Some(file) = user_file {
        config.insert_json5(
            "transport/auth/usrpwd/dictionary_file",
            &format!("\"{file}\""),
        )?;
        config.insert_json5("transport/auth/usrpwd/user", "\"router\"")?;
        config.insert_json5("transport/auth/usrpwd/password", "\"router\"")?;
    }
    zenoh::open(config).wait()
}

fn router_acts(
    router: &zenoh::Session,
    held: &mut Held,
    line: &str,
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let (verb, rest) = line.split_once(' ').unwrap_or((line, ""));
    let (key, value) = rest.split_once(' ').unwrap_or((rest, ""));
    let (key, value) = (key.to_string(), value.to_string());
    match verb {
        "put" => router
            .put(key, value)
            .congestion_control(CongestionControl::Block)
            .wait()?,
        "put-long" => router
            .put(key, vec![b'y'; value.parse()?])
            .congestion_control(CongestionControl::Block)
            .wait()?,
        "subscribe" => held
            .0
            .push(Box::new(router.declare_subscriber(key).wait()?)),
        "token" => held
            .0
            .push(Box::new(router.liveliness().declare_token(key).wait()?)),
        "offer" => {
            let queryable = router
                .declare_queryable(key.clone())
                .callback(move |query| {
                    let answer = format!("{} of {}", query.parameters(), key);
                    if query.reply(key.as_str(), answer).wait().is_err() {
                        eprintln!("a reply was not taken");
                    }
                });
            held.0.push(Box::new(queryable.wait()?));
        }
        "get" => held.0.push(Box::new(router.get(key).wait()?)),
        "forget" => held.0.clear(),
        other => return Err(other.into()),
    }
    Ok(())
}

/// Carries bytes both ways until the router is silent, and writes them down.
fn exchange(
    session: &mut Session,
    stream: &mut TcpStream,
    input: &mut Vec<u8>,
    asked: &mut Vec<InboundQuery>,
    text: &mut String,
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut chunk = [0; 65536];
    loop {
        let mut out = Vec::new();
        while session.poll_transmit(NOW_US, &mut out) > 0 {}
        stream.write_all(&out)?;
        for batch in batches(&mut out) {
            writeln!(text, "> {}", hex(&batch))?;
        }
        while let Some(line) = event_line(session, asked) {
            writeln!(text, "{line}")?;
        }
        if session.wants_disconnect() {
            return Ok(());
        }
        let read_bytes = match stream.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(read_bytes) => read_bytes,
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        input.extend_from_slice(&chunk[..read_bytes]);
        for batch in batches(input) {
            writeln!(text, "< {}", hex(&batch))?;
            session.handle_bytes(NOW_US, &batch)?;
            while let Some(line) = event_line(session, asked) {
                writeln!(text, "{line}")?;
            }
        }
    }
}
