//! The contract of magline: columns, units, roles, parameters, faults and the stage declaration.
//!
//! All other crates depend on this one. It uses Arrow types and TOML spans, but no files, plans or
//! numerics.

pub mod canonical;
mod column;
pub mod flight;
pub mod map;
pub mod metric;
pub mod plausible;
mod removed;
mod sampling;
mod stage;
mod unit;

pub use column::{Column, ColumnType, Described, Role, Shape, describe_field, field};
pub use params::{
    Args, Chosen, Fault, Given, Kind, Kinds, Lists, Literal, Nested, OrAuto, Own, Owner, Param, ParamDoc, Params,
    Place, Reader, Rule, Section, Sections, Several, Value, Word, choice, collect_doc, first, literal, nearest,
    no_text, obeys, one_line, params, paths, render, visible, words_rule,
};
pub use removed::{Correction, Removed};
pub use sampling::{RateLaw, Sampling, is_same_rate};
pub use stage::{
    AnyLinePoint, AnyStage, AnySurveyPoint, Arrays, Build, Entry, Gather, GatherDyn, Grain, Head, InputDecl, InputKind,
    KindDoc, LineIn, LinePoint, LineStage, LineStageDyn, MapStage, MapStageDyn, Part, Passes, Prepared, Product, Stage,
    StageDyn, SurveyPoint, SurveyStage, SurveyStageDyn, Table, TableKind, Unattended, Work, Yield, is_optional,
};
pub use unit::{convert, convertible_to, is_unit, usual_spelling};
