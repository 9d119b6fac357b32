//! The contract of magline: columns, units, roles, parameters, faults and the stage declaration.
//!
//! All other crates depend on this one. It uses Arrow types and TOML spans, but no files, plans or
//! numerics.

pub mod canonical;
pub mod casting;
mod column;
mod column_list;
pub mod flight;
pub mod keys;
pub mod map;
pub mod metric;
pub mod plausible;
mod removed;
mod sampling;
mod stage;
mod unit;

pub use column::{Column, ColumnDescription, ColumnType, Role, TableShape, describe_field, field};
pub use column_list::ColumnList;
pub use params::{
    ChoiceKeys, ChoiceKind, ChoiceList, ChoiceRegistry, ChoiceSelection, ChoiceSubset, DataLocation, Fault, FaultOwner,
    Literal, NestedParams, NumberOrAuto, Param, ParamDoc, ParamReader, ParamValue, Params, ParamsList, Rule,
    SpecEntries, SpecEntry, SpecSection, VerbatimText, choice, collect_doc, first, literal, nearest, no_text, obeys,
    one_line, params, paths, render, visible, words_rule,
};
pub use removed::{CorrectionSet, MagneticCorrection};
pub use sampling::{RateDependence, RateLaw, is_same_rate};
pub use stage::{
    AnyLinePart, AnyLinePoint, AnySharedData, AnyStage, AnySurveyPoint, CheckpointMonitor, ChoiceDoc, Grain, InputDecl,
    InputKind, LineInput, LineOutput, LinePoint, LineStage, LineStageDyn, MapStage, MapStageDyn, NullMonitor,
    PassThroughColumns, Stage, StageBuilder, StageDyn, StageEntry, StageHeader, StageOutput, StageRole, StageSchema,
    SurveyAggregator, SurveyAggregatorDyn, SurveyPoint, SurveyStage, SurveyStageDyn, Table, TableKind, is_optional,
};
pub use unit::{convert, convertible_to, is_unit, usual_spelling};
