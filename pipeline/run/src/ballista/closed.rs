//! Plans that a cluster accepts: tasks of magline as rows in memory, the node that computes them, and the writer of its
//! answers. All other plans are rejected, so no other file is read or written and no function is called.
//!
//! The message of a plan is checked before any node is created.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};

use arrow_ipc::root_as_message;
use ballista_core::serde::protobuf::{
    BallistaPhysicalPlanNode, ballista_physical_plan_node::PhysicalPlanType as Ballista,
};
use datafusion::{
    common::exec_err,
    error::{DataFusionError, Result},
    execution::TaskContext,
    logical_expr::LogicalPlan,
    physical_plan::ExecutionPlan,
};
use datafusion_proto::{
    logical_plan::{AsLogicalPlan, LogicalExtensionCodec},
    physical_plan::{AsExecutionPlan, PhysicalExtensionCodec},
    protobuf::{
        MemoryScanExecNode, PhysicalExtensionNode, PhysicalPlanNode, physical_plan_node::PhysicalPlanType as Node,
    },
};
use prost::{Message, bytes::BufMut};

use super::units::MARK;

/// Maximum length of a job's name.
const LONGEST_NAME: usize = 64;

/// Physical plan of a job, or of one of its tasks.
#[derive(Clone, Debug)]
pub struct JobPlan(PhysicalPlanNode);

/// Placeholder for logical plans, which magline does not use.
#[derive(Clone, Debug)]
pub struct LogicalPlanStub;

/// Whether a name is valid for a job; the name is also used as a folder name.
pub fn names_a_job(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    !name.is_empty() && name.len() <= LONGEST_NAME && name.chars().all(plain)
}

fn refused<T>(what: &str) -> Result<T> {
    exec_err!("this cluster accepts only tasks of magline: {what}")
}

/// Runs the decoder of another crate and catches its panics on damaged rows.
fn guarded<T>(decode: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| refused("the rows in memory are damaged"))
}

fn single(node: &PhysicalExtensionNode) -> Result<Option<&Node>> {
    match node.inputs.as_slice() {
        [input] => Ok(input.physical_plan_type.as_ref()),
        _ => refused("a node of the plan does not have exactly one input"),
    }
}

/// Checks a whole plan.
fn check(plan: &PhysicalPlanNode) -> Result<()> {
    let Some(Node::Extension(node)) = &plan.physical_plan_type else {
        return refused("the plan has a node that is not magline's");
    };
    if node.node.starts_with(MARK.as_bytes()) {
        return units(node);
    }
    let writer = match BallistaPhysicalPlanNode::decode(node.node.as_slice()).ok().and_then(|n| n.physical_plan_type) {
        Some(Ballista::ShuffleWriter(writer)) => writer,
        _ => return refused("the plan has a node that is not magline's"),
    };
    if !names_a_job(&writer.job_id) || writer.input.is_some() || writer.output_partitioning.is_some() {
        return refused("the node that writes the receipts is not a node of magline");
    }
    match single(node)? {
        Some(Node::Extension(input)) if input.node.starts_with(MARK.as_bytes()) => units(input),
        _ => refused("the output contains something other than receipts of tasks"),
    }
}

/// Checks magline's node, whose input must be rows in memory.
fn units(node: &PhysicalExtensionNode) -> Result<()> {
    match single(node)? {
        Some(Node::MemoryScan(MemoryScanExecNode { partitions, sort_information, fetch: None, .. }))
            if sort_information.is_empty() =>
        {
            if partitions.iter().all(|stream| has_declared_lengths(stream)) {
                return Ok(());
            }
            refused("the rows in memory are damaged")
        }
        _ => refused("the tasks are not rows in memory"),
    }
}

/// Whether each message of an Arrow stream has the length that it declares. This check is needed because the decoder
/// allocates declared lengths. Compressed buffers and dictionaries, which magline does not send, are rejected, too.
fn has_declared_lengths(mut stream: &[u8]) -> bool {
    const MARKER: [u8; 4] = [0xff; 4];
    while let Some((first, mut rest)) = stream.split_first_chunk::<4>() {
        let mut length = *first;
        if length == MARKER {
            let Some((next, after)) = rest.split_first_chunk::<4>() else { return false };
            (length, rest) = (*next, after);
        }
        let Ok(length) = usize::try_from(i32::from_le_bytes(length)) else { return false };
        if length == 0 {
            return true;
        }
        let Some((metadata, body)) = rest.split_at_checked(length) else { return false };
        let Ok(message) = root_as_message(metadata) else { return false };
        let is_compressed = message.header_as_record_batch().is_some_and(|batch| batch.compression().is_some());
        if is_compressed || message.header_as_dictionary_batch().is_some() {
            return false;
        }
        let after = usize::try_from(message.bodyLength()).ok().and_then(|length| body.split_at_checked(length));
        let Some((_, after)) = after else { return false };
        stream = after;
    }
    stream.is_empty()
}

impl AsExecutionPlan for JobPlan {
    fn try_decode(bytes: &[u8]) -> Result<JobPlan> {
        let plan = PhysicalPlanNode::decode(bytes);
        let plan = plan.map_err(|e| DataFusionError::Execution(format!("the plan is unreadable: {e}")))?;
        check(&plan)?;
        Ok(JobPlan(plan))
    }

    fn try_encode<B: BufMut>(&self, buffer: &mut B) -> Result<()> {
        self.0.try_encode(buffer)
    }

    fn try_into_physical_plan(
        &self,
        context: &TaskContext,
        codec: &dyn PhysicalExtensionCodec,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        guarded(|| self.0.try_into_physical_plan(context, codec))
    }

    fn try_from_physical_plan(plan: Arc<dyn ExecutionPlan>, codec: &dyn PhysicalExtensionCodec) -> Result<JobPlan> {
        PhysicalPlanNode::try_from_physical_plan(plan, codec).map(JobPlan)
    }
}

impl AsLogicalPlan for LogicalPlanStub {
    fn try_decode(_: &[u8]) -> Result<LogicalPlanStub> {
        refused("it accepts no queries")
    }

    fn try_encode<B: BufMut>(&self, _: &mut B) -> Result<()> {
        refused("it accepts no queries")
    }

    fn try_into_logical_plan(&self, _: &TaskContext, _: &dyn LogicalExtensionCodec) -> Result<LogicalPlan> {
        refused("it accepts no queries")
    }

    fn try_from_logical_plan(_: &LogicalPlan, _: &dyn LogicalExtensionCodec) -> Result<LogicalPlanStub> {
        refused("it accepts no queries")
    }
}
