//! Executor of a worker: registers at the scheduler, runs tasks, and serves their answers. Ballista's own executor
//! listens without encryption and accepts any plan of DataFusion. This executor requires the key of the cluster for
//! each connection, and accepts only the plans of `closed.rs`.

use std::{
    collections::{BTreeMap, HashMap},
    net::TcpListener,
    path::PathBuf,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use arrow_flight::flight_service_server::FlightServiceServer;
use ballista_core::{
    BALLISTA_PROTOCOL_VERSION, RuntimeProducer,
    error::BallistaError,
    extension::SessionConfigExt,
    serde::{
        BallistaCodec, BallistaLogicalExtensionCodec,
        protobuf::{
            CancelTasksParams, CancelTasksResult, ExecutorOperatingSystemSpecification, ExecutorRegistration,
            ExecutorResource, ExecutorSpecification, ExecutorStatus, ExecutorStoppedParams, FailedTask,
            HeartBeatParams, LaunchMultiTaskParams, LaunchMultiTaskResult, LaunchTaskParams, LaunchTaskResult,
            RegisterExecutorParams, RemoveJobDataParams, RemoveJobDataResult, StopExecutorParams, StopExecutorResult,
            SuccessfulTask, TaskStatus, UpdateTaskStatusParams,
            executor_grpc_server::{ExecutorGrpc, ExecutorGrpcServer},
            executor_resource::Resource,
            executor_status::Status as State,
            scheduler_grpc_client::SchedulerGrpcClient,
            task_status,
        },
        scheduler::{TaskDefinition, from_proto::get_task_definition_vec},
    },
};
use ballista_executor::execution_engine::{DefaultExecutionEngine, ExecutionEngine};
use datafusion::{
    error::DataFusionError,
    execution::{TaskContext, runtime_env::RuntimeEnvBuilder},
    prelude::SessionConfig,
};
use futures::future::{AbortHandle, abortable};
use log::{error, warn};
use ports::PortListener;
use tokio::{
    sync::Notify,
    time::{sleep, timeout},
};
use tonic::{
    Request, Response, Status,
    transport::{Channel, Server},
};

use super::{
    closed::{JobPlan, LogicalPlanStub, names_a_job},
    flight::AnswerFileService,
    key::ClusterTrust,
    stop_signal,
    units::TaskPlanCodec,
};

/// Maximum size of a message, in bytes.
pub const MESSAGE: usize = 16 << 20;
/// Maximum waiting time for a scheduler at the start.
const PATIENCE: Duration = Duration::from_secs(60);
/// Interval between attempts to connect.
const AGAIN_AFTER: Duration = Duration::from_millis(500);
/// Maximum time of a request to the scheduler.
const ANSWER: Duration = Duration::from_secs(20);
/// Interval between the reports of a stopping executor that still finishes its tasks.
const FINISHING_EVERY: Duration = Duration::from_secs(1);
/// The tasks of a stopping executor are dispatched to others after this time without a report, and a stopped executor
/// is removed after this time.
pub const GRACE: Duration = Duration::from_secs(3);
/// The scheduler counts as lost after this number of consecutive failed reports.
const MOST_LOST: usize = 5;
/// Maximum number of attempts to report the end of a task.
const TRIES: usize = 3;
/// Age at which unfetched answers are removed, and interval of the removal.
const KEPT: Duration = Duration::from_secs(3600);
const CLEANS_EVERY: Duration = Duration::from_secs(600);

/// Settings of an executor.
pub struct ExecutorSettings {
    /// Name of the executor.
    pub id: String,
    /// Address of the scheduler, HOST:PORT.
    pub scheduler: String,
    /// Authentication of scheduler and executor.
    pub trust: ClusterTrust,
    /// Host name at which the scheduler reaches the executor.
    pub host: String,
    /// Ports for answers and for tasks.
    pub listeners: (TcpListener, TcpListener),
    /// Number of simultaneous tasks.
    pub cores: usize,
    /// Folder for answers.
    pub work: PathBuf,
    /// Interval between reports to the scheduler.
    pub heartbeat: Duration,
}

/// Running task: job, stage and number.
type TaskKey = (String, usize, usize);

struct ExecutorState {
    me: ExecutorRegistration,
    scheduler: SchedulerGrpcClient<Channel>,
    codec: BallistaCodec<LogicalPlanStub, JobPlan>,
    engine: DefaultExecutionEngine,
    runtime: RuntimeProducer,
    work: PathBuf,
    running: Mutex<BTreeMap<TaskKey, AbortHandle>>,
    /// Whether a stop was requested.
    ends: AtomicBool,
    stop: Notify,
}

#[derive(Clone)]
struct ExecutorService(Arc<ExecutorState>);

fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

fn general(what: String) -> BallistaError {
    BallistaError::General(what)
}

impl ExecutorSettings {
    /// Runs until a signal or the scheduler stops it, or the scheduler is lost.
    ///
    /// # Errors
    /// Fails if the scheduler cannot be reached or rejects this executor, or a port cannot be served.
    pub async fn run(self) -> Result<(), BallistaError> {
        let encryption = self.trust.server().map_err(|fault| general(fault.to_string()))?;
        let local = |l: &TcpListener| l.local_addr().map(|a| u32::from(a.port()));
        let me = ExecutorRegistration {
            id: self.id.clone(),
            host: Some(self.host.clone()),
            port: local(&self.listeners.0)?,
            grpc_port: local(&self.listeners.1)?,
            specification: Some(ExecutorSpecification {
                resources: vec![ExecutorResource {
                    resource: Some(Resource::Vcores(u32::try_from(self.cores).unwrap_or(u32::MAX))),
                }],
            }),
            os_info: Some(ExecutorOperatingSystemSpecification::default()),
            ballista_protocol_version: BALLISTA_PROTOCOL_VERSION,
        };
        let spill = self.work.clone();
        let tasks = ExecutorService(Arc::new(ExecutorState {
            me,
            scheduler: self.connected().await?,
            codec: BallistaCodec::new(
                Arc::new(BallistaLogicalExtensionCodec::default()),
                Arc::new(TaskPlanCodec::of_worker()),
            ),
            engine: DefaultExecutionEngine::new(),
            runtime: Arc::new(move |_| RuntimeEnvBuilder::new().with_temp_file_path(spill.clone()).build_arc()),
            work: self.work.clone(),
            running: Mutex::default(),
            ends: AtomicBool::new(false),
            stop: Notify::new(),
        }));
        let door = |listener: TcpListener| -> Result<PortListener, BallistaError> {
            Ok(PortListener::by_handshake(tokio::net::TcpListener::from_std(listener)?, encryption.clone()))
        };
        let answers = FlightServiceServer::new(AnswerFileService::new(&self.work)).max_decoding_message_size(MESSAGE);
        let launches = ExecutorGrpcServer::new(tasks.clone()).max_decoding_message_size(MESSAGE);
        let answers = Server::builder().add_service(answers).serve_with_incoming(door(self.listeners.0)?.open());
        let launches = Server::builder().add_service(launches).serve_with_incoming(door(self.listeners.1)?.open());
        let worked = tasks.work(self.heartbeat);
        tokio::select! {
            served = answers => served.map_err(BallistaError::TonicError),
            served = launches => served.map_err(BallistaError::TonicError),
            worked = worked => worked,
        }
    }

    async fn connected(&self) -> Result<SchedulerGrpcClient<Channel>, BallistaError> {
        let endpoint = self.trust.endpoint(&self.scheduler)?;
        let begun = Instant::now();
        loop {
            match endpoint.connect().await {
                Ok(channel) => {
                    let client = SchedulerGrpcClient::new(channel);
                    return Ok(client.max_decoding_message_size(MESSAGE).max_encoding_message_size(MESSAGE));
                }
                Err(e) if begun.elapsed() > PATIENCE => return Err(BallistaError::TonicError(e)),
                Err(_) => sleep(AGAIN_AFTER).await,
            }
        }
    }
}

impl ExecutorService {
    fn running(&self) -> MutexGuard<'_, BTreeMap<TaskKey, AbortHandle>> {
        self.0.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Registers at the scheduler, reports until the end, and then shuts down in an orderly way.
    async fn work(&self, heartbeat: Duration) -> Result<(), BallistaError> {
        let mut scheduler = self.0.scheduler.clone();
        let metadata = Some(self.0.me.clone());
        let taken = scheduler.register_executor(RegisterExecutorParams { metadata }).await?;
        if !taken.into_inner().success {
            return Err(general("the scheduler rejects the registration".to_owned()));
        }
        let stop_requested = tokio::select! {
            () = stop_signal() => true,
            () = self.0.stop.notified() => false,
            () = self.report(heartbeat) => false,
            () = self.clean() => false,
        };
        self.0.ends.store(true, Ordering::Release);
        if stop_requested {
            self.finish().await;
            let (executor_id, reason) = (self.0.me.id.clone(), "told to stop".to_owned());
            let stopped = scheduler.executor_stopped(ExecutorStoppedParams { executor_id, reason });
            let _ = timeout(ANSWER, stopped).await;
        } else {
            self.running().values().for_each(AbortHandle::abort);
        }
        Ok(())
    }

    /// Waits for the end of the running tasks. Keeps reporting meanwhile, so that the scheduler dispatches no further
    /// tasks to this executor and does not reassign its running tasks.
    async fn finish(&self) {
        loop {
            let _ = timeout(ANSWER, self.beat()).await;
            let next = Instant::now() + FINISHING_EVERY;
            while Instant::now() < next {
                sleep(Duration::from_millis(50)).await;
                if self.running().is_empty() {
                    return;
                }
            }
        }
    }

    async fn beat(&self) -> bool {
        let ends = self.0.ends.load(Ordering::Acquire);
        let state = if ends { State::Terminating(String::new()) } else { State::Active(String::new()) };
        let beat = HeartBeatParams {
            executor_id: self.0.me.id.clone(),
            metrics: vec![],
            status: Some(ExecutorStatus { status: Some(state) }),
            metadata: Some(self.0.me.clone()),
        };
        match self.0.scheduler.clone().heart_beat_from_executor(beat).await {
            Ok(_) => true,
            Err(e) => {
                warn!("the scheduler does not accept the heartbeat of this worker: {}", e.message());
                false
            }
        }
    }

    /// Reports to the scheduler until too many reports have failed.
    async fn report(&self, every: Duration) {
        let mut lost = 0;
        while lost < MOST_LOST {
            lost = if self.beat().await { 0 } else { lost + 1 };
            sleep(every).await;
        }
        error!("the connection to the scheduler is lost");
    }

    /// Removes old answers periodically.
    async fn clean(&self) {
        loop {
            sleep(CLEANS_EVERY).await;
            let folders = std::fs::read_dir(&self.0.work).into_iter().flatten().flatten();
            let age = |e: &std::fs::DirEntry| e.metadata().ok()?.modified().ok()?.elapsed().ok();
            let runs = |e: &std::fs::DirEntry| self.running().keys().any(|(job, ..)| e.file_name() == job.as_str());
            for folder in folders.filter(|e| age(e).is_some_and(|age| age > KEPT) && !runs(e)) {
                let _ = std::fs::remove_dir_all(folder.path());
            }
        }
    }

    /// Computes a task and reports its end to the scheduler.
    async fn compute(self, task: TaskDefinition) {
        let begun = now_ms();
        let key: TaskKey = (task.job_id.to_string(), task.stage_id, task.task_id);
        let mut status = TaskStatus {
            task_id: u32::try_from(task.task_id).unwrap_or(u32::MAX),
            job_id: key.0.clone(),
            stage_id: u32::try_from(task.stage_id).unwrap_or(u32::MAX),
            stage_attempt_num: u32::try_from(task.stage_attempt_num).unwrap_or(u32::MAX),
            launch_time: task.launch_time,
            start_exec_time: begun,
            ..TaskStatus::default()
        };
        let (work, handle) = abortable(self.written(task));
        self.running().insert(key.clone(), handle);
        // The runtime catches a panic of a task, so that the end of the task is still reported.
        let done = match tokio::spawn(work).await {
            Ok(Ok(done)) => done,
            Ok(Err(_)) => Err(BallistaError::Cancelled),
            Err(e) => Err(general(e.to_string())),
        };
        status.end_exec_time = now_ms();
        status.status = Some(match done {
            Ok((partitions, metrics)) => {
                status.metrics = metrics;
                let executor_id = self.0.me.id.clone();
                task_status::Status::Successful(SuccessfulTask { executor_id, partitions, ..SuccessfulTask::default() })
            }
            Err(e) => task_status::Status::Failed(FailedTask::from(e)),
        });
        self.report_status(status).await;
        self.running().remove(&key);
    }

    fn written(
        &self,
        task: TaskDefinition,
    ) -> Pin<Box<dyn Future<Output = Result<ExecutorTaskOutput, BallistaError>> + Send + 'static>> {
        let tasks = self.0.clone();
        Box::pin(async move {
            let stage = tasks.engine.create_query_stage_exec(
                task.job_id,
                task.stage_id,
                task.task_id,
                task.global_output_partition_ids,
                task.plan,
                &tasks.work.display().to_string(),
                &task.session_config,
            )?;
            let runtime = (tasks.runtime)(&task.session_config)?;
            let none = (HashMap::new(), HashMap::new(), HashMap::new(), HashMap::new());
            let context =
                TaskContext::new(None, task.session_id, task.session_config, none.0, none.1, none.2, none.3, runtime);
            let partitions = stage.execute_query_stage(task.task_id, Arc::new(context)).await?;
            let metrics = stage.collect_plan_metrics().into_iter().map(TryInto::try_into);
            Ok((partitions, metrics.collect::<Result<_, BallistaError>>().unwrap_or_default()))
        })
    }

    async fn report_status(&self, status: TaskStatus) {
        let (executor_id, task_status) = (self.0.me.id.clone(), vec![status]);
        let end = UpdateTaskStatusParams { executor_id, task_status };
        for _ in 0..TRIES {
            match self.0.scheduler.clone().update_task_status(end.clone()).await {
                Ok(_) => return,
                Err(e) => warn!("the scheduler does not accept the end of a task: {}", e.message()),
            }
            sleep(AGAIN_AFTER).await;
        }
    }
}

/// Files of a task's answers, and the metrics of its plan nodes.
type ExecutorTaskOutput = (
    Vec<ballista_core::serde::protobuf::ShuffleWritePartition>,
    Vec<ballista_core::serde::protobuf::OperatorMetricsSet>,
);

#[tonic::async_trait]
impl ExecutorGrpc for ExecutorService {
    async fn launch_task(&self, _: Request<LaunchTaskParams>) -> Result<Response<LaunchTaskResult>, Status> {
        Err(Status::unimplemented("tasks are launched together"))
    }

    async fn launch_multi_task(
        &self,
        request: Request<LaunchMultiTaskParams>,
    ) -> Result<Response<LaunchMultiTaskResult>, Status> {
        let mut failed_jobs = vec![];
        for tasks in request.into_inner().multi_tasks {
            let job = tasks.job_id.clone();
            let config = SessionConfig::new_with_ballista();
            let none = (HashMap::new(), HashMap::new(), HashMap::new(), HashMap::new());
            let read = if names_a_job(&job) {
                get_task_definition_vec(
                    tasks,
                    self.0.runtime.clone(),
                    config,
                    none.0,
                    none.1,
                    none.2,
                    none.3,
                    self.0.codec.clone(),
                )
            } else {
                Err(DataFusionError::Execution("the name of the job is invalid".to_owned()).into())
            };
            match read {
                Ok(tasks) => tasks.into_iter().for_each(|task| drop(tokio::spawn(self.clone().compute(task)))),
                Err(e) => {
                    error!("tasks of a job are rejected: {e}");
                    failed_jobs.push(job);
                }
            }
        }
        Ok(Response::new(LaunchMultiTaskResult { failed_jobs }))
    }

    async fn stop_executor(
        &self,
        request: Request<StopExecutorParams>,
    ) -> Result<Response<StopExecutorResult>, Status> {
        if request.into_inner().executor_id == self.0.me.id {
            self.0.stop.notify_one();
        }
        Ok(Response::new(StopExecutorResult {}))
    }

    async fn cancel_tasks(&self, request: Request<CancelTasksParams>) -> Result<Response<CancelTasksResult>, Status> {
        for task in request.into_inner().task_infos {
            if let Some(handle) = self.running().get(&(task.job_id, task.stage_id as usize, task.task_id as usize)) {
                handle.abort();
            }
        }
        Ok(Response::new(CancelTasksResult { cancelled: true }))
    }

    async fn remove_job_data(
        &self,
        request: Request<RemoveJobDataParams>,
    ) -> Result<Response<RemoveJobDataResult>, Status> {
        let RemoveJobDataParams { job_id, remove_stage_ids } = request.into_inner();
        if !names_a_job(&job_id) {
            return Err(Status::invalid_argument("the name of the job is invalid"));
        }
        let folder = self.0.work.join(job_id);
        let folders = match remove_stage_ids.as_slice() {
            [] => vec![folder],
            stages => stages.iter().map(|stage| folder.join(stage.to_string())).collect(),
        };
        for folder in folders.iter().filter(|f| f.is_dir()) {
            std::fs::remove_dir_all(folder).map_err(|e| Status::internal(e.to_string()))?;
        }
        Ok(Response::new(RemoveJobDataResult {}))
    }
}
