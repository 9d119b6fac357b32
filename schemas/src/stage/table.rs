//! Tables in a plan: the inputs and the yield of a stage.

use crate::{Column, TableShape};

/// The part of a survey that a stage processes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grain {
    /// One whole flight line, in time order.
    Line,
    /// Every line that the stage's `where` selects.
    Survey,
    /// Whole maps, and no flight lines.
    Map,
}

impl Grain {
    /// The default kind of table that a stage of this grain yields.
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
    /// Scores of flight lines, a row for each metric.
    Scores,
    /// A map with the columns of [`crate::map::made_columns`].
    Map,
}

impl TableKind {
    /// Whether a table of this kind is small, with a few rows for each point of a sweep: all points are then in one
    /// file.
    pub const fn is_small(self) -> bool {
        match self {
            TableKind::Model | TableKind::Scores => true,
            TableKind::Lines | TableKind::Map => false,
        }
    }
}

/// The purpose of a stage, by which views of results find its tables. Stages without such a view have no role.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageRole {
    /// Fits a model of the aircraft field.
    FitsModel,
    /// Subtracts the aircraft field from a measurement.
    Compensates,
    /// Ranks the inputs of a model.
    RanksInputs,
    /// Estimates a track from measurements.
    EstimatesTrack,
    /// Reads a map along a line.
    ReadsMap,
    /// Scores lines.
    Scores,
    /// Pools the scores of lines.
    PoolsScores,
}

/// The kind of table that an input of a stage reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// A table of flight lines. A line stage receives the current line, and a survey stage each line in turn.
    Lines,
    /// One or several tables of flight lines.
    ManyLines,
    /// The model table of a fit.
    Model,
    /// One or several model tables.
    ManyModels,
    /// An anomaly map.
    Map,
    /// One or several anomaly maps.
    ManyMaps,
    /// A table of scores.
    Scores,
    /// A table of flight lines, all of which are available to each line of the other inputs, such as the days of a
    /// station's record. [`crate::LineStage::prepare`] receives the columns of all its lines together, in the order of
    /// flight and line.
    Record,
    /// One or several tables as for [`InputKind::Record`].
    ManyRecords,
}

impl InputKind {
    /// Whether the stage receives the current line of this input. The stage processes the lines that exist in all such
    /// inputs.
    pub const fn is_by_line(self) -> bool {
        match self {
            InputKind::Lines | InputKind::ManyLines | InputKind::Scores => true,
            InputKind::Model
            | InputKind::ManyModels
            | InputKind::Map
            | InputKind::ManyMaps
            | InputKind::Record
            | InputKind::ManyRecords => false,
        }
    }

    /// Whether all lines of this input are available to each line of the other inputs.
    pub const fn is_record(self) -> bool {
        matches!(self, InputKind::Record | InputKind::ManyRecords)
    }

    /// Whether this input may be several tables.
    pub const fn is_many(self) -> bool {
        match self {
            InputKind::ManyLines | InputKind::ManyModels | InputKind::ManyMaps | InputKind::ManyRecords => true,
            InputKind::Lines | InputKind::Model | InputKind::Map | InputKind::Scores | InputKind::Record => false,
        }
    }
}

/// One input of a stage: the key in the spec that names the table.
#[derive(Clone, Copy, Debug)]
pub struct InputDecl {
    /// The key, such as `input` or `map`.
    pub name: &'static str,
    /// Kind.
    pub kind: InputKind,
    /// Whether it is optional.
    pub optional: bool,
}

/// A table in the plan.
#[derive(Clone, Debug)]
pub enum Table {
    /// Flight lines with these columns.
    Lines(TableShape),
    /// A fitted model with these columns, and the columns that it requires of a flight line.
    Model {
        /// The columns of the model table.
        shape: TableShape,
        /// The columns that a line needs for the model to be applied.
        features: Vec<String>,
    },
    /// Scores of flight lines.
    Scores(TableShape),
    /// An anomaly map.
    Map(TableShape),
}

impl Table {
    /// Columns.
    pub fn shape(&self) -> &TableShape {
        match self {
            Table::Lines(s) | Table::Scores(s) | Table::Map(s) | Table::Model { shape: s, .. } => s,
        }
    }

    /// Word for the kind of table.
    pub fn kind(&self) -> &'static str {
        match self {
            Table::Lines(_) => "a table of flight lines",
            Table::Model { .. } => "a model table",
            Table::Scores(_) => "a table of scores",
            Table::Map(_) => "a map",
        }
    }
}

/// Columns of the first input that the stage's table keeps, row by row.
#[derive(Clone, Debug, PartialEq)]
pub enum PassThroughColumns {
    /// All columns: the stage appends columns.
    All,
    /// Only these columns; the rows are unchanged.
    Only(Vec<String>),
    /// No columns, because the rows are new.
    None,
}

/// The columns that a stage reads and yields, given its inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct StageSchema {
    /// The columns that the stage makes.
    pub columns: Vec<Column>,
    /// The columns that pass through unchanged.
    pub passes: PassThroughColumns,
    /// The columns that the stage reads, per input (all inputs, in the declared order).
    pub reads: Vec<Vec<String>>,
    /// Sample rate of the result, in Hz, if the stage makes the sampling even.
    pub rate_hz: Option<f64>,
    /// For a fit: the columns that a line needs for the model to be applied.
    pub features: Vec<String>,
    /// Whether a line may lack a column that is read. The column is then NaN or null; otherwise the line fails.
    pub lenient: bool,
    /// Notes on automatic choices.
    pub notes: Vec<String>,
}

impl StageSchema {
    /// A stage that appends `columns` and reads `reads` of its first input.
    pub fn append<S: AsRef<str>>(columns: Vec<Column>, reads: &[S]) -> Self {
        Self {
            columns,
            passes: PassThroughColumns::All,
            reads: vec![reads.iter().map(|s| s.as_ref().to_owned()).collect()],
            rate_hz: None,
            features: vec![],
            lenient: false,
            notes: vec![],
        }
    }
}
