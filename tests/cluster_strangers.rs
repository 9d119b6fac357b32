//! Requests of foreign clients to a cluster. Without the key all requests are rejected; with the key only tasks of
//! magline run.

use std::{fs, net::TcpListener, os::unix::fs::PermissionsExt, path::Path, sync::Arc, time::Duration};

use arrow_flight::{Action, Ticket, flight_service_client::FlightServiceClient};
use ballista_core::{
    serde::protobuf::{
        self, CancelJobParams, ExecuteQueryParams, LaunchMultiTaskParams, LaunchTaskParams, MultiTaskDefinition,
        RegisterExecutorParams, RemoveJobDataParams, StopExecutorParams, TaskId, execute_query_params::Query,
        execute_query_result::Result as Outcome, executor_grpc_client::ExecutorGrpcClient,
        scheduler_grpc_client::SchedulerGrpcClient,
    },
    version::insert_version_header,
};
use datafusion::{physical_plan::ExecutionPlan, prelude::SessionContext};
use datafusion_proto::{
    logical_plan::{AsLogicalPlan, DefaultLogicalExtensionCodec},
    physical_plan::{AsExecutionPlan, DefaultPhysicalExtensionCodec},
    protobuf::{LogicalPlanNode, PhysicalPlanNode},
};
use pipeline::run::ballista::ClusterTrust;
use prost::Message;
use tokio::runtime::Runtime;
use tokio_rustls::rustls::{
    DigitallySignedStruct, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    pki_types::{CertificateDer, ServerName, UnixTime},
};
use tonic::{
    Request, Status,
    body::Body,
    codegen::{Service, http},
    transport::{Channel, ClientTlsConfig, Endpoint},
};

use crate::{
    cluster_support::{Cluster, KEY_FILE, write_key},
    support::Bench,
};

const MAGLINE: &str = env!("CARGO_BIN_EXE_magline");
const SECRET: &str = "geheim";

/// A cluster of one worker, its ports, and files that must not be read or written through the cluster.
struct Scene {
    bench: Bench,
    cluster: Cluster,
    runtime: Runtime,
    scheduler: String,
    answers: String,
    tasks: String,
    plans: Plans,
}

/// DataFusion plans that a foreign client may submit.
struct Plans {
    physical: Vec<(&'static str, Vec<u8>)>,
    logical: Vec<u8>,
}

/// First of two consecutive free ports.
fn ports() -> u16 {
    let free = |port: u16| TcpListener::bind(("127.0.0.1", port));
    loop {
        let one = free(0).unwrap();
        let port = one.local_addr().unwrap().port();
        if port < u16::MAX && free(port + 1).is_ok() {
            return port;
        }
    }
}

async fn plans(folder: &Path) -> Plans {
    let session = SessionContext::new();
    let read =
        format!("CREATE EXTERNAL TABLE t (x VARCHAR) STORED AS CSV LOCATION '{}'", folder.join("secret.csv").display());
    session.sql(&read).await.unwrap();
    let write = |text: &str, name: &str| {
        format!("COPY (SELECT '{text}' AS x) TO '{}' STORED AS CSV", folder.join(name).display())
    };
    let mut physical = vec![];
    for (what, query) in [
        ("a scan of a file", "SELECT x FROM t".to_owned()),
        ("a scan below others", "SELECT x, count(*) FROM t GROUP BY x ORDER BY x LIMIT 3".to_owned()),
        ("a file that is written", write("owned", "written.csv")),
        ("rows without a file", "SELECT 1 AS x".to_owned()),
    ] {
        let plan: Arc<dyn ExecutionPlan> = session.sql(&query).await.unwrap().create_physical_plan().await.unwrap();
        let node = PhysicalPlanNode::try_from_physical_plan(plan, &DefaultPhysicalExtensionCodec {}).unwrap();
        physical.push((what, node.encode_to_vec()));
    }
    let plan = session.sql("SELECT x FROM t").await.unwrap().into_unoptimized_plan();
    let node = LogicalPlanNode::try_from_logical_plan(&plan, &DefaultLogicalExtensionCodec {}).unwrap();
    Plans { physical, logical: node.encode_to_vec() }
}

impl Scene {
    fn new() -> Scene {
        let bench = Bench::new();
        let secret = bench.path("secret.csv");
        fs::write(&secret, format!("x\n{SECRET}\n")).unwrap();
        fs::set_permissions(&secret, fs::Permissions::from_mode(0o600)).unwrap();
        let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 0);
        let port = ports();
        cluster.add_at("store", &[], port);
        let runtime = Runtime::new().unwrap();
        let plans = runtime.block_on(plans(bench.folder.path()));
        let (answers, tasks) = (format!("127.0.0.1:{port}"), format!("127.0.0.1:{}", port + 1));
        let scheduler = cluster.at.clone();
        Scene { bench, cluster, runtime, scheduler, answers, tasks, plans }
    }

    /// Asserts that nothing was read or written, and that scheduler and worker still work.
    fn assert_unharmed(&mut self) {
        assert!(!self.bench.path("written.csv").exists());
        assert!(self.cluster.scheduler.try_wait().unwrap().is_none(), "the scheduler has ended");
        assert!(
            self.cluster.workers[0].0.try_wait().unwrap().is_none(),
            "the worker has ended: {}",
            self.cluster.worker_stderr()
        );
        let engine = self.cluster.engine();
        let run = self.bench.run(&["--engine", &engine, "--key-file", KEY_FILE]);
        assert_eq!(run.code, 0, "{} {}", run.stderr, self.cluster.worker_stderr());
        assert!(!self.cluster.worker_stderr().contains(SECRET));
    }

    /// Submits a plan to the scheduler; returns an error if the plan is rejected.
    async fn submit(&self, channel: Channel, query: Query) -> Result<(), String> {
        let asked = ExecuteQueryParams { query: Some(query), ..ExecuteQueryParams::default() };
        let mut request = Request::new(asked);
        insert_version_header(request.metadata_mut());
        let answer = SchedulerGrpcClient::new(channel).execute_query(request).await.map_err(status_message)?;
        match answer.into_inner().result {
            Some(Outcome::Success(_)) => Ok(()),
            other => Err(format!("{other:?}")),
        }
    }

    /// Sends tasks to the worker; returns an error if the tasks are rejected.
    async fn launch(&self, channel: Channel, job: &str, plan: &[u8]) -> Result<(), String> {
        let task = TaskId { global_output_partition_ids: vec![0], vcores_consumed: 1, ..TaskId::default() };
        let tasks = MultiTaskDefinition {
            task_ids: vec![task],
            job_id: job.to_owned(),
            stage_id: 1,
            plan: plan.to_vec(),
            ..MultiTaskDefinition::default()
        };
        let asked = LaunchMultiTaskParams { multi_tasks: vec![tasks], scheduler_endpoint: self.scheduler.clone() };
        let answer = ExecutorGrpcClient::new(channel).launch_multi_task(asked).await.map_err(status_message)?;
        let failed = answer.into_inner().failed_jobs;
        if failed.is_empty() { Ok(()) } else { Err(format!("refused: {failed:?}")) }
    }
}

fn status_message(status: Status) -> String {
    status.to_string()
}

/// Request for a file of a job.
fn fetch(job: &str) -> Vec<u8> {
    let partition =
        protobuf::FetchPartition { job_id: job.to_owned(), stage_id: 1, ..protobuf::FetchPartition::default() };
    let action = protobuf::action::ActionType::FetchPartition(partition);
    protobuf::Action { action_type: Some(action), ..protobuf::Action::default() }.encode_to_vec()
}

/// Trusts any server.
#[derive(Debug)]
struct Anyone;

impl ServerCertVerifier for Anyone {
    fn verify_server_cert(
        &self,
        _: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, tokio_rustls::rustls::Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, tokio_rustls::rustls::Error> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn verify_tls13_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, tokio_rustls::rustls::Error> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ED25519, SignatureScheme::ECDSA_NISTP256_SHA256, SignatureScheme::RSA_PSS_SHA256]
    }
}

/// Status of a REST path of the scheduler.
async fn rest(mut channel: Channel, method: &str, path: &str) -> Result<u16, String> {
    let request = http::Request::builder().method(method).uri(path).body(Body::empty()).unwrap();
    std::future::poll_fn(|cx| channel.poll_ready(cx)).await.map_err(|e| e.to_string())?;
    channel.call(request).await.map(|answer| answer.status().as_u16()).map_err(|e| e.to_string())
}

#[test]
fn user_clients_without_the_key_are_rejected_by_a_cluster() {
    let mut scene = Scene::new();
    let other = scene.bench.path("other.key");
    write_key(&other, "another-key-of-a-test-7d1e4b0c9a");
    let other = ClusterTrust::read(Some(&other), false).unwrap();
    let endpoint = |scheme: &str, at: &str| Endpoint::from_shared(format!("{scheme}://{at}")).unwrap();
    let strangers = |at: &str| {
        let careless = endpoint("https", at);
        let careless = careless
            .tls_config_with_verifier(ClientTlsConfig::new().domain_name("x.invalid"), Arc::new(Anyone))
            .unwrap();
        [
            ("without encryption", endpoint("http", at)),
            ("with encryption and no certificate", careless),
            ("with another key", other.endpoint(at).unwrap()),
        ]
    };
    let limited =
        |e: Endpoint| e.connect_timeout(Duration::from_secs(5)).timeout(Duration::from_secs(5)).connect_lazy();
    let plan = scene.plans.physical[0].1.clone();
    scene.runtime.block_on(async {
        for (who, at) in strangers(&scene.scheduler) {
            let channel = || limited(at.clone());
            for query in [Query::PhysicalPlan(plan.clone()), Query::LogicalPlan(scene.plans.logical.clone())] {
                assert!(scene.submit(channel(), query).await.is_err(), "{who}");
            }
            let mut client = SchedulerGrpcClient::new(channel());
            assert!(client.cancel_job(CancelJobParams::default()).await.is_err(), "{who}");
            assert!(client.register_executor(RegisterExecutorParams::default()).await.is_err(), "{who}");
            for path in ["api/state", "api/executors", "api/jobs", "api/metrics", "healthz"] {
                let answer =
                    rest(channel(), "GET", &format!("{}/{path}", at.uri().to_string().trim_end_matches('/'))).await;
                assert!(answer.is_err(), "{who} asks for {path}: {answer:?}");
            }
            let ticket = Ticket { ticket: fetch("job").into() };
            assert!(FlightServiceClient::new(channel()).do_get(ticket).await.is_err(), "{who}");
        }
        for (who, at) in strangers(&scene.tasks) {
            let channel = || limited(at.clone());
            assert!(scene.launch(channel(), "job", &plan).await.is_err(), "{who}");
            let mut client = ExecutorGrpcClient::new(channel());
            assert!(client.stop_executor(StopExecutorParams::default()).await.is_err(), "{who}");
            assert!(client.launch_task(LaunchTaskParams::default()).await.is_err(), "{who}");
            assert!(client.remove_job_data(RemoveJobDataParams::default()).await.is_err(), "{who}");
        }
        for (who, at) in strangers(&scene.answers) {
            let ticket = Ticket { ticket: fetch("job").into() };
            let status = FlightServiceClient::new(limited(at)).do_get(ticket).await.unwrap_err();
            assert!(!status.message().contains("No such file"), "{who}: {status}");
        }
    });
    scene.assert_unharmed();
}

#[test]
fn user_clients_with_the_key_can_only_run_tasks_of_magline() {
    let mut scene = Scene::new();
    let trust = ClusterTrust::read(Some(&scene.bench.path(KEY_FILE)), false).unwrap();
    scene.runtime.block_on(async {
        let channel = |at: &str| trust.endpoint(at).unwrap().connect_lazy();
        for (what, plan) in &scene.plans.physical {
            let refused = scene.submit(channel(&scene.scheduler), Query::PhysicalPlan(plan.clone())).await.unwrap_err();
            assert!(refused.contains("accepts only tasks of magline"), "{what}: {refused}");
            let refused = scene.launch(channel(&scene.tasks), "job", plan).await.unwrap_err();
            assert!(refused.contains("refused: [\"job\"]"), "{what}: {refused}");
        }
        let logical = Query::LogicalPlan(scene.plans.logical.clone());
        let refused = scene.submit(channel(&scene.scheduler), logical).await.unwrap_err();
        assert!(refused.contains("it accepts no queries"), "{refused}");
        for job in ["", "..", "../..", "/etc", "a/b"] {
            let mut files = FlightServiceClient::new(channel(&scene.answers));
            let refused = files.do_get(Ticket { ticket: fetch(job).into() }).await.unwrap_err();
            assert!(refused.message().contains("the name of the job is invalid"), "{job}: {refused}");
            let action = Action { r#type: "IO_BLOCK_TRANSPORT".to_owned(), body: fetch(job).into() };
            let refused = files.do_action(action).await.unwrap_err();
            assert!(refused.message().contains("the name of the job is invalid"), "{job}: {refused}");
            let mut tasks = ExecutorGrpcClient::new(channel(&scene.tasks));
            let remove = RemoveJobDataParams { job_id: job.to_owned(), remove_stage_ids: vec![] };
            assert!(tasks.remove_job_data(remove).await.is_err(), "{job}");
        }
        // The same requests succeed with valid tasks.
        assert_eq!(
            rest(channel(&scene.scheduler), "GET", &format!("https://{}/api/state", scene.scheduler)).await,
            Ok(200)
        );
    });
    scene.assert_unharmed();
}

#[test]
fn user_a_cluster_without_a_key_is_rejected_except_on_the_loopback_interface() {
    let bench = Bench::new();
    let rejected = |args: &[&str]| {
        let output = bench.magline(args);
        (output.status.code(), crate::support::stderr(&output))
    };
    let at = "127.0.0.1:1";
    for args in [
        &["scheduler", "--bind", "127.0.0.1:0"][..],
        &["worker", "--scheduler", at],
        &["run", "spec.toml", "--engine", "ballista://127.0.0.1:1"],
    ] {
        let (code, text) = rejected(args);
        assert!(
            code == Some(2) && text.contains("the cluster has no key") && text.contains("--key-file"),
            "{args:?}: {text}"
        );
        let (code, text) = rejected(&[args, &["--key-file", "none.key"]].concat());
        assert!(code == Some(2) && text.contains("cannot read the key in none.key"), "{args:?}: {text}");
    }
    for args in [
        &["scheduler", "--bind", "0.0.0.0:0", "--insecure-loopback"][..],
        &["scheduler", "--bind", "[::]:0", "--insecure-loopback"],
    ] {
        let (code, text) = rejected(args);
        assert!(code == Some(2) && text.contains("other machines can connect to"), "{args:?}: {text}");
    }
}
