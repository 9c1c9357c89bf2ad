//! The disk under a real gateway fails to make anything durable, or is full: nobody gets a receipt for
//! what is not kept, the gateway ends with an error, and the next one goes on with what was.
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

/// While a file is there, `fsync` and `fdatasync` fail; while another one is, no file grows, and of
/// what is written to one at most a page finds room.
const LIBRARY: &str = r#"
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>
static int there(const char *name) {
    const char *file = getenv(name);
    return file != NULL && access(file, F_OK) == 0;
}
static int fails(void) {
    if (!there("FAILING_DISK")) return 0;
    errno = EIO;
    return 1;
}
static int is_full(int file) {
    struct stat found;
    if (!there("FULL_DISK")) return 0;
    if (fstat(file, &found) != 0 || !S_ISREG(found.st_mode)) return 0;
    errno = ENOSPC;
    return 1;
}
ssize_t pwrite(int file, const void *bytes, size_t count, off_t at) {
    ssize_t (*real)(int, const void *, size_t, off_t) =
        (ssize_t (*)(int, const void *, size_t, off_t))dlsym(RTLD_NEXT, "pwrite");
    if (is_full(file)) {
        /* What is left of the disk takes the first page of a larger piece. */
        if (count <= 4096) return -1;
        count = 4096;
    }
    return real(file, bytes, count, at);
}
ssize_t pwrite64(int file, const void *bytes, size_t count, off_t at) {
    return pwrite(file, bytes, count, at);
}
int ftruncate(int file, off_t length) {
    int (*real)(int, off_t) = (int (*)(int, off_t))dlsym(RTLD_NEXT, "ftruncate");
    struct stat found;
    if (is_full(file) && fstat(file, &found) == 0 && length > found.st_size) {
        errno = ENOSPC;
        return -1;
    }
    return real(file, length);
}
int ftruncate64(int file, off_t length) { return ftruncate(file, length); }
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
    lose_a_job("FAILING_DISK");
}

#[test]
fn on_a_full_disk_there_is_no_receipt_and_afterwards_every_job_has_run_once() {
    lose_a_job("FULL_DISK");
}

/// Hands a job in while the disk fails as this variable says.
fn lose_a_job(how: &str) {
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
        program.env("LD_PRELOAD", &library).env(how, &trigger);
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
