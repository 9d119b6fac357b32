//! Messages in Ballista plans: tasks, receipts, and the plan node that carries them.
//!
//! The leaf of a plan is a source in memory with tasks as rows, because Ballista only partitions leaves of known types.
//! The node above the leaf has the same partitions. The scheduler decodes and encodes the node without computing
//! anything. A worker never fails a partition, which would fail the job; it returns failures as rows.

use std::{
    fmt,
    sync::{Arc, OnceLock},
    thread,
    time::Duration,
};

use arrow_array::{Array, ArrayRef, RecordBatch, StringArray, UInt64Array, cast::AsArray, types::UInt64Type};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use ballista_core::serde::BallistaPhysicalExtensionCodec;
use datafusion::{
    common::{exec_err, tree_node::TreeNodeRecursion},
    error::{DataFusionError, Result},
    execution::TaskContext,
    physical_expr::{EquivalenceProperties, PhysicalExpr},
    physical_plan::{
        DisplayAs, DisplayFormatType, ExecutionPlan, PlanProperties, SendableRecordBatchStream,
        execution_plan::{Boundedness, EmissionType},
        stream::RecordBatchStreamAdapter,
    },
};
use datafusion_proto::physical_plan::{PhysicalExtensionCodec, PhysicalProtoConverterExtension};
use futures::TryStreamExt;

use crate::{children::ProcessStopHandle, task::VERSION};

/// Time that a worker process has to finish its unit after a stop signal.
const GRACE: Duration = Duration::from_secs(10);

/// Wire form of a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskMessage {
    /// Hash of the task.
    pub id: String,
    /// Wave: the tasks of a table in a run.
    pub wave: String,
    /// Maximum number of retries of a unit whose worker was lost.
    pub retries: u64,
    /// Maximum time of a unit, in seconds; 0 for no limit.
    pub unit_timeout_s: u64,
    /// Task, in JSON.
    pub task: String,
}

/// Wire form of the answer to a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AnswerMessage {
    /// Hash of the task.
    pub id: String,
    /// Name of the worker.
    pub worker: String,
    /// Receipt, in JSON; `None` for a rejected task.
    pub receipt: Option<String>,
    /// Reason why the worker rejected the task.
    pub refused: Option<String>,
}

fn schema(fields: &[(&str, DataType)]) -> SchemaRef {
    Arc::new(Schema::new(fields.iter().map(|(name, kind)| Field::new(*name, kind.clone(), true)).collect::<Vec<_>>()))
}

/// Columns of tasks.
pub fn handed_schema() -> SchemaRef {
    use DataType::{UInt64, Utf8};
    schema(&[("id", Utf8), ("wave", Utf8), ("retries", UInt64), ("unit_timeout_s", UInt64), ("task", Utf8)])
}

fn answered_schema() -> SchemaRef {
    use DataType::Utf8;
    schema(&[("id", Utf8), ("worker", Utf8), ("receipt", Utf8), ("refused", Utf8)])
}

fn texts<'a>(values: impl Iterator<Item = Option<&'a str>>) -> ArrayRef {
    Arc::new(values.collect::<StringArray>())
}

fn text(rows: &RecordBatch, column: &str, row: usize) -> Option<String> {
    let array = rows.column_by_name(column)?.as_string_opt::<i32>()?;
    (row < array.len() && array.is_valid(row)).then(|| array.value(row).to_owned())
}

fn number(rows: &RecordBatch, column: &str, row: usize) -> Option<u64> {
    let array = rows.column_by_name(column)?.as_primitive_opt::<UInt64Type>()?;
    (row < array.len() && array.is_valid(row)).then(|| array.value(row))
}

impl TaskMessage {
    /// Tasks as rows.
    ///
    /// # Errors
    /// Fails if Arrow rejects the columns.
    pub fn rows(all: &[TaskMessage]) -> Result<RecordBatch> {
        let numbers = |of: fn(&TaskMessage) -> u64| Arc::new(all.iter().map(of).collect::<UInt64Array>()) as ArrayRef;
        let columns = vec![
            texts(all.iter().map(|h| Some(h.id.as_str()))),
            texts(all.iter().map(|h| Some(h.wave.as_str()))),
            numbers(|h| h.retries),
            numbers(|h| h.unit_timeout_s),
            texts(all.iter().map(|h| Some(h.task.as_str()))),
        ];
        Ok(RecordBatch::try_new(handed_schema(), columns)?)
    }

    /// Tasks in some rows.
    fn read(rows: &RecordBatch) -> Option<Vec<TaskMessage>> {
        let one = |i: usize| {
            Some(TaskMessage {
                id: text(rows, "id", i)?,
                wave: text(rows, "wave", i)?,
                retries: number(rows, "retries", i)?,
                unit_timeout_s: number(rows, "unit_timeout_s", i)?,
                task: text(rows, "task", i)?,
            })
        };
        (0..rows.num_rows()).map(one).collect()
    }
}

impl AnswerMessage {
    fn rows(all: &[AnswerMessage]) -> Result<RecordBatch> {
        let columns = vec![
            texts(all.iter().map(|a| Some(a.id.as_str()))),
            texts(all.iter().map(|a| Some(a.worker.as_str()))),
            texts(all.iter().map(|a| a.receipt.as_deref())),
            texts(all.iter().map(|a| a.refused.as_deref())),
        ];
        Ok(RecordBatch::try_new(answered_schema(), columns)?)
    }

    /// Answers in some rows; `None` if the rows have other columns.
    pub fn read(rows: &RecordBatch) -> Option<Vec<AnswerMessage>> {
        let one = |i: usize| {
            Some(AnswerMessage {
                id: text(rows, "id", i)?,
                worker: text(rows, "worker", i)?,
                receipt: text(rows, "receipt", i),
                refused: text(rows, "refused", i),
            })
        };
        (0..rows.num_rows()).map(one).collect()
    }
}

/// Component that computes tasks in a worker.
pub trait TaskComputer: Send + Sync {
    /// Computes tasks that a program of the version `version` has dispatched. Returns one answer for each task, or no
    /// answer for tasks that a stop signal prevents.
    fn answers(&self, tasks: Vec<TaskMessage>, version: &str, leash: &ProcessStopHandle) -> Vec<AnswerMessage>;
}

/// Component that computes tasks in this process; unset in the process of a scheduler or a driver.
pub static COMPUTE: OnceLock<Box<dyn TaskComputer>> = OnceLock::new();

/// Guard that stops the work when its partition is cancelled.
struct CancellationGuard(Option<ProcessStopHandle>);

impl Drop for CancellationGuard {
    fn drop(&mut self) {
        if let Some(leash) = self.0.take() {
            leash.stop();
            thread::spawn(move || {
                thread::sleep(GRACE);
                leash.kill();
            });
        }
    }
}

async fn computed(rows: RecordBatch, version: String) -> Result<RecordBatch> {
    let Some(compute) = COMPUTE.get() else { return exec_err!("this process computes no tasks") };
    let Some(tasks) = TaskMessage::read(&rows) else {
        return exec_err!("the dispatched rows are not magline tasks");
    };
    let leash = ProcessStopHandle::default();
    let mut tether = CancellationGuard(Some(leash.clone()));
    let answers = tokio::task::spawn_blocking(move || compute.answers(tasks, &version, &leash)).await;
    tether.0.take();
    AnswerMessage::rows(&answers.map_err(|e| DataFusionError::External(Box::new(e)))?)
}

/// Plan node that computes tasks: rows of tasks in, rows of answers out.
#[derive(Debug)]
pub struct TaskComputeExec {
    input: Arc<dyn ExecutionPlan>,
    /// Version of the program that made the plan.
    version: String,
    properties: Arc<PlanProperties>,
}

impl TaskComputeExec {
    /// Creates the node above a source of tasks, as a plan of this version.
    pub fn new(input: Arc<dyn ExecutionPlan>) -> TaskComputeExec {
        TaskComputeExec::with_version(input, VERSION.to_owned())
    }

    fn with_version(input: Arc<dyn ExecutionPlan>, version: String) -> TaskComputeExec {
        // The scheduler divides the input and creates the node again, so the number of partitions is always read from
        // the input.
        let partitions = input.properties().output_partitioning().clone();
        let equal = EquivalenceProperties::new(answered_schema());
        let properties = PlanProperties::new(equal, partitions, EmissionType::Incremental, Boundedness::Bounded);
        TaskComputeExec { input, version, properties: Arc::new(properties) }
    }
}

impl DisplayAs for TaskComputeExec {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "magline units, {}", self.version)
    }
}

impl ExecutionPlan for TaskComputeExec {
    fn name(&self) -> &'static str {
        "MaglineUnits"
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        &self.properties
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        vec![&self.input]
    }

    fn benefits_from_input_partitioning(&self) -> Vec<bool> {
        vec![false]
    }

    fn apply_expressions(
        &self,
        _: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        Ok(TreeNodeRecursion::Continue)
    }

    fn with_new_children(self: Arc<Self>, mut children: Vec<Arc<dyn ExecutionPlan>>) -> Result<Arc<dyn ExecutionPlan>> {
        match children.pop() {
            Some(input) if children.is_empty() => {
                Ok(Arc::new(TaskComputeExec::with_version(input, self.version.clone())))
            }
            _ => exec_err!("units of magline have one input"),
        }
    }

    fn execute(&self, partition: usize, context: Arc<TaskContext>) -> Result<SendableRecordBatchStream> {
        let version = self.version.clone();
        let rows = self.input.execute(partition, context)?.and_then(move |rows| computed(rows, version.clone()));
        Ok(Box::pin(RecordBatchStreamAdapter::new(answered_schema(), rows)))
    }
}

/// Prefix of magline's node among the messages of a plan. No message of Ballista begins with a zero byte.
pub const MARK: &str = "\0magline ";

/// Codec of magline's node in a plan of Ballista.
///
/// A scheduler and a driver reject a node of another version. A worker decodes such a node and rejects its tasks in the
/// answers, because an error would fail the whole job.
#[derive(Debug, Default)]
pub struct TaskPlanCodec {
    ballista: BallistaPhysicalExtensionCodec,
    /// Whether nodes of other versions are decoded.
    lenient: bool,
}

impl TaskPlanCodec {
    /// Codec of a worker.
    pub fn of_worker() -> TaskPlanCodec {
        TaskPlanCodec { lenient: true, ..TaskPlanCodec::default() }
    }
}

impl PhysicalExtensionCodec for TaskPlanCodec {
    fn try_decode(
        &self,
        bytes: &[u8],
        inputs: &[Arc<dyn ExecutionPlan>],
        context: &TaskContext,
        converter: &dyn PhysicalProtoConverterExtension,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let version = std::str::from_utf8(bytes).ok().and_then(|text| text.strip_prefix(MARK));
        match (version, inputs) {
            (Some(version), [input]) if version == VERSION || self.lenient => {
                Ok(Arc::new(TaskComputeExec::with_version(input.clone(), version.to_owned())))
            }
            (Some(version), [_]) => {
                exec_err!("the run is magline {version}, but the scheduler is magline {VERSION}: use the same version")
            }
            (Some(_), _) => exec_err!("units of magline have one input"),
            (None, _) => self.ballista.try_decode(bytes, inputs, context, converter),
        }
    }

    fn try_encode(
        &self,
        node: Arc<dyn ExecutionPlan>,
        bytes: &mut Vec<u8>,
        converter: &dyn PhysicalProtoConverterExtension,
    ) -> Result<()> {
        match node.downcast_ref::<TaskComputeExec>() {
            Some(units) => bytes.extend_from_slice(format!("{MARK}{}", units.version).as_bytes()),
            None => return self.ballista.try_encode(node, bytes, converter),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use datafusion::datasource::{memory::MemorySourceConfig, source::DataSourceExec};
    use datafusion_proto::physical_plan::DefaultPhysicalProtoConverter;

    use super::*;

    fn task(id: &str) -> TaskMessage {
        let (id, wave, task) = (id.to_owned(), "w".to_owned(), "{\"task\":1}".to_owned());
        TaskMessage { id, wave, retries: 2, unit_timeout_s: 0, task }
    }

    #[test]
    fn unit_tasks_and_answers_round_trip() {
        let tasks = [task("a"), TaskMessage { unit_timeout_s: 7, ..task("b\n\"") }];
        let rows = TaskMessage::rows(&tasks).unwrap();
        assert_eq!(TaskMessage::read(&rows).unwrap(), tasks);
        let answer = |id: &str, receipt: Option<&str>| {
            let refused = if receipt.is_none() { Some("no".to_owned()) } else { None };
            AnswerMessage { id: id.to_owned(), worker: "w".to_owned(), receipt: receipt.map(str::to_owned), refused }
        };
        let answers = [answer("a", Some("{}")), answer("b", None)];
        assert_eq!(AnswerMessage::read(&AnswerMessage::rows(&answers).unwrap()).unwrap(), answers);
        assert!(
            AnswerMessage::read(&rows).is_none()
                && TaskMessage::read(&AnswerMessage::rows(&answers).unwrap()).is_none()
        );
    }

    #[test]
    fn unit_scheduler_rejects_and_worker_reads_a_node_of_another_version() {
        let parts =
            vec![vec![TaskMessage::rows(&[task("a")]).unwrap()], vec![TaskMessage::rows(&[task("b")]).unwrap()]];
        let leaf = MemorySourceConfig::try_new(&parts, handed_schema(), None).unwrap();
        let leaf = DataSourceExec::from_data_source(leaf) as Arc<dyn ExecutionPlan>;
        let node = Arc::new(TaskComputeExec::with_version(leaf.clone(), "9.9.9".to_owned()));
        assert_eq!(node.properties().output_partitioning().partition_count(), 2);
        let (strict, worker) = (TaskPlanCodec::default(), TaskPlanCodec::of_worker());
        let converter = DefaultPhysicalProtoConverter {};
        let mut bytes = vec![];
        strict.try_encode(node, &mut bytes, &converter).unwrap();
        let context = TaskContext::default();
        let refused =
            strict.try_decode(&bytes, std::slice::from_ref(&leaf), &context, &converter).unwrap_err().to_string();
        assert!(refused.contains("9.9.9") && refused.contains(VERSION) && !refused.contains("bug"), "{refused}");
        let read = worker.try_decode(&bytes, std::slice::from_ref(&leaf), &context, &converter).unwrap();
        // The node is encoded unchanged.
        let mut again = vec![];
        worker.try_encode(read, &mut again, &converter).unwrap();
        assert_eq!(again, bytes);
        assert!(worker.try_decode(&bytes, &[], &context, &converter).is_err());
        assert!(strict.try_decode(b"\0else", &[leaf], &context, &converter).is_err());
    }
}
