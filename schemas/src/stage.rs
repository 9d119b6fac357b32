//! The declaration of a stage, and the traits that its author implements.
//!
//! One [`stage!`](crate::stage!) declaration gives spec parsing and its messages, plan validation, `explain`, lineage,
//! cache keys, column pruning, `magline stages` and the reference pages. The author implements [`Stage`] and, by grain,
//! [`LineStage`], [`SurveyStage`] or [`MapStage`]; a run uses [`AnyStage`].

mod entry;
mod erased;
mod table;
mod work;

use std::any::Any;

use arrow_array::{ArrayRef, RecordBatch};

pub use self::{
    entry::{ChoiceDoc, StageBuilder, StageEntry, StageHeader, is_optional},
    erased::{
        AnyLinePart, AnyLinePoint, AnySharedData, AnyStage, AnySurveyPoint, LineOutput, LineStageDyn, MapStageDyn,
        StageDyn, SurveyAggregatorDyn, SurveyStageDyn,
    },
    table::{Grain, InputDecl, InputKind, PassThroughColumns, StageRole, StageSchema, Table, TableKind},
    work::{CheckpointMonitor, NullMonitor},
};
use crate::{Fault, Params};

/// The input of a stage for one line: only the declared columns.
#[derive(Clone)]
pub struct LineInput {
    /// The flight identifier.
    pub flight: String,
    /// The line identifier.
    pub line: String,
    /// The columns that the stage reads, per input. Models and maps are empty batches, because they are inputs of
    /// [`LineStage::prepare`].
    pub inputs: Vec<RecordBatch>,
    /// The rows that the stage's `where` selects; all rows without a `where`.
    pub keep: Option<Vec<bool>>,
}

/// The result of a survey or map stage.
#[derive(Clone, Debug)]
pub struct StageOutput {
    /// Arrays for the columns of [`Stage::yields`], in that order.
    pub columns: Vec<ArrayRef>,
    /// Warnings about untrustworthy results, one sentence each: rows of the table `warnings`.
    pub warnings: Vec<String>,
}

impl From<Vec<ArrayRef>> for StageOutput {
    fn from(columns: Vec<ArrayRef>) -> StageOutput {
        StageOutput { columns, warnings: vec![] }
    }
}

/// The trait that every stage implements.
pub trait Stage: Params + Any + Send + Sync {
    /// The columns that the stage reads and makes, given its input tables.
    ///
    /// # Errors
    /// Fails with all faults of the parameters or the tables, before anything runs.
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>>;

    /// Reason why the parameter `key` has no effect, for example because it belongs to a model that is not fitted.
    /// `None` if the parameter has an effect. The key of a result omits parameters without an effect, so points of a
    /// sweep that differ only in such parameters are computed once. A spec that sets such a parameter explicitly is
    /// rejected.
    fn unused_key(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Relative computing time per sample: the product of the parameters to which it is proportional, such as the
    /// number of particles. The unit of this number does not depend on the parameters. `explain --cost` multiplies
    /// measured seconds by the number.
    fn effort(&self) -> f64 {
        1.0
    }

    /// Word for the kind of work that the parameters select, such as leave-one-line-out fits. `explain --cost`
    /// estimates each kind separately. Empty if there is only one kind.
    fn manner(&self) -> &'static str {
        ""
    }

    /// SQL expressions that select or weight samples, each with the column that it makes. An expression without a
    /// column selects rows. Results over selected samples may disclose a single sample. Default: none.
    fn expressions(&self) -> Vec<(Option<&str>, &str)> {
        vec![]
    }

    /// Whether the model table may contain single samples, as for trees, kernels and networks. Default: false.
    fn memorises(&self) -> bool {
        false
    }
}

/// A stage that processes one line at a time.
pub trait LineStage: Stage {
    /// Data shared by all lines, such as the spline coefficients of a map; `()` for none.
    type Prepared: Send + Sync + 'static;

    /// Builds the data shared by all lines, once. `inputs` holds models and maps; line tables are empty batches. A
    /// stage whose data are `()` needs no implementation; for any other data, a missing implementation is a compile
    /// error.
    ///
    /// # Errors
    /// Fails for a model or map that cannot be used.
    fn prepare(&self, _inputs: &[RecordBatch]) -> Result<Self::Prepared, Fault> {
        const { assert!(size_of::<Self::Prepared>() == 0, "a stage with shared data must implement `prepare`") };
        let unit: Box<dyn Any> = Box::new(());
        unit.downcast().map(|unit| *unit).map_err(|_| Fault::bug("a stage with shared data has no `prepare`"))
    }

    /// The parameters that [`LineStage::prepare`] depends on, in canonical spelling. By default these are all
    /// parameters; a stage can omit some, so that points of a sweep share prepared data.
    fn prepare_key(&self) -> String {
        let mut pairs = vec![];
        self.spell(&mut pairs);
        pairs.iter().map(|(name, value)| format!("{name}={value};")).collect()
    }

    /// Arrays for the columns of [`Stage::yields`], in that order, for one line.
    ///
    /// # Errors
    /// Fails for a line that cannot be computed; the other lines are still computed.
    fn run(&self, line: &LineInput, prepared: &Self::Prepared) -> LineOutput;

    /// Runs several points of a sweep over one line, for stages that share work between points.
    ///
    /// The points are in the order of the plan, and belong to one flight and line. Each point has the columns that its
    /// stage declared, so columns may differ between points. Returns one result per point, in order, bit-identical to
    /// [`LineStage::run`]: a result does not depend on the other points, and a fault of one does not affect the others.
    /// All results are in memory at the same time. A panic aborts the whole call; a caller that needs the other points
    /// catches it and runs them one at a time.
    fn run_points(points: &[LinePoint<Self>]) -> Vec<LineOutput>
    where
        Self: Sized,
    {
        points.iter().map(|point| point.stage.run(point.line, point.prepared)).collect()
    }
}

/// A point of a sweep on one line.
pub struct LinePoint<'a, S: LineStage> {
    /// The stage with the parameters of the point.
    pub stage: &'a S,
    /// The line.
    pub line: &'a LineInput,
    /// The prepared data of the stage.
    pub prepared: &'a S::Prepared,
}

impl<S: LineStage> Clone for LinePoint<'_, S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: LineStage> Copy for LinePoint<'_, S> {}

/// A stage that processes together all lines that its `where` selects.
pub trait SurveyStage: Stage {
    /// Type that gathers the lines.
    type Gather: SurveyAggregator;

    /// Gathers the points of a sweep that use the same lines, to solve them together. A fault in the models or maps of
    /// one point is reported for its table in [`SurveyAggregator::finish`] and does not affect the others.
    fn gather(points: Vec<SurveyPoint<Self>>) -> Self::Gather
    where
        Self: Sized;
}

/// A point of a sweep over the lines of a survey.
pub struct SurveyPoint<'a, S: SurveyStage> {
    /// The stage with the parameters of the point.
    pub stage: &'a S,
    /// Inputs: whole models, maps and records. An empty batch represents each table of lines, which
    /// [`SurveyAggregator::map`] has already read.
    pub inputs: &'a [RecordBatch],
}

impl<S: SurveyStage> Clone for SurveyPoint<'_, S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: SurveyStage> Copy for SurveyPoint<'_, S> {}

/// Points of a survey stage during their computation. `map` may run on many lines concurrently; `finish` receives the
/// parts in the order of the lines.
pub trait SurveyAggregator: Send + Sync + 'static {
    /// The reduction of one line.
    type Part: Send + 'static;

    /// Reduces one line.
    ///
    /// # Errors
    /// Fails for a line that cannot be used; the computation continues without it.
    fn map(&self, line: &LineInput) -> Result<Self::Part, Fault>;

    /// The points that cannot use a reduced line, by position, and the reasons. These points continue without the line.
    /// All points continue without a line that [`SurveyAggregator::map`] rejected.
    fn refused(&self, _part: &Self::Part) -> Vec<(usize, Fault)> {
        vec![]
    }

    /// The table of each point, in the points' order. A computation of minutes keeps its state in `work`, so that an
    /// interrupted run resumes from it and gives the same bytes.
    fn finish(&self, parts: Vec<Self::Part>, work: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>>;
}

/// A stage that processes maps.
pub trait MapStage: Stage {
    /// The columns of [`Stage::yields`]. `maps` are the whole maps, each on its native grid ([`crate::map`]), in the
    /// order of the inputs.
    ///
    /// # Errors
    /// Fails for a map that cannot be computed.
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault>;
}

#[cfg(test)]
mod tests;
