//! `magline view`: a page of a store, and the data that the page requests, over HTTP on the loopback interface.
//!
//! Every address contains a random token, and the server answers only requests for its own host name. The server writes
//! only the copy of an object store and temporary files of downloads.

mod answer;
mod body;
mod connection;
mod page;
mod request;
mod workers;

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
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
use page::page;
use workers::{ComputeQueue, JobReceiver, work};

/// Number of threads for connections.
const CONNECTION_THREADS: usize = 2;
/// Number of threads that compute answers.
const WORKERS: usize = 3;
/// Maximum number of simultaneous downloads.
const DOWNLOADS: usize = 2;
/// Maximum number of simultaneous connections.
const CONNECTIONS: usize = 64;

/// Number of threads that compute the progress of a run.
const PROGRESS_WORKERS: usize = 2;

/// Settings of a view.
pub struct ViewSettings {
    /// Port on the loopback interface; 0 selects a free one.
    pub port: u16,
    /// Path of this program, which writes the files of downloads in a separate process.
    pub program: PathBuf,
    /// Private folder for files of downloads.
    pub temporary: PathBuf,
}

/// Spec of a view.
pub struct ViewedSpec<'a> {
    /// Name of the pipeline.
    pub pipeline: &'a str,
    /// Path of the spec, as the user gave it.
    pub file: &'a str,
}

/// Data of a view.
#[derive(Clone, Copy)]
pub struct ViewData<'a> {
    /// The store.
    pub store: &'a StoreView,
    /// The spec; `None` if a store is viewed.
    pub spec: Option<&'a ViewedSpec<'a>>,
    /// The runs of the spec, once its plan is made.
    pub run: Option<&'a RunProgress<'a>>,
}

/// Makes the plan of a spec, then passes the progress of its runs to the given function, which returns when the server
/// ends.
pub type PlanMaker<'a, E> = Box<dyn FnOnce(&dyn Fn(&RunProgress)) -> Result<(), E> + Send + 'a>;

impl ViewSettings {
    /// Serves the store in the folder `store`, whose scores have the metrics of `catalogue`, until the process ends.
    ///
    /// # Errors
    /// Fails if the store cannot be read, the port is in use, or threads cannot be started.
    pub fn serve_store(self, catalogue: &[StageEntry], store: &Path, started: impl FnOnce(&str)) -> Result<(), Fault> {
        let view = opened(catalogue, store)?;
        serve::<Fault>(self, ViewData { store: &view, spec: None, run: None }, None, started)
    }

    /// Serves the store of a spec until the process ends. The page is served while `plan` makes the plan of the spec.
    ///
    /// # Errors
    /// Returns the errors of `plan` and the errors of [`ViewSettings::serve_store`].
    pub fn serve_spec<E: From<Fault> + Send>(
        self,
        catalogue: &[StageEntry],
        (store, spec): (&Path, &ViewedSpec),
        plan: PlanMaker<E>,
        started: impl FnOnce(&str),
    ) -> Result<(), E> {
        let view = opened(catalogue, store)?;
        serve(self, ViewData { store: &view, spec: Some(spec), run: None }, Some(plan), started)
    }
}

fn opened(catalogue: &[StageEntry], store: &Path) -> Result<StoreView, Fault> {
    StoreView::new(store, catalogue.iter().flat_map(|stage| stage.metrics.iter().copied()).collect())
}

fn machine(what: &str, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("{what}: {e}"))
}

/// Serves until the process ends or `plan` fails. `started` receives the address of the page.
///
/// # Errors
/// Fails if the port is in use, or threads cannot be started. Also returns the errors of `plan`.
fn serve<E: From<Fault> + Send>(
    settings: ViewSettings,
    data: ViewData,
    plan: Option<PlanMaker<E>>,
    started: impl FnOnce(&str),
) -> Result<(), E> {
    let runtime =
        Builder::new_multi_thread().thread_name("view").worker_threads(CONNECTION_THREADS).enable_all().build();
    let runtime = runtime.map_err(|e| machine("cannot start threads", &e))?;
    let (listener, port) = runtime.block_on(bound(settings.port))?;
    let ((queue, jobs), (progress, progress_jobs)) = (ComputeQueue::new(), ComputeQueue::new());
    let token = format!("{}{}", Uuid::new_v4().simple(), Uuid::new_v4().simple());
    let state = Arc::new(ServerState {
        token: blake3::hash(token.as_bytes()),
        hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")],
        page: page(&data).into(),
        queue,
        progress,
        is_planned: AtomicBool::new(false),
        downloads: Arc::new(Semaphore::new(DOWNLOADS)),
        settings,
        open_bytes: Arc::default(),
    });
    let (failed, mut has_failed) = watch::channel(false);
    thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| work(&data, &jobs));
        }
        started(&format!("http://127.0.0.1:{port}/{token}/"));
        let planning = plan.map(|plan| {
            let (state, failed) = (Arc::downgrade(&state), &failed);
            scope.spawn(move || {
                let served = |run: &RunProgress| {
                    if let Some(state) = state.upgrade() {
                        state.is_planned.store(true, Ordering::Release);
                    }
                    work_on_progress(ViewData { run: Some(run), ..data }, &progress_jobs);
                };
                let made = plan(&served);
                failed.send_replace(made.is_err());
                made
            })
        });
        let connections = Arc::new(Semaphore::new(CONNECTIONS));
        runtime.block_on(async {
            tokio::select! {
                () = connection::accept(listener, connections, state) => {}
                _ = has_failed.wait_for(|failed| *failed) => {}
            }
        });
        // Connections hold the queues. The workers end when all connections are closed.
        runtime.shutdown_background();
        let panicked = |_| Err(Fault::bug("the plan could not be made because of a panic").into());
        planning.map_or(Ok(()), |planning| planning.join().unwrap_or_else(panicked))
    })
}

/// Answers requests for the progress of a run until the server ends.
fn work_on_progress(data: ViewData, jobs: &JobReceiver) {
    thread::scope(|scope| {
        for _ in 0..PROGRESS_WORKERS {
            scope.spawn(|| work(&data, jobs));
        }
    });
}

/// A listener on the loopback interface, and its port.
async fn bound(port: u16) -> Result<(TcpListener, u16), Fault> {
    let bind = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let taken = |e: &dyn std::fmt::Display| {
        machine(&format!("cannot listen on {bind}"), e).help("choose another port with `--port`; 0 selects a free port")
    };
    let listener = TcpListener::bind(bind).await.map_err(|e| taken(&e))?;
    let port = listener.local_addr().map_err(|e| taken(&e))?.port();
    Ok((listener, port))
}
