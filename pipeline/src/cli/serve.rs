//! `magline serve`: the store over Arrow Flight SQL.

use std::{net::SocketAddr, path::PathBuf};

use clap::Args;
use report::sql::memory;

use super::ExitReason;

/// The arguments of a server.
#[derive(Args)]
#[cfg_attr(not(feature = "serve"), allow(dead_code, reason = "only the feature `serve` reads the fields"))]
pub struct ServeArgs {
    /// The store's folder, or its address such as s3://BUCKET/PREFIX.
    #[arg(long, default_value = "store", value_parser = super::located)]
    store: PathBuf,
    /// The address to listen on; port 0 selects a free port.
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:31337")]
    bind: SocketAddr,
    /// The file with the token that clients must send, as a bearer token, or as the password with any user name.
    /// Without a token the server accepts only connections from this machine, from any user.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// The certificate chain in PEM format. Connections are then encrypted.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// The key of the certificate in PEM format.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// The memory limit of all queries together, such as 4GB. Larger operations use temporary files. By default, a
    /// quarter of the machine's memory, at most 8 GB.
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    memory_limit: Option<usize>,
    /// The maximum number of concurrent queries; further queries wait.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..))]
    queries: u16,
    /// The time limit of a query from its request to its last row, in seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..))]
    timeout: u32,
}

/// Serves until it is interrupted.
#[cfg(not(feature = "serve"))]
pub fn run(_: &ServeArgs) -> Result<(), ExitReason> {
    Err(without_serve())
}

/// The message of a program without the feature `serve`.
#[cfg(not(feature = "serve"))]
pub fn without_serve() -> ExitReason {
    let what = "error: this magline was built without the feature `serve`\n  help: build magline with `cargo build \
                --features magline/serve`";
    ExitReason::Wrong(what.to_owned())
}

/// Serves until it is interrupted.
#[cfg(feature = "serve")]
pub fn run(args: &ServeArgs) -> Result<(), ExitReason> {
    use std::{fs, path::Path, time::Duration};

    use schemas::Fault;
    use tokio::sync::watch;

    use super::{note, say::err, temporary::TemporaryFolder, tend};
    use crate::serve::{ServerSettings, Token, serve};

    if !tend::is_store(&args.store) {
        let fault = Fault::new(format!("{} is not a store", args.store.display()));
        return Err(fault.help("run a spec first, then give its store with `--store`").into());
    }
    let read = |path: &Path| fs::read(path).map_err(|e| Fault::new(format!("cannot read {}: {e}", path.display())));
    let token = args.token_file.as_deref().map(|path| -> Result<Token, Fault> {
        let text = String::from_utf8(read(path)?);
        let text = text.map_err(|_| Fault::new(format!("{} is not text", path.display())))?;
        Token::read(&text).map_err(|f| f.in_file(&path.display().to_string()))
    });
    let token = token.transpose()?;
    if let Some(path) = args.token_file.as_deref().filter(|path| others_read(path)) {
        note(&format!("other users of this machine can read the token file; run `chmod 600 {}`", path.display()));
    }
    let tls = match (&args.tls_cert, &args.tls_key) {
        (Some(certificate), Some(key)) => Some((read(certificate)?, read(key)?)),
        _ => None,
    };
    if tls.is_none() && !args.bind.ip().is_loopback() && token.is_some() {
        note("the token and all results are sent without encryption; encrypt them with `--tls-cert` and `--tls-key`");
    }
    let (stop, stopped) = watch::channel(false);
    // If no handler can be set, an interrupt ends the process at once.
    let _ = ctrlc::set_handler(move || {
        // A second interrupt does not wait for open queries.
        if stop.send_replace(true) {
            super::temporary::remove_all();
            std::process::exit(130);
        }
    });
    let spill = TemporaryFolder::new()?;
    let settings = ServerSettings {
        program: super::engine::program()?,
        store: args.store.clone(),
        bind: args.bind,
        token,
        tls,
        memory: args.memory_limit.unwrap_or_else(memory::by_default),
        spill: spill.path().to_owned(),
        queries: usize::from(args.queries),
        timeout: Duration::from_secs(u64::from(args.timeout)),
    };
    let scheme = if settings.tls.is_some() { "grpc+tls" } else { "grpc" };
    let who = if settings.token.is_some() { "with a token" } else { "to all users of this machine" };
    let store = args.store.display();
    Ok(serve(settings, |address| err!("serving {store} at {scheme}://{address}, read-only, {who}"), stopped)?)
}

/// Whether the group or others may read a file.
#[cfg(feature = "serve")]
fn others_read(file: &std::path::Path) -> bool {
    use std::os::unix::fs::PermissionsExt;

    std::fs::metadata(file).is_ok_and(|m| m.is_file() && m.permissions().mode() & 0o044 != 0)
}
