//! The scheduler: Ballista's, with our node among those that it knows.

use std::{
    net::{SocketAddr, TcpListener},
    sync::Arc,
    time::Duration,
};

use ballista_core::error::BallistaError;
use ballista_scheduler::{
    cluster::BallistaCluster,
    config::{SchedulerConfig, TaskDistributionPolicy},
    scheduler_process::{create_scheduler, start_grpc_service_with_listener},
};
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use schemas::Fault;
use uuid::Uuid;

use super::{client::named, runtime, told_to_stop, units::Codec};
use crate::store::host;

/// How often the scheduler looks for workers that are silent.
const LOOKS_EVERY: Duration = Duration::from_secs(5);
/// The age at which what is kept of a job that is over is dropped.
const KEPT: Duration = Duration::from_secs(60);

/// A scheduler that listens, and does not yet answer.
pub struct Listening {
    listener: TcpListener,
    address: SocketAddr,
    config: SchedulerConfig,
}

/// Listens on `address`, with port 0 on a free one. Workers report to it by the name `advertise`; by default the address, or this
/// host's name where that is all addresses. A worker that is silent for `worker_timeout` is given up.
///
/// # Errors
/// Fails when the address is taken or not this host's.
pub fn listen(address: SocketAddr, advertise: Option<&str>, worker_timeout: Duration) -> Result<Listening, Fault> {
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
        // No page of another host may ask for anything.
        cors_allowed_origins: format!("http://{advertised}:{}", address.port()),
        external_host: advertised,
        override_physical_codec: Some(Arc::new(Codec::default())),
        enable_embedded_flight_proxy: true,
        task_distribution: TaskDistributionPolicy::RoundRobin,
        executor_timeout_seconds: seconds,
        expire_dead_executor_interval_seconds: LOOKS_EVERY.as_secs().min(seconds),
        no_executors_grace_period_seconds: seconds,
        finished_job_data_clean_up_interval_seconds: KEPT.as_secs(),
        finished_job_state_clean_up_interval_seconds: KEPT.as_secs(),
        ..SchedulerConfig::default()
    };
    Ok(Listening { listener, address, config })
}

/// The name by which others find an address of this host.
pub fn name_of(address: SocketAddr) -> String {
    match address {
        _ if address.ip().is_unspecified() => host(),
        SocketAddr::V4(_) => address.ip().to_string(),
        SocketAddr::V6(_) => format!("[{}]", address.ip()),
    }
}

impl Listening {
    /// The address, with the port that was free.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The name that workers report to, with the port.
    pub fn advertised(&self) -> String {
        self.config.scheduler_endpoint()
    }

    /// Answers until the process is told to stop.
    ///
    /// # Errors
    /// Fails when Ballista does.
    pub fn serve(self) -> Result<(), Fault> {
        let Listening { listener, config, .. } = self;
        let served = async move {
            let listener = tokio::net::TcpListener::from_std(listener).map_err(BallistaError::from)?;
            let cluster = BallistaCluster::new_from_config(&config).await?;
            let server = create_scheduler::<LogicalPlanNode, PhysicalPlanNode>(cluster, Arc::new(config)).await?;
            tokio::select! {
                served = start_grpc_service_with_listener(listener, server) => served,
                () = told_to_stop() => Ok(()),
            }
        };
        runtime()?.block_on(served).map_err(|e: BallistaError| Fault::machine(format!("the scheduler ended: {e}")))
    }
}
