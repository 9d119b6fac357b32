//! `magline serve`: the tables of a store over Arrow Flight SQL, read-only.
//!
//! A query reads the tables as they were when it was planned. The server uses the session of `magline sql`, with the
//! same rules. Results published later are visible to later queries. Answers are streamed during computation.

mod child;
mod keys;
mod parameters;
mod process;
mod queries;
mod service;
mod spool;

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use arrow_flight::flight_service_server::FlightServiceServer;
use ports::{PortListener, TokenInterceptor, encryption};
use schemas::Fault;
use tokio::{
    net::TcpListener,
    runtime::{Builder, Runtime},
    sync::watch,
    time::sleep,
};
use tonic::{service::interceptor::InterceptedService, transport::Server};

pub use child::answer;
pub use ports::Token;
pub use process::COMMAND;
use queries::QueryRegistry;
use service::StoreQueryService;

/// Settings of the query server of a store.
pub struct ServerSettings {
    /// Path of this program, which computes each query in a separate process.
    pub program: PathBuf,
    /// Folder of the store.
    pub store: PathBuf,
    /// Address to listen on; port 0 selects a free one.
    pub bind: SocketAddr,
    /// Token that a client must send.
    pub token: Option<Token>,
    /// Certificate chain and key, PEM.
    pub tls: Option<(Vec<u8>, Vec<u8>)>,
    /// Maximum memory of all queries together, in bytes.
    pub memory: usize,
    /// Folder for spilled data.
    pub spill: PathBuf,
    /// Maximum number of simultaneous queries; others wait.
    pub queries: usize,
    /// Maximum time of a query, from its request to its last row.
    pub timeout: Duration,
}

/// Number of threads for connections; queries have separate threads.
const CONNECTION_THREADS: usize = 2;
/// Time within which open answers must end after a request to stop.
const GRACE: Duration = Duration::from_secs(3);
/// A client counts as disconnected after this time without a message.
const ALIVE: Duration = Duration::from_secs(30);
/// Maximum size of a message from a client: a query, or the values of its parameters, in bytes. Answers are sent in
/// messages of about 2 MB.
const MESSAGE: usize = 4 << 20;
/// Maximum number of simultaneous requests on one connection; further requests wait.
const STREAMS: u32 = 64;

fn machine(what: &str, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("{what}: {e}"))
}

/// Serves until `stop` is true, or its sender is dropped. `started` receives the address.
///
/// # Errors
/// Fails if the address is in use or is reachable from other hosts without a token, or the certificate or key is
/// invalid.
pub fn serve(
    settings: ServerSettings,
    started: impl FnOnce(SocketAddr),
    stop: watch::Receiver<bool>,
) -> Result<(), Fault> {
    if settings.token.is_none() && !settings.bind.ip().is_loopback() {
        let what = format!("other machines can connect to {}, but the server has no token", settings.bind.ip());
        return Err(Fault::new(what).help("give a token with `--token-file`, or use `--bind 127.0.0.1:31337`"));
    }
    let threads = |name: &'static str| {
        let mut builder = Builder::new_multi_thread();
        builder.thread_name(name).enable_all();
        builder
    };
    let connections = threads("connections").worker_threads(CONNECTION_THREADS).build();
    let connections: Runtime = connections.map_err(|e| machine("cannot start threads", &e))?;
    // Each query has a thread that reads the output of its process.
    let computing = threads("queries").worker_threads(CONNECTION_THREADS).build();
    let computing: Runtime = computing.map_err(|e| machine("cannot start threads", &e))?;
    let queries = QueryRegistry::new(&settings, computing.handle().clone());
    let processes = queries.processes();
    let done = connections.block_on(listen(settings, queries, started, stop));
    processes.end();
    // All clients have disconnected, so running queries are not waited for.
    computing.shutdown_background();
    connections.shutdown_background();
    done
}

async fn listen(
    settings: ServerSettings,
    queries: QueryRegistry,
    started: impl FnOnce(SocketAddr),
    stop: watch::Receiver<bool>,
) -> Result<(), Fault> {
    let check = TokenInterceptor::new(settings.token.clone());
    let service = StoreQueryService::new(queries, settings.token);
    let mut server = Server::builder()
        .http2_keepalive_interval(Some(ALIVE))
        .http2_keepalive_timeout(Some(ALIVE))
        .max_concurrent_streams(Some(STREAMS));
    let encryption = settings.tls.map(|(certificate, key)| encryption(&certificate, &key)).transpose()?;
    let taken = |e: &dyn std::fmt::Display| machine(&format!("cannot listen on {}", settings.bind), e);
    let listener = TcpListener::bind(settings.bind).await.map_err(|e| taken(&e))?;
    let door = PortListener::new(listener, encryption);
    started(door.address().map_err(|e| taken(&e))?);
    let stopped = |mut stop: watch::Receiver<bool>| async move {
        // An error means that the sender was dropped, which also stops the server.
        let _ = stop.wait_for(|stop| *stop).await;
    };
    let (first, later) = (stopped(stop.clone()), stopped(stop));
    let flight = FlightServiceServer::new(service).max_decoding_message_size(MESSAGE);
    let server = server.add_service(InterceptedService::new(flight, check));
    tokio::select! {
        done = server.serve_with_incoming_shutdown(door.open(), first) => done.map_err(|e| machine("cannot serve", &e)),
        () = async { later.await; sleep(GRACE).await } => Ok(()),
    }
}
