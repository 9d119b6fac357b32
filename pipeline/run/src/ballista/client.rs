//! Client of a scheduler: queries its state and its jobs by HTTP, and submits jobs.

use std::{error::Error, future::poll_fn, io, pin::Pin, sync::Arc, time::Duration};

use ballista_core::{
    config::BALLISTA_SCHEDULER_MAX_PARTITIONS_PER_TASK, execution_plans::execute_physical_plan,
    extension::SessionConfigExt,
};
use datafusion::{
    datasource::{memory::MemorySourceConfig, source::DataSourceExec},
    error::DataFusionError,
    physical_plan::{ExecutionPlan, common::collect},
    prelude::SessionConfig,
};
use schemas::Fault;
use serde_json::Value;
use tokio::{runtime::Runtime, time::timeout};
use tokio_rustls::rustls;
use tonic::{
    body::Body,
    codegen::{Body as _, Service, http},
    transport::Channel,
};

use super::{
    closed::JobPlan,
    key::ClusterTrust,
    runtime,
    units::{AnswerMessage, TaskComputeExec, TaskMessage, TaskPlanCodec, handed_schema},
};
use crate::task::VERSION;

/// Maximum time of a request.
const ANSWER: Duration = Duration::from_secs(5);
/// Maximum size of an answer, in bytes.
const MOST_BYTES: usize = 64 << 20;

/// Prefix of the name of each scheduler and worker, followed by its version.
const NAMED: &str = "magline-";

/// Name of a scheduler or a worker, with its version.
pub fn named(rest: &str) -> String {
    format!("{NAMED}{VERSION}-{rest}")
}

/// Whether a scheduler or a worker has this version.
fn is_ours(name: &str) -> bool {
    name.strip_prefix(NAMED).and_then(|rest| rest.strip_prefix(VERSION)).is_some_and(|rest| rest.starts_with('-'))
}

/// Version in the name of a scheduler or a worker.
fn version_of(name: &str) -> Option<&str> {
    name.strip_prefix(NAMED)?.split('-').next()
}

/// Client of a scheduler.
#[derive(Clone, Debug)]
pub struct SchedulerClient {
    /// Address, HOST:PORT.
    pub authority: String,
    /// Authentication of both sides.
    trust: ClusterTrust,
    channel: Channel,
    /// Runtime of the connection.
    runtime: Arc<Runtime>,
}

/// Reason why a scheduler is unusable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SchedulerFault {
    /// The scheduler does not answer.
    Silent(String),
    /// The scheduler has another key, or no key.
    Stranger,
    /// The scheduler has another version, or is not a scheduler of magline.
    Other(String),
}

/// Name, cores and workers of a scheduler at the last observation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ClusterSnapshot {
    /// Name of the scheduler, different after each start.
    pub scheduler: String,
    /// Cores of the workers of this version.
    pub cores: usize,
    /// Workers of another version.
    pub others: Vec<String>,
}

impl SchedulerFault {
    /// Fault for the user, with the cause and a remedy.
    pub fn fault(&self, authority: &str) -> Fault {
        match self {
            SchedulerFault::Silent(why) => {
                let fault = Fault::machine(format!("cannot connect to the scheduler at {authority}: {why}"));
                fault.help(format!(
                    "start the scheduler with `magline scheduler --bind {authority}`; scheduler, workers and runs need \
                     the same key"
                ))
            }
            SchedulerFault::Stranger => {
                let fault = Fault::new(format!("the scheduler at {authority} has a different key or no key"));
                fault.help("use the same `--key-file` for scheduler, workers and runs")
            }
            SchedulerFault::Other(what) => {
                let fault = Fault::new(format!("the scheduler at {authority} is {what}; this is magline {VERSION}"));
                fault.help("use the same version for scheduler, workers and runs")
            }
        }
    }
}

impl SchedulerClient {
    /// Address for the submission of jobs, and its authentication.
    pub fn place(&self) -> (String, ClusterTrust) {
        (self.authority.clone(), self.trust.clone())
    }

    /// Client of the scheduler at HOST:PORT.
    ///
    /// # Errors
    /// Fails if the address is invalid, or there are no threads for a connection.
    pub fn at(authority: &str, trust: &ClusterTrust) -> Result<SchedulerClient, Fault> {
        let runtime = Arc::new(runtime()?);
        let channel = {
            let _within = runtime.enter();
            let wrong = |e| Fault::new(format!("`{authority}` is not the address of a scheduler: {}", error_chain(&e)));
            trust.endpoint(authority).map_err(wrong)?.connect_lazy()
        };
        Ok(SchedulerClient { authority: authority.to_owned(), trust: trust.clone(), channel, runtime })
    }

    /// URL of the scheduler's interface.
    fn url(&self) -> String {
        self.trust.url(&self.authority)
    }

    /// Sends a request and reads the whole answer.
    fn request(&self, method: http::Method, path: &str) -> Result<Vec<u8>, SchedulerFault> {
        let request = http::Request::builder().method(method).uri(format!("{}/api/{path}", self.url()));
        let request = request.body(Body::empty()).map_err(|e| SchedulerFault::Silent(e.to_string()))?;
        let mut channel = self.channel.clone();
        let asked = async move {
            poll_fn(|cx| channel.poll_ready(cx)).await.map_err(|e| scheduler_fault(&e))?;
            let answer = channel.call(request).await.map_err(|e| scheduler_fault(&e))?;
            let (mut body, mut bytes) = (answer.into_body(), vec![]);
            while let Some(frame) = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await {
                let data = frame.map_err(|e| SchedulerFault::Silent(e.message().to_owned()))?.into_data();
                bytes.extend_from_slice(&data.unwrap_or_default());
                if bytes.len() > MOST_BYTES {
                    return Err(SchedulerFault::Silent("its response is too large".to_owned()));
                }
            }
            Ok(bytes)
        };
        let late = |_| SchedulerFault::Silent(format!("no response within {} s", ANSWER.as_secs()));
        self.runtime.block_on(async { timeout(ANSWER, asked).await }).map_err(late)?
    }

    fn ask(&self, path: &str) -> Result<Value, SchedulerFault> {
        let bytes = self.request(http::Method::GET, path)?;
        let wrong = |_| SchedulerFault::Silent("the server is not a Ballista scheduler".to_owned());
        serde_json::from_slice(&bytes).map_err(wrong)
    }

    /// Name of the scheduler, if the scheduler has this version.
    ///
    /// # Errors
    /// Fails if the scheduler does not answer, or has another version.
    pub fn name(&self) -> Result<String, SchedulerFault> {
        let state = self.ask("state")?;
        let name = state.get("scheduler_id").and_then(Value::as_str).unwrap_or_default();
        match version_of(name) {
            _ if is_ours(name) => Ok(name.to_owned()),
            Some(version) => Err(SchedulerFault::Other(format!("magline {version}"))),
            None => Err(SchedulerFault::Other("not a scheduler of magline".to_owned())),
        }
    }

    /// State of the scheduler and its workers.
    ///
    /// # Errors
    /// Returns the errors of [`SchedulerClient::name`].
    pub fn look(&self) -> Result<ClusterSnapshot, SchedulerFault> {
        let mut seen = ClusterSnapshot { scheduler: self.name()?, ..ClusterSnapshot::default() };
        let workers = self.ask("executors")?;
        for worker in workers.as_array().into_iter().flatten() {
            let name = worker.get("id").and_then(Value::as_str).unwrap_or_default();
            let cores = worker.pointer("/specification/vcores").and_then(Value::as_u64).unwrap_or(0);
            if is_ours(name) {
                seen.cores += usize::try_from(cores).unwrap_or(0);
            } else {
                seen.others.push(format!("{name} (magline {})", version_of(name).unwrap_or("?")));
            }
        }
        Ok(seen)
    }

    /// Identifiers and names of the unfinished jobs whose names `is_wanted` accepts.
    pub fn jobs(&self, is_wanted: impl Fn(&str) -> bool) -> Vec<(String, String)> {
        let jobs = self.ask("jobs").unwrap_or_default();
        let text = |job: &Value, key: &str| job.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
        let jobs = jobs.as_array().into_iter().flatten();
        let going = jobs.filter(|job| matches!(text(job, "status").as_str(), "Queued" | "Running"));
        going.map(|job| (text(job, "job_id"), text(job, "job_name"))).filter(|(_, name)| is_wanted(name)).collect()
    }

    /// Whether a worker computes a part of a job, as reported by the scheduler.
    pub fn is_at_work(&self, job: &str) -> bool {
        let Ok(stages) = self.ask(&format!("job/{job}/stages")) else { return false };
        let stages = stages.get("stages").and_then(Value::as_array).into_iter().flatten();
        let tasks = stages.filter_map(|stage| stage.get("tasks")?.as_array()).flatten();
        tasks.filter_map(|task| task.get("status")).any(|status| status == "Running")
    }

    /// Cancels a job. A job that cannot be cancelled runs to its end, and its results are kept.
    pub fn cancel(&self, job: &str) {
        let _ = self.request(http::Method::PATCH, &format!("job/{job}"));
    }
}

/// Text of an error, with its causes.
fn error_chain(e: &dyn Error) -> String {
    let causes = std::iter::successors(e.source(), |&e| e.source()).map(ToString::to_string);
    let mut all: Vec<String> = std::iter::once(e.to_string()).chain(causes).collect();
    all.dedup();
    all.join(": ")
}

/// Cause of a missing answer: the scheduler does not have our key, or it is unreachable.
fn scheduler_fault(e: &(dyn Error + 'static)) -> SchedulerFault {
    let of_key = |e: &(dyn Error + 'static)| {
        let inner = e.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        inner.is_some_and(|inner| inner.is::<rustls::Error>()) || e.is::<rustls::Error>()
    };
    let mut causes = std::iter::successors(Some(e), |&e| e.source());
    if causes.any(of_key) { SchedulerFault::Stranger } else { SchedulerFault::Silent(error_chain(e)) }
}

/// Submits tasks as the job `name`, with one task of Ballista per partition of `parts`, and collects the answers.
///
/// # Errors
/// Fails if the scheduler cannot be reached, or if the job fails or is cancelled.
pub async fn job(
    (authority, trust): (String, ClusterTrust),
    session: String,
    name: String,
    parts: Vec<Vec<TaskMessage>>,
) -> Result<Vec<AnswerMessage>, DataFusionError> {
    let config = SessionConfig::new_with_ballista()
        .set_usize(BALLISTA_SCHEDULER_MAX_PARTITIONS_PER_TASK, 1)
        .with_ballista_job_name(&name)
        .with_ballista_override_create_grpc_client_endpoint(trust.endpoints())
        .with_ballista_use_tls(trust.encrypts());
    let parts =
        parts.iter().map(|tasks| Ok(vec![TaskMessage::rows(tasks)?])).collect::<Result<Vec<_>, DataFusionError>>()?;
    let leaf = DataSourceExec::from_data_source(MemorySourceConfig::try_new(&parts, handed_schema(), None)?);
    let units: Arc<dyn ExecutionPlan> = Arc::new(TaskComputeExec::new(leaf));
    let (settings, codec, url) = (config.ballista_config(), TaskPlanCodec::default(), trust.url(&authority));
    let rows = execute_physical_plan::<JobPlan>(url, &settings, units, &codec, session, config).await?;
    let rows = collect(rows).await?;
    let answers: Option<Vec<Vec<AnswerMessage>>> = rows.iter().map(AnswerMessage::read).collect();
    let answers = answers.ok_or_else(|| DataFusionError::Execution("the response contains no receipts".to_owned()))?;
    Ok(answers.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_names_contain_the_version() {
        let own = named("node7-4711");
        assert!(is_ours(&own) && version_of(&own) == Some(VERSION));
        for other in
            [format!("magline-{VERSION}1-x"), "magline-9.9.9-x".to_owned(), "executor".to_owned(), String::new()]
        {
            assert!(!is_ours(&other), "{other}");
        }
        assert_eq!(version_of("magline-9.9.9-x-y"), Some("9.9.9"));
    }
}
