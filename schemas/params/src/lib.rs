//! Typed parameters: declared once by [`params!`], read from TOML with the position of every key, checked, documented,
//! and spelt canonically for the keys of results.
//!
//! A group of parameters is a struct whose fields have a unit, default, rule and documentation. Groups nest
//! ([`NestedParams`], [`ParamsList`]) and can be shared (`groups`). They hold choices among words ([`choice!`]) or
//! among [kinds](ChoiceKind) with their own keys ([`ChoiceSelection`]), such as the models of a fit. Every user error
//! becomes a [`Fault`] with its position and a remedy.

mod fault;
mod group;
mod kind;
mod literal;
mod nested;
pub mod paths;
mod section;
mod value;
mod visible;

pub use fault::{DataLocation, Fault, FaultOwner, nearest, render};
pub use group::{Param, ParamDoc, ParamReader, Params, collect_doc, first, no_text, obeys, words_rule};
pub use kind::{ChoiceKeys, ChoiceKind, ChoiceList, ChoiceRegistry, ChoiceSelection, ChoiceSubset};
pub use literal::{Literal, Rule};
pub use nested::{NestedParams, ParamsList};
pub use section::{SpecEntries, SpecEntry, SpecSection, literal};
pub use value::{NumberOrAuto, ParamValue, VerbatimText};
pub use visible::{one_line, visible};
