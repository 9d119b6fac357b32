//! The declaration of a stage, and what its author writes.
//!
//! From one [`stage!`](crate::stage!) declaration derive: spec parsing and its messages, plan validation, `explain`,
//! lineage, cache keys, column pruning, `magline stages` and the reference pages.

use std::{any::Any, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch};

use crate::{Args, Column, Fault, Lists, ParamDoc, Params, Reader, Shape, collect_doc, metric::Metric};

/// How much of a survey a stage must see at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grain {
    /// One whole flight line, in time order.
    Line,
    /// Every line that its `where` selects.
    Survey,
    /// Whole maps, and no flight lines.
    Map,
}

impl Grain {
    /// What a stage of this grain yields that does not say so.
    pub const fn usually_yields(self) -> TableKind {
        match self {
            Grain::Line => TableKind::Lines,
            Grain::Survey => TableKind::Model,
            Grain::Map => TableKind::Map,
        }
    }
}

/// The kind of table that a stage yields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableKind {
    /// Flight lines.
    Lines,
    /// A model, or another small table of a whole survey.
    Model,
    /// A map with the columns of [`crate::map::made_columns`].
    Map,
}

/// What a stage reads through one of its inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// A table of flight lines: the line at hand, or each in turn for a survey stage.
    Lines,
    /// One or several such tables.
    ManyLines,
    /// The model table of a fit.
    Model,
    /// An anomaly map.
    Map,
    /// One or several anomaly maps.
    ManyMaps,
    /// A table of scores.
    Scores,
}

/// One input of a stage: the key in the spec that names the table.
#[derive(Clone, Copy, Debug)]
pub struct InputDecl {
    /// The key, such as `input` or `map`.
    pub name: &'static str,
    /// Its kind.
    pub kind: InputKind,
    /// Whether it may be left out.
    pub optional: bool,
}

/// What a table is, seen from the plan.
#[derive(Clone, Debug)]
pub enum Table {
    /// Flight lines with these columns.
    Lines(Shape),
    /// A fitted model with these columns, and the columns of flight lines it must be applied to.
    Model {
        /// The columns of the model table.
        shape: Shape,
        /// The columns a line must have for the model to be applied.
        features: Vec<String>,
    },
    /// An anomaly map.
    Map(Shape),
}

impl Table {
    /// Its columns.
    pub fn shape(&self) -> &Shape {
        match self {
            Table::Lines(s) | Table::Map(s) | Table::Model { shape: s, .. } => s,
        }
    }

    /// The word for it.
    pub fn kind(&self) -> &'static str {
        match self {
            Table::Lines(_) => "a table of flight lines",
            Table::Model { .. } => "a model table",
            Table::Map(_) => "a map",
        }
    }
}

/// Which columns of the first input go on into the stage's own table, row by row.
#[derive(Clone, Debug, PartialEq)]
pub enum Passes {
    /// All of them: the stage appends columns.
    All,
    /// These only; the rows stay the same.
    Only(Vec<String>),
    /// None: the rows are new ones.
    None,
}

/// What a stage reads and yields, given the columns that reach it.
#[derive(Clone, Debug, PartialEq)]
pub struct Yield {
    /// The columns it makes.
    pub columns: Vec<Column>,
    /// What goes through unchanged.
    pub passes: Passes,
    /// The columns it is handed, per input (all inputs, in the declared order).
    pub reads: Vec<Vec<String>>,
    /// Samples per second of what it yields, where it made them even.
    pub rate_hz: Option<f64>,
    /// For a fit: the columns of a line that applying the model takes.
    pub features: Vec<String>,
    /// Whether a line may lack a column that is read: it is then handed over as NaN or null. Otherwise the line fails.
    pub lenient: bool,
    /// Whether the table is small and belongs into one file (models, scores).
    pub tidy: bool,
    /// What the user should know of a choice made automatically.
    pub notes: Vec<String>,
}

impl Yield {
    /// A stage that appends `columns` and reads `reads` of its first input.
    pub fn append<S: AsRef<str>>(columns: Vec<Column>, reads: &[S]) -> Self {
        Self {
            columns,
            passes: Passes::All,
            reads: vec![reads.iter().map(|s| s.as_ref().to_owned()).collect()],
            rate_hz: None,
            features: vec![],
            lenient: false,
            tidy: false,
            notes: vec![],
        }
    }
}

/// Something built once for all lines, such as the spline coefficients of a map.
pub type Prepared = Option<Arc<dyn Any + Send + Sync>>;

/// What a stage is handed for one line: only what it declared.
#[derive(Clone)]
pub struct LineIn {
    /// The flight identifier.
    pub flight: String,
    /// The line identifier.
    pub line: String,
    /// The columns it reads, per input; a model or map comes whole.
    pub inputs: Vec<RecordBatch>,
    /// The rows its `where` selects; all when there is none.
    pub keep: Option<Vec<bool>>,
    /// What [`Stage::prepare`] made.
    pub prepared: Prepared,
}

/// One survey stage at work: `map` may run on many lines at a time, `finish` sees the parts in line order.
pub trait Gather: Send + Sync {
    /// Reduces one line to what the answer needs of it.
    ///
    /// # Errors
    /// When the line cannot be used; the others go on without it.
    fn map(&self, line: &LineIn) -> Result<Box<dyn Any + Send>, Fault>;

    /// Which points cannot use a line that was mapped, by their place, and why. They go on without it, as those of all
    /// points do without a line that [`Gather::map`] refused.
    fn refused(&self, _part: &(dyn Any + Send)) -> Vec<(usize, Fault)> {
        vec![]
    }

    /// The table of each point, in the points' order.
    fn finish(&self, parts: Vec<Box<dyn Any + Send>>) -> Vec<Result<Vec<ArrayRef>, Fault>>;
}

/// What the author of a stage writes.
pub trait Stage: Params + Any + Send + Sync {
    /// The columns it reads and makes, given the tables that reach it.
    ///
    /// # Errors
    /// All that is wrong with the parameters or the tables, before anything runs.
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>>;

    /// Why the parameter `key` has no say beside the others, such as that it belongs to another model than the one that is
    /// fitted; `None` where it has. What has no say is left out of the key, so that points of a sweep which differ in
    /// nothing else are computed once; given outright it is a fault.
    fn idle(&self, _key: &str) -> Option<Fault> {
        None
    }

    /// Arrays for the columns of [`Stage::yields`], in that order, for one line.
    ///
    /// # Errors
    /// When this line cannot be computed; the other lines go on.
    fn run(&self, _line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        Err(Fault::bug("the stage does not work on single lines"))
    }

    /// Arrays for the columns of [`Stage::yields`], in that order, of a stage of [`Grain::Map`]. `maps` are the whole
    /// maps, each on its own grid ([`crate::map`]), in the order of the inputs.
    ///
    /// # Errors
    /// When the map cannot be computed.
    fn run_maps(&self, _maps: &[RecordBatch]) -> Result<Vec<ArrayRef>, Fault> {
        Err(Fault::bug("the stage does not work on maps"))
    }

    /// [`Stage::run`] of several points of a sweep over one line, for a stage that has something to share between them.
    ///
    /// All belong to the same flight and line, in the order of the plan; each has what it declared to read, so the
    /// columns need not be the same. One answer a point, in their order, and with the bits of [`Stage::run`]: what
    /// comes of a point does not depend on its company, and the fault of one leaves the others. All answers are in
    /// memory together. A panic takes the whole call with it: a caller that wants the other points catches it and runs
    /// them one at a time.
    fn run_points(points: &[(&Self, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>> {
        points.iter().map(|(stage, line)| stage.run(line)).collect()
    }

    /// What is the same for all lines, built once. `inputs` holds models and maps; line tables are empty batches.
    ///
    /// # Errors
    /// When a model or map cannot be used.
    fn prepare(&self, _inputs: &[RecordBatch]) -> Result<Prepared, Fault> {
        Ok(None)
    }

    /// The parameters that [`Stage::prepare`] depends on, in one spelling: all, unless a stage narrows them to share
    /// what it prepares between the points of a sweep.
    fn prepare_key(&self) -> String {
        let mut pairs = vec![];
        self.spell(&mut pairs);
        pairs.iter().map(|(name, value)| format!("{name}={value};")).collect()
    }

    /// For survey stages: the points of a sweep that see the same lines, solved together.
    fn gather(_points: Vec<&Self>) -> Option<Box<dyn Gather>> {
        None
    }
}

/// A [`Stage`] whose type is forgotten.
pub trait StageDyn: Send + Sync {
    /// Every parameter in its one spelling, without those that are [idle](Stage::idle).
    fn canonical(&self) -> Vec<(&'static str, String)>;
    /// See [`Stage::idle`].
    fn idle(&self, key: &str) -> Option<Fault>;
    /// See [`Stage::yields`].
    ///
    /// # Errors
    /// As there.
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>>;
    /// See [`Stage::run`].
    ///
    /// # Errors
    /// As there.
    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault>;
    /// See [`Stage::run_maps`].
    ///
    /// # Errors
    /// As there.
    fn run_maps(&self, maps: &[RecordBatch]) -> Result<Vec<ArrayRef>, Fault>;
    /// See [`Stage::run_points`]; `self` stands for the type only. A point that is not of this stage's type is run by
    /// itself.
    fn run_points(&self, points: &[(&dyn StageDyn, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>>;
    /// See [`Stage::prepare`].
    ///
    /// # Errors
    /// As there.
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Prepared, Fault>;
    /// See [`Stage::prepare_key`].
    fn prepare_key(&self) -> String;
    /// See [`Stage::gather`]; `points` are of this stage's type.
    fn gather(&self, points: &[&dyn StageDyn]) -> Option<Box<dyn Gather>>;
    /// For the way back to the type.
    fn as_any(&self) -> &dyn Any;
}

impl<S: Stage> StageDyn for S {
    fn canonical(&self) -> Vec<(&'static str, String)> {
        let mut pairs = vec![];
        self.spell(&mut pairs);
        pairs.retain(|(key, _)| Stage::idle(self, key).is_none());
        pairs
    }
    fn idle(&self, key: &str) -> Option<Fault> {
        Stage::idle(self, key)
    }
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        Stage::yields(self, inputs)
    }
    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        Stage::run(self, line)
    }
    fn run_maps(&self, maps: &[RecordBatch]) -> Result<Vec<ArrayRef>, Fault> {
        Stage::run_maps(self, maps)
    }
    fn run_points(&self, points: &[(&dyn StageDyn, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>> {
        let ours: Vec<(&S, &LineIn)> =
            points.iter().filter_map(|(stage, line)| Some((stage.as_any().downcast_ref::<S>()?, *line))).collect();
        let mut answers = S::run_points(&ours).into_iter();
        let mut answer = |stage: &dyn StageDyn, line: &LineIn| match stage.as_any().is::<S>() {
            true => answers.next().unwrap_or_else(|| stage.run(line)),
            false => stage.run(line),
        };
        points.iter().map(|(stage, line)| answer(*stage, line)).collect()
    }
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Prepared, Fault> {
        Stage::prepare(self, inputs)
    }
    fn prepare_key(&self) -> String {
        Stage::prepare_key(self)
    }
    fn gather(&self, points: &[&dyn StageDyn]) -> Option<Box<dyn Gather>> {
        S::gather(points.iter().filter_map(|p| p.as_any().downcast_ref::<S>()).collect())
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// How a stage is made from its parameters: all that is wrong with them, where they are.
pub type Build = Arc<dyn Fn(&Args) -> Result<Arc<dyn StageDyn>, Vec<Fault>> + Send + Sync>;

/// One row of the catalogue: all that the planner, `explain`, lineage, keys and docs read of a stage.
#[derive(Clone)]
pub struct Entry {
    /// The word after `stage =`.
    pub name: &'static str,
    /// Raised whenever the answer changes.
    pub version: u32,
    /// How much it must see at once.
    pub grain: Grain,
    /// The kind of table that it yields.
    pub yields: TableKind,
    /// Its inputs.
    pub inputs: &'static [InputDecl],
    /// What it does, when you want it, what it refuses, source.
    pub doc: String,
    /// A fragment of a spec that uses it, the table named like the stage. The examples of the catalogue, in its order,
    /// make one spec over a table of flights `flights` and a map `anomaly`; the reference prints them, and the test of
    /// the versions runs them.
    pub example: &'static str,
    /// What can be chosen by one of its keys, such as the models of a fit.
    pub kinds: Vec<KindDoc>,
    /// What a line is scored by, for a stage that makes a table of scores; empty for others.
    pub metrics: Vec<Metric>,
    /// Its parameters.
    pub params: Vec<ParamDoc>,
    /// Makes the stage from its parameters, or says all that is wrong with them.
    pub build: Build,
}

/// One of several things that a key of a stage chooses by name, as the reference shows it.
#[derive(Clone, Debug)]
pub struct KindDoc {
    /// The key that chooses it.
    pub key: &'static str,
    /// Its name.
    pub name: &'static str,
    /// What it does, when you want it, source.
    pub doc: String,
    /// Facts beside its keys, one a line, such as the default of a setting.
    pub facts: Vec<String>,
    /// Its own keys.
    pub params: Vec<ParamDoc>,
    /// Keys, one a line, that the example of the stage takes for this one; may be empty.
    pub example: &'static str,
}

/// What a [`stage!`](crate::stage!) declaration says beside the parameters.
#[doc(hidden)]
pub struct Head {
    pub name: &'static str,
    pub version: u32,
    pub grain: Grain,
    pub yields: TableKind,
    pub inputs: &'static [InputDecl],
    pub doc: &'static [&'static str],
    pub example: &'static str,
}

impl Entry {
    /// The row of a stage `S` whose choices among kinds are made from `lists`.
    #[doc(hidden)]
    pub fn of<S: Stage + Params>(head: Head, lists: Lists) -> Entry {
        let Head { name, version, grain, yields, inputs, doc, example } = head;
        let params = S::docs(&lists);
        let known: Vec<&str> = params.iter().map(|p| p.name).collect();
        let build = move |args: &Args| -> Result<Arc<dyn StageDyn>, Vec<Fault>> {
            let mut reader = Reader::new(name, args, None, &lists);
            let stage = S::read(&mut reader, None);
            let inputs: Vec<&str> = inputs.iter().map(|input| input.name).collect();
            reader.unknown_keys(&known, &inputs);
            let faults = reader.into_faults();
            match stage {
                Some(stage) if faults.is_empty() => Ok(Arc::new(stage)),
                _ => Err(faults),
            }
        };
        let (doc, build) = (collect_doc(doc), Arc::new(build));
        Entry { name, version, grain, yields, inputs, doc, example, kinds: vec![], metrics: vec![], params, build }
    }
}

/// Declares a stage once: name, version, grain, inputs, an example, parameters with unit, default, rule and
/// documentation. A parameter of a type `Option` says what happens where it is left out (`absent`). A stage that yields
/// another kind of table than is usual for its grain says so after the grain: `grain Survey, yields Map`. An input that
/// may be left out is the last: `inputs [map: Map, with: ManyMaps optional]`.
///
/// ```
/// use schemas::{stage, Fault, LineIn, Rule, Stage, Table, Yield};
/// stage! {
///     /// Multiplies a column.
///     Scale = "scale", version 1, grain Line, inputs [input: Lines], example r#"
/// [[stages]]
/// name   = "scale"
/// stage  = "scale"
/// input  = "flights"
/// column = "mag_1_c"
/// "#;
///     /// The column.
///     column: String, unit "";
///     /// The factor.
///     factor: f64, unit "1", default 2.0, rule Rule::Positive;
/// }
/// impl Stage for Scale {
///     fn yields(&self, _: &[&Table]) -> Result<Yield, Vec<Fault>> {
///         Ok(Yield::append(vec![], &[&self.column]))
///     }
///     fn run(&self, _: &LineIn) -> Result<Vec<arrow_array::ArrayRef>, Fault> {
///         Ok(vec![])
///     }
/// }
/// assert_eq!(Scale::entry().name, "scale");
/// ```
#[macro_export]
macro_rules! stage {
    (
        $(#[doc = $d:literal])*
        $Ty:ident = $name:literal, version $v:literal, grain $grain:ident, $(yields $kind_of_table:ident,)?
        inputs [$($inp:ident : $kind:ident $($optional:ident)?),* $(,)?],
        $(groups [$($g:ident : $gt:ty),* $(,)?],)? example $example:literal;
        $(
            $(#[doc = $pd:literal])* $p:ident : $pt:ty, unit $unit:literal
            $(, default $def:expr)? $(, absent $absent:literal)? $(, rule $rule:expr)? ;
        )*
    ) => {
        $crate::params! {
            $(#[doc = $d])*
            pub struct $Ty $(, groups [$($g: $gt),*])?;
            $(
                $(#[doc = $pd])* $p: $pt, unit $unit
                $(, default $def)? $(, absent $absent)? $(, rule $rule)?;
            )*
        }

        impl $Ty {
            /// The name in a spec.
            pub const NAME: &'static str = $name;

            /// The row of the catalogue.
            pub fn entry() -> $crate::Entry {
                Self::entry_with($crate::Lists::default())
            }

            /// The row of the catalogue, with what its keys choose from.
            pub fn entry_with(lists: $crate::Lists) -> $crate::Entry {
                let head = $crate::Head {
                    name: $name,
                    version: $v,
                    grain: $crate::Grain::$grain,
                    yields: $crate::first([
                        $($crate::TableKind::$kind_of_table,)?
                        $crate::Grain::$grain.usually_yields(),
                    ]).unwrap_or($crate::Grain::$grain.usually_yields()),
                    inputs: const { &[$($crate::InputDecl {
                        name: stringify!($inp),
                        kind: $crate::InputKind::$kind,
                        optional: $crate::is_optional(&[$(stringify!($optional))?]),
                    }),*] },
                    doc: &[$($d),*],
                    example: $example,
                };
                $crate::Entry::of::<Self>(head, lists)
            }
        }
    };
}

/// Whether an input is followed by a word; the only one there is says that it may be left out.
#[doc(hidden)]
pub const fn is_optional(words: &[&str]) -> bool {
    !words.is_empty()
}

#[cfg(test)]
mod tests;
