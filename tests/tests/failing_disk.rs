//! The disk under a real gateway fails to make anything durable: nobody gets a receipt for what is
//! not kept, the gateway ends with an error, and the next one goes on with what was.
#![cfg(target_os = "linux")]

use emulator::{EmulatedHandle, EmulatorConfig};
use keys::{AxisId, NodeId};
use serde_json::{Value, json};
use std::{
    fs,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};
use tests::field::{self, Gateway, PATIENCE};

/// `fsync` and `fdatasync` fail while a file is there.
const LIBRARY: &str = r#"
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <unistd.h>
static int fails(void) {
    const char *file = getenv("FAILING_DISK");
    if (file == NULL || access(file, F_OK) != 0) return 0;
    errno = EIO;
    return 1;
}
int fsync(int file) {
    int (*real)(int) = (int (*)(int))dlsym(RTLD_NEXT, "fsync");
    return fails() ? -1 : real(file);
}
int fdatasync(int file) {
    int (*real)(int) = (int (*)(int))dlsym(RTLD_NEXT, "fdatasync");
    return fails() ? -1 : real(file);
}
"#;

fn compile(folder: &Path) -> std::path::PathBuf {
    let (source, library) = (folder.join("disk.c"), folder.join("disk.so"));
    fs::write(&source, LIBRARY).expect("writes");
    let status = Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .args([&library, &source])
        .arg("-ldl")
        .status()
        .expect("a C compiler, as for Lua");
    assert!(status.success());
    library
}

fn job(id: &str, steps: i64) -> Value {
    json!({"id": id, "commands": [{"move": {"axis": 0, "delay_us": 100, "steps": steps}}]})
}

fn submit(client: &zenoh::Session, id: &str, steps: i64) -> Value {
    let answers = field::get(client, "fleet/node/left/job", Some(&job(id, steps)));
    answers.into_iter().next().unwrap_or_default()
}

fn wait_for(client: &zenoh::Session, id: &str) {
    let since = Instant::now();
    loop {
        let records = field::get(client, &format!("fleet/job/{id}"), None);
        if records
            .first()
            .is_some_and(|record| record["state"] == "succeeded")
        {
            return;
        }
        assert!(since.elapsed() < PATIENCE, "{records:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn node_at(connect: &str) -> EmulatedHandle {
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.connect = connect.to_owned();
    emulator::spawn(config).expect("a good configuration")
}

#[test]
fn without_fsync_there_is_no_receipt_and_afterwards_every_job_has_run_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let library = compile(folder.path());
    let trigger = folder.path().join("fails");
    let store = folder.path().join("fleet.redb");
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    let _inside = runtime.enter();
    // Apart, so that clients and node stay connected.
    let (_router, connect) = field::open_router();
    let start = || {
        let mut program = Command::new(field::binary("fleet"));
        program
            .env("LD_PRELOAD", &library)
            .env("FAILING_DISK", &trigger);
        Gateway::run(program, &store, Some(&connect))
    };
    let mut gateway = start();
    let node = node_at(&connect);
    let client = field::open_client(&connect);
    field::wait_for_nodes(&client, 1, |node| node["alive"] == true);
    assert_eq!(submit(&client, "before", 100)["job"], "before");
    wait_for(&client, "before");

    fs::write(&trigger, b"").expect("writes");
    let answer = submit(&client, "lost", 1_000);
    assert!(
        answer["job"].is_null(),
        "a receipt for what is not kept: {answer}"
    );
    assert!(!gateway.process.wait().success(), "it ends with an error");
    assert_eq!(node.position_steps(AxisId(0)), 100, "nothing moved for it");

    fs::remove_file(&trigger).expect("removes");
    let _gateway = start();
    field::wait_for_nodes(&client, 1, |node| node["alive"] == true);
    wait_for(&client, "before");
    // Whoever got no receipt asks again, under the same name.
    assert_eq!(submit(&client, "lost", 1_000)["job"], "lost");
    wait_for(&client, "lost");
    assert_eq!(node.position_steps(AxisId(0)), 1_100);
}
