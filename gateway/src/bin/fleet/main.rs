//! The operator's command line.
//!
//! `args.rs` is what can be typed, one file per verb does it, `link.rs` is the zenoh client that
//! all of them share (`serve` alone is the gateway itself), `show.rs` prints.

mod args;
mod backup;
#[cfg(feature = "demo")]
mod bench;
mod check;
#[cfg(feature = "demo")]
mod demo;
mod driver;
mod follow;
mod help;
mod jog;
mod kept;
mod link;
mod log;
mod manage;
mod pace;
mod pins;
mod provision;
mod script;
mod secure;
mod serve;
mod setup;
mod show;
mod sign;
mod stop;
mod submit;
mod supervisor;
mod trace;
mod tuning;
mod update;
mod watch;
mod written;

use args::{Common, Line, Verb};
use clap::Parser;
use keys::StopMode;
use link::{Failure, Link};
use std::process::ExitCode;

#[tokio::main]
async fn main() -> ExitCode {
    let line = Line::parse();
    let result = match &line.verb {
        Verb::Serve(serve) => run_gateway(&line.common, serve).await,
        verb => run_command(&line.common, verb).await,
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if let Some(message) = failure.message() {
                eprintln!("fleet: {message}");
            }
            ExitCode::from(failure.code())
        }
    }
}

async fn run_command(common: &Common, verb: &Verb) -> Result<(), Failure> {
    // A client's errors are told in its own words; the log of zenoh's is for who asks for it.
    let log = log::start("off", None)?;
    let result = perform(common, verb).await;
    log.end();
    result
}

/// The gateway's settings say where its spans go.
async fn run_gateway(common: &Common, line: &args::Serve) -> Result<(), Failure> {
    let config = serve::config(common, line)?;
    let log = log::start("info,zenoh=error", config.otlp.as_ref())?;
    let result = serve::serve(config, line, common.json).await;
    log.end();
    result
}

async fn perform(common: &Common, verb: &Verb) -> Result<(), Failure> {
    match verb {
        Verb::Config(config) => return serve::print_config(config),
        Verb::Help(line) => return help::help(line),
        Verb::Completions(line) => {
            help::completions(line);
            return Ok(());
        }
        Verb::Man => return help::man(),
        Verb::Check(line) => return check::check(line, common.json),
        Verb::Init(init) => return secure::init(init, common.json),
        Verb::Users(users) => return secure::users(users, common.json),
        Verb::Keys(keys) => return secure::keys(keys, common.json),
        Verb::Doctor(doctor) => return backup::doctor(doctor, common.json),
        Verb::Backup(line) if line.store.is_some() => {
            return backup::backup(None, line, common.json).await;
        }
        Verb::Provision(line) => return provision::provision(common, line).await,
        Verb::UpdateKey(line) => return update::make_key(line, common),
        #[cfg(feature = "demo")]
        Verb::Demo => return demo::demo(common).await,
        #[cfg(feature = "demo")]
        Verb::Bench(line) => {
            return bench::bench(common, &line.what, &line.nodes, line.seconds).await;
        }
        #[cfg(feature = "demo")]
        Verb::BenchNodes(line) => return bench::run_nodes(line.count, &line.connect).await,
        _ => {}
    }
    let link = Link::open(common).await?;
    let json = common.json;
    let result = match verb {
        Verb::Nodes => submit::nodes(&link, json).await,
        Verb::Submit(submit) => submit::submit(&link, submit, json).await,
        Verb::Jobs(jobs) => submit::jobs(&link, jobs, json).await,
        Verb::Trace(line) => trace::trace(&link, &line.job, json).await,
        Verb::Label(line) => manage::label(&link, line, json).await,
        Verb::Maintenance(line) => manage::maintenance(&link, line, json).await,
        Verb::Queue(line) => manage::queue(&link, line, json).await,
        Verb::Template(line) => kept::templates(&link, line, json).await,
        Verb::Schedule(line) => kept::schedules(&link, line, json).await,
        Verb::Move(line) => manage::reorder(&link, line, json).await,
        Verb::Watch(watch) => watch::watch(&link, watch.seconds, json).await,
        Verb::Cancel(cancel) => submit::cancel(&link, &cancel.job, json).await,
        Verb::Stop(stop) => {
            let mode = if stop.decelerate {
                StopMode::Decelerate
            } else {
                StopMode::Halt
            };
            stop::stop(&link, &stop.pattern, mode, json).await
        }
        Verb::Hold(hold) => pace::pace(&link, &hold.pattern, "hold", None, json).await,
        Verb::Resume(resume) => pace::pace(&link, &resume.pattern, "resume", None, json).await,
        Verb::Speed(speed) => {
            let percent = Some(speed.percent);
            pace::pace(&link, &speed.pattern, "speed", percent, json).await
        }
        Verb::Jog(line) => jog::jog(&link, line, json).await,
        Verb::Release(release) => stop::release(&link, &release.pattern, json).await,
        Verb::Backup(line) => backup::backup(Some(&link), line, json).await,
        Verb::Update(line) => update::update(&link, line, json).await,
        Verb::Setup(line) => setup::setup(&link, &line.pattern, json).await,
        Verb::Script(line) => script::script(&link, line, json).await,
        Verb::Serve(_)
        | Verb::Config(_)
        | Verb::Check(_)
        | Verb::Help(_)
        | Verb::Completions(_)
        | Verb::Man
        | Verb::Init(_)
        | Verb::Users(_)
        | Verb::Keys(_)
        | Verb::Doctor(_)
        | Verb::Provision(_)
        | Verb::UpdateKey(_) => unreachable!("done above"),
        #[cfg(feature = "demo")]
        Verb::Demo | Verb::Bench(_) | Verb::BenchNodes(_) => unreachable!("done above"),
    };
    link.close().await;
    result
}
