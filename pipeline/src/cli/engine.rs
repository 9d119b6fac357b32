//! `--engine`: the engine of a run.

use std::time::Duration;

use clap::Args;
use url::Url;

use super::{ExitReason, invocation, tend, threads};

/// Default port of a scheduler.
const PORT: u16 = 50050;

/// Engine of a run, and its limits.
#[derive(Args)]
pub struct EngineArgs {
    /// The engine. `local` computes in threads of this process. `processes` computes in processes of one thread each: a
    /// unit that crashes or takes too long affects no other unit. `ballista://HOST:PORT` computes on the workers of a
    /// cluster. Results do not depend on the engine.
    #[arg(long, value_name = "ENGINE", default_value = "local", value_parser = named)]
    engine: EngineName,
    /// Time limit of a unit, such as 90s or 2h. Requires `--engine processes` or a cluster.
    #[arg(long, value_name = "TIME", value_parser = tend::age)]
    unit_timeout: Option<Duration>,
    /// Maximum number of retries of a unit whose worker was lost; `--retries 2` permits three attempts.
    #[arg(long, value_name = "N", default_value_t = run::RETRIES)]
    pub retries: usize,
    /// With a cluster: the time to wait for the scheduler and for a worker. After this time, the remaining units fail.
    #[cfg(feature = "cluster")]
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = tend::age)]
    patience: Duration,
    /// With a cluster: the file with the key that scheduler, workers and runs share. By default, the key is in the
    /// environment variable MAGLINE_CLUSTER_KEY.
    #[cfg(feature = "cluster")]
    #[arg(long, value_name = "FILE")]
    key_file: Option<std::path::PathBuf>,
    /// With a cluster, for tests: use no key. The scheduler must listen on the loopback address.
    #[cfg(feature = "cluster")]
    #[arg(long, conflicts_with = "key_file")]
    insecure_loopback: bool,
}

/// Name of an engine.
#[derive(Clone, Debug, PartialEq, Eq)]
enum EngineName {
    /// The threads of this process.
    Local,
    /// Processes of this program.
    Processes,
    /// The cluster of a scheduler at HOST:PORT.
    Ballista(String),
}

/// Reads the value of `--engine`.
fn named(text: &str) -> Result<EngineName, String> {
    match text {
        "local" => Ok(EngineName::Local),
        "processes" => Ok(EngineName::Processes),
        url if url.starts_with("ballista:") => authority(url).map(|(host, port)| EngineName::Ballista(at(&host, port))),
        _ => Err("the engine must be `local`, `processes` or `ballista://HOST:PORT`".to_owned()),
    }
}

/// Formats HOST:PORT.
pub fn at(host: &str, port: u16) -> String {
    format!("{host}:{port}")
}

/// Host and port of `ballista://HOST:PORT`. An IPv6 address is in brackets.
fn authority(text: &str) -> Result<(String, u16), String> {
    let wrong = || format!("`{text}` is not the address of a scheduler: write ballista://HOST:PORT");
    let url = Url::parse(text).map_err(|e| format!("{}: {e}", wrong()))?;
    let bare = url.username().is_empty() && url.password().is_none() && url.query().is_none();
    let bare = bare && url.fragment().is_none() && matches!(url.path(), "" | "/");
    match url.host_str().filter(|host| !host.is_empty() && bare && url.scheme() == "ballista") {
        Some(host) => Ok((host.to_owned(), url.port().unwrap_or(PORT))),
        None => Err(wrong()),
    }
}

/// Reads HOST:PORT.
#[cfg(feature = "cluster")]
pub fn scheduler(text: &str) -> Result<(String, u16), String> {
    authority(&format!("ballista://{text}"))
        .map_err(|_| format!("`{text}` is not the address of a scheduler: write HOST:PORT"))
}

/// The requested engine, with `threads` threads or processes.
pub fn engine(args: &EngineArgs, threads: Option<usize>) -> Result<Box<dyn run::TaskEngine>, ExitReason> {
    let unit_timeout = args.unit_timeout;
    match &args.engine {
        EngineName::Local if unit_timeout.is_none() => Ok(Box::new(run::LocalEngine)),
        EngineName::Local => Err(ExitReason::Wrong(
            "error: the engine `local` cannot stop a unit after a time limit\n  help: use `--engine processes` with \
             `--unit-timeout`"
                .to_owned(),
        )),
        EngineName::Processes => {
            let program = program()?;
            let count = threads.unwrap_or_else(threads::cores);
            Ok(Box::new(run::ProcessEngine { program, count, retries: args.retries, unit_timeout }))
        }
        #[cfg(feature = "cluster")]
        EngineName::Ballista(authority) => {
            let limits = run::ballista::DispatchLimits { retries: args.retries, unit_timeout, patience: args.patience };
            let trust = run::ballista::ClusterTrust::read(args.key_file.as_deref(), args.insecure_loopback)?;
            let seconds = args.patience.as_secs();
            let waits = |why: &str| {
                super::note(&format!(
                    "waiting up to {seconds} s (`--patience`) for the scheduler at {authority}: {why}"
                ));
            };
            Ok(Box::new(run::ballista::BallistaEngine::connect(authority, &trust, limits, waits)?))
        }
        #[cfg(not(feature = "cluster"))]
        EngineName::Ballista(_) => Err(without_cluster()),
    }
}

/// Path of this program.
pub fn program() -> Result<std::path::PathBuf, ExitReason> {
    invocation::program().map_err(|e| ExitReason::Failed(format!("error: cannot find the magline executable: {e}")))
}

/// Error of a build without cluster support.
#[cfg(not(feature = "cluster"))]
pub fn without_cluster() -> ExitReason {
    ExitReason::Wrong(
        "error: this magline was built without the feature `cluster`\n  help: build magline with `cargo build \
         --features cluster`, or use `--engine processes`"
            .to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_engines_are_parsed_and_invalid_engines_rejected() {
        let ballista = |text: &str| Ok(EngineName::Ballista(text.to_owned()));
        assert_eq!(named("local"), Ok(EngineName::Local));
        assert_eq!(named("processes"), Ok(EngineName::Processes));
        assert_eq!(named("ballista://node-7.cluster:4711"), ballista("node-7.cluster:4711"));
        assert_eq!(named("ballista://10.0.0.1"), ballista("10.0.0.1:50050"));
        assert_eq!(named("ballista://[::1]:7/"), ballista("[::1]:7"));
        for wrong in [
            "",
            "Local",
            "spark://x:1",
            "ballista",
            "ballista:",
            "ballista://",
            "ballista:x:1",
            "ballista://:50050",
            "ballista://x:port",
            "ballista://x:70000",
            "ballista://x:1/queue",
            "ballista://me@x:1",
            "ballista://x:1?a=b",
            "ballista://x:1#a",
        ] {
            let message = named(wrong).unwrap_err();
            assert!(message.contains("ballista://HOST:PORT"), "{wrong}: {message}");
        }
    }
}
