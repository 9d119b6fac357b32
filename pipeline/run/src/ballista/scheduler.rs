//! Ballista's scheduler, extended by magline's plan node.

use std::{
    net::{SocketAddr, TcpListener},
    sync::Arc,
    time::Duration,
};

use arrow_flight::flight_service_server::FlightServiceServer;
use ballista_core::{
    error::BallistaError, extension::BallistaConfigGrpcEndpoint, flight_proxy_service::BallistaFlightProxyService,
    serde::protobuf::scheduler_grpc_server::SchedulerGrpcServer,
};
use ballista_scheduler::{
    api::get_routes,
    cluster::BallistaCluster,
    config::{SchedulerConfig, TaskDistributionPolicy},
    scheduler_process::create_scheduler,
};
use ports::PortListener;
use schemas::Fault;
use store::host;
use tokio_rustls::rustls::ServerConfig;
use tonic::{
    service::{Routes, RoutesBuilder},
    transport::Server,
};
use uuid::Uuid;

use super::{
    client::named,
    closed::{JobPlan, LogicalPlanStub},
    executor::{GRACE, MESSAGE},
    key::ClusterTrust,
    runtime, stop_signal,
    units::TaskPlanCodec,
};

/// Interval of the checks for silent workers.
const LOOKS_EVERY: Duration = Duration::from_secs(5);
/// Age at which the data of a finished job are dropped.
const KEPT: Duration = Duration::from_secs(60);
/// Interval of keep-alive checks of a client.
const ALIVE: Duration = Duration::from_secs(30);

/// Scheduler with a bound port that does not serve yet.
pub struct BoundScheduler {
    listener: TcpListener,
    address: SocketAddr,
    config: SchedulerConfig,
    trust: ClusterTrust,
    encryption: Option<Arc<ServerConfig>>,
}

/// Listens on `address`; port 0 selects a free port. Workers contact the scheduler by the name `advertise`. By default,
/// this is the host of `address`, or the name of this host if `address` is the unspecified address. A worker that is
/// silent for `worker_timeout` counts as lost. `trust` authenticates workers and runs.
///
/// # Errors
/// Fails if the address is in use, is not an address of this host, or can be reached by others without a key.
pub fn listen(
    address: SocketAddr,
    advertise: Option<&str>,
    worker_timeout: Duration,
    trust: ClusterTrust,
) -> Result<BoundScheduler, Fault> {
    trust.admits(address.ip())?;
    let encryption = trust.server()?;
    let fail = |e: std::io::Error| Fault::machine(format!("cannot listen on {address}: {e}"));
    let listener = TcpListener::bind(address).map_err(fail)?;
    listener.set_nonblocking(true).map_err(fail)?;
    let address = listener.local_addr().map_err(fail)?;
    let advertised = advertise.map_or_else(|| name_of(address), str::to_owned);
    let seconds = worker_timeout.as_secs().max(1);
    let config = SchedulerConfig {
        scheduler_id: named(&Uuid::new_v4().simple().to_string()),
        bind_host: address.ip().to_string(),
        bind_port: address.port(),
        // Requests from web pages of other hosts are rejected.
        cors_allowed_origins: format!("http://{advertised}:{}", address.port()),
        external_host: advertised,
        override_physical_codec: Some(Arc::new(TaskPlanCodec::default())),
        override_create_grpc_client_endpoint: Some(trust.endpoints()),
        use_tls: trust.encrypts(),
        enable_embedded_flight_proxy: true,
        task_distribution: TaskDistributionPolicy::RoundRobin,
        executor_timeout_seconds: seconds,
        executor_termination_grace_period: GRACE.as_secs(),
        expire_dead_executor_interval_seconds: LOOKS_EVERY.as_secs().min(seconds),
        no_executors_grace_period_seconds: seconds,
        finished_job_data_clean_up_interval_seconds: KEPT.as_secs(),
        finished_job_state_clean_up_interval_seconds: KEPT.as_secs(),
        ..SchedulerConfig::default()
    };
    Ok(BoundScheduler { listener, address, config, trust, encryption })
}

/// Name by which other hosts reach an address of this host.
pub fn name_of(address: SocketAddr) -> String {
    match address {
        _ if address.ip().is_unspecified() => host(),
        SocketAddr::V4(_) => address.ip().to_string(),
        SocketAddr::V6(_) => format!("[{}]", address.ip()),
    }
}

impl BoundScheduler {
    /// Address, with the port that was selected.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Host name and port at which workers reach the scheduler.
    pub fn advertised(&self) -> String {
        self.config.scheduler_endpoint()
    }

    /// Serves requests until the process receives a stop signal.
    ///
    /// # Errors
    /// Fails if Ballista fails.
    pub fn serve(self) -> Result<(), Fault> {
        let BoundScheduler { listener, config, trust, encryption, .. } = self;
        let served = async move {
            let listener = tokio::net::TcpListener::from_std(listener).map_err(BallistaError::from)?;
            let cluster = BallistaCluster::new_from_config(&config).await?;
            let scheduler = create_scheduler::<LogicalPlanStub, JobPlan>(cluster, Arc::new(config)).await?;
            let jobs = SchedulerGrpcServer::new(scheduler.clone());
            let endpoints = Arc::new(BallistaConfigGrpcEndpoint::new(trust.endpoints()));
            let answers = BallistaFlightProxyService::new(MESSAGE, MESSAGE, trust.encrypts(), Some(endpoints));
            let answers = FlightServiceServer::new(answers);
            let mut routes = RoutesBuilder::default();
            routes.add_service(jobs.max_decoding_message_size(MESSAGE).max_encoding_message_size(MESSAGE));
            routes.add_service(answers.max_decoding_message_size(MESSAGE).max_encoding_message_size(MESSAGE));
            let routes = get_routes(Arc::new(scheduler)).merge(routes.routes().into_axum_router());
            let server = Server::builder().http2_keepalive_interval(Some(ALIVE)).add_routes(Routes::from(routes));
            tokio::select! {
                served = server.serve_with_incoming(PortListener::by_handshake(listener, encryption).open()) => {
                    served.map_err(BallistaError::TonicError)
                }
                () = stop_signal() => Ok(()),
            }
        };
        runtime()?.block_on(served).map_err(|e: BallistaError| Fault::machine(format!("the scheduler ended: {e}")))
    }
}
