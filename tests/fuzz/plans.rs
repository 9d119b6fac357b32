//! Mutated plans, tasks and receipts of a cluster.

use arrow_array::{RecordBatch, StringArray, UInt64Array};
use arrow_schema::{DataType, Field, Schema};
use ballista_core::serde::protobuf::{
    BallistaPhysicalPlanNode, ShuffleWriterExecNode, ballista_physical_plan_node::PhysicalPlanType as Ballista,
};
use datafusion::{
    datasource::{memory::MemorySourceConfig, source::DataSourceExec},
    execution::TaskContext,
    physical_plan::ExecutionPlan,
    prelude::SessionContext,
};
use datafusion_proto::{
    physical_plan::{AsExecutionPlan, DefaultPhysicalExtensionCodec},
    protobuf::{PhysicalExtensionNode, PhysicalPlanNode, physical_plan_node::PhysicalPlanType as Node},
};
use pipeline::run::{
    Receipt, Task,
    ballista::{JobPlan, TaskPlanCodec},
};
use prost::Message;
use serde_json::json;
use tokio::runtime::Runtime;

use super::*;

/// Prefix of magline's node.
const MARK: &str = "\0magline ";

fn message(plan: Arc<dyn ExecutionPlan>) -> PhysicalPlanNode {
    PhysicalPlanNode::try_from_physical_plan(plan, &DefaultPhysicalExtensionCodec {}).unwrap()
}

/// Rows of one task in memory.
fn rows() -> PhysicalPlanNode {
    let texts = |name: &str| Field::new(name, DataType::Utf8, true);
    let numbers = |name: &str| Field::new(name, DataType::UInt64, true);
    let fields = vec![texts("id"), texts("wave"), numbers("retries"), numbers("unit_timeout_s"), texts("task")];
    let schema = Arc::new(Schema::new(fields));
    let text = |value: &str| Arc::new(StringArray::from(vec![value])) as arrow_array::ArrayRef;
    let number = || Arc::new(UInt64Array::from(vec![1])) as arrow_array::ArrayRef;
    let columns = vec![text("a"), text("w"), number(), number(), text("{}")];
    let batch = RecordBatch::try_new(schema.clone(), columns).unwrap();
    let source = MemorySourceConfig::try_new(&[vec![batch.clone()], vec![batch]], schema, None).unwrap();
    message(DataSourceExec::from_data_source(source))
}

/// Plans of DataFusion that read, write or compute.
fn foreign(folder: &Path) -> Vec<PhysicalPlanNode> {
    let file = folder.join("secret.csv");
    fs::write(&file, "x\n1\n").unwrap();
    let session = SessionContext::new();
    let queries = [
        "SELECT x FROM t".to_owned(),
        "SELECT x, count(*) FROM t GROUP BY x ORDER BY x LIMIT 3".to_owned(),
        format!("COPY (SELECT 'x' AS x) TO '{}' STORED AS CSV", folder.join("written.csv").display()),
        "SELECT 1 AS x".to_owned(),
        "SELECT a.x FROM t a JOIN t b ON a.x = b.x".to_owned(),
    ];
    let table = format!("CREATE EXTERNAL TABLE t (x VARCHAR) STORED AS CSV LOCATION '{}'", file.display());
    Runtime::new().unwrap().block_on(async {
        session.sql(&table).await.unwrap();
        let mut all = vec![];
        for query in queries {
            all.push(message(session.sql(&query).await.unwrap().create_physical_plan().await.unwrap()));
        }
        all
    })
}

fn extension(node: Vec<u8>, inputs: Vec<PhysicalPlanNode>) -> PhysicalPlanNode {
    PhysicalPlanNode { physical_plan_type: Some(Node::Extension(PhysicalExtensionNode { node, inputs })) }
}

fn writer(job: &str, input: Option<PhysicalPlanNode>) -> Vec<u8> {
    let writer = ShuffleWriterExecNode { job_id: job.to_owned(), stage_id: 1, input, output_partitioning: None };
    BallistaPhysicalPlanNode { physical_plan_type: Some(Ballista::ShuffleWriter(writer)) }.encode_to_vec()
}

/// Random tree of nodes, mostly one that a cluster accepts.
fn tree(random: &mut Random, leaves: &[PhysicalPlanNode], depth: usize) -> PhysicalPlanNode {
    let input = |random: &mut Random| {
        if random.chance(12) && depth < 6 { tree(random, leaves, depth + 1) } else { random.pick(&leaves[..1]).clone() }
    };
    let units = |random: &mut Random| {
        let count = if random.chance(12) { random.below(3) } else { 1 };
        let inputs = (0..count).map(|_| input(random)).collect();
        let version = if random.chance(3) { *random.pick(&PIECES) } else { "0.1.0" };
        extension(format!("{MARK}{version}").into_bytes(), inputs)
    };
    match random.below(8) {
        0 => random.pick(leaves).clone(),
        1..4 => units(random),
        _ => {
            let job = if random.chance(4) { format!("job{}", random.pick(&PIECES)) } else { "job-1".to_owned() };
            let inner = random.chance(12).then(|| random.pick(leaves).clone());
            let below = if random.chance(8) { tree(random, leaves, depth + 1) } else { units(random) };
            extension(writer(&job, inner), vec![below])
        }
    }
}

/// Names of the nodes of a plan, and the properties of its sources.
fn assert_only_tasks(plan: &Arc<dyn ExecutionPlan>) {
    let known = ["MaglineUnits", "ShuffleWriterExec", "DataSourceExec"];
    assert!(known.contains(&plan.name()), "{}", plan.name());
    if let Some(source) = plan.downcast_ref::<DataSourceExec>() {
        assert!(source.data_source().downcast_ref::<MemorySourceConfig>().is_some(), "{plan:?}");
        assert!(plan.children().is_empty());
    }
    plan.children().into_iter().for_each(assert_only_tasks);
}

#[test]
fn user_mutated_plans_of_a_cluster_contain_only_tasks() {
    let bench = Bench::new();
    let mut leaves = vec![rows()];
    leaves.extend(foreign(bench.folder.path()));
    let encoded: Vec<Vec<u8>> = leaves.iter().map(Message::encode_to_vec).collect();
    let context = TaskContext::default();
    fuzz("plans", 2_000, |random| {
        let mut bytes = tree(random, &leaves, 0).encode_to_vec();
        if random.chance(2) {
            bytes = mutated_text(random, &bytes, &["\n"]);
        }
        if random.chance(8) {
            let at = random.below(bytes.len() + 1);
            bytes.splice(at..at, random.pick(&encoded).iter().copied());
        }
        let Ok(plan) = JobPlan::try_decode(&bytes) else { return false };
        let mut accepted = false;
        for codec in [TaskPlanCodec::default(), TaskPlanCodec::of_worker()] {
            if let Ok(plan) = plan.try_into_physical_plan(&context, &codec) {
                assert_only_tasks(&plan);
                accepted = true;
            }
        }
        accepted
    });
    assert!(!bench.path("written.csv").exists());
}

#[test]
fn bug_a_length_that_rows_in_memory_declare_is_not_allocated() {
    let whole = rows();
    let Some(Node::MemoryScan(scan)) = &whole.physical_plan_type else { panic!("rows in memory") };
    let context = TaskContext::default();
    let decoded = |rows: PhysicalPlanNode| {
        let bytes = extension(format!("{MARK}0.1.0").into_bytes(), vec![rows]).encode_to_vec();
        JobPlan::try_decode(&bytes)
            .is_ok_and(|plan| plan.try_into_physical_plan(&context, &TaskPlanCodec::default()).is_ok())
    };
    assert!(decoded(whole.clone()));
    // One of these positions holds the length of the body. An allocation of 35 TB would end the process.
    for at in (0..scan.partitions[0].len() - 8).step_by(4) {
        let mut scan = scan.clone();
        scan.partitions[0][at..at + 8].copy_from_slice(&(1_i64 << 45).to_le_bytes());
        decoded(PhysicalPlanNode { physical_plan_type: Some(Node::MemoryScan(scan)) });
    }
}

#[test]
fn user_mutated_tasks_and_receipts_are_read_or_rejected() {
    let key = "0123456789abcdef0123456789abcdef";
    let unit = json!({"point": 3, "line": 7, "key": key, "without": [2, 5]});
    let task = json!({"task": 1, "magline": "0.1.0", "plan": key, "table": "fit", "part": true, "units": [unit]});
    let answer =
        json!({"point": 3, "line": 7, "key": key, "axes": {"mag": "a"}, "place": ["1", "2"], "outcome": "computed"});
    let receipt = json!({"receipt": 1, "magline": "0.1.0", "plan": key, "table": "fit", "task": key, "units": [answer],
        "seconds": 0.5, "worker": "w"});
    assert!(Task::parse(&task.to_string()).is_ok());
    assert!(Receipt::parse(&receipt.to_string()).is_ok(), "{:?}", Receipt::parse(&receipt.to_string()));
    fuzz("tasks", 3_000, |random| {
        let mut changed = if random.chance(2) { task.clone() } else { receipt.clone() };
        (0..=random.below(2)).for_each(|_| mutated_json(random, &mut changed));
        let mut text = changed.to_string();
        if random.chance(4) {
            text = String::from_utf8_lossy(&mutated_text(random, text.as_bytes(), &[key])).into_owned();
        }
        let (task, receipt) = (Task::parse(&text), Receipt::parse(&text));
        if let Ok(task) = &task {
            let again = serde_json::to_string(task).unwrap();
            assert_eq!(Task::parse(&again).as_ref(), Ok(task), "{text}");
        }
        task.is_ok() || receipt.is_ok()
    });
}
