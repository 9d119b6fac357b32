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
use run::ballista::{self, ClusterTrust, WorkerConfig, WorkerExit};
use store::shown;

use super::{ExitReason, engine, invocation, note, task, tend::age, threads};

/// Delay before a worker that has lost its scheduler restarts.
const AGAIN_AFTER: Duration = Duration::from_secs(1);

/// Options for the shared key of a cluster.
#[derive(Args)]
struct ClusterKeyArgs {
    /// The file with the key that scheduler, workers and runs of a cluster share. Connections are encrypted; a
    /// connection without the key is rejected. By default, the key is in the environment variable MAGLINE_CLUSTER_KEY.
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// For tests: require no key, and listen only on the loopback address. Every user of this machine can then run
    /// computations in this process.
    #[arg(long, conflicts_with = "key_file")]
    insecure_loopback: bool,
}

impl ClusterKeyArgs {
    fn read(&self) -> Result<ClusterTrust, ExitReason> {
        Ok(ClusterTrust::read(self.key_file.as_deref(), self.insecure_loopback)?)
    }
}

/// The arguments of `scheduler`.
#[derive(Args)]
pub struct SchedulerArgs {
    /// The address to listen on.
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:50050")]
    bind: SocketAddr,
    /// The host name or address that workers connect to; by default the address of `--bind`, or the host name for
    /// 0.0.0.0.
    #[arg(long, value_name = "NAME")]
    advertise: Option<String>,
    /// The maximum time between two reports of a worker. After this time, its tasks are dispatched to other workers.
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = age)]
    worker_timeout: Duration,
    #[command(flatten)]
    trust: ClusterKeyArgs,
    /// Suppress notes.
    #[arg(short, long)]
    quiet: bool,
}

/// The arguments of `worker`.
#[derive(Args)]
pub struct WorkerArgs {
    /// The address of the scheduler.
    #[arg(long, value_name = "HOST:PORT", value_parser = engine::scheduler)]
    scheduler: (String, u16),
    /// The store of the runs: its folder, or its address such as s3://BUCKET/PREFIX.
    #[arg(long, default_value = "store", value_parser = super::located)]
    store: PathBuf,
    /// The number of concurrent tasks, each in a process of one thread; all cores by default.
    #[arg(long, value_name = "N", value_parser = threads::count)]
    cores: Option<usize>,
    /// The folder for receipts in transit; by default the system's folder for temporary files.
    #[arg(long, value_name = "DIR")]
    work: Option<PathBuf>,
    /// The address to listen on. The scheduler must be able to connect to it.
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    bind: IpAddr,
    /// The host name or address that the scheduler connects to; by default the address of `--bind`, or the host name
    /// for 0.0.0.0.
    #[arg(long, value_name = "NAME")]
    advertise: Option<String>,
    /// The first of two consecutive ports to listen on; by default two free ports.
    #[arg(long, value_name = "PORT", default_value_t = 0, hide_default_value = true)]
    port: u16,
    /// Interval between reports to the scheduler.
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = age)]
    heartbeat: Duration,
    #[command(flatten)]
    trust: ClusterKeyArgs,
    /// Suppress notes and the errors of units; receipts contain the errors.
    #[arg(short, long)]
    quiet: bool,
}

/// The help of `worker`.
pub const WORKER_HELP: &str = "\
The worker prints a receipt of each task, as `magline task` does. A worker that loses its scheduler waits for it and \
registers again. After SIGTERM or Ctrl-C, it finishes its current units and ends.

Exit status:
  0  stopped by a signal
  1  the scheduler cannot connect to the worker, or a port is not available
  2  the scheduler has another version or key, or there is no key

pipeline/CLUSTER.md describes all failures.";

/// Sets the log of Ballista: warnings, or the levels of the variable RUST_LOG.
fn log() {
    let mut log = env_logger::Builder::new();
    log.filter_level(LevelFilter::Warn).parse_env("RUST_LOG");
    log.format(|to, record| {
        writeln!(to, "{}: {}: {}", record.level().as_str().to_lowercase(), record.target(), record.args())
    });
    // An existing logger is kept.
    let _ = log.try_init();
}

fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// Serves as the scheduler of a cluster until a stop signal arrives.
///
/// # Errors
/// Fails if the address cannot be listened on.
pub fn scheduler(args: &SchedulerArgs) -> Result<(), ExitReason> {
    super::QUIET.store(args.quiet, std::sync::atomic::Ordering::Relaxed);
    log();
    let listening = ballista::listen(args.bind, args.advertise.as_deref(), args.worker_timeout, args.trust.read()?)?;
    let at = listening.advertised();
    note(&format!("the scheduler listens on {}", listening.address()));
    note(&format!(
        "workers: `magline worker --scheduler {at} --store STORE`; runs: `magline run SPEC --engine ballista://{at}`"
    ));
    if args.trust.insecure_loopback {
        note("no key is required, so every user of this machine can run computations in this process");
    }
    Ok(listening.serve()?)
}

/// Computes the tasks of a scheduler until a stop signal arrives.
///
/// # Errors
/// Fails if the scheduler has another version or cannot reach this worker.
pub fn worker(args: &WorkerArgs) -> Result<(), ExitReason> {
    super::QUIET.store(args.quiet, std::sync::atomic::Ordering::Relaxed);
    log();
    let trust = args.trust.read()?;
    let (host, port) = args.scheduler.clone();
    let at = engine::at(&host, port);
    if args.bind.is_loopback() && !is_loopback(&host) {
        return Err(ExitReason::Wrong(format!(
            "error: the scheduler at {at} cannot connect to this worker on {}\n  help: give an address of this host \
             with `--bind`, such as `--bind 0.0.0.0`",
            args.bind
        )));
    }
    if !args.store.join("STORE").is_file() {
        note(&format!("there is no store {} yet; tasks are rejected until a run creates it", shown(&args.store)));
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
    ballista::await_scheduler(&at, &config.trust, None, |why| {
        note(&format!("waiting for the scheduler at {at}: {why}"));
    })?;
    note(&format!("{} registered with the scheduler at {at}", super::counted(config.cores, "core")));
    match ballista::work(&config, Box::new(task::print))? {
        WorkerExit::Requested => Ok(()),
        WorkerExit::Alone => {
            note(&format!("the connection to the scheduler at {at} is lost; restarting the worker"));
            sleep(AGAIN_AFTER);
            // Replaces this process, because parts of Ballista cannot be started twice in one process.
            let e = Command::new(&config.program).args(invocation::arguments()).exec();
            Err(ExitReason::Failed(format!("error: cannot start {}: {e}", config.program.display())))
        }
    }
}
