//! The contract of magline: columns, units, roles, parameters, faults and the stage declaration.
//!
//! Everything else depends on this crate; it knows Arrow types and TOML spans, and nothing of files, plans or
//! numerics.

pub mod canonical;
mod column;
mod fault;
pub mod flight;
pub mod map;
pub mod metric;
pub mod plausible;
mod stage;
mod unit;
mod value;

pub use column::{Column, ColumnType, Described, Role, Shape, describe_field, field};
pub use fault::{Fault, Owner, Place, nearest, render};
pub use stage::{
    Args, Build, Declared, Entry, Gather, Given, Grain, InputDecl, InputKind, LineIn, ParamDoc, Passes, Prepared,
    Stage, StageDyn, Table, TableKind, Yield, collect_doc, is_optional, read_param, unknown_keys, words_rule,
};
pub use unit::{convert, convertible_to, is_unit, usual_spelling};
pub use value::{Literal, OrAuto, Rule, Value};
