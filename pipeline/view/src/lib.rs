//! `magline view`: a page of a store, and the data that it asks for, over HTTP on the loopback interface.
//!
//! Every address contains a random token, and the server answers only requests for its own host name. It writes only
//! the copy of an object store and temporary files of downloads.

mod answer;
mod body;
mod connection;
mod page;
mod request;
mod workers;

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    thread,
};

use report::view::{RunProgress, StoreView};
use schemas::{Fault, StageEntry};
use tokio::{
    net::TcpListener,
    runtime::Builder,
    sync::{Semaphore, watch},
};
use uuid::Uuid;

use connection::ServerState;
use workers::{ComputeQueue, work};

/// Threads for connections.
const CONNECTION_THREADS: usize = 2;
/// Threads that compute answers.
const WORKERS: usize = 3;
/// Simultaneous downloads.
const DOWNLOADS: usize = 2;
/// Simultaneous connections.
const CONNECTIONS: usize = 64;

/// Settings of a view.
pub struct ViewSettings {
    /// Port on the loopback interface; 0 selects a free one.
    pub port: u16,
    /// Path of this program, which writes the files of downloads in a separate process.
    pub program: PathBuf,
    /// Private folder for files of downloads.
    pub temporary: PathBuf,
}

/// Data of a view.
pub struct ViewData<'a> {
    /// The store.
    pub store: &'a StoreView,
    /// The runs of a spec, if the view is of a spec.
    pub run: Option<&'a RunProgress<'a>>,
}

impl ViewSettings {
    /// Serves the store in the folder `store`, whose scores have the metrics of `catalogue`, until the process ends.
    ///
    /// # Errors
    /// Fails if the store cannot be read. Also returns the errors of [`serve`].
    pub fn serve_store(
        self,
        catalogue: &[StageEntry],
        store: &Path,
        run: Option<&RunProgress>,
        started: impl FnOnce(&str),
    ) -> Result<(), Fault> {
        let metrics = catalogue.iter().flat_map(|stage| stage.metrics.iter().copied()).collect();
        let view = StoreView::new(store, metrics)?;
        let (_keep, stop) = watch::channel(false);
        serve(self, &ViewData { store: &view, run }, started, stop)
    }
}

fn machine(what: &str, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("{what}: {e}"))
}

/// Serves until `stop` is true or its sender is dropped. `started` receives the address of the page.
///
/// # Errors
/// Fails if the port is in use, or threads cannot be started.
pub fn serve(
    settings: ViewSettings,
    data: &ViewData,
    started: impl FnOnce(&str),
    stop: watch::Receiver<bool>,
) -> Result<(), Fault> {
    let runtime =
        Builder::new_multi_thread().thread_name("view").worker_threads(CONNECTION_THREADS).enable_all().build();
    let runtime = runtime.map_err(|e| machine("cannot start threads", &e))?;
    let (queue, jobs) = ComputeQueue::new();
    thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| work(data, &jobs));
        }
        let done = runtime.block_on(listen(settings, queue, started, stop));
        // Connections hold the queue. The workers end when all of them are gone.
        runtime.shutdown_background();
        done
    })
}

async fn listen(
    settings: ViewSettings,
    queue: ComputeQueue,
    started: impl FnOnce(&str),
    mut stop: watch::Receiver<bool>,
) -> Result<(), Fault> {
    let bind = SocketAddr::from((Ipv4Addr::LOCALHOST, settings.port));
    let taken = |e: &dyn std::fmt::Display| {
        machine(&format!("cannot listen on {bind}"), e).help("choose another port with `--port`; 0 selects a free port")
    };
    let listener = TcpListener::bind(bind).await.map_err(|e| taken(&e))?;
    let port = listener.local_addr().map_err(|e| taken(&e))?.port();
    let token = format!("{}{}", Uuid::new_v4().simple(), Uuid::new_v4().simple());
    let state = Arc::new(ServerState {
        token: blake3::hash(token.as_bytes()),
        hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")],
        queue,
        downloads: Arc::new(Semaphore::new(DOWNLOADS)),
        settings,
        open_bytes: Arc::default(),
    });
    let connections = Arc::new(Semaphore::new(CONNECTIONS));
    started(&format!("http://127.0.0.1:{port}/{token}/"));
    tokio::select! {
        () = connection::accept(listener, connections, state) => Ok(()),
        // A dropped sender stops the server too.
        _ = stop.wait_for(|stop| *stop) => Ok(()),
    }
}
