//! The declaration of a stage, and what its author writes.
//!
//! From one [`stage!`](crate::stage!) declaration derive: spec parsing and its messages, plan validation, `explain`,
//! lineage, cache keys, column pruning, `magline stages` and the reference pages. Its author writes [`Stage`] and, by
//! what the stage works on, [`LineStage`], [`SurveyStage`] or [`MapStage`]; a run works with [`AnyStage`].

mod entry;
mod erased;
mod table;
mod work;

use std::any::Any;

use arrow_array::{ArrayRef, RecordBatch};

pub use self::{
    entry::{Build, Entry, Head, KindDoc, is_optional},
    erased::{
        AnyLinePoint, AnyStage, AnySurveyPoint, Arrays, GatherDyn, LineStageDyn, MapStageDyn, Part, Prepared, StageDyn,
        SurveyStageDyn,
    },
    table::{Grain, InputDecl, InputKind, Passes, Table, TableKind, Yield},
    work::{Unattended, Work},
};
use crate::{Fault, Params};

/// What a stage is handed for one line: only what it declared.
#[derive(Clone)]
pub struct LineIn {
    /// The flight identifier.
    pub flight: String,
    /// The line identifier.
    pub line: String,
    /// The columns it reads, per input; models and maps are empty batches, since [`LineStage::prepare`] sees
    /// them.
    pub inputs: Vec<RecordBatch>,
    /// The rows its `where` selects; all when there is none.
    pub keep: Option<Vec<bool>>,
}

/// What a survey or map stage makes of all that it works on.
#[derive(Clone, Debug)]
pub struct Product {
    /// Arrays for the columns of [`Stage::yields`], in that order.
    pub columns: Vec<ArrayRef>,
    /// What is not to be trusted as it is, a sentence each: rows of the table `warnings`.
    pub warnings: Vec<String>,
}

impl From<Vec<ArrayRef>> for Product {
    fn from(columns: Vec<ArrayRef>) -> Product {
        Product { columns, warnings: vec![] }
    }
}

/// What the author of every stage writes.
pub trait Stage: Params + Any + Send + Sync {
    /// The columns it reads and makes, given the tables that reach it.
    ///
    /// # Errors
    /// All that is wrong with the parameters or the tables, before anything runs.
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>>;

    /// Why the parameter `key` has no effect beside the others, such as that it belongs to another model than the one that
    /// is fitted; `None` where it has. What has no effect is left out of the key, so that points of a sweep which differ in
    /// nothing else are computed once; given outright it is a fault.
    fn idle(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// How much work a sample is, in any unit that does not depend on the parameters: where some of them multiply it, such
    /// as a number of particles, their product. `explain --cost` scales measured seconds by it.
    fn effort(&self) -> f64 {
        1.0
    }

    /// A word for the way in which the parameters have the work done, where it is work of another kind: a fit that leaves out
    /// each line in turn. `explain --cost` prices it by itself. Empty where there is one way.
    fn manner(&self) -> &'static str {
        ""
    }

    /// Expressions in SQL that select or weight samples, each with the column that it makes; without a column it selects
    /// rows. What is computed over such samples may be a single sample. Default: none.
    fn expressions(&self) -> Vec<(Option<&str>, &str)> {
        vec![]
    }

    /// Whether the table of what it learns may contain single samples, as trees, kernels and networks do. Default: false.
    fn memorises(&self) -> bool {
        false
    }
}

/// A stage that works on one line at a time.
pub trait LineStage: Stage {
    /// What is the same for all lines, such as the spline coefficients of a map; `()` where there is nothing.
    type Prepared: Send + Sync + 'static;

    /// What is the same for all lines, built once. `inputs` holds models and maps; line tables are empty batches.
    ///
    /// # Errors
    /// When a model or map cannot be used.
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Self::Prepared, Fault>;

    /// The parameters that [`LineStage::prepare`] depends on, in one spelling: all, unless a stage narrows them to share
    /// what it prepares between the points of a sweep.
    fn prepare_key(&self) -> String {
        let mut pairs = vec![];
        self.spell(&mut pairs);
        pairs.iter().map(|(name, value)| format!("{name}={value};")).collect()
    }

    /// Arrays for the columns of [`Stage::yields`], in that order, for one line.
    ///
    /// # Errors
    /// When this line cannot be computed; the other lines go on.
    fn run(&self, line: &LineIn, prepared: &Self::Prepared) -> Arrays;

    /// [`LineStage::run`] of several points of a sweep over one line, for a stage that has something to share between
    /// them.
    ///
    /// All belong to the same flight and line, in the order of the plan; each has what it declared to read, so the
    /// columns need not be the same. One answer a point, in their order, and with the bits of [`LineStage::run`]: what
    /// comes of a point does not depend on its company, and the fault of one leaves the others. All answers are in
    /// memory together. A panic takes the whole call with it: a caller that wants the other points catches it and runs
    /// them one at a time.
    fn run_points(points: &[LinePoint<Self>]) -> Vec<Arrays>
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
    pub line: &'a LineIn,
    /// What the stage prepared.
    pub prepared: &'a S::Prepared,
}

impl<S: LineStage> Clone for LinePoint<'_, S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: LineStage> Copy for LinePoint<'_, S> {}

/// A stage that works on all lines of a survey that its `where` selects.
pub trait SurveyStage: Stage {
    /// How the lines are gathered.
    type Gather: Gather;

    /// The points of a sweep that see the same lines, solved together. What is wrong with the models or maps of one point
    /// is a fault of its table in [`Gather::finish`], and leaves the others.
    fn gather(points: Vec<SurveyPoint<Self>>) -> Self::Gather
    where
        Self: Sized;
}

/// A point of a sweep over the lines of a survey.
pub struct SurveyPoint<'a, S: SurveyStage> {
    /// The stage with the parameters of the point.
    pub stage: &'a S,
    /// Its inputs: models, maps and records whole; tables of lines are empty batches, since [`Gather::map`] sees them.
    pub inputs: &'a [RecordBatch],
}

impl<S: SurveyStage> Clone for SurveyPoint<'_, S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: SurveyStage> Copy for SurveyPoint<'_, S> {}

/// Points of a survey stage at work: `map` may run on many lines at a time, `finish` sees the parts in line order.
pub trait Gather: Send + Sync + 'static {
    /// What the answers need of one line.
    type Part: Send + 'static;

    /// Reduces one line to what the answers need of it.
    ///
    /// # Errors
    /// When the line cannot be used; the others go on without it.
    fn map(&self, line: &LineIn) -> Result<Self::Part, Fault>;

    /// Which points cannot use a line that was mapped, by their place, and why. They go on without it, as those of all
    /// points do without a line that [`Gather::map`] refused.
    fn refused(&self, _part: &Self::Part) -> Vec<(usize, Fault)> {
        vec![]
    }

    /// The table of each point, in the points' order. What takes minutes keeps its state in `work`, so that a run that
    /// is killed goes on from there, to the same bytes.
    fn finish(&self, parts: Vec<Self::Part>, work: &dyn Work) -> Vec<Result<Product, Fault>>;
}

/// A stage that works on maps.
pub trait MapStage: Stage {
    /// The columns of [`Stage::yields`]. `maps` are the whole maps, each on its own grid ([`crate::map`]), in the order of
    /// the inputs.
    ///
    /// # Errors
    /// When the map cannot be computed.
    fn run(&self, maps: &[RecordBatch]) -> Result<Product, Fault>;
}

#[cfg(test)]
mod tests;
