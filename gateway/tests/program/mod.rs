//! The program `fleet`: run to its end, or as a gateway in a process of its own.

#![allow(dead_code, reason = "each test uses a part of it")]

use assert_cmd::Command;
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command as Process, Stdio},
    time::Duration,
};

/// Far more than a program takes that waits for several things; only a failure waits so long.
const PROGRAM_PATIENCE: Duration = Duration::from_secs(300);

/// What a program said, and how it ended.
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// Runs `fleet` with these words.
pub(crate) fn fleet(line: &[&str]) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_fleet"))
        .args(line)
        .timeout(PROGRAM_PATIENCE)
        .output()
        .expect("started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    Ran {
        code: output.status.code(),
        out: text(output.stdout),
        err: text(output.stderr),
    }
}

/// The same as [`PROGRAM_PATIENCE`] for each of its answers, as an option.
pub(crate) const PATIENT: [&str; 2] = ["--timeout", "60"];

/// A gateway in a process of its own, ended with the test.
pub(crate) struct Gateway {
    pub(crate) process: Child,
    pub(crate) connect: String,
    http: String,
    _store: tempfile::TempDir,
}

impl Gateway {
    pub(crate) fn start() -> Self {
        Self::start_with(&[], "error")
    }

    /// Runs it with options of `fleet serve`; `log` is what is logged.
    pub(crate) fn start_with(options: &[&str], log: &str) -> Self {
        Self::run(Process::new(env!("CARGO_BIN_EXE_fleet")), options, log)
    }

    /// Runs it by a shell that lets no file grow beyond this.
    #[cfg(unix)]
    pub(crate) fn start_with_files_up_to(kib: u32) -> Self {
        let mut shell = Process::new("bash");
        // Ignored, the signal becomes an error of the write.
        let script = format!("trap '' XFSZ; ulimit -f {kib}; exec \"$0\" \"$@\"");
        shell.args(["-c", &script, env!("CARGO_BIN_EXE_fleet")]);
        Self::run(shell, &[], "error")
    }

    fn run(mut program: Process, options: &[&str], log: &str) -> Self {
        let store = tempfile::tempdir().expect("a directory");
        let mut process = program
            .args([
                "serve",
                "--listen",
                "tcp/127.0.0.1:0",
                "--http",
                "127.0.0.1:0",
            ])
            .args(["--json", "--store"])
            .arg(store.path().join("fleet.redb"))
            .args(options)
            .env("RUST_LOG", log)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("started");
        let mut line = String::new();
        BufReader::new(process.stdout.take().expect("piped"))
            .read_line(&mut line)
            .expect("a line");
        let ready: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        let connect = ready["locators"][0].as_str().expect("text").to_owned();
        let http = ready["http"].as_str().expect("text").to_owned();
        Self {
            process,
            connect,
            http,
            _store: store,
        }
    }

    /// Ends it in good order; returns its log.
    #[cfg(unix)]
    pub(crate) fn end(mut self) -> String {
        let pid = self.process.id().to_string();
        let kill = Process::new("kill").args(["-TERM", &pid]).status();
        assert!(kill.expect("there is a kill").success());
        let mut log = String::new();
        let mut said = self.process.stderr.take().expect("piped");
        said.read_to_string(&mut log).expect("UTF-8");
        let ended = self.process.wait().expect("it was there");
        assert!(ended.success(), "{ended}: {log}");
        log
    }

    pub(crate) fn fleet(&self, line: &[&str]) -> Ran {
        fleet(&[line, &["--connect", &self.connect], &PATIENT].concat())
    }
}

impl Gateway {
    /// Asks by HTTP; returns status and body.
    pub(crate) fn http(&self, path: &str) -> (u16, String) {
        let mut socket = TcpStream::connect(&self.http).expect("connected");
        let request = format!("GET {path} HTTP/1.1\r\nHost: fleet\r\nConnection: close\r\n\r\n");
        socket.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        socket.read_to_string(&mut answer).expect("UTF-8");
        let (head, body) = answer.split_once("\r\n\r\n").expect("head and body");
        let status = head
            .split(' ')
            .nth(1)
            .and_then(|status| status.parse().ok());
        (status.expect("a status"), body.to_owned())
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        // It may have ended by itself, and then the test has failed already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
