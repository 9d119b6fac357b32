//! `scheduler` and `worker`: a cluster of this program.

use std::{
    io::Write,
    net::{IpAddr, SocketAddr},
    os::unix::process::CommandExt,
    path::PathBuf,
    process::Command,
    thread::sleep,
    time::Duration,
};

use clap::Args;
use log::LevelFilter;

use super::{Stop, engine, note, task, tend::age, threads};
use crate::{
    run::ballista::{self, Ended, Trust, WorkerConfig},
    store::shown,
};

/// How long a worker that has lost its scheduler waits before it begins again.
const AGAIN_AFTER: Duration = Duration::from_secs(1);

/// How the members of a cluster know each other.
#[derive(Args)]
struct TrustArgs {
    /// The file that holds the key of the cluster, which scheduler, workers and runs share: connections are encrypted, and
    /// refused without it. By default the key is taken from the variable MAGLINE_CLUSTER_KEY.
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// For tests: ask nobody for a key, and listen on the loopback alone. Every user of this machine can then have this
    /// program compute.
    #[arg(long, conflicts_with = "key_file")]
    insecure_loopback: bool,
}

impl TrustArgs {
    fn read(&self) -> Result<Trust, Stop> {
        Ok(Trust::read(self.key_file.as_deref(), self.insecure_loopback)?)
    }
}

/// The arguments of `scheduler`.
#[derive(Args)]
pub struct SchedulerArgs {
    /// The address to listen on.
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:50050")]
    bind: SocketAddr,
    /// The name by which workers reach this scheduler; by default the address, or the host's name where it listens on all.
    #[arg(long, value_name = "NAME")]
    advertise: Option<String>,
    /// How long a worker may be silent before what it had is given to others.
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = age)]
    worker_timeout: Duration,
    #[command(flatten)]
    trust: TrustArgs,
    /// No notes.
    #[arg(short, long)]
    quiet: bool,
}

/// The arguments of `worker`.
#[derive(Args)]
pub struct WorkerArgs {
    /// The scheduler.
    #[arg(long, value_name = "HOST:PORT", value_parser = engine::scheduler)]
    scheduler: (String, u16),
    /// The store of the runs: its folder, or its address.
    #[arg(long, default_value = "store", value_parser = super::located)]
    store: PathBuf,
    /// Tasks at once, each in a process of one thread; all cores by default.
    #[arg(long, value_name = "N", value_parser = threads::count)]
    cores: Option<usize>,
    /// The folder for receipts that are on their way; by default that of the system for temporary files.
    #[arg(long, value_name = "DIR")]
    work: Option<PathBuf>,
    /// The address to listen on, which the scheduler must reach.
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    bind: IpAddr,
    /// The name by which the scheduler reaches this worker; by default the address, or the host's name where it listens on all.
    #[arg(long, value_name = "NAME")]
    advertise: Option<String>,
    /// The first of two ports to listen on; by default two that are free.
    #[arg(long, value_name = "PORT", default_value_t = 0, hide_default_value = true)]
    port: u16,
    /// The time between two reports to the scheduler.
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = age)]
    heartbeat: Duration,
    #[command(flatten)]
    trust: TrustArgs,
    /// What is wrong with units is in their receipts alone.
    #[arg(short, long)]
    quiet: bool,
}

/// The help of `worker`.
pub const WORKER_HELP: &str = "\
A receipt of each task is printed, as by `magline task`. A worker that loses its scheduler waits for it, and begins again. \
Told to stop (SIGTERM, Ctrl-C) it finishes the units it is at. Exit status: 0 told to stop; 1 the scheduler cannot reach it, or a \
port is not to be had; 2 the scheduler is another version or has another key, or there is no key. pipeline/CLUSTER.md says what happens when.";

/// What Ballista says: warnings, or what the variable RUST_LOG asks for.
fn log() {
    let mut log = env_logger::Builder::new();
    log.filter_level(LevelFilter::Warn).parse_env("RUST_LOG");
    log.format(|to, said| writeln!(to, "{}: {}: {}", said.level().as_str().to_lowercase(), said.target(), said.args()));
    // One that is set already stays.
    let _ = log.try_init();
}

fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// Serves as the scheduler of a cluster, until it is told to stop.
///
/// # Errors
/// Fails when the address cannot be listened on.
pub fn scheduler(args: &SchedulerArgs) -> Result<(), Stop> {
    super::QUIET.store(args.quiet, std::sync::atomic::Ordering::Relaxed);
    log();
    let listening = ballista::listen(args.bind, args.advertise.as_deref(), args.worker_timeout, args.trust.read()?)?;
    let at = listening.advertised();
    note(&format!("the scheduler listens on {}", listening.address()));
    note(&format!(
        "workers: `magline worker --scheduler {at} --store STORE`; runs: `magline run SPEC --engine ballista://{at}`"
    ));
    if args.trust.insecure_loopback {
        note("nobody is asked for a key: every user of this machine can have this program compute");
    }
    Ok(listening.serve()?)
}

/// Computes what a scheduler hands out, until it is told to stop.
///
/// # Errors
/// Fails when the scheduler is another version or cannot reach this worker.
pub fn worker(args: &WorkerArgs) -> Result<(), Stop> {
    super::QUIET.store(args.quiet, std::sync::atomic::Ordering::Relaxed);
    log();
    let trust = args.trust.read()?;
    let (host, port) = args.scheduler.clone();
    let at = engine::at(&host, port);
    if args.bind.is_loopback() && !is_loopback(&host) {
        return Err(Stop::Wrong(format!(
            "error: the scheduler at {at} cannot reach this worker on {}\n  help: name an address of this host with `--bind`, \
             such as `--bind 0.0.0.0`",
            args.bind
        )));
    }
    if !args.store.join("STORE").is_file() {
        note(&format!("there is no store {} yet; tasks are refused until a run has made it", shown(&args.store)));
    }
    let config = WorkerConfig {
        host,
        port,
        program: engine::program()?,
        store: args.store.clone(),
        cores: args.cores.unwrap_or_else(threads::cores),
        work: args.work.clone().unwrap_or_else(std::env::temp_dir),
        bind: args.bind,
        ports: args.port,
        advertise: args.advertise.clone(),
        heartbeat: args.heartbeat,
        trust,
    };
    ballista::await_scheduler(&at, &config.trust, |why| note(&format!("waiting for the scheduler at {at}: {why}")))?;
    note(&format!("{} at work for the scheduler at {at}", super::counted(config.cores, "core")));
    match ballista::work(&config, Box::new(task::print))? {
        Ended::Told => Ok(()),
        Ended::Alone => {
            note(&format!("the scheduler at {at} is gone; beginning again"));
            sleep(AGAIN_AFTER);
            // In place of this process, of which parts of Ballista cannot be started twice.
            let e = Command::new(&config.program).args(std::env::args_os().skip(1)).exec();
            Err(Stop::Failed(format!("error: cannot start {}: {e}", config.program.display())))
        }
    }
}
